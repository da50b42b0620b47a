"""Tables and the figure of the tracking benchmark, from its rows alone."""

from matplotlib.figure import Figure

from mixer_torch.benchmarks import peers, report, results

SHOWN = ("HOTA", "AssA", "IDF1")
OURS = ("MIXER", "MIXER online")
ORACLE = "oracle"
COLORS = {
    "MIXER": "#111318",
    "MIXER online": "#5b6472",
    "SORT": "#8fb8de",
    "ByteTrack": "#3f88c5",
    "OC-SORT": "#44a08d",
    "C-BIoU": "#7a5195",
    "norfair": "#e0a458",
    "ARC-SORT": "#c0392b",
    "oracle": "#b9bec7",
}


def make(out):
    """Tables and the figure from the rows in a folder; the Markdown comes back."""
    rows = results.read(out / "rows.csv")
    speed = results.read(out / "speed.csv")
    together = [row for row in rows if row["sequence"] == "combined"]
    families = list(dict.fromkeys(row["family"] for row in together))
    text = [*table_of_families(together, families)]
    for family in families:
        text += by_sequence([row for row in rows if row["family"] == family], family)
    text += speed_table(speed)
    if absent := [name for name in peers.PEERS if name not in {row["tracker"] for row in rows}]:
        text.append(f"\nNot installed, so left out: {', '.join(absent)} (`make peers`).")
    (out / "table.md").write_text("\n".join(text) + "\n")
    figure_of_families(together, families, out / "tracking")
    return "\n".join(text) + "\n"


def table_of_families(together, families):
    """HOTA / AssA / IDF1 of each tracker on each family; bold: the best of those not told."""
    lines = [
        f"{' / '.join(SHOWN)} of each family, all sequences together. What is shown of MIXER was "
        "learned on the other families.",
        "",
        "| | " + " | ".join(families) + " |",
        "|---|" + "---:|" * len(families),
    ]
    found = {(row["tracker"], row["family"]): row for row in together}
    names = list(dict.fromkeys(row["tracker"] for row in together))
    best = {
        (family, key): max(
            found[name, family][key] for name in names if name != ORACLE and (name, family) in found
        )
        for family in families
        for key in SHOWN
    }
    for name in names:
        cells = [_cell(found.get((name, family)), family, best) for family in families]
        label = f"**{name}**" if name in OURS else name
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _cell(row, family, best):
    if row is None:
        return "–"
    figures = []
    for key in SHOWN:
        text = f"{row[key]:.1f}"
        leads = row["tracker"] != ORACLE and row[key] == best[family, key]
        figures.append(f"**{text}**" if leads else text)
    return " / ".join(figures)


def by_sequence(rows, family):
    """HOTA and ID switches of each tracker on each sequence of a family, and frames a second."""
    names = list(dict.fromkeys(row["sequence"] for row in rows))
    lines = [
        f"### {family}",
        "",
        "| HOTA (ID switches) | " + " | ".join(names) + " | frames/s |",
        "|---|" + "---:|" * (len(names) + 1),
    ]
    for (tracker,), group in results.grouped(rows, "tracker").items():
        found = {row["sequence"]: f"{row['HOTA']:.1f} ({row['IDSW']:.0f})" for row in group}
        whole = next(row for row in group if row["sequence"] == "combined")
        speed = f"{whole['frames'] / whole['seconds']:.0f}" if whole["seconds"] != "" else ""
        cells = " | ".join(found[name] for name in names)
        lines.append(f"| {tracker} | {cells} | {speed} |")
    return [*lines, ""]


def speed_table(rows):
    """Time, memory and quality on crowds, against their density and length."""
    lines = [
        f"### Crowds ({results.machine()})",
        "",
        "| | boxes a frame | frames | frames/s | MiB | HOTA | IDF1 | median ms | 99 % ms |",
        "|---|" + "---:|" * 8,
    ]
    for row in rows:
        latency = [
            f"{row[key]:.1f}" if row[key] != "" else ""
            for key in ("latency_median_ms", "latency_p99_ms")
        ]
        lines.append(
            f"| {row['tracker']} | {row['detections'] / row['frames']:.0f} "
            f"| {row['frames']:.0f} | {row['frames'] / row['seconds']:.0f} "
            f"| {row['peak_mib']:.0f} | {row['HOTA']:.1f} | {row['IDF1']:.1f} "
            f"| {' | '.join(latency)} |"
        )
    return [*lines, ""]


def figure_of_families(together, families, path):
    """HOTA of each tracker on each family, as bars; a line where perfect identities would be."""
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    axes = figure.subplots()
    names = [n for n in dict.fromkeys(row["tracker"] for row in together) if n != ORACLE]
    found = {(row["tracker"], row["family"]): row["HOTA"] for row in together}
    width = 0.84 / max(len(names), 1)
    for k, name in enumerate(names):
        place = [i + (k - (len(names) - 1) / 2) * width for i in range(len(families))]
        values = [found.get((name, family), 0) for family in families]
        axes.bar(place, values, width * 0.92, color=COLORS.get(name), label=name)
    for i, family in enumerate(families):
        if (ORACLE, family) in found:
            label = "same detections, true identities" if i == 0 else None
            axes.hlines(found[ORACLE, family], i - 0.45, i + 0.45, "#888", "--", label=label)
    axes.set_xticks(range(len(families)), families)
    axes.set(ylabel="HOTA, %", ylim=(0, 100))
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=5, frameon=False, fontsize=8)
    report.save(figure, path)

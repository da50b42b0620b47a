"""Tables and figures of the tracking benchmark, from its rows alone."""

from matplotlib.figure import Figure

from mixer_torch.benchmarks import peers, report, results

TIME_LIMIT, FRAMES_LIMIT = 120, 1000  # seconds for how many frames of 50 detections
SHOWN = ("HOTA", "AssA", "DetA", "IDF1", "MOTA")
COLORS = {
    "MIXER": "#111318",
    "MIXER online": "#5b6472",
    "SORT": "#8fb8de",
    "ByteTrack": "#3f88c5",
    "OC-SORT": "#44a08d",
    "norfair": "#e0a458",
    "oracle": "#b9bec7",
}


def make(out):
    """Tables and figures from the rows in a folder; the Markdown comes back."""
    rows = results.read(out / "rows.csv")
    speed = results.read(out / "speed.csv")
    text = "\n".join(
        [
            *combined(rows),
            *by_sequence(rows, "IDF1"),
            *by_sequence(rows, "IDSW"),
            *latency(rows),
            *speed_table(speed),
        ]
    )
    if absent := [name for name in peers.PEERS if name not in {row["tracker"] for row in rows}]:
        text += f"\nNot installed, so left out: {', '.join(absent)} (`make peers`).\n"
    (out / "table.md").write_text(text)
    accuracy_figure(rows, out / "tracking")
    speed_figure(speed, out / "speed")
    return text


def combined(rows):
    """All sequences together: metrics, and what they cost."""
    together = [row for row in rows if row["sequence"] == "combined"]
    first = together[0]
    places = len({row["sequence"] for row in rows}) - 1
    lines = [
        f"## {places} sequences, {first['frames']:.0f} frames, "
        f"{first['detections']:.0f} detections",
        "",
        "Bold: best of those that are not told the truth.",
        "",
        "| | " + " | ".join((*SHOWN, "ID switches", "frames/s", "MiB")) + " |",
        "|---|" + "---:|" * (len(SHOWN) + 3),
    ]
    told = [row for row in together if row["tracker"] != "oracle"]
    for row in together:
        cells = []
        for key, best in [*((key, max) for key in SHOWN), ("IDSW", min)]:
            cell = f"{row[key]:.0f}" if key == "IDSW" else f"{row[key]:.1f}"
            leads = row in told and row[key] == best(other[key] for other in told)
            cells.append(f"**{cell}**" if leads else cell)
        timed = row["seconds"] != ""
        cells.append(f"{row['frames'] / row['seconds']:.0f}" if timed else "")
        cells.append(f"{row['peak_mib']:.0f}" if timed else "")
        lines.append(f"| {row['tracker']} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def by_sequence(rows, key):
    """One metric of each tracker on each sequence."""
    names = list(dict.fromkeys(row["sequence"] for row in rows))
    lines = [f"| {key} | " + " | ".join(names) + " |", "|---|" + "---:|" * len(names)]
    digits = 0 if key == "IDSW" else 1
    for (tracker,), group in results.grouped(rows, "tracker").items():
        found = {row["sequence"]: f"{row[key]:.{digits}f}" for row in group}
        lines.append(f"| {tracker} | " + " | ".join(found[name] for name in names) + " |")
    return [*lines, ""]


def latency(rows):
    """How long after a frame its answer is there, of those who answer frame by frame."""
    told = [row for row in rows if row["latency_median_ms"] != ""]
    if not told:
        return []
    lines = [
        "| latency of a frame | sequence | median, ms | 95 %, ms | highest, ms |",
        "|---|---|---:|---:|---:|",
    ]
    for row in told:
        figures = [f"{row[key]:.1f}" for key in row if key.startswith("latency")]
        lines.append(f"| {row['tracker']} | {row['sequence']} | " + " | ".join(figures) + " |")
    return [*lines, ""]


def speed_table(rows):
    """Time, memory and quality on crowds, against the number of frames."""
    each = rows[0]["detections"] / rows[0]["frames"]
    lines = [
        f"## Crowds of {each:.0f} detections a frame ({results.machine()})",
        "",
        "| | frames | s | ms a frame | MiB | HOTA | IDF1 |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        lines.append(
            f"| {row['tracker']} | {row['frames']:.0f} | {row['seconds']:.1f} "
            f"| {1000 * row['seconds'] / row['frames']:.1f} | {row['peak_mib']:.0f} "
            f"| {row['HOTA']:.1f} | {row['IDF1']:.1f} |"
        )
    return [*lines, ""]


def accuracy_figure(rows, path):
    """Metrics of all sequences as bars, and IDF1 of each sequence as points."""
    together = [row for row in rows if row["sequence"] == "combined"]
    figure = Figure(figsize=(10.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2.4))
    told = [row for row in together if row["tracker"] != "oracle"]
    width = 0.84 / len(told)
    keys = ("HOTA", "AssA", "IDF1", "MOTA")
    for k, row in enumerate(told):
        place = [i + (k - (len(told) - 1) / 2) * width for i in range(len(keys))]
        values = [row[key] for key in keys]
        name = row["tracker"]
        left.bar(place, values, width * 0.92, color=COLORS.get(name), label=name)
        for x, value in zip(place, values, strict=True):
            ink = "white" if name.startswith("MIXER") else "#111318"
            left.text(x, value - 3.2, f"{value:.0f}", ha="center", fontsize=7, color=ink)
    for row in (row for row in together if row["tracker"] == "oracle"):
        for i, key in enumerate(keys):
            label = "oracle: same detections, true identities" if i == 0 else None
            left.hlines(row[key], i - 0.45, i + 0.45, "#888", "--", linewidth=1.2, label=label)
    left.set_xticks(range(len(keys)), keys)
    left.set(ylabel="%", title="all sequences")
    _points(rows, right)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=8
    )
    report.save(figure, path)


def _points(rows, axes):
    """IDF1 of each tracker on each sequence, the sequences below one another."""
    names = list(dict.fromkeys(row["sequence"] for row in rows if row["sequence"] != "combined"))
    for (tracker,), group in results.grouped(rows, "tracker").items():
        found = {row["sequence"]: row["IDF1"] for row in group}
        ours = tracker.startswith("MIXER")
        axes.plot(
            [found[name] for name in names],
            range(len(names)),
            "|" if tracker == "oracle" else "D" if ours else "o",
            color=COLORS.get(tracker),
            markersize=14 if tracker == "oracle" else 7,
            markeredgewidth=2 if tracker == "oracle" else 0.6,
            markeredgecolor=None if tracker == "oracle" else "white",
            zorder=3 if ours else 2,
        )
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set(xlabel="IDF1, %", title="each sequence")
    axes.grid(axis="both", alpha=0.25, linewidth=0.6)
    axes.tick_params(axis="y", length=0)


def speed_figure(rows, path):
    """Time per frame and memory against the length of the sequence."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    panels = figure.subplots(1, 2)
    for (tracker,), group in results.grouped(rows, "tracker").items():
        frames = [row["frames"] for row in group]
        style = {
            "color": COLORS.get(tracker),
            "label": tracker,
            "marker": "D" if tracker.startswith("MIXER") else "o",
            "linewidth": 2.4 if tracker == "MIXER" else 1.4,
            "markersize": 5,
        }
        panels[0].plot(frames, [1000 * row["seconds"] / row["frames"] for row in group], **style)
        panels[1].plot(frames, [row["peak_mib"] for row in group], **style)
    limit = 1000 * TIME_LIMIT / FRAMES_LIMIT
    panels[0].axhline(limit, color="#c0392b", linestyle=":", linewidth=1.2)
    panels[0].annotate(
        f"{TIME_LIMIT} s for {FRAMES_LIMIT} frames", (1, limit), (-4, 4), color="#c0392b",
        xycoords=("axes fraction", "data"), textcoords="offset points", ha="right", fontsize=8,
    )  # fmt: skip
    lengths = sorted({row["frames"] for row in rows})
    for axes, (name, title) in zip(
        panels, (("ms a frame", "time"), ("MiB", "peak memory of the process")), strict=True
    ):
        axes.set(xscale="log", xlabel="frames of about 50 detections", ylabel=name, title=title)
        axes.set_xticks(lengths, [f"{length:.0f}" for length in lengths], fontsize=8)
        axes.xaxis.minorticks_off()
        axes.grid(alpha=0.25, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_yscale("log")
    panels[0].yaxis.set_major_formatter("{x:g}")
    panels[1].set_ylim(bottom=0)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=8
    )
    report.save(figure, path)

"""Tables and figures of the comparisons, from their rows alone."""

from mixer_torch.benchmarks.results import grouped, machine, mean, spread

PAPER = {
    "All-pairs": ((0.47, 0.41), (0.75, 0.50), (0.11, 0.71), (0.08, 1.00), (0.08, 1.00)),
    "Consecutive": ((0.47, 0.41), (0.93, 0.29), (0.27, 0.45), (0.57, 0.43), (0.68, 0.43)),
    "Spectral": ((0.13, 0.42), (0.15, 0.51), (0.14, 0.45), (0.29, 0.63), (0.35, 0.62)),
    "MatchLift": ((0.83, 0.24), (0.83, 0.34), (0.34, 0.17), (0.51, 0.83), (0.51, 0.72)),
    "QuickMatch": ((0.92, 0.20), (0.97, 0.24), (0.18, 0.32), (0.20, 0.36), (0.29, 0.34)),
    "CLEAR": ((0.56, 0.21), (0.14, 0.58), (0.13, 0.41), (0.30, 0.75), (0.28, 0.77)),
    "MIXER (published)": ((0.88, 0.35), (0.85, 0.45), (0.13, 0.35), (0.85, 0.62), (0.88, 0.82)),
}
"""Precision and recall of Lusk et al. 2021, Table II: bbox, proximity, colour, SIFT, combined."""


def cells(rows, columns):
    """By algorithm and column: precision, recall, F1 and its spread, over the seeds."""
    found = {}
    for (algorithm, modalities), group in grouped(rows, "algorithm", "modalities").items():
        if modalities in columns:
            averages = tuple(mean(group, key) for key in ("precision", "recall", "f1"))
            found[algorithm, modalities] = (*averages, spread(group, "f1"))
    return found


def best(found, columns):
    """The algorithm of the highest F1 in each column, and (algorithm, column) of the highest."""
    algorithms = {algorithm for algorithm, _ in found}
    of_column = {
        column: max(sorted(algorithms), key=lambda a: found[a, column][2]) for column in columns
    }
    overall = max(found, key=lambda key: found[key][2])
    return of_column, overall


def _cells_as_text(rows, columns, bold, underline, pattern):
    found = cells(rows, columns)
    of_column, overall = best(found, columns)
    for algorithm in dict.fromkeys(algorithm for algorithm, _ in found):
        texts = []
        for column in columns:
            text = pattern.format(*found[algorithm, column])
            text = bold.format(text) if of_column[column] == algorithm else text
            texts.append(underline.format(text) if overall == (algorithm, column) else text)
        yield algorithm, texts


def markdown_table(dataset, rows, columns, paper):
    """Precision/recall and F1 ± spread; best F1 of a column bold, of the table underlined."""
    seeds = len({row["seed"] for row in rows})
    several = f" ± its standard deviation over {seeds} scenes" if seeds > 1 else " on one scene"
    lines = [
        f"## {dataset}",
        "",
        f"Precision/recall, F1{several}. Bold: best F1 of the column; underlined: of the table. "
        + ("*Italics: the paper's own, on its own data.*" if paper else ""),
        "",
        "| | " + " | ".join(columns.values()) + " | consistent |",
        "|---" * (len(columns) + 2) + "|",
    ]
    consistent = {a: min(r["consistent"] == "True" for r in g) for (a,), g in by_name(rows).items()}
    pattern = "{:.2f}/{:.2f} {:.3f}" + (" ± {:.3f}" if seeds > 1 else "")
    for algorithm, texts in _cells_as_text(rows, columns, "**{}**", "<u>{}</u>", pattern):
        if algorithm in paper:
            figures = zip(texts, paper[algorithm], strict=True)
            texts = [f"{text}<br>*{p:.2f}/{r:.2f} {f1(p, r):.2f}*" for text, (p, r) in figures]
        says = "yes" if consistent[algorithm] else "no"
        lines.append(f"| {algorithm} | " + " | ".join(texts) + f" | {says} |")
    return "\n".join(lines)


def latex_table(rows, columns, paper):
    """The table in the paper's form, our figures and the paper's side by side."""
    lines = [
        r"% \usepackage{booktabs}",
        r"\begin{tabular}{l" + "cc" * len(columns) + "}"
        if paper
        else r"\begin{tabular}{l" + "c" * len(columns) + "}",
        r"\toprule",
    ]
    names = [rf"{name} & (paper)" if paper else name for name in columns.values()]
    lines.append(" & " + " & ".join(names) + r" \\ \midrule")
    pattern = "{:.2f}/{:.2f}"
    bold, underline = r"\textbf{{{}}}", r"\underline{{{}}}"
    for algorithm, texts in _cells_as_text(rows, columns, bold, underline, pattern):
        if paper:
            figures = paper.get(algorithm)
            shown = [f"{p:.2f}/{r:.2f}" for p, r in figures] if figures else ["--"] * len(texts)
            texts = [f"{ours} & {theirs}" for ours, theirs in zip(texts, shown, strict=True)]
        lines.append(f"{algorithm} & " + " & ".join(texts) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def f1(precision, recall):
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def by_name(rows):
    return grouped(rows, "algorithm")


def failure_table(dataset, failures):
    """How each algorithm goes wrong on the combined modalities."""
    lines = [
        f"### Where each fails: {dataset}, combined",
        "",
        "Means over the scenes. Parts: clusters that an object is spread over. Mixed: share of "
        "the clusters of two and more that hold several objects. Open cycles: a ~ b ~ c, but not "
        "a ~ c.",
        "",
        "| | wrong links | missed links | parts | mixed | open cycles | links within a view |",
        "|---|---|---|---|---|---|---|",
    ]
    for (algorithm,), group in by_name(failures).items():
        counts = [mean(group, key) for key in ("wrong_links", "missed_links")]
        inconsistent = [mean(group, key) for key in ("open_cycles", "within_view_links")]
        labelled = [row for row in group if row["parts_of_an_object"] != ""]
        parts = f"{mean(labelled, 'parts_of_an_object'):.1f}" if labelled else ""
        mixed = f"{mean(labelled, 'mixed_clusters'):.2f}" if labelled else ""
        lines.append(
            f"| {algorithm} | {counts[0]:.0f} | {counts[1]:.0f} | {parts} | {mixed} "
            f"| {inconsistent[0]:.0f} | {inconsistent[1]:.0f} |"
        )
    return "\n".join(lines)


def verdict(rows, columns):
    """What the paper claims, tested: who gains by combining modalities, and who is best."""
    found = cells(rows, columns)
    combined = list(columns)[-1]
    single = list(columns)[:-1]
    lines = ["| | best single | combined | gain |", "|---|---|---|---|"]
    for algorithm in dict.fromkeys(algorithm for algorithm, _ in found):
        strongest = max(single, key=lambda column, a=algorithm: found[a, column][2])
        before, after = found[algorithm, strongest][2], found[algorithm, combined][2]
        lines.append(
            f"| {algorithm} | {before:.3f} ({columns[strongest]}) | {after:.3f} "
            f"| {after - before:+.3f} |"
        )
    _, (name, column) = best(found, columns)
    others = [value[2] for (algorithm, _), value in found.items() if "MIXER" not in algorithm]
    ours = max(value[2] for (algorithm, _), value in found.items() if "MIXER" in algorithm)
    lines += [
        "",
        f"Highest F1 of the table: {name} on {columns[column]}. Best of MIXER {ours:.3f}, best of "
        f"the others {max(others):.3f}: a factor of {ours / max(max(others), 1e-9):.2f} "
        "(the paper's: 0.85 / 0.60 = 1.42).",
    ]
    return "\n".join(lines)


def size_table(rows):
    """Seconds against m on synthetic problems."""
    timed = [row for row in rows if row["dataset"].startswith("synthetic_")]
    if not timed:
        return ""
    sizes = sorted({size_of(row) for row in timed})
    lines = [
        f"## Seconds against m ({machine()})",
        "",
        "| | " + " | ".join(f"m = {size}" for size in sizes) + " |",
        "|---" * (len(sizes) + 1) + "|",
    ]
    for (algorithm,), group in by_name(timed).items():
        seconds = {size_of(row): row["seconds"] for row in group}
        lines.append(
            f"| {algorithm} | " + " | ".join(f"{seconds[size]:.3f}" for size in sizes) + " |"
        )
    return "\n".join(lines)


def size_of(row):
    return int(row["dataset"].removeprefix("synthetic_"))


def size_figure(rows, path):
    """Seconds against m, both on logarithmic axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    timed = [row for row in rows if row["dataset"].startswith("synthetic_")]
    for (algorithm,), group in by_name(timed).items():
        axes.loglog(
            [size_of(row) for row in group],
            [row["seconds"] for row in group],
            marker="o",
            markersize=3,
            **style(algorithm),
        )
    axes.set(xlabel="observations m", ylabel="seconds")
    axes.grid(alpha=0.3, which="both", linewidth=0.4)
    axes.legend(fontsize=7, ncols=2)
    save(figure, path)


def ablation_figure(rows, sets, path):
    """F1 of each algorithm, a bar for each set of modalities."""
    from matplotlib.figure import Figure

    names = list(by_name(rows))
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.subplots()
    width = 0.8 / len(sets)
    found = grouped(rows, "algorithm", "modalities")
    for k, modalities in enumerate(sets):
        groups = [found[name[0], modalities] for name in names]
        axes.bar(
            [i + (k - (len(sets) - 1) / 2) * width for i in range(len(names))],
            [mean(group, "f1") for group in groups],
            width,
            yerr=[spread(group, "f1") for group in groups],
            error_kw={"linewidth": 0.7},
            color=f"C{k}",
            label=modalities.replace("+", " + "),
        )
    axes.set_xticks(range(len(names)), [name[0] for name in names], rotation=20, ha="right")
    axes.set(ylabel="F1", ylim=(0, 1))
    axes.grid(axis="y", alpha=0.3, linewidth=0.4)
    figure.legend(fontsize=8, ncols=len(sets), loc="outside upper center", frameon=False)
    save(figure, path)


def sweep_figure(rows, sweeps, path):
    """F1 of each algorithm against one parameter a panel, the optimum as a dashed ceiling."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7), layout="constrained")
    panels = figure.subplots(2, 2, sharey=True).ravel()
    for axes, (sweep, label) in zip(panels, sweeps.items(), strict=True):
        chosen = [row for row in rows if row["dataset"].startswith(f"{sweep}=")]
        for (algorithm,), group in by_name(chosen).items():
            points = grouped(group, "dataset")
            axes.plot(
                [float(name.split("=")[1]) for (name,) in points],
                [mean(point, "f1") for point in points.values()],
                **style(algorithm),
            )
        axes.set(xlabel=label, ylabel="F1", ylim=(0, 1.02))
        axes.grid(alpha=0.3, linewidth=0.4)
    lines, names = panels[0].get_legend_handles_labels()
    figure.legend(lines, names, fontsize=8, ncols=6, loc="outside upper center", frameon=False)
    save(figure, path)


def style(algorithm):
    """MIXER stands out, in black; the optimum is in golden dashes."""
    look = {"MIXER": ("black", 2.5, "-"), "optimum": ("gold", 1.0, (0, (2, 3)))}
    color, width, line = look.get(algorithm, (None, 1.2, "-"))
    return {"label": algorithm, "color": color, "linewidth": width, "linestyle": line}


def save(figure, path):
    """As PNG and as SVG."""
    for suffix in (".png", ".svg"):
        figure.savefig(path.with_suffix(suffix), dpi=160)

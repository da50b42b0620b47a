"""Table II of the paper: algorithms against modalities, on the parking lot and on real video.

Also says how each algorithm goes wrong where modalities are combined, and how long it takes
against the number of observations m. Everything but rows.csv and failures.csv is made from them.

    mixer bench table2 --out out/benchmarks/table2
"""

from tqdm import tqdm

from mixer_torch.benchmarks import comparison, report, results
from mixer_torch.benchmarks.chosen import CHOSEN
from mixer_torch.benchmarks.comparison import ALL, MODALITIES
from mixer_torch.datasets.synthetic import synthetic

SIZES = (50, 100, 200, 400, 700, 1000)


def run(quick, seeds):
    """Rows and failures of every algorithm on every scene."""
    rows, failures = [], []
    scenes = comparison.parking_lots(seeds, num_frames=40 if quick else 100)
    for dataset, seed, affinity, identity in (
        *scenes,
        *([] if quick else comparison.real_scenes()),
    ):
        sets = [(name,) for name in affinity.modalities] + [affinity.modalities]
        solvers = tqdm(comparison.algorithms(dataset).items(), f"{dataset} {seed}", disable=None)
        for name, solver in solvers:
            for modalities in sets:
                row, failure = comparison.measure(
                    name, solver, affinity, identity, dataset, seed, modalities
                )
                rows.append(row)
                failures.append(failure)
    return rows, failures


def run_sizes(sizes):
    """Rows of every algorithm on synthetic problems of about m observations."""
    rows, solvers = [], comparison.algorithms(comparison.SYNTHETIC)
    for size in sizes:
        affinity, labels = synthetic(
            objects=size // 10, views=16, visible=0.6, outliers=0.0, seed=0
        )
        name = f"synthetic_{len(affinity)}"
        for algorithm, solver in tqdm(solvers.items(), name, disable=None):
            rows.append(comparison.measure(algorithm, solver, affinity, labels, name, 0)[0])
    return rows


def main(argv=None):
    quick = "one short drive, small sizes"
    arguments = results.arguments((__file__, __doc__), argv, quick, seeds=(5, "parking lots"))
    if not arguments.from_rows:
        comparison.warm_up()
        rows, failures = run(arguments.quick, range(1 if arguments.quick else arguments.seeds))
        rows += run_sizes(SIZES[:3] if arguments.quick else SIZES)
        results.write(arguments.out / "rows.csv", comparison.COLUMNS, rows)
        results.write(arguments.out / "failures.csv", comparison.FAILURES, failures)
    return make(arguments.out)


def make(out):
    """Tables and figures from the rows in a folder; the Markdown comes back."""
    rows = results.read(out / "rows.csv")
    failures = results.read(out / "failures.csv")
    parts = []
    for (dataset,), group in results.grouped(rows, "dataset").items():
        if dataset.startswith("synthetic"):
            continue
        sets = {row["modalities"] for row in group}
        combined = max(sets, key=lambda names: names.count("+"))
        columns = {name: shown for name, shown in MODALITIES.items() if name in sets}
        columns[combined] = "combined"
        paper = report.PAPER if (dataset, combined) == ("parking_lot", ALL) else {}
        parts.append(report.markdown_table(dataset, group, columns, paper))
        (out / f"table_{dataset}.tex").write_text(report.latex_table(group, columns, paper))
        chosen = [f for f in failures if (f["dataset"], f["modalities"]) == (dataset, combined)]
        parts.append(report.failure_table(dataset, chosen))
        parts.append(report.verdict(group, columns))
    parts += [report.size_table(rows), settings()]
    report.size_figure(rows, out / "time")
    text = "\n\n".join(part for part in parts if part) + "\n"
    (out / "table.md").write_text(text)
    return text


def settings():
    """How each algorithm was set, where not at its authors' defaults."""
    lines = [
        "## Settings",
        "",
        "Chosen by `mixer bench tuning`, by one small search for each algorithm on other seeds and "
        "frames; the authors' defaults where nothing is said.",
        "",
    ]
    for dataset, chosen in CHOSEN.items():
        said = "; ".join(f"{name} {options(setting)}" for name, setting in chosen.items())
        lines.append(f"- {dataset}: {said}")
    return "\n".join(lines)


def options(setting):
    return ", ".join(f"{key} = {value}" for key, value in setting.items())


if __name__ == "__main__":
    print(main())

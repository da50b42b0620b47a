"""F1 against noise, wrong scores, missing observations and the number of views.

Synthetic problems with four modalities that are silent for most pairs; one parameter is moved at a
time. The ceiling is the F1 of the proven optimum: what the best solver could reach, which is less
than 1 where the scores mislead. Everything but rows.csv is made from it.

    mixer bench robustness --out out/benchmarks/robustness
"""

from tqdm import tqdm

from mixer_torch.benchmarks import comparison, report, results
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.exact import Exact

BASE = {"noise": 0.2, "wrong": 0.2, "visible": 0.6, "views": 6}
SWEEPS = {
    "noise": ("noise of the scores (standard deviation)", (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)),
    "wrong": ("share of scores that are wrong", (0.0, 0.1, 0.2, 0.3, 0.4)),
    "missing": ("share of objects missing in a view", (0.0, 0.2, 0.4, 0.6, 0.8)),
    "views": ("views", (2, 4, 6, 9, 12)),
}


def problem(sweep, value, seed):
    """A synthetic problem with one parameter of the base moved."""
    name, moved = ("visible", 1 - value) if sweep == "missing" else (sweep, value)
    chosen = BASE | {name: moved}
    return synthetic(objects=8, modalities=4, inconclusive=0.6, seed=seed, **chosen)


def run(trials, thin):
    rows = []
    solvers = comparison.algorithms(comparison.SYNTHETIC) | {"optimum": Exact(time_limit=20.0)}
    for sweep, (_, values) in SWEEPS.items():
        for value in values[::2] if thin else values:
            for seed in tqdm(range(trials), f"{sweep} {value}", disable=None):
                affinity, labels = problem(sweep, value, seed)
                for name, solver in solvers.items():
                    row, _ = comparison.measure(
                        name, solver, affinity, labels, f"{sweep}={value}", seed
                    )
                    rows.append(row)
    return rows


def make(out):
    """Figure and table from the rows in a folder; the Markdown comes back."""
    rows = results.read(out / "rows.csv")
    report.sweep_figure(
        rows, {key: label for key, (label, _) in SWEEPS.items()}, out / "robustness"
    )
    places = [place for (place,) in results.grouped(rows, "dataset")]
    found = {
        algorithm: {place: points for (place,), points in results.grouped(group, "dataset").items()}
        for (algorithm,), group in results.grouped(rows, "algorithm").items()
    }
    return results.write_table(out, results.means("F1", found, places, "f1", 2))


def main(argv=None):
    quick = "3 trials, every other value"
    arguments = results.arguments((__file__, __doc__), argv, quick, trials=(20, "problems a point"))
    if not arguments.from_rows:
        comparison.warm_up()
        rows = run(3 if arguments.quick else arguments.trials, arguments.quick)
        results.write(arguments.out / "rows.csv", comparison.COLUMNS, rows)
    return make(arguments.out)


if __name__ == "__main__":
    print(main())

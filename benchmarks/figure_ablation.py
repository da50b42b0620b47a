"""The paper's bar chart: F1 of every algorithm as modalities are added to the strongest one.

The strongest modality is the one on which MIXER is best by itself; the others follow in the order
of their strength. Everything but rows.csv is made from it.

    mixer bench figure_ablation --out out/benchmarks/figure_ablation
"""

from tqdm import tqdm

from mixer_torch.benchmarks import comparison, report, results


def order(rows):
    """The modalities by the mean F1 of MIXER on each alone, the strongest first."""
    alone = [row for row in rows if row["algorithm"] == "MIXER" and "+" not in row["modalities"]]
    strength = {
        name: results.mean(group, "f1")
        for (name,), group in results.grouped(alone, "modalities").items()
    }
    return sorted(strength, key=strength.__getitem__, reverse=True)


def run(seeds, num_frames):
    scenes = list(comparison.parking_lots(seeds, num_frames))
    rows = []
    for dataset, seed, affinity, identity in scenes:
        for name in affinity.modalities:
            solver = comparison.algorithms(dataset)["MIXER"]
            row, _ = comparison.measure("MIXER", solver, affinity, identity, dataset, seed, (name,))
            rows.append(row)
    names = order(rows)
    for dataset, seed, affinity, identity in scenes:
        solvers = tqdm(comparison.algorithms(dataset).items(), f"{dataset} {seed}", disable=None)
        for algorithm, solver in solvers:
            for k in range(1, len(names) + 1):
                if (algorithm, k) == ("MIXER", 1):
                    continue
                row, _ = comparison.measure(
                    algorithm, solver, affinity, identity, dataset, seed, names[:k]
                )
                rows.append(row)
    return rows


def make(out):
    """Figure and table from the rows in a folder; the Markdown comes back."""
    rows = results.read(out / "rows.csv")
    names = order(rows)
    sets = ["+".join(names[:k]) for k in range(1, len(names) + 1)]
    found = results.grouped(rows, "algorithm", "modalities")
    algorithms = [name for name in comparison.SETTINGS if (name, sets[0]) in found]
    rows = [row for name in algorithms for key in sets for row in found[name, key]]
    report.ablation_figure(rows, sets, out / "ablation")
    found = {name: {key: found[name, key] for key in sets} for name in algorithms}
    return results.write_table(out, results.means("F1", found, sets, "f1", 3))


def main(argv=None):
    quick = "one short drive"
    arguments = results.arguments((__file__, __doc__), argv, quick, seeds=(5, "parking lots"))
    if not arguments.from_rows:
        comparison.warm_up()
        seeds = range(1 if arguments.quick else arguments.seeds)
        rows = run(seeds, num_frames=40 if arguments.quick else 100)
        results.write(arguments.out / "rows.csv", comparison.COLUMNS, rows)
    return make(arguments.out)


if __name__ == "__main__":
    print(main())

"""The same small search for every algorithm: which of its settings is best where no table looks.

Each setting in ``comparison.SETTINGS`` is run on held-out scenes of each dataset: parking lots of
other seeds, other frames of PETS and of the hotel, synthetic problems of other seeds. The one of
the highest mean F1, over each modality alone and all together, is the one to use
(chosen.py, whose text comes last).

    mixer bench tuning --out out/benchmarks/tuning
"""

import json
import pprint

from tqdm import tqdm

from mixer_torch.benchmarks import comparison, results


def run(num_frames):
    rows = []
    for dataset, seed, affinity, identity in comparison.held_out(num_frames):
        sets = [(name,) for name in affinity.modalities] + [affinity.modalities]
        candidates = tqdm(comparison.SETTINGS.items(), f"{dataset} {seed}", disable=None)
        for name, (kind, settings) in candidates:
            for setting in settings if len(settings) > 1 else ():
                for modalities in sets:
                    row, _ = comparison.measure(
                        name, kind(**setting), affinity, identity, dataset, seed, modalities
                    )
                    rows.append(row | {"setting": json.dumps(setting)})
    return rows


def main(argv=None):
    arguments = results.arguments((__file__, __doc__), argv, "40 frames in place of 100")
    if not arguments.from_rows:
        rows = run(40 if arguments.quick else 100)
        results.write(arguments.out / "rows.csv", (*comparison.COLUMNS, "setting"), rows)
    return results.tabled(arguments.out, table)


def table(rows):
    """Mean F1 of each setting on each dataset, the chosen ones in bold, and as a literal."""
    datasets = [name for (name,) in results.grouped(rows, "dataset")]
    lines = [
        "| algorithm | setting | " + " | ".join(datasets) + " |",
        "|---|---" + "|---" * len(datasets) + "|",
    ]
    chosen = {dataset: {} for dataset in datasets}
    for (algorithm,), group in results.grouped(rows, "algorithm").items():
        means = {
            key: results.mean(found, "f1")
            for key, found in results.grouped(group, "setting", "dataset").items()
        }
        settings = list(results.grouped(group, "setting"))
        for dataset in datasets:
            best = max(settings, key=lambda key, d=dataset: means[key[0], d])
            chosen[dataset][algorithm] = json.loads(best[0])
        for (setting,) in settings:
            is_best = [chosen[d][algorithm] == json.loads(setting) for d in datasets]
            shown = [f"{means[setting, dataset]:.3f}" for dataset in datasets]
            shown = [f"**{s}**" if best else s for s, best in zip(shown, is_best, strict=True)]
            lines.append(f"| {algorithm} | {setting} | " + " | ".join(shown) + " |")
    return "\n".join([*lines, "", "    CHOSEN = " + pprint.pformat(chosen, width=90), ""])


if __name__ == "__main__":
    print(main())

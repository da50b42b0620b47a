"""The same small search for every algorithm: which of its settings is best where no table looks.

Each setting in ``comparison.SETTINGS`` is run on parking lots of held-out seeds, on each modality
and on all of them; the one of the highest mean F1 over all of these is the one to use
(``comparison.CHOSEN``).

    mixer bench tuning --out out/benchmarks/tuning
"""

import argparse
import json
from pathlib import Path

from tqdm import tqdm

from mixer_torch.benchmarks import comparison


def run(num_frames):
    rows = []
    for dataset, seed, affinity, identity in comparison.parking_lots(
        comparison.HELD_OUT, num_frames
    ):
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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/tuning"))
    parser.add_argument("--quick", action="store_true", help="40 frames in place of 100")
    arguments = parser.parse_args(argv)
    rows = run(40 if arguments.quick else 100)
    comparison.write(arguments.out / "rows.csv", (*comparison.COLUMNS, "setting"), rows)
    text = table(comparison.read(arguments.out / "rows.csv"))
    (arguments.out / "table.md").write_text(text)
    return text


def table(rows):
    """Mean F1 of each setting, the chosen one in bold."""
    lines = ["| algorithm | setting | mean F1, all columns | combined |", "|---|---|---|---|"]
    for (algorithm,), group in comparison.grouped(rows, "algorithm").items():
        settings = comparison.grouped(group, "setting")
        means = {key: comparison.mean(chosen, "f1") for key, chosen in settings.items()}
        best = max(means, key=means.__getitem__)
        for key, chosen in settings.items():
            combined = [row for row in chosen if row["modalities"] == comparison.ALL]
            shown = f"{means[key]:.3f}"
            shown = f"**{shown}**" if key == best else shown
            lines.append(
                f"| {algorithm} | {key[0]} | {shown} | {comparison.mean(combined, 'f1'):.3f} |"
            )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(main())

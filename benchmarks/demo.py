"""Time and memory of the main job on the parking lot: score four modalities, then solve.

The peer is the obvious way to match SIFT descriptors: one OpenCV matcher call for each pair of
crops, on a sample of the pairs, in the same run. Rows go to rows.csv, the table is made from them.

    python benchmarks/demo.py --out out/benchmarks/demo
"""

import argparse
import csv
import resource
import time
from functools import partial
from pathlib import Path

import cv2
import torch

import mixer_torch as mx
from mixer_torch.datasets import ParkingLot
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.scorers import SIFT, Color, IoU, Proximity

COLUMNS = ("stage", "seconds", "pairs_per_second", "peak_memory_mb")


def peak_memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure(stage, rows, work, pairs=0):
    start = time.perf_counter()
    result = work()
    seconds = time.perf_counter() - start
    rows.append(
        dict(zip(COLUMNS, (stage, seconds, pairs / seconds, peak_memory_mb()), strict=True))
    )
    return result


def match_one_by_one(descriptors, pairs, ratio=0.8):
    """Mutual ratio-test matches of each pair by OpenCV, one call a pair and direction."""
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    counts = []
    for a, b in pairs:
        if len(descriptors[a]) < 2 or len(descriptors[b]) < 2:
            counts.append(0)
            continue
        kept = [
            {
                (first.queryIdx, first.trainIdx)
                for first, second in matcher.knnMatch(x, y, k=2)
                if first.distance < ratio * second.distance
            }
            for x, y in ((descriptors[a], descriptors[b]), (descriptors[b], descriptors[a]))
        ]
        counts.append(len(kept[0] & {(j, i) for i, j in kept[1]}))
    return counts


def run(rows, frames):
    """Fill the rows; how many observations, and the F1 of the answer."""
    observations = measure("place cars and detect", rows, ParkingLot(num_frames=frames).load)
    measure("render", rows, lambda: sum(1 for _ in observations.images.crops()))
    pairs = mx.Every()(observations)
    scores, scorers = [], (IoU(), Proximity(), Color(), SIFT())
    for scorer in scorers:
        name = f"score {scorer.name}"
        describe = partial(scorer.describe, observations)
        description = measure(f"{name}: describe", rows, describe)
        compare = partial(scorer.score_described, description, pairs)
        scores.append(measure(f"{name}: compare", rows, compare, pairs.shape[1]))
    names = [scorer.name for scorer in scorers]
    affinity = mx.Affinity(
        pairs, torch.stack([s.float() for s in scores]), observations.view, names
    )
    association = measure("solve", rows, lambda: mx.solve(affinity))
    order = torch.randperm(pairs.shape[1], generator=torch.Generator().manual_seed(0))
    sample = pairs[:, order[:5000]].T.tolist()
    descriptors, count = description
    lists = [own[:n].numpy() for own, n in zip(descriptors, count.tolist(), strict=True)]
    measure(
        "peer: OpenCV, pair by pair", rows, partial(match_one_by_one, lists, sample), len(sample)
    )
    metrics = evaluate(association, observations["identity"], observations.view)
    return len(observations), metrics["f1"]


def table(path):
    with path.open() as file:
        rows = list(csv.DictReader(file))
    lines = [
        "| stage | seconds | pairs per second | peak memory so far, MiB |",
        "|---|---|---|---|",
    ]
    for row in rows:
        rate = float(row["pairs_per_second"])
        shown = f"{rate:,.0f}" if rate else ""
        lines.append(
            f"| {row['stage']} | {float(row['seconds']):.2f} | {shown} "
            f"| {float(row['peak_memory_mb']):.0f} |"
        )
    ours = next(row for row in rows if row["stage"] == "score SIFT: compare")
    peer = next(row for row in rows if row["stage"].startswith("peer"))
    ratio = float(ours["pairs_per_second"]) / float(peer["pairs_per_second"])
    total = sum(float(row["seconds"]) for row in rows if row["stage"].startswith(("score", "sol")))
    lines.append(f"\nScoring and solving: {total:.1f} s.")
    lines.append(f"Matching SIFT in batches: {ratio:.1f} x the peer's rate, same descriptors.")
    return "\n".join(lines)


def main(argv=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/demo"))
    parser.add_argument("--quick", action="store_true", help="20 frames in place of 100")
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    m, f1 = run(rows, 20 if arguments.quick else 100)
    path = arguments.out / "rows.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    text = table(path)
    (arguments.out / "table.md").write_text(text + "\n")
    print(f"{m} observations, {torch.get_num_threads()} threads, F1 {f1:.3f}\n{text}")


if __name__ == "__main__":
    main()

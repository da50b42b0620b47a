"""Time and memory of `mixer demo`: score four modalities on the parking lot, then solve.

The peer is the obvious way to match SIFT descriptors: one OpenCV matcher call for each pair of
crops, on a sample of the pairs, in the same run. Rows go to rows.csv, the table is made from them.
demo.jpg, beside them, is the picture in the README.

    mixer bench demo --out out/benchmarks/demo
"""

import resource
import time
from functools import partial

import cv2
import torch

import mixer_torch as mx
from mixer_torch.benchmarks import results
from mixer_torch.datasets import ParkingLot
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.plots import frames_figure
from mixer_torch.scorers import SIFT, Color, IoU, Proximity
from mixer_torch.scorers.curves import PiecewiseLinear

COLUMNS = ("stage", "seconds", "pairs_per_second", "peak_memory_mb")
PICTURE_WIDTH = 1500  # pixels


def peak_memory_mb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure(stage, rows, work, pairs=0):
    start = time.perf_counter()
    result = work()
    seconds = time.perf_counter() - start
    values = (stage, seconds, pairs / seconds, peak_memory_mb())
    rows.append(dict(zip(COLUMNS, values, strict=True)))
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
    """Fill the rows; the observations and the answer."""
    observations = measure("place cars and detect", rows, ParkingLot(num_frames=frames).load)
    measure("render", rows, lambda: sum(1 for _ in observations.images.crops()))
    pairs = mx.Every()(observations)
    little = PiecewiseLinear([0, 1], [0.45, 0.55])  # as in configs/parking_lot.yaml
    color = Color(mode="semantic", calibrator=little)
    scores, scorers = [], (IoU(), Proximity(), color, SIFT())
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
    return observations, association


def table(rows):
    lines = [
        "| stage | seconds | pairs per second | peak memory so far, MiB |",
        "|---|---|---|---|",
    ]
    for row in rows:
        rate = row["pairs_per_second"]
        shown = f"{rate:,.0f}" if rate else ""
        lines.append(
            f"| {row['stage']} | {row['seconds']:.2f} | {shown} | {row['peak_memory_mb']:.0f} |"
        )
    ours = next(row for row in rows if row["stage"] == "score SIFT: compare")
    peer = next(row for row in rows if row["stage"].startswith("peer"))
    ratio = ours["pairs_per_second"] / peer["pairs_per_second"]
    total = sum(row["seconds"] for row in rows if row["stage"].startswith(("score", "sol")))
    lines.append(f"\nScoring and solving: {total:.1f} s.")
    lines.append(f"Matching SIFT in batches: {ratio:.1f} x the peer's rate, same descriptors.\n")
    return "\n".join(lines)


def main(argv=None):
    arguments = results.arguments((__file__, __doc__), argv, "20 frames in place of 100")
    heading = ""
    if not arguments.from_rows:
        rows = []
        observations, association = run(rows, 20 if arguments.quick else 100)
        results.write(arguments.out / "rows.csv", COLUMNS, rows)
        figure = frames_figure(observations, association.labels)
        dpi = PICTURE_WIDTH / figure.get_figwidth()
        figure.savefig(arguments.out / "demo.jpg", dpi=dpi, pil_kwargs={"quality": 85})
        f1 = evaluate(association, observations["identity"], observations.view)["f1"]
        heading = f"{results.machine()}: {len(observations)} observations, F1 {f1:.3f}\n"
    return heading + results.tabled(arguments.out, table)


if __name__ == "__main__":
    print(main())

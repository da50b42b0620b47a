"""Is velocity worth learning from? PETS 2009 S2.L1, frames 160-780, every 20th (needs MIXER_DATA).

Motion is the distance between where both would be halfway in time, from the velocity that the
frames between tell (MOTChallenge's window). Each set of modalities, for pairs of up to 40 and of up
to 60 frames, is trained on PETS frames 1-150 and TUD-Stadtmitte in two ways: calibrators whose log
odds add up, and the mean of eight networks over them, each blind to some persons.

"Held out" is measured in training alone: persons of PETS in four folds, each pair scored by a model
that has seen neither person's fold; F1 is that of all 20 phases. What is chosen by it: pairs of up
to 40 or 60 frames by the mean F1 of all that is trained for them, then the least Cllr. "Window" is
the later frames: all persons, and those who are not in frames 1-150; networks of five seeds.
Without colour, for want of pixels, all later frames can be had: Cllr at every offset.

    python benchmarks/learning_motion.py --out out/benchmarks/learning_motion
"""

import argparse
import csv
import math
import time
from itertools import combinations_with_replacement
from pathlib import Path

import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from mixer_torch.benchmarks.comparison import grouped, mean, spread
from mixer_torch.benchmarks.learning import (
    SPARSE,
    apply,
    as_input,
    fit_calibrators,
    log_ratios,
    sample,
)
from mixer_torch.calibration_metrics import cllr
from mixer_torch.datasets import MOTChallenge
from mixer_torch.fusion import LogOddsFusion
from scorers import SIFT, Color, IoU, Proximity
from scorers.learned import SURE, EvidenceEnsemble, EvidenceNetwork
from train.data import Rows
from train.evaluation import solved
from train.pairs import parts_of_objects
from train.selectors import AtGaps
from train.tables import pair_table

COLUMNS = ("frames", "modalities", "method", "measured", "seed", "cllr", "f1", "f1_new")
PETS, TOWN = "mot15/PETS09-S2L1", "mot15/TUD-Stadtmitte"
SETS = (
    ("overlap", "distance", "colour", "SIFT"),
    ("overlap", "motion", "colour", "SIFT"),
    ("overlap", "distance", "motion", "colour", "SIFT"),
    ("distance", "motion", "colour"),
    ("motion", "colour"),
)
FOLDS = ((9, 12), (13, 16), (11, 19), (15, 17))
"""Persons of frames 1-150: each fold one who is seen often and one who is not."""
COVARIATES = ("time_gap",)
MEMBERS = 8


def scorer(name):
    return {
        "overlap": lambda: IoU(max_gap=SPARSE[0] + 0.05, feature="time", disjoint=0.45),
        "distance": lambda: Proximity(speed=1.5, memory=5),
        "motion": lambda: Proximity(scale=2, swerve=0, memory=5),
        "colour": lambda: Color("histogram"),
        "SIFT": SIFT,
    }[name]()


def tables(names, gaps, cache):
    """Of the training in two sequences, and of the window."""
    half_width = 1.0 if "motion" in names else 0.0
    sequences = [
        MOTChallenge(PETS, start=1, stop=150, window=half_width),
        MOTChallenge(TOWN),
        MOTChallenge(PETS, start=160, stop=780, step=20, window=half_width),
    ]
    scorers, selector = [scorer(name) for name in names], AtGaps(SPARSE[:gaps])
    return [pair_table(sequence, scorers, selector, cache) for sequence in sequences]


def fit_ensemble(calibrators, trained_on, seed, epochs=100):
    rows = Rows(trained_on)
    ratio, values = as_input(apply(calibrators, rows.evidence)), rows.covariates_of(COVARIATES)
    chosen, _ = sample(rows.same, seed=seed)
    parts = parts_of_objects(rows.objects, MEMBERS, seed)
    part = torch.cat([parts, torch.tensor([-1])])[rows.objects[:, chosen]]  # -1: clutter's
    torch.manual_seed(seed)
    members = [EvidenceNetwork(len(ratio), COVARIATES) for _ in range(MEMBERS)]
    for k, network in enumerate(members):
        network.covariates.learn(values)
        seen = chosen[(part != k).all(0)]
        truth = rows.same[seen].float()
        prior = math.log(truth.mean() / (1 - truth.mean()))
        optimiser = torch.optim.AdamW(network.parameters(), lr=5e-3, weight_decay=1e-2)
        for _ in range(epochs):
            optimiser.zero_grad()
            logit = network(ratio[:, seen], values[seen]).nan_to_num(0.0) + prior
            binary_cross_entropy_with_logits(logit, truth).backward()
            optimiser.step()
    return EvidenceEnsemble(members)


@torch.no_grad()
def ensemble_scores(network, calibrators, table):
    ratio = network(as_input(apply(calibrators, table.evidence)), table.covariates_of(COVARIATES))
    return torch.sigmoid(ratio.nan_to_num(0.0).double())[None]


def figures(table, scores, fusion):
    names = [str(k) for k in range(len(scores))]
    return {
        "cllr": float(cllr(log_ratios(scores).sum(0), table.same)),
        "f1": solved(table, scores, names, fusion)["f1"],
    }


def held_out(pets, town):
    """Scores of all pairs of PETS by both methods, from models that know neither person."""
    identity = pets.observations["identity"]
    fold = pets.observations["frame"] // 20 % len(FOLDS)  # of clutter
    for k, persons in enumerate(FOLDS):
        fold[torch.isin(identity, torch.tensor(persons))] = k
    a, b = fold[pets.pairs]
    added, fused = torch.full_like(pets.evidence, 0.5), torch.full((1, len(pets)), 0.5).double()
    for i, j in combinations_with_replacement(range(len(FOLDS)), 2):
        scored = (((a == i) & (b == j)) | ((a == j) & (b == i))).nonzero()[:, 0]
        rest = ((a != i) & (a != j) & (b != i) & (b != j)).nonzero()[:, 0]
        trained_on, unseen = [pets.select(rest), town], pets.select(scored)
        calibrators = fit_calibrators(trained_on)
        added[:, scored] = apply(calibrators, unseen.evidence)
        network = fit_ensemble(calibrators, trained_on, 0)
        fused[:, scored] = ensemble_scores(network, calibrators, unseen)
    return added, fused


def measure(names, gaps, cache, seeds):
    pets, town, window = tables(names, gaps, cache)
    added, fused = held_out(pets, town)
    rules = {"calibrators": LogOddsFusion(), "ensemble": LogOddsFusion(cap=SURE)}
    rows = [
        {"method": method, "measured": "held out", **figures(pets, scores, rules[method])}
        for method, scores in (("calibrators", added), ("ensemble", fused))
    ]
    identity = window.observations["identity"]
    fresh = ~torch.isin(identity, pets.observations["identity"]) | (identity < 0)
    index = fresh[window.pairs].all(0).nonzero()[:, 0]
    calibrators = fit_calibrators([pets, town])
    found = [("calibrators", "", apply(calibrators, window.evidence))]
    for seed in range(seeds):
        network = fit_ensemble(calibrators, [pets, town], seed)
        found.append(("ensemble", seed, ensemble_scores(network, calibrators, window)))
    for method, seed, scores in found:
        new = figures(window.select(index), scores[:, index], rules[method])["f1"]
        of_all = figures(window, scores, rules[method])
        row = {"method": method, "measured": "window", "seed": seed, **of_all, "f1_new": new}
        rows.append(row)
    said = {"frames": 20 * gaps, "modalities": " + ".join(names)}
    return [{**said, **row} for row in rows]


def at_every_offset(cache):
    """What motion is worth on all later frames, of which only every 20th has pixels: no colour."""
    rows = []
    for gaps in (2, 3):
        for names in (("distance",), ("distance", "motion")):
            pets, town, _ = tables(names, gaps, cache)
            half_width = 1.0 if "motion" in names else 0.0
            late = MOTChallenge(PETS, start=160, window=half_width, pixels=False)
            scorers = [scorer(name) for name in names]
            unseen = pair_table(late, scorers, AtGaps(SPARSE[:gaps]), cache)
            calibrators = fit_calibrators([pets, town])
            network = fit_ensemble(calibrators, [pets, town], 0)
            said = {"frames": 20 * gaps, "modalities": " + ".join(names)}
            said["measured"] = f"all {len(unseen)} pairs from frame 160 on"
            for method, scores in (
                ("calibrators", apply(calibrators, unseen.evidence)),
                ("ensemble", ensemble_scores(network, calibrators, unseen)),
            ):
                cost = float(cllr(log_ratios(scores).sum(0), unseen.same))
                rows.append({**said, "method": method, "cllr": cost})
    return rows


def table(rows):
    heads = ["held out: Cllr", "F1", "window: Cllr", "F1", "F1, new persons"]
    lines = ["| frames | modalities | method | " + " | ".join(heads) + " |", "|---" * 8 + "|"]
    solved_rows = [row for row in rows if row["measured"] in ("held out", "window")]
    for key, group in grouped(solved_rows, "frames", "modalities", "method").items():
        cells = []
        for measured, names in (("held out", COLUMNS[5:7]), ("window", COLUMNS[5:])):
            chosen = [row for row in group if row["measured"] == measured]
            for name in names:
                text = f"{mean(chosen, name):.3f}"
                cells.append(f"{text} ± {spread(chosen, name):.3f}" if len(chosen) > 1 else text)
        lines.append("| " + " | ".join([*key, *cells]) + " |")
    inside = [row for row in rows if row["measured"] == "held out"]
    ranges = grouped(inside, "frames")
    best = max(ranges, key=lambda key: mean(ranges[key], "f1"))
    chosen = min(ranges[best], key=lambda row: row["cllr"])
    lines += ["", f"Chosen: {chosen['frames']} frames, {chosen['modalities']}, {chosen['method']}"]
    lines += ["", "| frames | modalities | method | measured | Cllr |", "|---" * 5 + "|"]
    for row in rows:
        if row not in solved_rows:
            cells = [row[key] for key in COLUMNS[:4]]
            lines.append("| " + " | ".join([*cells, f"{row['cllr']:.3f}"]) + " |")
    return "\n".join(lines)


def main(argv=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/learning_motion"))
    parser.add_argument("--seeds", type=int, default=5)
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for gaps in (2, 3):
        for names in SETS:
            start = time.perf_counter()
            rows += measure(names, gaps, arguments.out / "evidence", arguments.seeds)
            print(f"{20 * gaps} {' + '.join(names)}: {time.perf_counter() - start:.0f} s")
    rows += at_every_offset(arguments.out / "evidence")
    path = arguments.out / "rows.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    with path.open() as file:
        read = [
            {k: float(v) if v and k in COLUMNS[5:] else v for k, v in row.items()}
            for row in csv.DictReader(file)
        ]
    text = table(read)
    (arguments.out / "table.md").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()

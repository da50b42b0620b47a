"""Are the frames between worth learning from? PETS 2009 S2.L1, frames 160-780, every 20th.

Motion is the distance between where both would be halfway in time, from the velocity that the
frames between tell (MOTChallenge's window). Each set of modalities, for pairs of up to 20, 40 and
60 frames (one, two and three views of the window), is trained on PETS frames 1-150 and
TUD-Stadtmitte, whose table of truth tells where its ground is, in two ways: calibrators whose log
odds add up, and the mean of eight networks over them, each blind to some persons. The embedding was
trained on other persons yet (configs/train/embedding.yaml, to be run first). It needs MIXER_DATA.

"Held out" is measured in training alone: the persons of each sequence in four folds, each pair
scored by a model that has seen neither person's fold. F1 is that of all phases: of PETS the frames
1, 21, 41, ..., then 2, 22, 42, ...; of TUD-Stadtmitte, which lasts 7.1 s, the frames 1, 72, 143,
then 2, 73, 144, ..., two or three views each. The rule that chooses by it, in two steps:

1. Pairs of up to 20, 40 or 60 frames: the greatest F1, in the mean over both sequences and over all
   sets of modalities and both ways that are trained for such pairs. How many views back to compare
   is a matter of what the clustering makes of it, and the mean over many hangs little on each.
2. Among those, the modalities and the way: the least Cllr, in the mean over both sequences. It is
   that of the same pairs for all of them, and varies less than F1, which hangs on few decisions.

The rule was written down before any of these figures was known, and chose before any of these
models was tried on the window. Two more sets, with the tracklets that an earlier tracker made of
all frames, were tried later; they went with that tracker, and docs/results.md has their figures.

Then "window" is the later frames: all persons, and those who are not in frames 1-150; networks of
five seeds. With --training_only, the window is not looked at; with --without_ground, the ground of
TUD-Stadtmitte is not known, which leaves overlap and looks there. Without colour, for want of
pixels, all later frames can be had: Cllr at every offset.

    python benchmarks/learning_motion.py --out out/benchmarks/learning_motion
"""

import argparse
import math
import time
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path

import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from mixer_torch.benchmarks import results
from mixer_torch.benchmarks.learning import (
    SPARSE,
    apply,
    fit_calibrators,
    sample,
)
from mixer_torch.benchmarks.results import grouped, mean, spread
from mixer_torch.datasets import Dataset, MOTChallenge
from mixer_torch.fusion import LogOddsFusion
from mixer_torch.metrics.calibration import cllr
from mixer_torch.scorers import SIFT, Color, Embedding, IoU, Proximity
from mixer_torch.scorers.likelihood_ratio import log_ratio_of
from mixer_torch.scorers.pair_network import (
    MAX_LOG_RATIO,
    EvidenceEnsemble,
    EvidenceNetwork,
    as_evidence,
)
from mixer_torch.train.data import Rows
from mixer_torch.train.evaluation import solved
from mixer_torch.train.pairs import parts_of_objects
from mixer_torch.train.selectors import AtGaps
from mixer_torch.train.tables import pair_table

COLUMNS = ("frames", "modalities", "method", "measured", "seed", "cllr", "f1", "f1_new")
PETS, TOWN = "mot15/PETS09-S2L1", "mot15/TUD-Stadtmitte"
SETS = (
    ("overlap", "distance", "colour", "SIFT"),
    ("overlap", "motion", "colour", "SIFT"),
    ("overlap", "distance", "motion", "colour", "SIFT"),
    ("distance", "motion", "colour"),
    ("motion", "colour"),
    ("distance", "motion", "embedding"),
    ("distance", "motion", "colour", "embedding"),
)
FOLDS = (
    ((9, 12), (13, 16), (11, 19), (15, 17)),  # PETS, frames 1-150
    ((1, 3, 10), (5, 6, 9), (4, 7), (2, 8)),  # TUD-Stadtmitte
)
"""Persons of each sequence of training: each fold some who are seen often and some who are not."""
VIEWS = (20, 71)
"""Frames from view to view in each, 2.9 s."""
TRAINING = ("PETS held out", "TUD held out")
COVARIATES = ("time_gap",)
MEMBERS = 8
RULES = {"calibrators": LogOddsFusion(), "ensemble": LogOddsFusion(cap=MAX_LOG_RATIO)}


def scorer(name, embedding):
    return {
        "overlap": lambda: IoU(max_gap=SPARSE[0] + 0.05, feature="time", disjoint=0.45),
        "distance": lambda: Proximity(speed=1.5, memory=5),
        "motion": lambda: Proximity(scale=2, swerve=0, memory=5),
        "colour": lambda: Color("histogram"),
        "SIFT": SIFT,
        "embedding": lambda: Embedding(embedding, mirror=True, centre=True),
    }[name]()


@dataclass(frozen=True)
class Candidate:
    """A set of modalities, compared in pairs of up to so many views, with TUD's ground or not."""

    names: tuple[str, ...]
    gaps: int
    cache: Path
    embedding: Path
    ground: bool = True

    def table(self, path, **arguments):
        half_width = 1.0 if "motion" in self.names and (self.ground or path == PETS) else 0.0
        sequence: Dataset = MOTChallenge(path, window=half_width, **arguments)
        scorers = [scorer(name, self.embedding) for name in self.names]
        return pair_table(sequence, scorers, AtGaps(SPARSE[: self.gaps]), self.cache)

    def training(self):
        ground = {"calibration": f"{TOWN}/gt/gt.txt"} if self.ground else {}
        return [self.table(PETS, start=1, stop=150), self.table(TOWN, **ground)]

    def said(self, method, measured):
        modalities = " + ".join(self.names)
        frames = 20 * self.gaps
        said = {"frames": frames, "modalities": modalities, "method": method}
        return {**said, "measured": measured}


def fit_ensemble(calibrators, trained_on, seed, epochs=100):
    rows = Rows(trained_on)
    ratio, values = as_evidence(apply(calibrators, rows.evidence)), rows.covariates_of(COVARIATES)
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
    ratio = network(
        as_evidence(apply(calibrators, table.evidence)), table.covariates_of(COVARIATES)
    )
    return torch.sigmoid(ratio.nan_to_num(0.0).double())[None]


def figures(table, scores, fusion, chosen):
    """Cllr of all pairs, F1 of those that are chosen."""
    names = [str(k) for k in range(len(scores))]
    return {
        "cllr": float(cllr(log_ratio_of(scores).sum(0), table.same)),
        "f1": solved(table.select(chosen), scores[:, chosen], names, fusion)["f1"],
    }


def held_out(tables, k):
    """Scores of all pairs of sequence k by both methods, from models that know neither person."""
    seen, others = tables[k], [*tables[:k], *tables[k + 1 :]]
    identity, folds = seen.observations["identity"], FOLDS[k]
    fold = seen.observations["frame"] // 20 % len(folds)  # of clutter
    for number, persons in enumerate(folds):
        fold[torch.isin(identity, torch.tensor(persons))] = number
    a, b = fold[seen.pairs]
    added, fused = torch.full_like(seen.evidence, 0.5), torch.full((1, len(seen)), 0.5).double()
    for i, j in combinations_with_replacement(range(len(folds)), 2):
        scored = (((a == i) & (b == j)) | ((a == j) & (b == i))).nonzero()[:, 0]
        rest = ((a != i) & (a != j) & (b != i) & (b != j)).nonzero()[:, 0]
        trained_on, unseen = [seen.select(rest), *others], seen.select(scored)
        calibrators = fit_calibrators(trained_on)
        added[:, scored] = apply(calibrators, unseen.evidence)
        network = fit_ensemble(calibrators, trained_on, 0)
        fused[:, scored] = ensemble_scores(network, calibrators, unseen)
    return {"calibrators": added, "ensemble": fused}


def in_phase(table, step):
    """Pairs of frames that are a whole number of views apart, to the frame."""
    frame = table.observations["frame"][table.pairs]
    return ((frame[1] - frame[0]) % step == 0).nonzero()[:, 0]


def measure_training(candidate):
    """Of both sequences of training, by models that have not seen the persons of a pair."""
    rows, tables = [], candidate.training()
    for k, measured in enumerate(TRAINING):
        chosen = in_phase(tables[k], VIEWS[k])
        for method, scores in held_out(tables, k).items():
            found = figures(tables[k], scores, RULES[method], chosen)
            rows.append({**candidate.said(method, measured), **found})
    return rows


def measure_window(candidate, seeds):
    """Of the window, by models that were trained on all of the training."""
    tables = candidate.training()
    window = candidate.table(PETS, start=160, stop=780, step=20)
    identity = window.observations["identity"]
    fresh = ~torch.isin(identity, tables[0].observations["identity"]) | (identity < 0)
    index = fresh[window.pairs].all(0).nonzero()[:, 0]
    calibrators = fit_calibrators(tables)
    found = [("calibrators", "", apply(calibrators, window.evidence))]
    for seed in range(seeds):
        network = fit_ensemble(calibrators, tables, seed)
        found.append(("ensemble", seed, ensemble_scores(network, calibrators, window)))
    rows = []
    for method, seed, scores in found:
        of_all, new = (figures(window, scores, RULES[method], x) for x in (slice(None), index))
        said = candidate.said(method, "window")
        rows.append({**said, "seed": seed, **of_all, "f1_new": new["f1"]})
    return rows


def at_every_offset(candidate):
    """What motion is worth on all later frames, of which only every 20th has pixels: no colour."""
    tables = candidate.training()
    unseen = candidate.table(PETS, start=160, pixels=False)
    calibrators = fit_calibrators(tables)
    network = fit_ensemble(calibrators, tables, 0)
    rows = []
    for method, scores in (
        ("calibrators", apply(calibrators, unseen.evidence)),
        ("ensemble", ensemble_scores(network, calibrators, unseen)),
    ):
        cost = float(cllr(log_ratio_of(scores).sum(0), unseen.same))
        said = candidate.said(method, f"all {len(unseen)} pairs from frame 160 on")
        rows.append({**said, "cllr": cost})
    return rows


def choose(rows):
    """What the rule chooses: frames, modalities, method."""
    inside = [row for row in rows if row["measured"] in TRAINING]
    ranges = grouped(inside, "frames")
    (frames,) = max(ranges, key=lambda key: mean(ranges[key], "f1"))
    found = grouped(
        [row for row in inside if row["frames"] == frames], "frames", "modalities", "method"
    )
    return min(found, key=lambda key: mean(found[key], "cllr"))


def chosen_line(rows):
    frames, modalities, method = choose(rows)
    return f"Chosen: {frames:.0f} frames, {modalities}, {method}"


def table(rows):
    """All that was measured, what the rule chooses, and what its first step goes by."""
    shown = [(measured, COLUMNS[5:7]) for measured in TRAINING] + [("window", COLUMNS[5:])]
    heads = [f"{measured}: {name}" for measured, names in shown for name in names]
    lines = ["| frames | modalities | method | " + " | ".join(heads) + " |", "|---" * 10 + "|"]
    solved_rows = [row for row in rows if row["measured"] in (*TRAINING, "window")]
    for (frames, *key), group in grouped(solved_rows, "frames", "modalities", "method").items():
        cells = [f"{frames:.0f}", *key]
        for measured, names in shown:
            chosen = [row for row in group if row["measured"] == measured]
            for name in names:
                text = f"{mean(chosen, name):.3f}" if chosen else ""
                cells.append(f"{text} ± {spread(chosen, name):.3f}" if len(chosen) > 1 else text)
        lines.append("| " + " | ".join(cells) + " |")
    lines.append("")
    inside = [row for row in rows if row["measured"] in TRAINING]
    for (frames,), group in grouped(inside, "frames").items():
        lines.append(f"Up to {frames:.0f} frames, held out: F1 {mean(group, 'f1'):.3f}")
    lines += ["", chosen_line(rows)]
    lines += ["", "| frames | modalities | method | measured | Cllr |", "|---" * 5 + "|"]
    for row in rows:
        if row not in solved_rows:
            cells = [f"{row['frames']:.0f}", *(row[key] for key in COLUMNS[1:4])]
            lines.append("| " + " | ".join([*cells, f"{row['cllr']:.3f}"]) + " |")
    return "\n".join([*lines, ""])


def main(argv=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/learning_motion"))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--training_only", action="store_true")
    parser.add_argument("--without_ground", action="store_true")
    weights = Path("out/train/embedding/export/embedding.safetensors")
    parser.add_argument("--embedding", type=Path, default=weights)
    arguments = parser.parse_args(argv)
    common = arguments.out / "evidence", arguments.embedding, not arguments.without_ground
    candidates = [Candidate(names, gaps, *common) for gaps in (1, 2, 3) for names in SETS]
    rows = []
    for candidate in candidates:
        start = time.perf_counter()
        rows += measure_training(candidate)
        said = f"{20 * candidate.gaps} {' + '.join(candidate.names)}"
        print(f"{said}: {time.perf_counter() - start:.0f} s", flush=True)
    print(chosen_line(rows), flush=True)
    if not arguments.training_only:
        for candidate in candidates:
            rows += measure_window(candidate, arguments.seeds)
        for gaps in (2, 3):
            for names in (("distance",), ("distance", "motion")):
                rows += at_every_offset(Candidate(names, gaps, *common))
    results.write(arguments.out / "rows.csv", COLUMNS, rows)
    print(results.tabled(arguments.out, table))


if __name__ == "__main__":
    main()

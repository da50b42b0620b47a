"""What learning is worth: calibrators, fusion weights and pair network against the hand-set scores.

Parking lots: trained on two seeds, tested on five others. Real video (needs MIXER_DATA): trained on
PETS frames 1-150 and TUD-Stadtmitte, tested on PETS frames 160-780, with all persons and with those
only who are not in frames 1-150; and trained on PETS alone, tested on TUD-Stadtmitte; pairs are as
far apart in time in training as in the test. "By hand" is what the configurations say; "chosen
fusion" is the one whose clusters are best in training sequences that were held out; "ceiling" is
calibrators that were fitted to the test itself. Rows go to rows.csv, the tables are made from them.

    python benchmarks/learning.py --out out/benchmarks/learning
"""

import argparse
import math
import os
import time
from pathlib import Path

import torch
from torch.nn.functional import binary_cross_entropy_with_logits, softplus

from mixer_torch.benchmarks import results
from mixer_torch.benchmarks.results import grouped, mean, spread
from mixer_torch.datasets import MOTChallenge, ParkingLot
from mixer_torch.fusion import LogOddsFusion
from mixer_torch.metrics.calibration import calibration_metrics
from mixer_torch.scorers import SIFT, Color, IoU, Proximity
from mixer_torch.scorers.calibrators import MonotoneSpline
from mixer_torch.scorers.curves import PiecewiseLinear
from mixer_torch.scorers.likelihood_ratio import log_ratio_of
from mixer_torch.scorers.pair_network import MAX_LOG_RATIO, EvidenceNetwork, as_evidence
from mixer_torch.train.calibration import has_both_kinds
from mixer_torch.train.data import PairData, Rows
from mixer_torch.train.evaluation import solved
from mixer_torch.train.selectors import AtGaps
from mixer_torch.train.tables import calibrated

COLUMNS = ("experiment", "test", "method", "modality", "cllr", "min_cllr", "ece", "f1")
COVARIATES = ("time_gap", "box_size", "size_ratio")
SPARSE = (20 / 7, 40 / 7, 60 / 7)
"""Seconds between views of PETS 160-780, and the gaps that configs/pets.yaml compares."""
DENSE = (5 / 7, 10 / 7, 15 / 7)
"""Seconds between views of TUD-Stadtmitte, every 18th frame, and twice and three times that."""


def fit_calibrators(tables):
    """Shrunk by what is held out: whole sequences where several have the modality, else objects."""
    rows, fitted = Rows(tables), []
    sequence = torch.cat([torch.full((len(table),), k) for k, table in enumerate(tables)])
    first = torch.cat([table.observations["identity"][table.pairs[0]] for table in tables])
    for evidence in rows.evidence:
        calibrator = MonotoneSpline()
        if has_both_kinds(evidence, rows.same):  # else it says nothing
            several = len(torch.unique(sequence[evidence.isfinite()])) > 1
            calibrator.fit(evidence, rows.same, groups=sequence if several else first)
        fitted.append(calibrator)
    return fitted


@torch.no_grad()
def apply(calibrators, evidence):
    scores = torch.full_like(evidence, 0.5)
    for row, calibrator, raw in zip(scores, calibrators, evidence, strict=True):
        known = raw.isfinite()
        row[known] = calibrator(raw[known])
    return scores


def sample(same, negatives=10, seed=0):
    """All same pairs and some of the others, and the logit of the base rate among them."""
    different = (~same).nonzero()[:, 0]
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(len(different), generator=generator)[: negatives * int(same.sum())]
    chosen = torch.cat([same.nonzero()[:, 0], different[order]])
    return chosen, math.log(int(same.sum()) / max(len(order), 1))


def fit_fusion(scores, same, names):
    """Weights and cap by log loss."""
    chosen, prior = sample(same)
    ratio, truth = log_ratio_of(scores[:, chosen]), same[chosen].double()
    free = torch.full((len(scores) + 1,), 0.5413, dtype=torch.float64)
    free[-1] = 4.0
    free.requires_grad_()
    optimiser = torch.optim.Adam([free], lr=0.05)
    for _ in range(200):
        optimiser.zero_grad()
        cap = softplus(free[-1])
        capped = torch.maximum(torch.minimum(ratio, cap), -cap)
        logit = softplus(free[:-1]) @ capped + prior
        binary_cross_entropy_with_logits(logit, truth).backward()
        optimiser.step()
    *weights, cap = softplus(free.detach()).tolist()
    return LogOddsFusion(dict(zip(names, weights, strict=True)), cap)


def fit_network(scores, same, covariates, epochs=150):
    chosen, prior = sample(same)
    torch.manual_seed(0)
    network = EvidenceNetwork(len(scores), COVARIATES)
    network.covariates.learn(covariates)
    ratio = as_evidence(scores[:, chosen])
    values, truth = covariates[chosen], same[chosen].float()
    optimiser = torch.optim.AdamW(network.parameters(), lr=5e-3, weight_decay=1e-2)
    for _ in range(epochs):
        optimiser.zero_grad()
        logit = network(ratio, values).nan_to_num(0.0) + prior
        binary_cross_entropy_with_logits(logit, truth).backward()
        optimiser.step()
    return network


def fusions(tables, calibrators, names):
    rows = Rows(tables)
    learned = fit_fusion(apply(calibrators, rows.evidence), rows.same, names)
    return {"linear": None, "log odds": LogOddsFusion(), "learned weights": learned}


def choose_fusion(tables, names):
    """The name of the fusion whose clusters are best in sequences that it was not trained on."""
    found = {"log odds": []}
    for k, table in enumerate(tables if len(tables) > 1 else []):
        rest = [*tables[:k], *tables[k + 1 :]]
        calibrators = fit_calibrators(rest)
        scores = apply(calibrators, table.evidence)
        for name, fusion in fusions(rest, calibrators, names).items():
            found.setdefault(name, []).append(solved(table, scores, names, fusion)["f1"])
    print("F1 held out:", {name: [round(f1, 3) for f1 in row] for name, row in found.items()})
    return max(found, key=lambda name: sum(found[name]))


def measure(experiment, test, method, table, scores, names, fusion=None):
    """A row for each modality, and one for the solved problem."""
    rows = []
    for k, name in enumerate(names):
        known = table.evidence[k].isfinite() if len(names) > 1 else torch.ones_like(table.same)
        same = table.same[known]
        if 0 < int(same.sum()) < len(same):
            found = calibration_metrics(log_ratio_of(scores[k][known]), same)
            figures = {key: found[key] for key in ("cllr", "min_cllr", "ece")}
            rows.append({"modality": name, **figures})
    rows.append({"modality": "all", "f1": solved(table, scores, names, fusion)["f1"]})
    said = {"experiment": experiment, "test": test, "method": method}
    return [{**said, **row} for row in rows]


def compare(experiment, data, tests, ceiling=False):
    start = time.perf_counter()
    rows, names = Rows(data.tables("train")), data.modalities
    calibrators = fit_calibrators(data.tables("train"))
    trained = apply(calibrators, rows.evidence)
    candidates = fusions(data.tables("train"), calibrators, names)
    fusion = candidates["learned weights"]
    network = fit_network(trained, rows.same, rows.covariates_of(COVARIATES))
    print(f"{experiment}: fitted in {time.perf_counter() - start:.1f} s; {fusion.weights}")
    chosen = choose_fusion(data.tables("train"), names)
    found = []
    for test, table in tests:
        by_hand = calibrated(data.scorers, table)
        after = apply(calibrators, table.evidence)
        with torch.no_grad():
            ratio = network(as_evidence(after), table.covariates_of(COVARIATES)).nan_to_num(0.0)
        fused = torch.sigmoid(ratio)[None]
        methods = [
            ("by hand", by_hand, None),
            ("by hand, log odds", by_hand, LogOddsFusion()),
            ("calibrated", after, None),
            ("calibrated, log odds", after, LogOddsFusion()),
            ("calibrated, learned weights", after, fusion),
            ("calibrated, chosen fusion", after, candidates[chosen]),
        ]
        if ceiling:
            own = apply(fit_calibrators([table]), table.evidence)
            methods += [("ceiling", own, None), ("ceiling, log odds", own, LogOddsFusion())]
        for method, scores, rule in methods:
            found += measure(experiment, test, method, table, scores, names, rule)
        found += measure(
            experiment, test, "network", table, fused, ("fused",), LogOddsFusion(cap=MAX_LOG_RATIO)
        )
    return found


def parking_lots(frames, cache, seeds=(1, 2, 3, 4, 5)):
    little = PiecewiseLinear([0, 1], [0.45, 0.55])  # as in configs/parking_lot.yaml
    scorers = [IoU(), Proximity(), Color(calibrator=little), SIFT()]
    lots = [ParkingLot(seed, num_frames=frames) for seed in (101, 102)]
    test = [ParkingLot(seed, num_frames=frames) for seed in seeds]
    data = PairData(scorers, lots, lots[:1], test, cache=cache)
    tests = list(zip((f"seed {seed}" for seed in seeds), data.tables("test"), strict=True))
    return compare("parking lot", data, tests)


def real_video(cache):
    """By hand: as configs/pets.yaml says, which was chosen with PETS 160-780 in view."""
    scorers = [
        IoU(max_gap=SPARSE[0] + 0.05, feature="time", disjoint=0.45),
        Proximity(speed=1.5, memory=5),
        Color("histogram"),
        SIFT(),
    ]
    # As they come, but that boxes of neighbouring views may overlap, and that clothes are patterns.
    plain = [IoU(max_gap=SPARSE[0] + 0.05, feature="time"), Proximity(), Color("histogram"), SIFT()]
    pets = [MOTChallenge("mot15/PETS09-S2L1", start=1, stop=150)]
    town = [MOTChallenge("mot15/TUD-Stadtmitte")]
    late = [MOTChallenge("mot15/PETS09-S2L1", start=160, stop=780, step=20)]
    rows = []
    for name, used in (("PETS + TUD", scorers), ("PETS + TUD, scorers as they come", plain)):
        data = PairData(used, [*pets, *town], pets, late, AtGaps(SPARSE), cache=cache)
        known = torch.unique(data.tables("train")[0].observations["identity"])
        table = data.tables("test")[0]
        identity = table.observations["identity"]
        objects = torch.unique(identity[identity >= 0])
        old = int(torch.isin(objects, known).sum())
        print(f"PETS 160-780: {len(objects)} persons, {old} of them in frames 1-150")
        fresh = table.of_identities(~torch.isin(identity, known) | (identity < 0))
        tests = [("PETS 160-780", table), ("its new persons", fresh)]
        rows += compare(name, data, tests, ceiling=True)
    # TUD-Stadtmitte without its ground, which no file of calibration but only its truth tells.
    without_position = [IoU(max_gap=DENSE[0] + 0.05, feature="time"), *scorers[2:]]
    sparse_town = [MOTChallenge("mot15/TUD-Stadtmitte", step=18)]
    across = PairData(without_position, pets, pets, sparse_town, AtGaps(DENSE), cache=cache)
    tests = [("TUD-Stadtmitte", across.tables("test")[0])]
    return rows + compare("PETS alone", across, tests, ceiling=True)


def with_spread(rows, key):
    text = f"{mean(rows, key):.3f}"
    return f"{text} ± {spread(rows, key):.3f}" if len(rows) > 1 else text


def table(rows):
    lines = ["| experiment | test | method | modality | Cllr | min Cllr | ECE |", "|---" * 7 + "|"]
    lot = {"by hand", "calibrated", "network", "ceiling"}
    figures = [row for row in rows if row["modality"] != "all" and row["method"] in lot]
    by = ("experiment", "method", "modality")
    for (experiment, method, modality), group in grouped(figures, *by).items():
        tests = "5 seeds" if experiment == "parking lot" else group[0]["test"]
        group = group if experiment == "parking lot" else group[:1]  # the first test of it
        cells = " | ".join(with_spread(group, key) for key in ("cllr", "min_cllr", "ece"))
        lines.append(f"| {experiment} | {tests} | {method} | {modality} | {cells} |")
    lines += ["", "| experiment | test | method | F1 |", "|---|---|---|---|"]
    solved_rows = [row for row in rows if row["modality"] == "all"]
    for row in solved_rows:
        row["test"] = "5 seeds" if row["experiment"] == "parking lot" else row["test"]
    for (experiment, test, method), group in grouped(
        solved_rows, "experiment", "test", "method"
    ).items():
        f1 = with_spread(group, "f1")
        lines.append(f"| {experiment} | {test} | {method} | {f1} |")
    return "\n".join([*lines, ""])


def main(argv=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/learning"))
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--only", choices=("parking_lot", "real"))
    arguments = parser.parse_args(argv)
    cache = arguments.out / "evidence"
    rows = []
    if arguments.only != "real":
        rows += parking_lots(arguments.frames, cache)
    if arguments.only != "parking_lot" and os.environ.get("MIXER_DATA"):
        rows += real_video(cache)
    results.write(arguments.out / "rows.csv", COLUMNS, rows)
    print(results.tabled(arguments.out, table))


if __name__ == "__main__":
    main()

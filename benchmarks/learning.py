"""What learning is worth: calibrators, fusion weights and pair network against the hand-set scores.

Parking lots: trained on two seeds, tested on five others. Real video (needs MIXER_DATA): trained on
PETS frames 1-150 and TUD-Stadtmitte, tested on PETS frames 160-780, with all persons and with those
only who are not in frames 1-150; and trained on PETS alone, tested on TUD-Stadtmitte. Rows go to
rows.csv, the tables are made from them.

    python benchmarks/learning.py --out out/benchmarks/learning
"""

import argparse
import csv
import math
import os
import time
from pathlib import Path

import torch
from torch.nn.functional import binary_cross_entropy_with_logits, softplus

from mixer_torch.benchmarks.comparison import grouped, mean, spread
from mixer_torch.calibration_metrics import calibration_metrics
from mixer_torch.datasets import MOTChallenge, ParkingLot
from mixer_torch.fusion import LogOddsFusion
from scorers import SIFT, Color, IoU, Proximity
from scorers.calibrators import MonotoneSpline
from scorers.learned import SURE, EvidenceNetwork
from train.data import PairData, Rows
from train.evaluation import solved
from train.tables import calibrated

COLUMNS = ("experiment", "test", "method", "modality", "cllr", "min_cllr", "ece", "f1")
COVARIATES = ("time_gap", "box_size", "size_ratio")


def log_ratios(scores):
    return torch.logit(scores.double(), eps=1e-6)


def fit_calibrators(rows):
    return [MonotoneSpline().fit(evidence, rows.same) for evidence in rows.evidence]


@torch.no_grad()
def apply(calibrators, evidence):
    scores = torch.full_like(evidence, 0.5)
    for row, calibrator, raw in zip(scores, calibrators, evidence, strict=True):
        known = raw.isfinite()
        row[known] = calibrator(raw[known])
    return scores


def sample(same, rivals=10, seed=0):
    """All same pairs and some of the others, and the logit of the base rate among them."""
    different = (~same).nonzero()[:, 0]
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(len(different), generator=generator)[: rivals * int(same.sum())]
    chosen = torch.cat([same.nonzero()[:, 0], different[order]])
    return chosen, math.log(int(same.sum()) / max(len(order), 1))


def fit_fusion(scores, same, names):
    """Weights and cap by log loss."""
    chosen, prior = sample(same)
    ratio, truth = log_ratios(scores[:, chosen]), same[chosen].double()
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
    ratio = as_input(scores[:, chosen])
    values, truth = covariates[chosen], same[chosen].float()
    optimiser = torch.optim.AdamW(network.parameters(), lr=5e-3, weight_decay=1e-2)
    for _ in range(epochs):
        optimiser.zero_grad()
        logit = network(ratio, values).nan_to_num(0.0) + prior
        binary_cross_entropy_with_logits(logit, truth).backward()
        optimiser.step()
    return network


def as_input(scores):
    ratio = log_ratios(scores).float()
    return ratio.where(scores != 0.5, ratio.new_full((), torch.nan))


def measure(experiment, test, method, table, scores, names, fusion=None):
    """A row for each modality, and one for the solved problem."""
    rows = []
    for k, name in enumerate(names):
        known = table.evidence[k].isfinite() if len(names) > 1 else torch.ones_like(table.same)
        same = table.same[known]
        if 0 < int(same.sum()) < len(same):
            found = calibration_metrics(log_ratios(scores[k][known]), same)
            figures = {key: found[key] for key in ("cllr", "min_cllr", "ece")}
            rows.append({"modality": name, **figures})
    rows.append({"modality": "all", "f1": solved(table, scores, names, fusion)["f1"]})
    said = {"experiment": experiment, "test": test, "method": method}
    return [{**said, **row} for row in rows]


def compare(experiment, data, tests):
    start = time.perf_counter()
    rows, names = Rows(data.tables("train")), data.modalities
    calibrators = fit_calibrators(rows)
    trained = apply(calibrators, rows.evidence)
    fusion = fit_fusion(trained, rows.same, names)
    network = fit_network(trained, rows.same, rows.covariates_of(COVARIATES))
    print(f"{experiment}: fitted in {time.perf_counter() - start:.1f} s; {fusion.weights}")
    found = []
    for test, table in tests:
        by_hand = calibrated(data.scorers, table)
        after = apply(calibrators, table.evidence)
        with torch.no_grad():
            ratio = network(as_input(after), table.covariates_of(COVARIATES)).nan_to_num(0.0)
        fused = torch.sigmoid(ratio)[None]
        for method, scores, rule in (
            ("by hand", by_hand, None),
            ("by hand, log odds", by_hand, LogOddsFusion()),
            ("calibrated", after, None),
            ("calibrated, log odds", after, LogOddsFusion()),
            ("calibrated, learned weights", after, fusion),
        ):
            found += measure(experiment, test, method, table, scores, names, rule)
        found += measure(
            experiment, test, "network", table, fused, ("fused",), LogOddsFusion(cap=SURE)
        )
    return found


def parking_lots(frames, cache, seeds=(1, 2, 3, 4, 5)):
    scorers = [IoU(), Proximity(), Color(), SIFT()]
    lots = [ParkingLot(seed, num_frames=frames) for seed in (101, 102)]
    test = [ParkingLot(seed, num_frames=frames) for seed in seeds]
    data = PairData(scorers, lots, lots[:1], test, cache=cache)
    tests = list(zip((f"seed {seed}" for seed in seeds), data.tables("test"), strict=True))
    return compare("parking lot", data, tests)


def real_video(cache):
    scorers = [IoU(max_gap=2.9, feature="time"), Proximity(speed=1.5), Color("histogram"), SIFT()]
    pets = [MOTChallenge("mot15/PETS09-S2L1", start=1, stop=150, step=5)]
    town = [MOTChallenge("mot15/TUD-Stadtmitte", step=9)]
    test = [MOTChallenge("mot15/PETS09-S2L1", start=160, stop=780, step=20)]
    data = PairData(scorers, [*pets, *town], pets, test, cache=cache)
    known = torch.unique(data.tables("train")[0].observations["identity"])
    table = data.tables("test")[0]
    identity = table.observations["identity"]
    objects = torch.unique(identity[identity >= 0])
    old = torch.isin(objects, known)
    print(f"PETS 160-780: {len(objects)} persons, {int(old.sum())} of them in frames 1-150")
    fresh = table.of_identities(~torch.isin(identity, known) | (identity < 0))
    rows = compare("PETS + TUD", data, [("PETS 160-780", table), ("its new persons", fresh)])
    # There is no calibration of TUD-Stadtmitte, so no position.
    without_position = [scorers[0], *scorers[2:]]
    across = PairData(without_position, pets, pets, town, cache=cache)
    return rows + compare("PETS alone", across, [("TUD-Stadtmitte", across.tables("test")[0])])


def numbers(row):
    return {key: float(row[key]) if row[key] and key in COLUMNS[4:] else row[key] for key in row}


def table(rows):
    lines = ["| experiment | test | method | modality | Cllr | min Cllr | ECE |", "|---" * 7 + "|"]
    lot = {"by hand", "calibrated", "network"}
    figures = [row for row in rows if row["modality"] != "all" and row["method"] in lot]
    by = ("experiment", "method", "modality")
    for (experiment, method, modality), group in grouped(figures, *by).items():
        tests = "5 seeds" if experiment == "parking lot" else group[0]["test"]
        group = group if experiment == "parking lot" else group[:1]  # the first test of it
        cells = " | ".join(
            f"{mean(group, key):.3f} ± {spread(group, key):.3f}"
            for key in ("cllr", "min_cllr", "ece")
        )
        lines.append(f"| {experiment} | {tests} | {method} | {modality} | {cells} |")
    lines += ["", "| experiment | test | method | F1 |", "|---|---|---|---|"]
    solved_rows = [row for row in rows if row["modality"] == "all"]
    for row in solved_rows:
        row["test"] = "5 seeds" if row["experiment"] == "parking lot" else row["test"]
    for (experiment, test, method), group in grouped(
        solved_rows, "experiment", "test", "method"
    ).items():
        f1 = f"{mean(group, 'f1'):.3f} ± {spread(group, 'f1'):.3f}"
        lines.append(f"| {experiment} | {test} | {method} | {f1} |")
    return "\n".join(lines)


def main(argv=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/learning"))
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--only", choices=("parking_lot", "real"))
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    cache = arguments.out / "evidence"
    rows = []
    if arguments.only != "real":
        rows += parking_lots(arguments.frames, cache)
    if arguments.only != "parking_lot" and os.environ.get("MIXER_DATA"):
        rows += real_video(cache)
    path = arguments.out / "rows.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    with path.open() as file:
        text = table([numbers(row) for row in csv.DictReader(file)])
    (arguments.out / "table.md").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()

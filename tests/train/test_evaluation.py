"""Solving labelled pairs: what counts as an error where the pairs fall into parts."""

from dataclasses import replace

import torch

from mixer_torch.observations import Observations
from mixer_torch.pairs import Every
from mixer_torch.train.evaluation import components_of, ratios_by_modality, solved, summary
from mixer_torch.train.selectors import AtGaps
from mixer_torch.train.tables import PairTable


def table(selector, frames=12, objects=3):
    frame = torch.arange(frames * objects) // objects
    identity = torch.arange(frames * objects) % objects
    features = {"frame": frame, "time": frame.double(), "identity": identity}
    seen = Observations(frame, features)
    pairs = selector(seen)
    same = identity[pairs[0]] == identity[pairs[1]]
    return PairTable(seen, pairs, same.float()[None], {}, same)


def test_components_are_what_no_pair_links():
    pairs = torch.tensor([[0, 2, 5], [2, 4, 7]])
    part = components_of(pairs, 8).tolist()
    assert part[0] == part[2] == part[4]
    assert part[5] == part[7]
    assert len({part[k] for k in (0, 1, 3, 5, 6)}) == 5
    assert components_of(torch.zeros(2, 0, dtype=torch.int64), 0).tolist() == []


def test_perfect_scores_are_perfect_in_every_part():
    for selector in (Every(), AtGaps([3, 6], "frame", 0)):
        rows = table(selector)
        found = solved(rows, 0.02 + 0.96 * rows.evidence, ["truth"], None)
        assert found == {"precision": 1.0, "recall": 1.0, "f1": 1.0}


def test_what_a_part_does_not_join_is_missed():
    rows = table(AtGaps([3, 6], "frame", 0))
    scores = 0.02 + 0.96 * rows.evidence
    scores[:, (rows.observations["frame"][rows.pairs] == 0).any(0)] = 0.02
    found = solved(rows, scores, ["truth"], None)
    # Of three parts of four frames, six pairs an object each, one has lost three an object.
    assert found["precision"] == 1.0
    assert found["recall"] == 15 / 18


def test_no_pairs():
    rows = table(AtGaps([100], "frame", 0))
    assert solved(rows, rows.evidence, ["truth"], None)["f1"] == 1.0


def test_a_modality_is_judged_on_what_it_speaks_of_when_tables_hold_scores():
    rows = table(Every())
    evidence = rows.evidence.where(torch.arange(len(rows)) % 2 == 0, torch.nan)
    raw = replace(rows, evidence=evidence, known=evidence.isfinite())
    scored = replace(raw, evidence=raw.evidence.nan_to_num(0.5))
    for of in (raw, scored, scored.select(torch.arange(len(rows)))):
        ratio, _ = ratios_by_modality([of], [scored.evidence], ["truth"])["truth"]
        assert len(ratio) == int(evidence.isfinite().sum())


def test_summary_names_what_was_measured():
    figures = dict.fromkeys(("cllr", "min_cllr", "ece", "brier", "auc"), 0.25)
    text = summary({"by hand": {"modalities": {"SIFT": figures}, "f1": 0.5}})
    assert "| by hand | SIFT | 0.250 |" in text
    assert "| by hand | 0.500 |" in text

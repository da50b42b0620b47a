"""Learning a tracker's weights from labelled sequences."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from collections.abc import Sequence as Listed
from dataclasses import replace

import numpy as np
from jaxtyping import Int64

from mixer_torch.tracking.evidence import (
    CONTEXT,
    FEATURES,
    FIRST_STAGE,
    MODALITIES,
    Frame,
    Pairs,
    compared,
)
from mixer_torch.tracking.examples import UNKNOWN, Example
from mixer_torch.tracking.fitting import fit
from mixer_torch.tracking.following import (
    DETECTION,
    Follower,
    Linking,
    frame_of,
    odds_of_objects,
    with_rivals,
)
from mixer_torch.tracking.joining import JOIN, at_rest, ends
from mixer_torch.tracking.measured import Measured
from mixer_torch.tracking.objects import TRACK, Boxes, numbered, track_features
from mixer_torch.tracking.states import States
from mixer_torch.tracking.weights import Network, Weights

EASY_IOU, EASY_SHARE = 0.05, 0.15
"""Pairs that differ and do not overlap are many: this share of them is kept, and weighs as all."""
MOST_ROWS = 40_000  # pairs of a family
FEWEST_JOINS = 20
"""Joins that a family counts as at least: with fewer, chance would have too large a say."""
MAJORITY = 0.6
LONGEST_GAP = 3.0  # seconds, of the gaps that are learned from
SHORT_WAIT, FEWEST_WAITED = 0.3, 3
"""Seconds, and frames at least, after which tracks are cut to learn how gaps are bridged: the
longer a tracker waits, the fewer gaps are left to learn from."""


class _Recorder(Follower):
    """Follows a labelled sequence and writes down every pair that it compares.

    Args:
        example: The sequence.
        odds: (n,) log odds of its detections.
        taught: Whether links are the true ones.
        weights: Networks that there are already; the first stage is 0 without any.
        linking: How detections are put on tracks.
    """

    def __init__(
        self, example: Example, odds: np.ndarray, taught: bool, weights: Weights, linking: Linking
    ) -> None:
        super().__init__(weights, linking, example.frame_rate)
        self.example, self.odds, self.taught = example, odds, taught
        self.truth = np.full(len(example.identity), -1)  # of each track, by its number
        self.features: list[np.ndarray] = []
        self.rivals: list[np.ndarray] = []
        self.same: list[np.ndarray] = []

    def run(self) -> tuple[np.ndarray, np.ndarray]:
        """The track of each detection and the evidence of its link."""
        sequence, measured = self.example.sequence, self.example.measured
        label, link = np.full(len(sequence.box), -1), np.zeros(len(sequence.box))
        for t in range(len(sequence.frames)):
            rows = sequence.rows(t)
            frame = frame_of(sequence, t, self.odds[rows], self.example.description[rows])
            label[rows], link[rows] = self.step(t, frame, measured.camera[t], measured)
            identity = self.example.identity[rows]
            known = (identity >= 0) & (label[rows] >= 0)
            self.truth[label[rows][known]] = identity[known]
        return label, link

    def compare(
        self, states: States, frame: Frame, now: float, measured: Measured
    ) -> tuple[Pairs, np.ndarray]:
        pairs = compared(states, frame, now, measured)
        networks = self.weights.networks
        first = (
            networks["evidence"](pairs.features)
            if "evidence" in networks
            else np.zeros(len(pairs.track))
        )
        rivals = with_rivals(pairs, first)
        self.features.append(pairs.features)
        self.rivals.append(rivals)
        track = self.truth[states.identity[pairs.track]]
        found = self.example.identity[frame.row[pairs.detection]]
        same = np.where(track >= 0, found == track, np.where(found >= 0, 0, -1))
        self.same.append(np.where(found == UNKNOWN, -1, same))
        return pairs, networks["rivals"](rivals) if "rivals" in networks else first

    def assign(
        self, states: States, frame: Frame, pairs: Pairs, evidence: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        if not self.taught:
            return super().assign(states, frame, pairs, evidence)
        track = self.truth[states.identity]
        found = self.example.identity[frame.row]
        equal = (track[:, None] == found) & (found >= 0)
        # the track of an object that was seen last, where it has several
        latest = np.where(equal, states.seen[:, None], -np.inf)
        best = latest.argmax(0) if len(states) else np.zeros(len(frame.row), dtype=int)
        has = equal.any(0)
        return best[has], np.flatnonzero(has)


Family = Listed[Example]
Progress = Callable[[str], None]


def train(
    families: Mapping[str, Family],
    linking: Linking | None = None,
    seed: int = 0,
    progress: Progress = lambda text: None,
) -> Weights:
    """Learn all networks; families count alike, however long they are.

    First what detections are by themselves; then pairs along the true tracks; then pairs, and
    rivals, along the tracks that the tracker makes by itself, since those are what it will meet.

    Args:
        families: Labelled sequences by family (a data set with a detector).
        linking: How the tracker works that the weights are for.
        seed: Of the draws.
        progress: Told what is done.

    Raises:
        ValueError: There is no family, or one of which no two detections are known to be of one
            object, or of two.
    """
    if not families:
        raise ValueError("families: expected at least one, got none")
    for name, family in families.items():
        if not family:
            raise ValueError(f"families: expected examples of {name!r}, got none")
    linking = linking or Linking()
    generator = np.random.default_rng(seed)
    networks = {"objectness": _objectness(families, seed)}
    progress("objectness")

    def rows(taught: bool, weights: Weights) -> tuple[np.ndarray, ...]:
        return _pairs(families, weights, taught, linking, generator)

    true = rows(True, Weights(networks))
    networks["evidence"] = _fit_evidence(true[0], true[2], true[3], seed)
    progress(f"evidence, on {len(true[2])} pairs along true tracks")
    features, _, same, weight = _together(true, rows(False, Weights(networks)))
    networks["evidence"] = _fit_evidence(features, same, weight, seed)
    progress(f"evidence, on {len(same)} pairs along its own tracks, too")
    names = (*MODALITIES["rivals"], *CONTEXT)
    modality = ["rivals"] * len(MODALITIES["rivals"]) + ["context"] * len(CONTEXT)
    _, rivals, same, weight = _together(*(rows(way, Weights(networks)) for way in (True, False)))
    networks["rivals"] = fit(rivals, same, weight, names, modality, seed=seed)
    progress("rivals")
    short = replace(linking, longest_unseen=SHORT_WAIT, fewest_unseen=FEWEST_WAITED)
    networks["joins"] = _joins(families, Weights(networks), short, seed)
    progress("joins")
    networks["tracks"] = _tracks(families, Weights(networks), linking, seed)
    progress("tracks")
    return Weights(networks)


def _together(*parts: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Pairs along true tracks and along the tracker's own ones."""
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


def _fit_evidence(features: np.ndarray, same: np.ndarray, weight: np.ndarray, seed: int) -> Network:
    modality = [key for key in FIRST_STAGE for _ in MODALITIES[key]] + ["context"] * len(CONTEXT)
    return fit(features, same, weight, FEATURES, modality, seed=seed)


def _tracks(
    families: Mapping[str, Family], weights: Weights, linking: Linking, seed: int
) -> Network:
    """Whether the boxes of a track are those of an object: each track counts by its boxes."""
    x, same, weight = [], [], []
    for family in families.values():
        parts = [_judged(one, weights, linking) for one in family]
        features, true, false = (np.concatenate(part) for part in zip(*parts, strict=True))
        total = np.sqrt(np.concatenate([true, false])).sum()
        x += [features, features]
        same += [np.ones(len(true)), np.zeros(len(false))]
        weight += [np.sqrt(true) / total, np.sqrt(false) / total]
    rows, equal, counts = (np.concatenate(part) for part in (x, same, weight))
    return fit(rows, equal, counts, TRACK, ["track"] * len(TRACK), epochs=40, seed=seed)


def _joins(
    families: Mapping[str, Family], weights: Weights, linking: Linking, seed: int
) -> Network:
    """Whether a track that ends and one that begins are one object, from tracks of short waits."""
    x, same, weight = [], [], []
    for family in families.values():
        parts = [_ends_of(one, weights, linking) for one in family]
        features, equal = (np.concatenate(part) for part in zip(*parts, strict=True))
        x.append(features)
        same.append(equal)
        weight.append(np.full(len(equal), 1 / (equal.sum() + FEWEST_JOINS)))
    rows, known, counts = (np.concatenate(part) for part in (x, same, weight))
    modality = ["gap" if name in JOIN[:12] else "context" for name in JOIN]
    return fit(rows, known, counts, JOIN, modality, epochs=30, seed=seed)


def _ends_of(one: Example, weights: Weights, linking: Linking) -> tuple[np.ndarray, np.ndarray]:
    """Features of gaps between tracks of which it is known what they are of, and whether of one."""
    odds = odds_of_objects(weights["objectness"], one.description)
    label, _ = _Recorder(one, odds, False, weights, linking).run()
    label = numbered(label)
    sequence, measured = one.sequence, one.measured
    if label.max(initial=-1) < 1:
        return np.zeros((0, len(JOIN))), np.zeros(0)
    overlap, near = (
        one.description[:, DETECTION.index(name)] for name in ("overlap", "neighbours")
    )
    columns = odds, overlap, near
    longest = max(1, round(LONGEST_GAP * one.frame_rate))
    resting = at_rest(sequence, measured.camera)
    pairs = ends(label, sequence, resting, columns, measured, weights, longest)
    truth = _majority(label, one.identity)
    a, b = truth[pairs.before], truth[pairs.after]
    known = (a >= 0) & (b >= 0)
    return pairs.features[known], (a == b)[known].astype(float)


def _majority(label: np.ndarray, identity: np.ndarray) -> Int64[np.ndarray, " k"]:
    """The identity of most boxes of each track; -1 where it is of clutter or of several."""
    row = np.flatnonzero((label >= 0) & (identity != UNKNOWN))
    count = int(label.max(initial=-1)) + 1
    _, number = np.unique(identity[row], return_inverse=True)
    values = np.unique(identity[row])
    table = np.zeros((count, max(len(values), 1)))
    np.add.at(table, (label[row], number), 1)
    best = table.argmax(1)
    sure = table.max(1) >= MAJORITY * np.maximum(table.sum(1), 1)
    sure &= table.sum(1) > 0
    return np.where(sure, values[best] if len(values) else -1, -1)


def _judged(one: Example, weights: Weights, linking: Linking) -> tuple[np.ndarray, ...]:
    """Features of the tracks that the tracker makes; how many of their boxes are true, false."""
    odds = odds_of_objects(weights["objectness"], one.description)
    label, link = _Recorder(one, odds, False, weights, linking).run()
    label = numbered(label)
    row = np.flatnonzero(label >= 0)
    count = int(label.max(initial=-1)) + 1
    true = np.bincount(label[row], one.identity[row] >= 0, count)
    false = np.bincount(label[row], one.identity[row] == -1, count)
    return track_features(boxes_of(one, label, link, odds)), true, false


def boxes_of(one: Example, label: np.ndarray, link: np.ndarray, odds: np.ndarray) -> Boxes:
    """What is known of each detection when tracks are judged."""
    sequence, measured = one.sequence, one.measured
    overlap, most, neighbours = (
        one.description[:, DETECTION.index(name)]
        for name in ("overlap_stronger", "overlap", "neighbours")
    )
    rank, meaning = measured.rank(sequence.score), measured.means(sequence.score)
    return Boxes(label, sequence.frame, odds, overlap, link, rank, meaning, most, neighbours)


def _objectness(families: Mapping[str, Family], seed: int) -> Network:
    x, same, weight = [], [], []
    for family in families.values():
        features = np.concatenate([e.description for e in family])
        identity = np.concatenate([e.identity for e in family])
        known = identity != UNKNOWN
        x.append(features[known])
        same.append(identity[known] >= 0)
        weight.append(np.full(known.sum(), 1 / max(known.sum(), 1)))
    rows, equal, counts = (np.concatenate(part) for part in (x, same, weight))
    return fit(rows, equal, counts, DETECTION, ["detection"] * len(DETECTION), seed=seed)


def _pairs(
    families: Mapping[str, Family],
    weights: Weights,
    taught: bool,
    linking: Linking,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Features, features of rivals, whether the same, and weights, of pairs of all families."""
    columns: list[list[np.ndarray]] = [[], [], [], []]
    for name, family in families.items():
        parts = [_recorded(one, weights, taught, linking, generator) for one in family]
        rows = [np.concatenate(part) for part in zip(*parts, strict=True)]
        if len(rows[2]) > MOST_ROWS:
            chosen = generator.choice(len(rows[2]), MOST_ROWS, replace=False)
            rows = [row[chosen] for row in rows]
        if not ((rows[2] == 1).any() and (rows[2] == 0).any()):
            raise ValueError(
                f"families: {name!r} has no two detections of one object, or none of two, in "
                "frames close to each other; is its identity feature the truth?"
            )
        rows[3] = rows[3] / rows[3][rows[2] == 1].sum()
        for column, row in zip(columns, rows, strict=True):
            column.append(row)
    features, rivals, same, weight = (np.concatenate(column) for column in columns)
    return features, rivals, same, weight


def _recorded(
    one: Example, weights: Weights, taught: bool, linking: Linking, generator: np.random.Generator
) -> list[np.ndarray]:
    odds = odds_of_objects(weights["objectness"], one.description)
    recorder = _Recorder(one, odds, taught, weights, linking)
    recorder.run()
    none = np.zeros((0, len(FEATURES))), np.zeros((0, 3 + len(CONTEXT))), np.zeros(0, dtype=int)
    logs = (recorder.features, recorder.rivals, recorder.same)
    features, rivals, same = (
        np.concatenate([empty, *log]) for empty, log in zip(none, logs, strict=True)
    )
    easy = (same == 0) & (features[:, FEATURES.index("iou_best")] < EASY_IOU)
    keep = (same >= 0) & (~easy | (generator.random(len(same)) < EASY_SHARE))
    weight = np.where(easy, 1 / EASY_SHARE, 1.0)
    return [features[keep], rivals[keep], same[keep], weight[keep]]

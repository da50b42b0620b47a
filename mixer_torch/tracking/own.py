"""Weights for data of one's own: learned from labelled sequences, and judged on those left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from mixer_torch.io.tracks import MotTruth
from mixer_torch.metrics.tracking import evaluate_sequences
from mixer_torch.observations import Observations
from mixer_torch.scoring import Progress
from mixer_torch.tracking.examples import UNKNOWN, examples, simulated
from mixer_torch.tracking.tracker import Tracker
from mixer_torch.tracking.training import Family, train
from mixer_torch.tracking.weights import Weights
from mixer_torch.tracks import Tracks

SCENES = 48
"""Simulated scenes that are learned from beside one's own data, which may be little."""
VARIANTS = 3
"""Stretches of each sequence: one as it is, two made harder."""
LEAST_OVERLAP = 0.3
"""Intersection over union from which a detection is an object, to learn from. At the 0.5 of the
metrics a loose box would be clutter and its object lost, from one frame to the next."""
METRICS = ("HOTA", "IDF1")
MOST_PARTS = 3
"""Parts that the sequences are divided into, each to be judged by what the others taught."""


@dataclass(frozen=True)
class Labelled:
    """A sequence of which the truth is known.

    Args:
        observations: The detections, with ``identity`` by the truth, at :data:`LEAST_OVERLAP`: -1
            for clutter.
        truth: Its truth.
    """

    observations: Observations
    truth: MotTruth

    def to_learn_from(self, seed: int) -> Family:
        """Stretches of it; detections on what neither counts nor is wrong are of no known kind."""
        everything = Tracks.from_labels(self.observations, torch.arange(len(self.observations)))
        counted = torch.zeros(len(self.observations), dtype=torch.bool)
        counted[self.truth.without_distractors(everything).observation] = True
        identity = self.observations["identity"]
        unknown = (identity < 0) & ~counted
        known = self.observations.with_features(identity=identity.where(~unknown, UNKNOWN))
        return examples(known, seed, VARIANTS)


@dataclass(frozen=True)
class Gain:
    """A metric, percent, of a sequence with the weights shipped and with own ones that were
    learned without it.
    """

    sequence: str
    metric: str
    shipped: float
    own: float

    @property
    def gain(self) -> float:
        """By how much own weights are better."""
        return self.own - self.shipped


def learn(
    sequences: Mapping[str, Labelled], seed: int = 0, progress: Progress | None = None
) -> tuple[Weights, list[Gain]]:
    """Weights learned from all sequences, and what they gain on sequences held out.

    The sequences are divided into up to three parts. Weights learned from the others (and from
    simulated scenes) track each part; those returned are learned from all.

    Args:
        sequences: At least two, by name.
        seed: Of the draws.
        progress: Called with stage, number done and total.

    Raises:
        ValueError: There are less than two, or one from which nothing can be learned.
    """
    if len(sequences) < 2:
        raise ValueError(
            f"sequences: expected at least two, one to judge what another taught; got "
            f"{len(sequences)}"
        )
    told = progress or (lambda what, done, of: None)
    scenes = simulated(SCENES, seed)
    parts = min(MOST_PARTS, len(sequences))
    data = {name: one.to_learn_from(seed + k) for k, (name, one) in enumerate(sequences.items())}
    gains = []
    for part in range(parts):
        told("learned", part, parts + 1)
        held_out = list(sequences)[part::parts]
        others = [one for name, family in data.items() if name not in held_out for one in family]
        weights = train({"own": others, "simulated": scenes}, seed=seed)
        gains += _judged({name: sequences[name] for name in held_out}, weights)
    told("learned", parts, parts + 1)
    everything = [one for family in data.values() for one in family]
    weights = train({"own": everything, "simulated": scenes}, seed=seed)
    told("learned", parts + 1, parts + 1)
    card = {"families": [f"own: {', '.join(sequences)}", f"{SCENES} simulated scenes"]}
    order = {name: k for k, name in enumerate(sequences)}
    return Weights(weights.networks, card), sorted(gains, key=lambda gain: order[gain.sequence])


def _judged(sequences: Mapping[str, Labelled], weights: Weights) -> list[Gain]:
    truths = {name: one.truth.tracks for name, one in sequences.items()}
    scores = []
    for tracker in (Tracker(), Tracker(weights=weights)):
        tracks = {
            name: one.truth.without_distractors(tracker.track(one.observations))
            for name, one in sequences.items()
        }
        scores.append(evaluate_sequences(tracks, truths)["sequences"])
    shipped, own = scores
    return [
        Gain(name, metric, shipped[name][metric], own[name][metric])
        for name in sequences
        for metric in METRICS
    ]


def mean_gain(gains: Sequence[Gain], metric: str) -> float:
    """By how much own weights are better than those shipped, in the mean over sequences."""
    return float(np.mean([one.gain for one in gains if one.metric == metric]))

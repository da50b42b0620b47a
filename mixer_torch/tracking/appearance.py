"""Further modalities of a tracker: any scorers, on what observations have beside boxes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from mixer_torch.observations import Observations
from mixer_torch.scoring import Scorer, check_needs
from mixer_torch.tracking.evidence import Frame, Pairs
from mixer_torch.tracking.states import States

LARGEST = 4.0
"""Nats that one further modality may say: a calibrator is sure only of what it has seen."""


class ScorerEvidence:
    """What scorers say of pairs of observations, as log likelihood ratios, nats.

    Each observation is described once. A track is compared by its latest box.

    Args:
        scorers: One for each modality.
        observations: With what the scorers need.
        rows: (n,) the observation of each detection of the sequence.

    Raises:
        KeyError: A scorer needs what is missing.
    """

    def __init__(
        self, scorers: Sequence[Scorer], observations: Observations, rows: np.ndarray
    ) -> None:
        self.rows = torch.from_numpy(rows).to(observations.device)
        self.scorers = list(scorers)
        with torch.no_grad():
            for scorer in self.scorers:
                check_needs(scorer, observations)
            self.descriptions = [scorer.describe(observations) for scorer in self.scorers]
            self.contexts = [scorer.calibrator.describe(observations) for scorer in self.scorers]

    def __call__(self, states: States, frame: Frame, pairs: Pairs) -> Float64[np.ndarray, " P"]:
        """(P,) the sum over the modalities; 0 where none has anything to say."""
        total = np.zeros(len(pairs.track))
        if not len(total):
            return total
        earlier = states.row[pairs.track]
        later = frame.row[pairs.detection]
        chosen = self.rows[torch.from_numpy(np.stack([earlier, later])).to(self.rows.device)]
        with torch.no_grad():
            for scorer, description, context in zip(
                self.scorers, self.descriptions, self.contexts, strict=True
            ):
                score = scorer.score_described(description, chosen, None, context)
                total += evidence_of(score)
        return total


def evidence_of(score: Tensor) -> Float64[np.ndarray, " P"]:
    """Scores LR / (1 + LR) as log likelihood ratios, bounded."""
    odds = torch.logit(score.double()).nan_to_num(posinf=LARGEST, neginf=-LARGEST)
    return odds.clamp(-LARGEST, LARGEST).cpu().numpy()

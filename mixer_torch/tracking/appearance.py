"""Looks, described once: appearance scorers compare boxes, and tracklets by their mean looks."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from mixer_torch.observations import Observations
from mixer_torch.scoring import Scorer, check_needs

APPEARANCE = "appearance/"
"""What the features begin with that hold descriptions; the number of the scorer follows."""


class Looks(Scorer):
    """A scorer whose descriptions are a feature already, of boxes or the mean ones of tracklets.

    Args:
        scorer: Says how descriptions are compared, and with what calibrator.
        key: The feature.
    """

    def __init__(self, scorer: Scorer, key: str) -> None:
        super().__init__(scorer.calibrator)
        self.scorer = scorer
        self.needs = (key,)
        self.chunk = scorer.chunk

    @property
    def name(self) -> str:
        return self.scorer.name

    def compare(self, description: Tensor, pairs: Tensor) -> Tensor:
        return self.scorer.compare(description, pairs)


def with_looks(observations: Observations, scorers: Sequence[Scorer]) -> Observations:
    """The observations with what each scorer says of their looks as features, once and for all.

    Args:
        observations: With what the scorers need.
        scorers: Their descriptions have to be one tensor of floats, a row for each observation,
            whose mean makes sense: histograms, embeddings.

    Raises:
        KeyError: A scorer needs what is missing.
        ValueError: A description is of another form.
    """
    found = {}
    for k, scorer in enumerate(scorers):
        key = f"{APPEARANCE}{k}"
        if key in observations.features:
            continue
        check_needs(scorer, observations)
        description = scorer.describe(observations)
        if not (isinstance(description, Tensor) and description.is_floating_point()):
            raise ValueError(
                f"appearance: expected scorers that describe looks by one tensor of floats, "
                f"got {scorer.name}"
            )
        found[key] = description.detach()
    return observations.with_features(**found) if found else observations


def looks(scorers: Sequence[Scorer]) -> list[Looks]:
    """Scorers that compare what :func:`with_looks` found."""
    return [Looks(scorer, f"{APPEARANCE}{k}") for k, scorer in enumerate(scorers)]


def pooled(value: Tensor, labels: Tensor, count: int) -> Tensor:
    """The mean of a feature in each cluster, over the rows without NaN; NaN where there is none.

    Args:
        value: (m, ...) floats.
        labels: (m,) clusters, 0..count - 1.
        count: How many there are.
    """
    rows = value.double()[:, None].flatten(1)
    good = rows.isfinite().all(1)
    total = rows.new_zeros(count, rows.shape[1]).index_add(0, labels[good], rows[good])
    number = torch.bincount(labels[good], minlength=count)[:, None]
    return (total / number).reshape(count, *value.shape[1:]).to(value.dtype)

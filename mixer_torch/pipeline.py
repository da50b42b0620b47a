"""The whole flow: observations are scored, scores are fused, and the fused problem is solved."""

from __future__ import annotations

from collections.abc import Iterable

from torch import Tensor

from mixer_torch.association import Association
from mixer_torch.fusion import Fusion
from mixer_torch.observations import Observations
from mixer_torch.pairs import PairSelector
from mixer_torch.scoring import Progress, Scorer, score
from mixer_torch.solvers.base import solve
from mixer_torch.solvers.problem import Solver


def associate(
    observations: Observations,
    scorers: Iterable[Scorer] | Scorer,
    solver: Solver | None = None,
    pairs: Tensor | PairSelector | None = None,
    fusion: Fusion | None = None,
    progress: Progress | None = None,
) -> Association:
    """Say which observations are of the same object.

    Args:
        observations: What was seen.
        scorers: One for each modality.
        solver: The algorithm; ``Mixer()`` if None.
        pairs: Which pairs to compare, (2, P) or a rule; every pair across views if None.
        fusion: How modalities add up; the paper's ``LinearFusion()`` if None.
        progress: Told what is done while it goes on.

    Returns:
        A cluster label for each observation, and proof of what was reached.

    Raises:
        KeyError: A scorer needs a feature that is missing.
        ValueError: An argument is malformed, or a score is not in [0, 1].
    """
    affinity = score(observations, scorers, pairs, progress)
    return solve(affinity, solver, fusion)

"""What fitted calibrators have in common: a log likelihood ratio that is learned and never wild."""

from __future__ import annotations

import copy
import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, softplus

from mixer_torch.observations import Observations
from mixer_torch.scorers.covariates import Covariates, Features, support
from mixer_torch.scorers.fitting import (
    best_factor,
    best_shift,
    gathered,
    logistic_regression,
    minimise,
    thinned,
)
from mixer_torch.scoring import Calibrator

FOLDS = 4
CONVINCING = 5.0
"""Nats of held-out log likelihood that a calibrator has to gain before it may speak at all. Twice
the gain that the best factor makes of noise is distributed as chi² of one degree of freedom, or 0
where the best is none, so noise passes once in about a thousand times."""


class LikelihoodRatio(Calibrator):
    """Score sigmoid(r) of evidence x under circumstances c, r a fitted log likelihood ratio:

        r(x, c) = shrinkage * support(x, c) * ( exp(u · φ(c)) h(x) + v · ψ(c) ),
        -log(n_same + 1) <= r <= log(n_different + 1)

    h is what a subclass defines, monotone where it says so; φ(c) and ψ(c) are columns of the
    covariates, and without any there is no second factor or summand. Fitting minimises log loss of
    r + logit P(same | c), in which the base rate under the circumstances is estimated apart: r is
    then log p(x | same, c) - log p(x | different, c), at whatever rate matches occur, and
    circumstances that make a match likely are no evidence by themselves, unless ``counted``.

    Three things keep it modest. It claims no larger ratio than the number of pairs of the other
    kind that training saw. ``support`` falls to 0 outside of the range that training saw.
    ``shrinkage`` in [0, 1] is the factor that is best on held-out pairs, and 0, which is a score of
    0.5 everywhere, where holding out shows no gain: pure noise says nothing. Before it is fitted it
    says nothing either.

    Args:
        covariates: Names of :data:`mixer_torch.scorers.covariates.COVARIATES`.
        regularisation: Weight of the penalty that keeps parameters finite.
        counted: Whether the circumstances are evidence themselves: r is then the log ratio of
            p(x, c | same) and p(x, c | different). Of several modalities at most one should
            count them.

    Raises:
        ValueError: A covariate is not known, or regularisation is not positive.
    """

    base_rate: Tensor
    counts: Tensor
    bounds: Tensor
    shrinkage: Tensor

    def __init__(
        self,
        covariates: Sequence[str] = (),
        regularisation: float = 1e-4,
        counted: bool = False,
    ) -> None:
        super().__init__()
        if not 0 < regularisation < float("inf"):
            raise ValueError(f"regularisation: expected a positive number, got {regularisation}")
        self.counted = counted
        self.covariates = Covariates(covariates)
        self.needs = self.covariates.needs
        self.regularisation = regularisation
        columns = self.covariates.width
        base = self.covariates.base_columns(torch.zeros(1, len(self.covariates))).shape[1]
        self.gain = nn.Parameter(torch.zeros(columns, dtype=torch.float64))
        self.offset = nn.Parameter(torch.zeros(base - 1, dtype=torch.float64))
        self.register_buffer("base_rate", torch.zeros(base, dtype=torch.float64))
        self.register_buffer("counts", torch.zeros(2, dtype=torch.float64))
        self.register_buffer("bounds", torch.zeros(2, dtype=torch.float64))
        self.register_buffer("shrinkage", torch.ones((), dtype=torch.float64))

    @property
    def settings(self) -> dict[str, Any]:
        """The arguments that make an unfitted calibrator like this one."""
        return {
            "covariates": list(self.covariates.names),
            "regularisation": self.regularisation,
            "counted": self.counted,
        }

    def describe(self, observations: Observations) -> Features:
        return self.covariates.describe(observations)

    def calibrate(self, evidence: Tensor, circumstances: Any, pairs: Tensor) -> Tensor:
        return self(evidence, self.covariates.of(circumstances or {}, pairs))

    def forward(self, evidence: Tensor, covariates: Tensor | None = None) -> Tensor:
        """Scores (P,) of evidence (P,) and raw covariates (P, c), average ones if None."""
        return torch.sigmoid(self.log_ratio(evidence, covariates))

    def log_ratio(self, evidence: Tensor, covariates: Tensor | None = None) -> Tensor:
        """r(x, c), (P,) in nats, in the dtype of the evidence."""
        x, c = self._wide(evidence, covariates)
        inside = support(x, *self.bounds.to(x.device)) * self.covariates.support(c)
        ratio = self.shrinkage * inside * self._free_ratio(x, c)
        same, different = torch.log1p(self.counts)
        return ratio.clamp(-same, different).to(evidence.dtype)

    def _wide(
        self, evidence: Tensor, covariates: Tensor | None
    ) -> tuple[Float[Tensor, " P"], Float[Tensor, "P c"]]:
        count = len(self.covariates)
        if covariates is None:
            covariates = self.covariates.centre.expand(len(evidence), count)
        if covariates.shape != (len(evidence), count):
            raise ValueError(
                f"covariates: expected shape ({len(evidence)}, {count}) for "
                f"{', '.join(self.covariates.names) or 'none'}, got {tuple(covariates.shape)}"
            )
        return evidence.double(), covariates.double()

    def _free_ratio(self, x: Float[Tensor, " P"], c: Float[Tensor, "P c"]) -> Float[Tensor, " P"]:
        if not len(self.covariates):
            return self.ratio(x)
        gain = torch.exp((self.covariates.columns(c) @ self.gain).clamp(-4, 4))
        return gain * self.ratio(x) + self.covariates.base_columns(c)[:, :-1] @ self.offset

    @abstractmethod
    def ratio(self, x: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        """h(x), float64."""

    @abstractmethod
    def prepare(self, x: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> None:
        """Take from the pairs of training what is not learned by descent."""

    def penalty(self) -> Tensor:
        """What is added to the log loss, times ``regularisation``."""
        return self.gain.square().sum() + self.offset.square().sum()

    def learn_statistics(self, evidence: Any, same: Any, covariates: Any = None) -> LikelihoodRatio:
        """All of fitting but the descent: ranges, counts, base rate, and :meth:`prepare`.

        Raises:
            ValueError: Lengths differ, or one of the two kinds of pairs is missing.
        """
        x, y, c = self._training_pairs(evidence, same, covariates)
        self.counts.copy_(torch.stack([y.sum(), (~y).sum()]))
        self.bounds.copy_(torch.stack([x.min(), x.max()]))
        self.covariates.learn(c)
        base = self.covariates.base_columns(c)
        base[:, :-1] *= not self.counted
        self.base_rate.copy_(logistic_regression(base, y.double(), 1e-6))
        with torch.no_grad():
            self.prepare(x, y)
        return self

    def loss(
        self,
        evidence: Tensor,
        same: Tensor,
        covariates: Tensor | None = None,
        kept: float = 1.0,
    ) -> Tensor:
        """Mean log loss at the base rate of training, with the penalty.

        ``kept`` is the share of the different pairs that were kept where some were left out.
        """
        x, c = self._wide(evidence, covariates)
        prior = self.covariates.base_columns(c) @ self.base_rate - math.log(kept)
        logit = self._free_ratio(x, c) + prior
        fit = binary_cross_entropy_with_logits(logit, same.double())
        return fit + self.regularisation * self.penalty()

    def fit(
        self, evidence: Any, same: Any, covariates: Any = None, groups: Any = None
    ) -> LikelihoodRatio:
        """Fit to labelled pairs, in seconds, deterministically.

        Args:
            evidence: (P,) raw evidence; pairs of NaN are left out.
            same: (P,) bool, whether the pair shows one object.
            covariates: (P, c) raw values of the covariates; needed where there are any.
            groups: (P,) integers: pairs of one group (an object, a sequence) are held out together
                when the shrinkage is chosen. Each pair for itself if None.

        Raises:
            ValueError: Lengths differ, one of the two kinds of pairs is missing, or no group can
                be held out.
        """
        x, y, c = self._training_pairs(evidence, same, covariates)
        group = torch.arange(len(x)) if groups is None else _finite(groups, evidence)
        held_out = torch.zeros_like(x)
        fold, used = _folds(group.to(x.device), y), 0
        for number in range(FOLDS):
            inside = fold == number
            rest = y[~inside]
            if not bool(inside.any()) or not 0 < int(rest.sum()) < len(rest):
                continue
            other = copy.deepcopy(self)._fit_all(x[~inside], rest, c[~inside])
            held_out[inside] = other.log_ratio(x[inside], c[inside]).detach()
            used += 1
        if groups is not None and not used:
            raise ValueError(
                "groups: expected two or more such that pairs of both kinds are left when one is "
                "held out; without groups, each pair is held out for itself"
            )
        self._fit_all(x, y, c)
        self._shrink(held_out, y, c)
        return self

    def _fit_all(self, x: Tensor, y: Tensor, c: Tensor) -> LikelihoodRatio:
        self.learn_statistics(x, y, c)
        self.shrinkage.fill_(1)
        learned = [parameter for parameter in self.parameters() if parameter.numel()]
        if learned and len(self.covariates):
            chosen, kept = thinned(y)
            x, y, c = x[chosen], y[chosen], c[chosen]
            minimise(lambda: self.loss(x, y, c, kept), learned)
        elif learned:
            value, of_same, of_all = gathered(x, y)
            minimise(lambda: self._gathered_loss(value, of_same, of_all), learned)
        return self

    def _gathered_loss(self, value: Tensor, of_same: Tensor, of_all: Tensor) -> Tensor:
        """The loss of all pairs where there are no covariates, from how many have which value."""
        logit = self.ratio(value) + self.base_rate[-1]
        fit = (of_all * softplus(logit) - of_same * logit).sum() / of_all.sum()
        return fit + self.regularisation * self.penalty()

    def shrink(self, evidence: Any, same: Any, covariates: Any = None) -> LikelihoodRatio:
        """Choose the shrinkage on pairs that fitting did not see."""
        x, y, c = self._training_pairs(evidence, same, covariates)
        self.shrinkage.fill_(1)
        self._shrink(self.log_ratio(x, c).detach(), y, c)
        return self

    def _shrink(self, ratio: Tensor, y: Tensor, c: Tensor) -> None:
        prior = self.covariates.base_columns(c) @ self.base_rate
        prior = prior + best_shift(prior, y)
        factor = best_factor(ratio, y, prior)
        gain = _log_likelihood(factor * ratio + prior, y) - _log_likelihood(prior, y)
        self.shrinkage.copy_(factor if float(gain) > CONVINCING else torch.zeros_like(factor))

    def _training_pairs(
        self, evidence: Any, same: Any, covariates: Any
    ) -> tuple[Float[Tensor, " P"], Bool[Tensor, " P"], Float[Tensor, "P c"]]:
        x = torch.as_tensor(evidence).detach().double().flatten()
        y = torch.as_tensor(same).to(x.device, torch.bool).flatten()
        if x.shape != y.shape:
            raise ValueError(
                f"same: expected one for each of {len(x)} pieces of evidence, got {len(y)}"
            )
        count = len(self.covariates)
        if covariates is None and count:
            raise ValueError(f"covariates: expected shape ({len(x)}, {count}), got None")
        c = x.new_zeros(len(x), 0) if covariates is None else torch.as_tensor(covariates)
        if c.shape != (len(x), count):
            raise ValueError(
                f"covariates: expected shape ({len(x)}, {count}), got {tuple(c.shape)}"
            )
        known = x.isfinite()
        x, y, c = x[known], y[known], c[known].detach().to(x)
        kinds = int(y.sum()), int((~y).sum())
        if not all(kinds):
            raise ValueError(
                f"same: expected pairs of both kinds, got {kinds[0]} same and {kinds[1]} "
                "different ones with finite evidence"
            )
        return x, y, c

    def _load_from_state_dict(self, state: Any, prefix: str, *arguments: Any) -> None:
        """Take the sizes of the file: how many knots there are depends on the training pairs."""
        for name, own in [*self._parameters.items(), *self._buffers.items()]:
            saved = state.get(prefix + name)
            if own is not None and saved is not None and saved.shape != own.shape:
                own.data = own.data.new_zeros(saved.shape)
        super()._load_from_state_dict(state, prefix, *arguments)

    def extra_repr(self) -> str:
        same, different = self.counts.tolist()
        return f"{same:.0f} same, {different:.0f} different, shrinkage={float(self.shrinkage):.3g}"


def _log_likelihood(logit: Tensor, y: Tensor) -> Tensor:
    return -softplus(torch.where(y, -logit, logit)).sum()


def _finite(groups: Any, evidence: Any) -> Tensor:
    """The groups of the pairs with finite evidence."""
    group = torch.as_tensor(groups).flatten()
    known = torch.as_tensor(evidence).detach().flatten().isfinite()
    if group.shape != known.shape:
        raise ValueError(f"groups: expected {len(known)} integers, got {len(group)}")
    return group[known.to(group.device)]


def _folds(group: Tensor, y: Bool[Tensor, " P"]) -> Tensor:
    """A fold for each pair: groups go round in turn, those with pairs of the same object first."""
    _, number = torch.unique(group, return_inverse=True)
    order = torch.zeros(int(number.max()) + 1, dtype=torch.float64, device=group.device)
    order.index_add_(0, number, y.double())
    rank = torch.empty_like(order, dtype=torch.int64)
    shuffled = torch.randperm(len(order), generator=torch.Generator().manual_seed(0))
    shuffled = shuffled.to(group.device)
    by_matches = torch.argsort(order[shuffled], descending=True, stable=True)
    rank[shuffled[by_matches]] = torch.arange(len(order), device=group.device)
    return rank[number] % FOLDS

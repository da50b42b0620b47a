"""Base class of fitted, bounded log-likelihood-ratio calibrators, and how they are fitted."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, softplus

from mixer_torch.observations import Observations
from mixer_torch.scorers.covariates import Covariates, Features, support
from mixer_torch.scorers.curves import labelled_pairs, logistic_regression
from mixer_torch.scoring import Calibrator

FOLDS = 4
"""Of the cross-validation that chooses the shrinkage."""
SIGNIFICANT = 5.0
"""Nats of held-out log likelihood that a calibrator has to gain to be used at all. Twice the gain
that the best factor makes of pure noise is distributed as chi² with one degree of freedom, or is 0
where the best factor is 0, so noise passes once in about a thousand times."""
BINS = 2_000
"""Distinct values of the evidence at most, in fits without covariates, so that a fit takes a second
whatever the number of pairs: each stands for at most 0.05 % of them."""
MIN_NEGATIVES, NEGATIVES = 4_000, 4
"""Different pairs that fits with covariates keep: at least so many, and so many for each same
pair. With four for each the variance of the estimates is 5/4 of that with all of them."""


class LikelihoodRatio(Calibrator, ABC):
    """Score sigmoid(r) of evidence x in the context c, r a fitted log likelihood ratio:

        r(x, c) = shrinkage * support(x, c) * ( exp(u · φ(c)) h(x) + v · ψ(c) ),
        -log(n_same + 1) <= r <= log(n_different + 1)

    h is what a subclass defines, monotone where it says so; φ(c) and ψ(c) are columns of the
    covariates, and without any there is no second factor or summand. Fitting minimises log loss of
    r + logit P(same | c), in which the base rate P(same | c) is estimated separately: r is then
    log p(x | same, c) - log p(x | different, c), at whatever rate matches occur, and a context
    that makes a match likely is no evidence by itself, unless ``covariates_as_evidence``.

    Three safeguards: **bounds**, a ratio no larger than the number of pairs of the other kind that
    training saw; **range limits**, as ``support`` falls to 0 outside of the range that training
    saw; and **cross-validated shrinkage**, the factor in [0, 1] that is best on held-out pairs,
    and 0, a score of 0.5 everywhere, where holding out shows no gain, as for pure noise. Before it
    is fitted, every score is 0.5 too.

    A subclass defines :meth:`prepare` and :meth:`ratio`, and :meth:`penalty` and
    :attr:`settings` where it has parameters or arguments of its own.

    Args:
        covariates: Names of :data:`mixer_torch.scorers.covariates.COVARIATES`.
        regularisation: Weight of :meth:`penalty`, which keeps parameters finite. The default is
            small enough to be unnoticed where the two kinds of pairs overlap.
        covariates_as_evidence: Whether the context is evidence itself: r is then the log ratio of
            p(x, c | same) and p(x, c | different). For one modality of several at most, as
            otherwise the same evidence is added up several times.

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
        covariates_as_evidence: bool = False,
    ) -> None:
        super().__init__()
        if not 0 < regularisation < float("inf"):
            raise ValueError(f"regularisation: expected a positive number, got {regularisation}")
        self.covariates_as_evidence = covariates_as_evidence
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
            "covariates_as_evidence": self.covariates_as_evidence,
        }

    def describe(self, observations: Observations) -> Features:
        return self.covariates.describe(observations)

    def calibrate(self, evidence: Tensor, context: Any, pairs: Tensor) -> Tensor:
        return self(evidence, self.covariates.of(context or {}, pairs))

    def forward(self, evidence: Tensor, covariates: Tensor | None = None) -> Tensor:
        """Scores (P,) of evidence (P,) and raw covariates (P, c), average ones if None."""
        return torch.sigmoid(self.log_ratio(evidence, covariates))

    def log_ratio(self, evidence: Tensor, covariates: Tensor | None = None) -> Tensor:
        """r(x, c), (P,) in nats, in the dtype of the evidence."""
        x, c = self._in_float64(evidence, covariates)
        inside = support(x, *self.bounds.to(x.device)) * self.covariates.support(c)
        ratio = self.shrinkage * inside * self._unbounded_ratio(x, c)
        same, different = torch.log1p(self.counts)
        return ratio.clamp(-same, different).to(evidence.dtype)

    def _in_float64(
        self, evidence: Tensor, covariates: Tensor | None
    ) -> tuple[Float[Tensor, " P"], Float[Tensor, "P c"]]:
        if covariates is None:
            covariates = self.covariates.mean.expand(len(evidence), len(self.covariates))
        self._check_shape(covariates, len(evidence))
        return evidence.double(), covariates.double()

    def _check_shape(self, covariates: Tensor | None, pairs: int) -> None:
        got = None if covariates is None else tuple(covariates.shape)
        if got != (pairs, len(self.covariates)):
            raise ValueError(
                f"covariates: expected shape ({pairs}, {len(self.covariates)}) for "
                f"{', '.join(self.covariates.names) or 'none'}, got {got}"
            )

    def _unbounded_ratio(
        self, x: Float[Tensor, " P"], c: Float[Tensor, "P c"]
    ) -> Float[Tensor, " P"]:
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
        base[:, :-1] *= not self.covariates_as_evidence
        # Nearly unregularised: the base rate is to be right for every context.
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
        x, c = self._in_float64(evidence, covariates)
        prior = self.covariates.base_columns(c) @ self.base_rate - math.log(kept)
        logit = self._unbounded_ratio(x, c) + prior
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
        group = torch.arange(len(x)) if groups is None else _of_finite(groups, evidence)
        held_out = torch.zeros_like(x)
        fold, used = _folds(group.to(x.device), y), 0
        for number in range(FOLDS):
            inside = fold == number
            rest = y[~inside]
            if not bool(inside.any()) or not 0 < int(rest.sum()) < len(rest):
                continue
            other = copy.deepcopy(self)._fit_unshrunk(x[~inside], rest, c[~inside])
            held_out[inside] = other.log_ratio(x[inside], c[inside]).detach()
            used += 1
        if groups is not None and not used:
            raise ValueError(
                "groups: expected two or more such that pairs of both kinds are left when one is "
                "held out; without groups, each pair is held out for itself"
            )
        self._fit_unshrunk(x, y, c)
        self._choose_shrinkage(held_out, y, c)
        return self

    def _fit_unshrunk(self, x: Tensor, y: Tensor, c: Tensor) -> LikelihoodRatio:
        self.learn_statistics(x, y, c)
        self.shrinkage.fill_(1)
        learned = [parameter for parameter in self.parameters() if parameter.numel()]
        if learned and len(self.covariates):
            chosen, kept = _fewer_negatives(y)
            x, y, c = x[chosen], y[chosen], c[chosen]
            _minimise(lambda: self.loss(x, y, c, kept), learned)
        elif learned:
            value, of_same, of_all = _binned(x, y)
            _minimise(lambda: self._binned_loss(value, of_same, of_all), learned)
        return self

    def _binned_loss(self, value: Tensor, of_same: Tensor, of_all: Tensor) -> Tensor:
        """:meth:`loss` without covariates, from how many same and all pairs have which value."""
        logit = self.ratio(value) + self.base_rate[-1]
        fit = (of_all * softplus(logit) - of_same * logit).sum() / of_all.sum()
        return fit + self.regularisation * self.penalty()

    def shrink(self, evidence: Any, same: Any, covariates: Any = None) -> LikelihoodRatio:
        """Choose the shrinkage on pairs that fitting did not see."""
        x, y, c = self._training_pairs(evidence, same, covariates)
        self.shrinkage.fill_(1)
        self._choose_shrinkage(self.log_ratio(x, c).detach(), y, c)
        return self

    def _choose_shrinkage(self, ratio: Tensor, y: Tensor, c: Tensor) -> None:
        """The k in [0, 1] for which k * ratio + prior has the least log loss; 0 if no gain."""
        prior, truth = self.covariates.base_columns(c) @ self.base_rate, y.double()
        # The prior is moved to the mean of y; both derivatives below increase.
        prior = prior + _root(
            lambda shift: torch.sigmoid(prior + shift).mean() - truth.mean(), -40.0, 40.0
        )
        factor = _root(
            lambda k: ((torch.sigmoid(k * ratio + prior) - truth) * ratio).mean(), 0.0, 1.0
        )
        gain = _log_likelihood(factor * ratio + prior, y) - _log_likelihood(prior, y)
        self.shrinkage.fill_(factor if float(gain) > SIGNIFICANT else 0.0)

    def _training_pairs(
        self, evidence: Any, same: Any, covariates: Any
    ) -> tuple[Float[Tensor, " P"], Bool[Tensor, " P"], Float[Tensor, "P c"]]:
        count = torch.as_tensor(evidence).numel()
        if covariates is not None:
            covariates = torch.as_tensor(covariates).detach()
        if covariates is not None or len(self.covariates):
            self._check_shape(covariates, count)
        x, y, known = labelled_pairs(evidence, same)
        c = x.new_zeros(len(x), 0) if covariates is None else covariates[known].to(x)
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


def log_ratio_of(score: Tensor) -> Tensor:
    """The log likelihood ratio that a score stands for, float64, kept within ±13.8 nats."""
    return torch.logit(score.double(), eps=1e-6)


def _log_likelihood(logit: Tensor, y: Tensor) -> Tensor:
    return -softplus(torch.where(y, -logit, logit)).sum()


def _root(increasing: Callable[[float], Tensor], low: float, high: float) -> float:
    """Where an increasing function is 0, by bisection; the end that is nearer to it if nowhere."""
    if float(increasing(high)) <= 0:
        return high
    if float(increasing(low)) >= 0:
        return low
    for _ in range(60):
        middle = (low + high) / 2
        if float(increasing(middle)) > 0:
            high = middle
        else:
            low = middle
    return (low + high) / 2


def _of_finite(groups: Any, evidence: Any) -> Tensor:
    """The groups of the pairs with finite evidence."""
    group = torch.as_tensor(groups).flatten()
    known = torch.as_tensor(evidence).detach().flatten().isfinite()
    if group.shape != known.shape:
        raise ValueError(f"groups: expected {len(known)} integers, got {len(group)}")
    return group[known.to(group.device)]


def _folds(group: Tensor, y: Bool[Tensor, " P"]) -> Tensor:
    """A fold for each pair: groups are dealt in turn, those with the most same pairs first."""
    _, number = torch.unique(group, return_inverse=True)
    matches = torch.zeros(int(number.max()) + 1, dtype=torch.float64, device=group.device)
    matches.index_add_(0, number, y.double())
    rank = torch.empty_like(matches, dtype=torch.int64)
    shuffled = torch.randperm(len(matches), generator=torch.Generator().manual_seed(0))
    shuffled = shuffled.to(group.device)
    by_matches = torch.argsort(matches[shuffled], descending=True, stable=True)
    rank[shuffled[by_matches]] = torch.arange(len(matches), device=group.device)
    return rank[number] % FOLDS


def _fewer_negatives(same: Bool[Tensor, " P"]) -> tuple[Bool[Tensor, " P"], float]:
    """All same pairs and enough of the different ones, and the share of those that is kept."""
    different = (~same).nonzero()[:, 0]
    wanted = max(MIN_NEGATIVES, NEGATIVES * int(same.sum()))
    if len(different) <= wanted:
        return torch.ones_like(same), 1.0
    order = torch.randperm(len(different), generator=torch.Generator().manual_seed(0))
    chosen = same.clone()
    chosen[different[order[:wanted].to(different.device)]] = True
    return chosen, wanted / len(different)


def _binned(
    x: Float[Tensor, " P"], same: Bool[Tensor, " P"]
) -> tuple[Float[Tensor, " k"], Float[Tensor, " k"], Float[Tensor, " k"]]:
    """At most :data:`BINS` values of the evidence, and how many same and all pairs have each.

    Exact where there are no more distinct values; else each bin has the mean of its evidence.
    """
    value, place = torch.unique(x, return_inverse=True)
    if len(value) > BINS:
        rank = torch.empty_like(place)
        rank[torch.argsort(x)] = torch.arange(len(x), device=x.device)
        place = torch.unique(rank * BINS // len(x), return_inverse=True)[1]
    of_all = torch.bincount(place).double()
    value = torch.zeros_like(of_all).index_add_(0, place, x) / of_all
    return value, torch.bincount(place[same], minlength=len(of_all)).double(), of_all


def _minimise(loss: Callable[[], Tensor], parameters: list[nn.Parameter]) -> None:
    """Minimise a smooth function of parameters by L-BFGS."""
    optimiser = torch.optim.LBFGS(
        parameters,
        max_iter=60,
        tolerance_grad=1e-9,
        tolerance_change=1e-10,
        line_search_fn="strong_wolfe",
    )

    def closure() -> Tensor:
        optimiser.zero_grad()
        value = loss()
        value.backward()
        return value

    optimiser.step(closure)
    for parameter in parameters:
        parameter.grad = None

"""Calibrators that are fitted to labelled pairs, and the files that keep them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import softplus

from mixer_torch.io.weights import load_weights, read_weights, write_weights
from mixer_torch.observations import Observations
from mixer_torch.scorers.curves import interpolate
from mixer_torch.scorers.likelihood_ratio import LikelihoodRatio
from mixer_torch.scoring import Calibrator

FORMAT = "mixer-torch calibrator 2"

Direction = Literal["increasing", "decreasing", "either"]
"""``increasing`` where more evidence means more alike, ``decreasing`` for distances, ``either`` for
what the pairs of training say."""


class Platt(LikelihoodRatio):
    """h(x) = a z + b with z the standardised evidence: logistic regression (Platt 1999).

    Args:
        covariates: See :class:`~mixer_torch.scorers.likelihood_ratio.LikelihoodRatio`.
        regularisation: Weight of a² and of the covariates' weights squared in the loss.
        covariates_as_evidence: See there.
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self,
        covariates: Sequence[str] = (),
        regularisation: float = 1e-4,
        covariates_as_evidence: bool = False,
    ) -> None:
        super().__init__(covariates, regularisation, covariates_as_evidence)
        self.slope = nn.Parameter(torch.zeros((), dtype=torch.float64))
        self.intercept = nn.Parameter(torch.zeros((), dtype=torch.float64))
        self.register_buffer("mean", torch.zeros((), dtype=torch.float64))
        self.register_buffer("std", torch.ones((), dtype=torch.float64))

    def prepare(self, x: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> None:
        self.mean.copy_(x.mean())
        self.std.copy_(x.std(correction=0).clamp(min=1e-9))

    def ratio(self, x: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        return self.slope * (x - self.mean) / self.std + self.intercept

    def penalty(self) -> Tensor:
        return super().penalty() + self.slope.square()


class Isotonic(LikelihoodRatio):
    """h(x), the monotone function of the greatest likelihood (Zadrozny and Elkan 2002).

    Adjacent violators are pooled. A pool that holds n_s of N_s same and n_d of N_d different pairs
    has, with the odds o = N_s / N_d, the log likelihood ratio

        h = log (n_s + 1) / (n_d + 1 / o) - log o,

    whose prior counts keep a pool of one kind from being infinitely sure. Between pools h is
    interpolated linearly.

    Args:
        direction: See :data:`Direction`.
        covariates: See :class:`~mixer_torch.scorers.likelihood_ratio.LikelihoodRatio`.
        regularisation: Weight of the covariates' squares in the loss.
        covariates_as_evidence: See there.

    Raises:
        ValueError: direction is another.
    """

    knots: Tensor
    values: Tensor

    def __init__(
        self,
        direction: Direction = "either",
        covariates: Sequence[str] = (),
        regularisation: float = 1e-4,
        covariates_as_evidence: bool = False,
    ) -> None:
        super().__init__(covariates, regularisation, covariates_as_evidence)
        self.direction = _checked(direction)
        self.register_buffer("knots", torch.zeros(1, dtype=torch.float64))
        self.register_buffer("values", torch.zeros(1, dtype=torch.float64))

    @property
    def settings(self) -> dict[str, Any]:
        return {"direction": self.direction, **super().settings}

    def prepare(self, x: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> None:
        from scipy.optimize import isotonic_regression

        sign = _sign(self.direction, x, same)
        value, place = torch.unique(sign * x, return_inverse=True)
        total = torch.bincount(place, minlength=len(value)).double()
        hits = torch.bincount(place[same], minlength=len(value)).double()
        mean = isotonic_regression((hits / total).cpu().numpy(), weights=total.cpu().numpy()).x
        pool = torch.unique_consecutive(torch.from_numpy(mean).to(x), return_inverse=True)[1]
        of_same = torch.zeros(int(pool.max()) + 1).to(x).index_add_(0, pool, hits)
        of_all = torch.zeros_like(of_same).index_add_(0, pool, total)
        odds = self.counts[0] / self.counts[1]
        ratio = ((of_same + 1) / (of_all - of_same + 1 / odds)).log() - odds.log()
        # The prior counts weigh more on small pools, so neighbours may be out of order again.
        smooth = isotonic_regression(ratio.cpu().numpy(), weights=of_all.cpu().numpy()).x
        ends = torch.ones_like(pool, dtype=torch.bool)
        ends[1:-1] = (pool[1:-1] != pool[:-2]) | (pool[1:-1] != pool[2:])
        knots, values = value[ends], torch.from_numpy(smooth.copy()).to(x)[pool[ends]]
        flip = [0] if sign < 0 else []
        self.knots, self.values = (sign * knots).flip(flip), values.flip(flip)

    def ratio(self, x: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        return interpolate(x, self.knots, self.values)


class MonotoneSpline(LikelihoodRatio):
    """h(x), a monotone quadratic spline: its derivative is piecewise linear and never negative.

        h(x) = b + sign * Σ_j softplus(w_j) B_j(x),   B_j(x) = ∫ hat function of knot j

    (I-splines, Ramsay 1988). The knots are quantiles at which both kinds of pairs count alike; the
    B_j are scaled to rise from 0 to 1. Beyond the outermost knots h is constant.

    Args:
        knots: Number of knots at most.
        direction: See :data:`Direction`.
        covariates: See :class:`~mixer_torch.scorers.likelihood_ratio.LikelihoodRatio`.
        regularisation: Weight of the squared rises and of the covariates' squares in the loss.
        covariates_as_evidence: See there.

    Raises:
        ValueError: knots < 2, or direction is another.
    """

    places: Tensor
    sign: Tensor

    def __init__(
        self,
        knots: int = 10,
        direction: Direction = "either",
        covariates: Sequence[str] = (),
        regularisation: float = 1e-4,
        covariates_as_evidence: bool = False,
    ) -> None:
        super().__init__(covariates, regularisation, covariates_as_evidence)
        if knots < 2:
            raise ValueError(f"knots: expected an integer >= 2, got {knots}")
        self.knots = knots
        self.direction = _checked(direction)
        self.rises = nn.Parameter(torch.full((2,), -4.0, dtype=torch.float64))
        self.intercept = nn.Parameter(torch.zeros((), dtype=torch.float64))
        self.register_buffer("places", torch.tensor([0.0, 1.0], dtype=torch.float64))
        self.register_buffer("sign", torch.ones((), dtype=torch.float64))

    @property
    def settings(self) -> dict[str, Any]:
        return {"knots": self.knots, "direction": self.direction, **super().settings}

    def prepare(self, x: Float[Tensor, " P"], same: Bool[Tensor, " P"]) -> None:
        self.sign.fill_(_sign(self.direction, x, same))
        places = balanced_quantiles(x, same, self.knots)
        self.places = places if len(places) > 1 else torch.stack([places[0], places[0] + 1])
        self.rises.data = self.rises.new_full((len(self.places),), -2.0)
        self.intercept.data.zero_()

    def ratio(self, x: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        return self.intercept + self.sign * (self.basis(x) @ softplus(self.rises))

    def basis(self, x: Float[Tensor, " P"]) -> Float[Tensor, "P k"]:
        """B_j(x), rising from 0 to 1 between the neighbours of knot j."""
        x = x[:, None].clamp(self.places[0], self.places[-1])
        width = self.places.diff()
        share = ((x - self.places[:-1]) / width).clamp(0, 1)
        up, down = share.square() / 2, share - share.square() / 2
        nothing = torch.zeros_like(x)
        area = torch.cat([nothing, up * width], 1) + torch.cat([down * width, nothing], 1)
        none = width.new_zeros(1)
        return area / (torch.cat([none, width]) / 2 + torch.cat([width, none]) / 2)

    def penalty(self) -> Tensor:
        return super().penalty() + softplus(self.rises).square().sum()


class Fitted(Calibrator):
    """A calibrator that was fitted and saved: one line in a configuration.

        calibrator: {class_path: Fitted, init_args: {path: SIFT.safetensors}}

    Args:
        path: What :func:`save_calibrator` or ``mixer-train fit`` wrote.

    Attributes:
        scorer: The scorer whose evidence it was fitted to, as ``class_path`` and ``init_args``;
            None where it was not said.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is something else.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__()
        self.path = Path(path)
        self.fitted, self.scorer = load_calibrator(path)
        self.needs = self.fitted.needs

    def forward(self, evidence: Tensor) -> Tensor:
        return self.fitted(evidence)

    def describe(self, observations: Observations) -> Any:
        return self.fitted.describe(observations)

    def calibrate(self, evidence: Tensor, context: Any, pairs: Tensor) -> Tensor:
        return self.fitted.calibrate(evidence, context, pairs)

    def extra_repr(self) -> str:
        return f"path={str(self.path)!r}"


def save_calibrator(
    path: str | Path, calibrator: LikelihoodRatio, scorer: Mapping[str, Any] | None = None
) -> None:
    """Write a safetensors file: the tensors, and as metadata the class and its arguments.

    Args:
        path: File to write, whole or not at all.
        calibrator: Of a class of this file, or of a subclass of ``LikelihoodRatio`` of yours.
        scorer: ``class_path`` and ``init_args`` of the scorer whose evidence it was fitted to.
    """
    settings = {
        "class_path": _path_of(type(calibrator)),
        "init_args": json.dumps(calibrator.settings),
        "scorer": json.dumps(None if scorer is None else dict(scorer)),
    }
    write_weights(path, FORMAT, calibrator, settings)


def load_calibrator(path: str | Path) -> tuple[LikelihoodRatio, dict[str, Any] | None]:
    """Read what :func:`save_calibrator` wrote: the calibrator, and the scorer's settings.

    Nothing that the file names is imported or run: its class must be one of this file, or a
    subclass of ``LikelihoodRatio`` that is imported already.
    """
    tensors, found = read_weights(path, FORMAT)
    known = {_path_of(kind): kind for kind in _subclasses(LikelihoodRatio)}
    if found["class_path"] not in known:
        raise ValueError(
            f"{path}: no calibrator {found['class_path']!r} is imported; there are "
            f"{', '.join(sorted(known))}"
        )
    calibrator = known[found["class_path"]](**json.loads(found["init_args"]))
    load_weights(path, calibrator, tensors)
    return calibrator.requires_grad_(False), json.loads(found["scorer"])


def _path_of(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _subclasses(kind: type) -> list[Any]:
    children: list[type] = kind.__subclasses__()
    return [*children, *(other for child in children for other in _subclasses(child))]


def balanced_quantiles(
    x: Float[Tensor, " P"], same: Bool[Tensor, " P"], count: int
) -> Float[Tensor, " k"]:
    """Extremes and quantiles between them, up to ``count`` values, each kind counted as a half."""
    order = torch.argsort(x)
    weight = torch.where(same, 0.5 / same.sum(), 0.5 / (~same).sum())[order]
    wanted = torch.linspace(0, 1, count, dtype=x.dtype, device=x.device)
    place = torch.searchsorted(weight.cumsum(0), wanted).clamp(max=len(x) - 1)
    place[0], place[-1] = 0, len(x) - 1
    return torch.unique(x[order[place]])


def _sign(direction: str, x: Tensor, same: Tensor) -> float:
    if direction == "either":
        rank = torch.empty_like(x)
        rank[torch.argsort(x, stable=True)] = torch.arange(len(x), dtype=x.dtype, device=x.device)
        return 1.0 if rank[same].mean() >= rank[~same].mean() else -1.0
    return 1.0 if direction == "increasing" else -1.0


def _checked(direction: str) -> str:
    if direction not in ("increasing", "decreasing", "either"):
        raise ValueError(
            f"direction: expected 'increasing', 'decreasing' or 'either', got {direction!r}"
        )
    return direction

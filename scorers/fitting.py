"""The descents behind fitted calibrators, and what keeps them small."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

BINS = 2_000
"""Values at which evidence is gathered at most."""
ENOUGH, RIVALS = 4_000, 4
"""Different pairs that descent keeps: at least so many, and so many for each same pair."""


def thinned(same: Bool[Tensor, " P"]) -> tuple[Bool[Tensor, " P"], float]:
    """All same pairs and enough of the different ones, and the share of those that is kept.

    Matches are rare, and beyond some number for each of them more different pairs add nothing.
    """
    different = (~same).nonzero()[:, 0]
    wanted = max(ENOUGH, RIVALS * int(same.sum()))
    if len(different) <= wanted:
        return torch.ones_like(same), 1.0
    order = torch.randperm(len(different), generator=torch.Generator().manual_seed(0))
    chosen = same.clone()
    chosen[different[order[:wanted].to(different.device)]] = True
    return chosen, wanted / len(different)


def gathered(
    x: Float[Tensor, " P"], same: Bool[Tensor, " P"]
) -> tuple[Float[Tensor, " k"], Float[Tensor, " k"], Float[Tensor, " k"]]:
    """Evidence gathered at no more than ``BINS`` values, and how many same and all pairs are there.

    Exact where there are no more different values; else each bin has the mean of its evidence.
    """
    value, place = torch.unique(x, return_inverse=True)
    if len(value) > BINS:
        rank = torch.empty_like(place)
        rank[torch.argsort(x)] = torch.arange(len(x), device=x.device)
        place = torch.unique(rank * BINS // len(x), return_inverse=True)[1]
    of_all = torch.bincount(place).double()
    value = torch.zeros_like(of_all).index_add_(0, place, x) / of_all
    return value, torch.bincount(place[same], minlength=len(of_all)).double(), of_all


def minimise(loss: Any, parameters: list[nn.Parameter], iterations: int = 60) -> None:
    """Minimise a smooth function of parameters by L-BFGS."""
    optimiser = torch.optim.LBFGS(
        parameters,
        max_iter=iterations,
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


def logistic_regression(
    columns: Float[Tensor, "P c"], y: Float[Tensor, " P"], regularisation: float
) -> Float[Tensor, " c"]:
    """Minimise mean log loss of columns w + regularisation / 2 * |w|² over w, by Newton's method.

    The last column is the constant and goes almost free.
    """
    penalty = torch.full_like(columns[0], regularisation)
    penalty[-1] = 1e-9

    def loss(weight: Tensor) -> Tensor:
        fit = binary_cross_entropy_with_logits(columns @ weight, y)
        return fit + (penalty * weight.square()).sum() / 2

    weight = torch.zeros_like(columns[0])
    weight[-1] = torch.logit(y.mean(), eps=1e-12)
    for _ in range(50):
        probability = torch.sigmoid(columns @ weight)
        gradient = columns.T @ (probability - y) / len(y) + penalty * weight
        variance = probability * (1 - probability)
        curvature = (columns.T * variance) @ columns / len(y) + torch.diag(penalty)
        step = torch.linalg.solve(curvature, gradient)
        size, now = 1.0, loss(weight)
        while size > 1e-6 and loss(weight - size * step) > now:
            size /= 2
        weight = weight - size * step
        if float(gradient.abs().max()) < 1e-10:
            break
    return weight


def best_shift(prior: Float[Tensor, " P"], y: Bool[Tensor, " P"]) -> Float[Tensor, ""]:
    """The shift b for which sigmoid(prior + b) has the mean of y, by bisection."""
    low, high = prior.new_tensor(-40.0), prior.new_tensor(40.0)
    for _ in range(60):
        middle = (low + high) / 2
        over = torch.sigmoid(prior + middle).mean() > y.double().mean()
        low, high = torch.where(over, low, middle), torch.where(over, middle, high)
    return (low + high) / 2


def best_factor(
    ratio: Float[Tensor, " P"], y: Bool[Tensor, " P"], prior: Float[Tensor, " P"]
) -> Float[Tensor, ""]:
    """The factor k in [0, 1] for which k ratio + prior has the least log loss, convex in k."""
    low, high = prior.new_zeros(()), prior.new_ones(())
    for _ in range(40):
        middle = (low + high) / 2
        slope = ((torch.sigmoid(middle * ratio + prior) - y.double()) * ratio).mean()
        low, high = torch.where(slope > 0, low, middle), torch.where(slope > 0, middle, high)
    return torch.where(low > 1 - 1e-9, torch.ones_like(low), (low + high) / 2)

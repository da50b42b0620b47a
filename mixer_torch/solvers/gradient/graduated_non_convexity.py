"""Graduated non-convexity: the relaxed problem, made convex first and concave last."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mixer_torch.solvers.eigen import extreme_eigenvalues
from mixer_torch.solvers.gradient.batch import Batch, Descent, continued
from mixer_torch.solvers.gradient.momentum import travel
from mixer_torch.solvers.gradient.penalty_doubling import PenaltyDoubling
from mixer_torch.solvers.gradient.projection import project_rows
from mixer_torch.solvers.gradient.relaxation import graduated_objective, graduated_step
from mixer_torch.solvers.gradient.rounding import binary_labels
from mixer_torch.solvers.gradient.schedule import Schedule, choice

# All set by hand, on random problems like those of benchmarks/quality.py, whose column "gradient
# stage" shows what they reach. c and w are relative to the least eigenvalue of Ā.
STEP = 2.0  # steps of 2 / L: the momentum damps what a plain gradient would overshoot
CURVATURE = (-0.5, 0.4, 1.5)  # c when the sweep starts, when it ends, and after the finish
DISTINCTNESS = (0.1, 0.8, 2.0)  # w at the same times
FINISH = 0.2  # share of the iterations that is spent on the finish
START_NOISE = 0.3  # added to the 1 / k of the start, before it is projected

Precision = Literal["float32", "tf32", "bfloat16"]


@dataclass(frozen=True)
class GraduatedNonConvexity(Schedule):
    """A sweep of the problem from convex to concave (Blake and Zisserman 1987).

    Problems that are not binary at its end, such as those in which nothing attracts, go on from
    there by the schedule of the paper, on the simplex.

    Args:
        iterations: Steps of the sweep.
        precision: Of the matrix products: "float32" for that of the costs (which may be float64),
            "tf32" or "bfloat16".

    Raises:
        ValueError: An argument is out of range.
    """

    iterations: int = 100
    precision: str = "float32"

    def __post_init__(self) -> None:
        choice("precision", self.precision, Precision)
        if self.iterations < 1:
            raise ValueError(f"iterations: expected at least 1, got {self.iterations}")

    def descend(self, batch: Batch, columns: int, max_iterations: int, seed: int) -> Descent:
        iterations = min(max_iterations, self.iterations)
        result = graduated_descent(
            batch, columns, iterations=iterations, seed=seed, precision=self.precision
        )
        left = max_iterations - iterations
        if not left:
            return result
        open_ = (~binary_labels(result.assignment, batch)[1]).nonzero()[:, 0]
        if not len(open_):
            return result
        rest = Batch(batch.cost[open_], batch.distinctness[open_], batch.mask[open_])
        finish = PenaltyDoubling("simplex")
        return continued(
            result, open_, finish.descend_from(rest, result.assignment[open_], left, seed)
        )


def graduated_descent(
    batch: Batch,
    columns: int,
    *,
    iterations: int = 100,
    seed: int = 0,
    precision: str = "float32",
) -> Descent:
    """Projected gradient descent while the problem turns from nearly convex to concave.

        minimise  <U Uᵀ, Ā> / |λ| + w <U Uᵀ, P_d> − c ‖U‖²,  each row of U on the simplex

    With row sums 1 the orthogonality penalty is m − ‖U‖², so −c ‖U‖² is the term d <Uᵀ U, P_o> of
    the paper with c for d. For c <= λ, the least eigenvalue of Ā + w P_d, the problem is convex and
    its solution has all columns alike; for c above the largest eigenvalue it is concave in every
    direction and its solutions are vertices, which are binary. The sweep of c between the two
    (Blake and Zisserman's graduated non-convexity; Zaslavskiy, Bach and Vert used it for graph
    matching) passes from one to the other slowly enough that global structure is decided first.
    A last, short sweep raises both coefficients until every row is at a vertex.

    Each iteration is a step of 2 / L with momentum, L being the spectral norm of the curvature, for
    all problems at once; the host waits for nothing. There is no line search: it would have
    to look at an objective that changes in every step.

    Args:
        batch: The problems.
        columns: k, the number of columns of U: an upper bound of the number of clusters, guessed.
        iterations: Steps in all.
        seed: Of the small disturbance from which the columns part.
        precision: "float32" for matrix products in the dtype of the costs, "tf32" or "bfloat16".
    """
    low, high = extreme_eigenvalues(batch.cost, seed)
    scale = torch.where(low < 0, -low, 1.0)
    cost = batch.cost / scale[:, None, None]
    curvature, weight = _sweep(iterations)
    step = _steps(curvature, weight, high / scale, batch.distinctness.sum(2).amax(1))
    c = torch.tensor(curvature).to(step, non_blocking=True)[:, None]
    matrix, multiply = torch.empty_like(cost), _products(precision)

    def product(t: int, ahead: Tensor) -> Tensor:
        torch.add(cost, batch.distinctness, alpha=weight[t], out=matrix)
        return multiply(matrix, ahead)

    with _allowed_tf32(precision, cost.device):
        start = _first(batch, columns, seed)
        assignment, forms = travel(start, *graduated_step(step, c), batch.mask, product)
    form, square = forms.unbind(1)
    objective = graduated_objective(form, square, batch.mask.sum(1), c)
    count = torch.full_like(scale, iterations, dtype=torch.int64)
    penalty = torch.full_like(scale, DISTINCTNESS[-1])
    return Descent(assignment, count, penalty, objective * scale)


def _first(batch: Batch, columns: int, seed: int) -> Float[Tensor, "B m k"]:
    """Every row near the middle of the simplex, disturbed alike in each problem."""
    cost = batch.cost
    generator = torch.Generator(device=cost.device).manual_seed(seed)
    shape = cost.shape[1], columns
    noise = torch.rand(shape, generator=generator, dtype=cost.dtype, device=cost.device)
    start = (1 / columns + START_NOISE * noise).expand(len(batch), *shape).contiguous()
    return project_rows(start, batch.mask)


def _steps(
    curvature: list[float], weight: list[float], high: Tensor, crowd: Tensor
) -> Float[Tensor, "T B"]:
    """2 / L at each iteration: L bounds what the curvature does in any direction.

    The eigenvalues of Ā / |λ| + w P_d − c I lie between −1 − w − c, as P_d is a union of cliques
    for which no eigenvalue is below −1, and high + w crowd − c.
    """
    both = torch.tensor([curvature, weight], dtype=high.dtype)
    c, w = both.to(high.device, non_blocking=True)[..., None]
    bound = torch.maximum((high + w * crowd - c).abs(), 1 + w + c)
    return STEP / bound


def _sweep(iterations: int) -> tuple[list[float], list[float]]:
    """Coefficients c and w at each iteration: a straight line, then a steeper one."""
    finish = int(FINISH * iterations)
    first = iterations - finish
    done = [(t + 1) / first for t in range(first)] + [1 + (t + 1) / finish for t in range(finish)]
    curvature, weight = (np.interp(done, [0, 1, 2], x) for x in (CURVATURE, DISTINCTNESS))
    return curvature.tolist(), weight.tolist()


def _products(precision: str) -> Any:
    if precision != "bfloat16":
        return torch.bmm

    def multiply(a: Tensor, b: Tensor) -> Tensor:
        return torch.bmm(a.bfloat16(), b.bfloat16()).to(b.dtype)

    return multiply


@contextmanager
def _allowed_tf32(precision: str, device: torch.device) -> Iterator[None]:
    """TF32 for the products inside, where it was asked for; torch has no switch for one product.

    A CPU has no TF32, and several threads may be here at once, so there the switch is left alone.
    Since 2.9 torch has two names for its switch, and to look at one is an error where the other is
    in use: the newer one can always be looked at.
    """
    if precision != "tf32" or device.type == "cpu":
        yield
        return
    products: Any = torch.backends.cuda.matmul
    newer = hasattr(products, "fp32_precision")
    name, on = ("fp32_precision", "tf32") if newer else ("allow_tf32", True)
    before = getattr(products, name)
    setattr(products, name, on)
    try:
        yield
    finally:
        setattr(products, name, before)

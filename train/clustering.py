"""Training through the clustering: a loss on U Uᵀ of the relaxed problem, and its derivative.

The relaxed problem with rows on the simplex (see
:mod:`mixer_torch.solvers.gradient.graduated_non_convexity`),

    minimise  F(U) = <U Uᵀ, Ā> / |λ| + w <U Uᵀ, P_d> − c ‖U‖²,   λ the least eigenvalue of Ā,

is swept to a c at which its solutions are not yet binary, as a binary U has no derivative. There U
is a fixed point U = g(U, Ā) of a projected gradient step, so that dU = J_U dU + J_Ā dĀ and

    gradient by Ā = J_Āᵀ v,   v = (I − J_Uᵀ)⁻¹ gradient by U ≈ Σ_{i<n} (J_Uᵀ)^i gradient by U.

One step is kept for this, whatever n and however many steps led to U: memory grows with neither.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn
from torch.utils.data import DataLoader
from torch.utils.data import Dataset as Batches

from mixer_torch.datasets.base import Dataset
from mixer_torch.fusion import LogOddsFusion
from mixer_torch.scorers.pair_network import MAX_LOG_RATIO, EvidenceEnsemble, load_network
from mixer_torch.scoring import Scorer
from mixer_torch.solvers.eigen import extreme_eigenvalues
from mixer_torch.solvers.gradient.relaxation import distinctness_matrix, project_to_simplex
from mixer_torch.train.data import EpochSampler, PairData
from mixer_torch.train.evaluation import solved
from mixer_torch.train.pairs import PairTraining
from mixer_torch.train.tables import PairTable


@dataclass(frozen=True)
class Relaxation:
    """How the relaxed problem is solved and differentiated.

    Args:
        columns: Of U: the most clusters there may be.
        iterations: Steps while c is swept.
        settle: Steps at the last c.
        curvature: c at the start and at the end, in units of |λ|.
        distinctness: w.
        terms: n of the series; 0 for the last step alone.
        seed: Of the noise that breaks the symmetry of the columns.
    """

    columns: int = 48
    iterations: int = 60
    settle: int = 300
    curvature: tuple[float, float] = (-0.8, -0.3)
    distinctness: float = 0.8
    terms: int = 50
    seed: int = 0

    def __call__(
        self,
        cost: Float[Tensor, "m m"],
        view: Int64[Tensor, " m"],
        scale: Float[Tensor, ""] | None = None,
    ) -> Float[Tensor, "m k"]:
        """U, differentiable by the symmetric cost matrix Ā; |λ|, or ``scale``, is a constant."""
        apart = distinctness_matrix(view, cost.dtype)
        with torch.no_grad():
            low, high = extreme_eigenvalues(cost[None])
            scale = (-low).clamp(min=1e-6)[0] if scale is None else scale
            size = 1 / (1 + self.distinctness * (1 + apart.sum(1).max()) + (high[0] / scale).abs())
            fixed = self._solve(cost / scale, apart, size)
        last = self.curvature[1]
        known = fixed.detach().requires_grad_()
        with torch.enable_grad():
            inner = self._step(known, cost.detach() / scale, apart, size, last)
        result = self._step(fixed, cost / scale, apart, size, last)
        if result.requires_grad and self.terms:
            result.register_hook(lambda gradient: self._series(gradient, inner, known))
        return result

    def _solve(self, cost: Tensor, apart: Tensor, size: Tensor) -> Tensor:
        generator = torch.Generator().manual_seed(self.seed)
        noise = torch.rand(len(cost), self.columns, generator=generator, dtype=torch.float64)
        assignment = project_to_simplex(1 / self.columns + 0.3 * noise.to(cost))
        sweep = np.linspace(*self.curvature, self.iterations).tolist()
        for curvature in [*sweep, *[self.curvature[1]] * self.settle]:
            assignment = self._step(assignment, cost, apart, size, curvature)
        return assignment

    def _step(
        self, assignment: Tensor, cost: Tensor, apart: Tensor, size: Tensor, curvature: float
    ) -> Tensor:
        """g(U, Ā): one projected gradient step on F."""
        push = (cost + self.distinctness * apart) @ assignment - curvature * assignment
        return project_to_simplex(assignment - size * push)

    def _series(self, gradient: Tensor, inner: Tensor, known: Tensor) -> Tensor:
        total = term = gradient
        for _ in range(self.terms):
            (term,) = torch.autograd.grad(inner, known, term, retain_graph=True)
            total = total + term
        return total


def association_loss(
    assignment: Float[Tensor, "m k"], pairs: Int64[Tensor, "2 P"], same: Bool[Tensor, " P"]
) -> Float[Tensor, ""]:
    """1 − a smooth F1 of the pairs: 2 Σ_same X / (Σ X + number of same pairs), X = U Uᵀ."""
    together = (assignment[pairs[0]] * assignment[pairs[1]]).sum(1)
    hits = together[same].sum()
    return 1 - 2 * hits / (together.sum() + same.sum()).clamp(min=1e-9)


class Windows(Batches):
    """Windows of consecutive views, with the pairs inside each."""

    def __init__(self, tables: Sequence[PairTable], views: int, stride: int) -> None:
        self.windows: list[PairTable] = []
        for table in tables:
            view = table.observations.view
            order = torch.unique(view)
            for start in range(0, max(len(order) - views, 0) + 1, stride):
                inside = torch.isin(view, order[start : start + views])
                self.windows.append(table.of_identities(inside))

    def __len__(self) -> int:
        return len(self.windows)

    def __getitem__(self, index: Any) -> Tensor:
        """The number of a window: a trainer could not move a table to a device."""
        return torch.as_tensor(index).flatten()[0]


class WindowData(PairData):
    """A :class:`~mixer_torch.train.data.PairData` that is trained on windows of consecutive views.

    Args:
        scorers: One for each modality, with their calibrators.
        train: Sequences to train on.
        validate: Sequences to validate on; held-out identities if None or empty.
        test: Sequences to test on.
        views: Views in a window.
        stride: Views from the start of one window to that of the next.
        seed: Of the order.
        cache: Folder in which raw evidence is kept between runs; none if None.
    """

    def __init__(
        self,
        scorers: list[Scorer],
        train: list[Dataset],
        validate: list[Dataset] | None = None,
        test: list[Dataset] | None = None,
        views: int = 30,
        stride: int = 10,
        seed: int = 0,
        cache: Path | None = None,
    ) -> None:
        super().__init__(scorers, train, validate, test, seed=seed, cache=cache)
        if views < 2 or stride < 1:
            raise ValueError(
                f"views, stride: expected 2 or more and 1 or more, got {views}, {stride}"
            )
        self.views, self.stride = views, stride
        self.windows: list[PairTable] = []

    def train_dataloader(self) -> DataLoader:
        windows = Windows(self.tables("train"), self.views, self.stride)
        self.windows = windows.windows
        every = torch.ones(len(windows), dtype=torch.bool)
        sampler = EpochSampler(every, 1, 1, self.seed, *self.place)
        return DataLoader(windows, sampler=sampler, batch_size=None)


class AssociationTraining(PairTraining):
    """A pair network trained on the association itself, after training pair by pair.

    Args:
        start: Network to start from, written by training pair by pair; naive Bayes if None.
        covariates: Names of covariates, where there is no ``start``.
        relaxation: How the relaxed problem is solved and differentiated.
        learning_rate: Of Adam.
        seed: Of the weights at the start.
    """

    def __init__(
        self,
        start: Path | None = None,
        covariates: Sequence[str] = ("time_gap", "box_size", "size_ratio"),
        relaxation: Relaxation | None = None,
        learning_rate: float = 1e-3,
        seed: int = 0,
    ) -> None:
        super().__init__(covariates, learning_rate=learning_rate, seed=seed)
        self.start = start
        self.relaxation = relaxation or Relaxation()

    def setup(self, stage: str) -> None:
        fresh = not isinstance(self.network, EvidenceEnsemble)
        super().setup(stage)
        if self.start is not None and fresh:
            network: nn.Module = load_network(self.start, self.data.modalities)
            self.network = network.requires_grad_()
            self.names = self.network.covariates.names  # type: ignore[union-attr, assignment]

    def training_step(self, batch: Any, batch_idx: int) -> Tensor:
        data: WindowData = self.data  # type: ignore[assignment]
        loss = self.loss_of(data.windows[int(batch)])
        self.log_loss(loss, 1)
        return loss

    def loss_of(self, table: PairTable) -> Tensor:
        """The loss of the association of one table whose evidence is scores."""
        present = torch.unique(table.pairs)
        place = torch.zeros(len(table.observations), dtype=torch.int64)
        place[present] = torch.arange(len(present))
        cost = -self(table.evidence, table.covariates_of(self.names))
        a, b = place[table.pairs]
        full = cost.new_zeros(len(present), len(present))
        full = full.index_put((a, b), cost).index_put((b, a), cost)
        assignment = self.relaxation(full, table.observations.view[present])
        return association_loss(assignment, torch.stack([a, b]), table.same)

    def validation_step(self, batch: Mapping[str, Any], batch_idx: int) -> None:
        super().validation_step(batch, batch_idx)
        found = [
            solved(table, self.scores(table), ("fused",), LogOddsFusion(cap=MAX_LOG_RATIO))["f1"]
            for table in self.data.tables("validate")
        ]
        self.log_once({"val/f1": sum(found) / len(found)})

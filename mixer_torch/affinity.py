"""How alike: for some pairs of observations, one score in [0, 1] for each modality."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from mixer_torch.fusion import Fusion, LinearFusion
from mixer_torch.io.files import load_npz, save_npz
from mixer_torch.observations import count_views, integers
from mixer_torch.pairs import within_view

FORMAT = "mixer-torch affinity 1"


@dataclass(frozen=True)
class Affinity:
    """Scores of pairs of observations; a pair that is not listed is 0.5 in every modality.

    Args:
        pairs: (2, P) int64 with ``pairs[0] < pairs[1]``, each once, none within a view.
        scores: (l, P) float in [0, 1]: 1 surely the same, 0 surely not, 0.5 nothing to say.
        view: (m,) int64, the set of each observation; negative for none.
        modalities: l names, all different.

    Raises:
        ValueError: An argument is malformed, or a score is NaN or out of range; the message names
            the argument, what was expected and what came.
    """

    pairs: Tensor
    scores: Tensor
    view: Tensor
    modalities: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "view", integers("view", self.view))
        object.__setattr__(self, "modalities", tuple(self.modalities))
        scores = torch.as_tensor(self.scores)
        if scores.dtype not in (torch.float32, torch.float64):
            scores = scores.float()
        object.__setattr__(self, "scores", scores)
        object.__setattr__(self, "pairs", torch.as_tensor(self.pairs))
        check_pairs(self.pairs, self.view)
        expected = (len(self.modalities), self.pairs.shape[1])
        if tuple(scores.shape) != expected:
            raise ValueError(
                f"scores: expected shape (modalities, pairs) = {expected}, "
                f"got {tuple(scores.shape)}"
            )
        if len(set(self.modalities)) != len(self.modalities) or not self.modalities:
            raise ValueError(f"modalities: expected different names, got {self.modalities}")
        good = (scores >= 0) & (scores <= 1)
        if not bool(good.all()):
            modality, pair = (int(i) for i in (~good).nonzero()[0])
            a, b = self.pairs[:, pair].tolist()
            raise ValueError(
                f"scores: expected values in [0, 1], got {scores[modality, pair].item()} "
                f"in modality {self.modalities[modality]!r} for the pair ({a}, {b})"
            )

    def __repr__(self) -> str:
        scores = f"{str(self.scores.dtype).removeprefix('torch.')} on {self.scores.device}"
        return (
            f"Affinity({count_views(self.view)}; {self.pairs.shape[1]} pairs; "
            f"modalities: {', '.join(self.modalities)}; {scores})"
        )

    def __len__(self) -> int:
        """m, the number of observations."""
        return len(self.view)

    @classmethod
    def from_dense(
        cls,
        scores: Any,
        view: Any,
        modalities: Sequence[str] | None = None,
        indistinct: Any = None,
    ) -> Affinity:
        """From full matrices, with every pair across views listed.

        Args:
            scores: (m, m) or (l, m, m), symmetric, tensor or array; entries on the diagonal and
                within a view are ignored.
            view: (m,) the set of each observation.
            modalities: l names; ``score_0``, … if None.
            indistinct: Views in which distinctness does not hold: their observations get view -1,
                which is none, so that the pairs within them are listed too.

        Raises:
            ValueError: The shape is wrong, a matrix is not symmetric, or a score is out of range.
        """
        view = integers("view", view)
        view = view if indistinct is None else waive(view, indistinct)
        scores = torch.as_tensor(scores)
        scores = scores if scores.is_floating_point() else scores.float()
        scores = scores[None] if scores.ndim == 2 else scores
        m = len(view)
        if scores.ndim != 3 or scores.shape[1:] != (m, m):
            raise ValueError(
                f"scores: expected shape ({m}, {m}) or (l, {m}, {m}) for a view of {m} "
                f"observations, got {tuple(scores.shape)}"
            )
        view = view.to(scores.device)
        if modalities is None:
            modalities = [f"score_{k}" for k in range(len(scores))]
        pairs = torch.triu_indices(m, m, offset=1, device=scores.device)
        pairs = pairs[:, ~within_view(view, pairs)]
        upper, lower = scores[:, pairs[0], pairs[1]], scores[:, pairs[1], pairs[0]]
        if not torch.allclose(upper, lower, rtol=0, atol=1e-5, equal_nan=True):
            worst = int((upper - lower).abs().nan_to_num(torch.inf).argmax())
            modality, pair = divmod(worst, upper.shape[1])
            a, b = pairs[:, pair].tolist()
            raise ValueError(
                f"scores: expected symmetric matrices, got {upper[modality, pair].item()} at "
                f"({a}, {b}) and {lower[modality, pair].item()} at ({b}, {a}) "
                f"in modality {modalities[modality]!r}"
            )
        return cls(pairs, upper, view, tuple(modalities))

    def dense(self) -> Tensor:
        """(l, m, m): 0.5 where nothing is listed, 1 on the diagonal, 0 within a view."""
        m = len(self)
        full = self.scores.new_full((len(self.modalities), m, m), 0.5)
        a, b = self.pairs
        full[:, a, b] = self.scores
        full[:, b, a] = self.scores
        full[:, (self.view[:, None] == self.view) & (self.view >= 0)] = 0
        full.diagonal(dim1=1, dim2=2).fill_(1)
        return full

    def cost(self, fusion: Fusion | None = None) -> Tensor:
        """(P,) fused cost of each pair: negative attracts, 0 is indifferent, positive repels.

        The paper's sum of 1 - 2 s where fusion is None.
        """
        fusion = LinearFusion() if fusion is None else fusion
        return fusion(self.scores, self.modalities)

    def select(self, modalities: str | Sequence[str]) -> Affinity:
        """The affinity in some of the modalities, in the order given.

        Raises:
            KeyError: There is no modality of that name.
        """
        names = (modalities,) if isinstance(modalities, str) else tuple(modalities)
        for name in names:
            if name not in self.modalities:
                raise KeyError(f"no modality {name!r}; modalities: {', '.join(self.modalities)}")
        rows = [self.modalities.index(name) for name in names]
        return Affinity(self.pairs, self.scores[rows], self.view, names)

    def to(self, device: torch.device | str) -> Affinity:
        """The same affinity with all tensors on a device."""
        return Affinity(
            self.pairs.to(device), self.scores.to(device), self.view.to(device), self.modalities
        )

    def save(self, path: str | Path) -> None:
        """Write one npz with ``pairs``, ``scores``, ``view`` and ``modalities``."""
        arrays = {
            "format": np.array(FORMAT),
            "pairs": self.pairs.cpu().numpy(),
            "scores": self.scores.detach().cpu().numpy(),
            "view": self.view.cpu().numpy(),
            "modalities": np.array(self.modalities),
        }
        save_npz(path, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Affinity:
        """Read what :meth:`save` wrote."""
        arrays = load_npz(path, FORMAT)
        pairs, scores, view = (torch.from_numpy(arrays[k]) for k in ("pairs", "scores", "view"))
        return cls(pairs, scores, view, tuple(str(name) for name in arrays["modalities"]))


def check_pairs(pairs: Tensor, view: Tensor) -> None:
    """ValueError unless pairs are (2, P) int64, in range, ordered, unique and across views."""
    if pairs.ndim != 2 or pairs.shape[0] != 2 or pairs.dtype != torch.int64:
        raise ValueError(
            f"pairs: expected int64 of shape (2, P), got {pairs.dtype} of shape "
            f"{tuple(pairs.shape)}"
        )
    if not pairs.shape[1]:
        return
    m = len(view)
    if not (int(pairs.min()) >= 0 and int(pairs.max()) < m):
        raise ValueError(
            f"pairs: expected indices in 0..{m - 1}, got {int(pairs.min())}..{int(pairs.max())}"
        )
    _refuse(pairs, pairs[0] >= pairs[1], "expected pairs[0] < pairs[1]")
    _refuse(pairs, within_view(view, pairs), "expected no pair within one view")
    key = (pairs[0] * m + pairs[1]).sort()
    repeated = torch.zeros_like(key.values, dtype=torch.bool)
    repeated[key.indices[1:]] = key.values[1:] == key.values[:-1]
    _refuse(pairs, repeated, "expected each pair once")


def waive(view: Int64[Tensor, " m"], indistinct: Any) -> Int64[Tensor, " m"]:
    """Views with those in which distinctness does not hold set to -1, which is no view.

    Raises:
        ValueError: Not integers, or a view that no observation has.
    """
    waived = integers("indistinct", indistinct).to(view.device)
    absent = waived[~torch.isin(waived, view)]
    if len(absent):
        raise ValueError(f"indistinct: no observation is of view {int(absent[0])}")
    return torch.where(torch.isin(view, waived), -1, view)


def _refuse(pairs: Tensor, wrong: Tensor, expected: str) -> None:
    if bool(wrong.any()):
        a, b = pairs[:, wrong.nonzero()[0, 0]].tolist()
        raise ValueError(f"pairs: {expected}, got ({a}, {b})")

"""Score matrices drawn from a model, with the truth: the paper's synthetic problems."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from mixer_torch.affinity import Affinity
from mixer_torch.pairs import within_view


def synthetic(
    objects: int = 10,
    views: int = 6,
    visible: float = 0.6,
    outliers: float = 0.5,
    modalities: int = 1,
    wrong: float | Sequence[float] = 0.1,
    inconclusive: float | Sequence[float] = 0.0,
    noise: float | Sequence[float] = 0.2,
    seed: int | torch.Generator = 0,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str = "cpu",
) -> tuple[Affinity, Int64[Tensor, " m"]]:
    """Draw partial views of some objects, with outliers, and noisy scores of all pairs.

    The model, each draw independent of the others:

    1. Each object is seen in each view with probability ``visible``; a view in which none would
       be shows one of them. Each view has Poisson(``outliers``) observations of things seen
       nowhere else. Observations come in random order within their view.
    2. For each pair across views and each modality k, the score is the truth, 1 or 0; flipped
       with probability ``wrong[k]``; plus a Gaussian of deviation ``noise[k]``, clipped to
       [0, 1]; and 0.5 instead with probability ``inconclusive[k]``.

    The paper's (section IV, table I): 10 objects, partial views, outliers, noise, 10 <= m <= 50.

    Args:
        objects: Number of objects, the paper's m_u less the outliers.
        views: Number of views n.
        visible: Probability.
        outliers: Mean number a view.
        modalities: Number l.
        wrong: Probability; one for all modalities, or one for each.
        inconclusive: Probability; likewise.
        noise: Standard deviation; likewise.
        seed: Seed, or a generator on the CPU: a seed gives the same problem on every device.
        dtype: Of the scores: float32 or float64. The problem is the same up to rounding.
        device: Of the result.

    Returns:
        The affinity, with all pairs across views listed, and the true labels, numbered in order
        of first appearance, each outlier a label of its own.

    Raises:
        ValueError: An argument is out of range, or has not one value for each modality.
    """
    _check(objects, views, modalities, visible, outliers)
    flip = _each("wrong", wrong, modalities, 1.0)
    silent = _each("inconclusive", inconclusive, modalities, 1.0)
    deviation = _each("noise", noise, modalities, float("inf"))
    generator = seed if isinstance(seed, torch.Generator) else torch.Generator().manual_seed(seed)

    view, labels = _observe(objects, views, visible, outliers, generator)
    pairs = torch.triu_indices(len(view), len(view), offset=1)
    pairs = pairs[:, ~within_view(view, pairs)]
    same = labels[pairs[0]] == labels[pairs[1]]
    scores = _score(same, flip, silent, deviation, generator)
    names = tuple(f"score_{k}" for k in range(modalities))
    affinity = Affinity(pairs, scores.to(dtype), view, names)
    return affinity.to(device), labels.to(device)


def _check(objects: int, views: int, modalities: int, visible: float, outliers: float) -> None:
    for name, count in {"objects": objects, "views": views}.items():
        if count < 0:
            raise ValueError(f"{name}: expected 0 or more, got {count}")
    if modalities < 1:
        raise ValueError(f"modalities: expected 1 or more, got {modalities}")
    if not 0 <= visible <= 1:
        raise ValueError(f"visible: expected a probability, got {visible}")
    if not 0 <= outliers < float("inf"):
        raise ValueError(f"outliers: expected 0 or more, got {outliers}")


def _score(
    same: Bool[Tensor, " P"],
    flip: Float[Tensor, "l 1"],
    silent: Float[Tensor, "l 1"],
    deviation: Float[Tensor, "l 1"],
    generator: torch.Generator,
) -> Float[Tensor, "l P"]:
    """Noisy scores of pairs, in float64."""
    shape = (len(flip), len(same))
    flipped = torch.rand(shape, generator=generator, dtype=torch.float64) < flip
    scores = (same ^ flipped).double()
    scores += deviation * torch.randn(shape, generator=generator, dtype=torch.float64)
    scores = scores.clamp(0, 1)
    scores[torch.rand(shape, generator=generator, dtype=torch.float64) < silent] = 0.5
    return scores


def _observe(
    objects: int, views: int, visible: float, outliers: float, generator: torch.Generator
) -> tuple[Int64[Tensor, " m"], Int64[Tensor, " m"]]:
    """What is seen in each view, in random order: view and label of every observation."""
    view, identity = [], []
    unseen = objects
    clutter = torch.poisson(torch.full((views,), float(outliers)), generator=generator)
    for k in range(views):
        seen = (torch.rand(objects, generator=generator) < visible).nonzero()[:, 0]
        if objects and not len(seen):
            seen = torch.randint(objects, (1,), generator=generator)
        strange = unseen + torch.arange(int(clutter[k]))
        unseen += len(strange)
        both = torch.cat([seen, strange])
        identity.append(both[torch.randperm(len(both), generator=generator)])
        view.append(torch.full_like(both, k))
    if not views:
        return torch.empty(0, dtype=torch.int64), torch.empty(0, dtype=torch.int64)
    return torch.cat(view), _by_appearance(torch.cat(identity))


def _by_appearance(identity: Int64[Tensor, " m"]) -> Int64[Tensor, " m"]:
    number: dict[int, int] = {}
    return torch.tensor([number.setdefault(i, len(number)) for i in identity.tolist()]).long()


def _each(name: str, value: float | Sequence[float], modalities: int, most: float) -> Tensor:
    """(l, 1): a value for each modality."""
    values = list(value) if isinstance(value, Sequence) else [value] * modalities
    if len(values) != modalities:
        raise ValueError(f"{name}: expected {modalities} values, got {len(values)}")
    for one in values:
        if not 0 <= one <= most:
            raise ValueError(f"{name}: expected values in 0..{most:g}, got {one}")
    return torch.tensor(values, dtype=torch.float64)[:, None]

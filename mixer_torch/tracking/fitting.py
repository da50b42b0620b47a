"""Fitting one additive network of log likelihood ratios: weighted logistic regression."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Listed

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor, nn

from mixer_torch.tracking.weights import FARTHEST, Network, masks

FEWEST_STEPS = 500
"""Steps of a fit at least: a few thousand rows are one batch, and some tens of steps leave weights
near where they began."""


def fit(
    x: Float64[np.ndarray, "n f"],
    same: np.ndarray,
    weight: np.ndarray,
    features: Listed[str],
    modality: Listed[str],
    units: int = 8,
    epochs: int = 10,
    decay: float = 1e-3,
    seed: int = 0,
) -> Network:
    """Fit a network by weighted logistic regression, with AdamW. Without rows it says nothing: 0.

    Args:
        x: Inputs.
        same: (n,) 1 for one thing, 0 for two.
        weight: (n,) of the rows.
        features: Names of the inputs.
        modality: Of each input.
        units: Hidden units of each modality.
        epochs: Passes through the rows.
        decay: Weight decay.
        seed: Of the draws.
    """
    generator = torch.Generator().manual_seed(seed)
    owner, mask = masks(modality, units)
    if not len(x):
        return Network.silent(tuple(features), tuple(modality), owner)
    mean, scale = x.mean(0), x.std(0) + 1e-3
    z = torch.from_numpy(np.clip((x - mean) / scale, -FARTHEST, FARTHEST)).float()
    y, w = (
        torch.from_numpy(np.asarray(same)).float(),
        torch.from_numpy(weight / weight.mean()).float(),
    )
    sees = torch.from_numpy(mask).float()
    inputs, hidden = sees.shape
    first = nn.Parameter(torch.randn(inputs, hidden, generator=generator) / inputs**0.5)
    out = nn.Parameter(0.1 * torch.randn(hidden, generator=generator))
    bias, linear = nn.Parameter(torch.zeros(hidden)), nn.Parameter(torch.zeros(inputs))
    constant = nn.Parameter(torch.zeros(1))
    parameters = [first, out, bias, linear, constant]

    def logit(batch: Tensor) -> Tensor:
        return torch.relu(batch @ (first * sees) + bias) @ out + batch @ linear + constant

    _descend(parameters, logit, z, y, w, epochs, decay, generator)
    inner, shift, outer, straight = (
        p.detach().double().numpy() for p in (first * sees, bias, out, linear)
    )
    constants = tuple(features), tuple(modality), owner, mean, scale
    return Network(*constants, inner, shift, outer, straight, float(constant.detach()))


def _descend(
    parameters: Listed[nn.Parameter],
    logit: Callable[[Tensor], Tensor],
    z: Tensor,
    y: Tensor,
    w: Tensor,
    epochs: int,
    decay: float,
    generator: torch.Generator,
    batch: int = 4096,
    rate: float = 6e-3,
) -> None:
    """Minimise the weighted log loss, with a rate that rises and falls once."""
    optimiser = torch.optim.AdamW(parameters, lr=rate, weight_decay=decay)
    epochs = max(epochs, -(-FEWEST_STEPS // -(-len(z) // batch)))
    steps = epochs * -(-len(z) // batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps + 1)
    loss_of = nn.BCEWithLogitsLoss(reduction="none")
    for _ in range(epochs):
        for rows in torch.randperm(len(z), generator=generator).split(batch):
            loss = (loss_of(logit(z[rows]), y[rows]) * w[rows]).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()

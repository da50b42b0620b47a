"""One score from the evidence of several modalities: a learned alternative to a fixed fusion."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from mixer_torch.io.weights import load_weights, read_weights, write_weights
from mixer_torch.observations import Observations
from mixer_torch.scorers.covariates import Covariates
from mixer_torch.scorers.curves import Logistic
from mixer_torch.scorers.likelihood_ratio import log_ratio_of
from mixer_torch.scorers.proximity import Proximity
from mixer_torch.scoring import NOTHING_TO_SAY, Calibrator, Scorer, unique_names

FORMAT = "mixer-torch pair network 3"
MAX_LOG_RATIO = 8.0
"""Largest log likelihood ratio that goes in or comes out, nats: a convention, odds of 3,000."""


class EvidenceNetwork(nn.Module):
    """r = Σ_k w_k r_k + f(r_1, …, r_l, which are known, φ(c)): naive Bayes and a correction.

    r_k is the log likelihood ratio of modality k, 0 where it has nothing to say; f is a network of
    one hidden layer that starts as 0, so that before training the answer is that of log-odds
    fusion with weights of 1.

    Args:
        modalities: l.
        covariates: Names of :data:`mixer_torch.scorers.covariates.COVARIATES`.
        width: Units of the hidden layer.
    """

    def __init__(self, modalities: int, covariates: Sequence[str] = (), width: int = 32) -> None:
        super().__init__()
        self.covariates = Covariates(covariates)
        self.weights = nn.Parameter(torch.ones(modalities))
        inputs = 2 * modalities + self.covariates.width
        self.hidden = nn.Linear(inputs, width)
        self.out = nn.Linear(width, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(
        self, ratios: Float[Tensor, "l P"], covariates: Float[Tensor, "P c"]
    ) -> Float[Tensor, " P"]:
        """Log likelihood ratios (P,) in nats; NaN where no modality has anything to say.

        Args:
            ratios: Of each modality, NaN where it has nothing to say.
            covariates: Raw values.
        """
        says = ~ratios.isnan()
        known = ratios.where(says, ratios.new_zeros(())).clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO)
        columns = self.covariates.columns(covariates).to(known)
        inputs = torch.cat([known.T / 2, says.T.to(known), columns], 1)
        correction = self.out(torch.tanh(self.hidden(inputs)))[:, 0]
        ratio = (self.weights @ known + correction).clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO)
        return ratio.where(says.any(0), ratio.new_full((), torch.nan))


class EvidenceEnsemble(nn.Module):
    """r = (1/n) Σ_i r_i: the mean of the log likelihood ratios of several networks.

    Networks with other initial weights, trained on other objects, agree where the evidence is plain
    and differ where it is not, so that their mean varies less with either than one network does.

    Args:
        members: One or more, of the same modalities and covariates.

    Raises:
        ValueError: There is none, or covariates differ.
    """

    def __init__(self, members: Sequence[EvidenceNetwork]) -> None:
        super().__init__()
        if len({member.covariates.names for member in members}) != 1:
            raise ValueError("members: expected one or more networks of the same covariates")
        self.members = nn.ModuleList(members)

    @property
    def covariates(self) -> Covariates:
        """Those of the first member: all members read the same."""
        first: Any = self.members[0]
        return first.covariates

    def forward(
        self, ratios: Float[Tensor, "l P"], covariates: Float[Tensor, "P c"]
    ) -> Float[Tensor, " P"]:
        """As one network's; see :meth:`EvidenceNetwork.forward`."""
        return torch.stack([member(ratios, covariates) for member in self.members]).mean(0)


class PairNetwork(Scorer):
    """One calibrated score of all that is known of a pair, by one or several learned networks.

    Args:
        path: What ``mixer-train`` wrote; untrained, which is naive Bayes, if None.
        scorers: The modalities that it was trained with, in that order, with their calibrators;
            :class:`~mixer_torch.scorers.proximity.Proximity` alone if None.
        covariates: Names of covariates, for an untrained one; a file says its own.
        calibrator: Takes the place of the sigmoid of the log likelihood ratio.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is something else, or of other modalities.
    """

    def __init__(
        self,
        path: str | Path | None = None,
        scorers: Sequence[Scorer] | None = None,
        covariates: Sequence[str] = (),
        calibrator: Calibrator | None = None,
    ) -> None:
        super().__init__(calibrator or Logistic(1.0, 0.0))
        self.scorers = nn.ModuleList([Proximity()] if scorers is None else scorers)
        names = unique_names([scorer.name for scorer in self._parts()])
        self.network = (
            EvidenceEnsemble([EvidenceNetwork(len(names), covariates)])
            if path is None
            else load_network(path, names)
        )
        needs = [
            key for scorer in self._parts() for key in (*scorer.needs, *scorer.calibrator.needs)
        ]
        self.needs = tuple(dict.fromkeys([*needs, *self.network.covariates.needs]))
        self.chunk = min(scorer.chunk for scorer in self._parts())

    def _parts(self) -> list[Any]:
        return list(self.scorers)

    def describe(self, observations: Observations) -> tuple[Any, ...]:
        """What each scorer and its calibrator describe, and the features of the covariates."""
        parts = [
            (scorer.describe(observations), scorer.calibrator.describe(observations))
            for scorer in self._parts()
        ]
        return (*parts, self.network.covariates.describe(observations))

    def compare(self, description: tuple[Any, ...], pairs: Tensor) -> Tensor:
        *parts, features = description
        rows = []
        for scorer, (described, context) in zip(self._parts(), parts, strict=True):
            score = scorer.score_described(described, pairs, None, context)
            rows.append(as_evidence(score))
        return self.network(torch.stack(rows), self.network.covariates.of(features, pairs))


def as_evidence(scores: Float[Tensor, "*l P"]) -> Float[Tensor, "*l P"]:
    """Log likelihood ratios of scores, NaN at 0.5: nothing to say."""
    ratio = log_ratio_of(scores).float()
    return ratio.where(scores != NOTHING_TO_SAY, ratio.new_full((), torch.nan))


def save_network(
    path: str | Path, network: EvidenceEnsemble | EvidenceNetwork, modalities: Sequence[str]
) -> None:
    """Write a safetensors file with the names of the modalities and covariates."""
    ensemble = network if isinstance(network, EvidenceEnsemble) else EvidenceEnsemble([network])
    first: Any = ensemble.members[0]
    settings = {
        "modalities": json.dumps(list(modalities)),
        "covariates": json.dumps(list(first.covariates.names)),
        "width": str(first.hidden.out_features),
        "members": str(len(ensemble.members)),
    }
    write_weights(path, FORMAT, ensemble, settings)


def load_network(path: str | Path, modalities: Sequence[str]) -> EvidenceEnsemble:
    """Read what :func:`save_network` wrote.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is something else, or of other modalities.
    """
    tensors, settings = read_weights(path, FORMAT)
    names = json.loads(settings["modalities"])
    if list(modalities) != names:
        raise ValueError(
            f"{path}: trained for the scorers {', '.join(names)}, got {', '.join(modalities)}"
        )
    covariates, width = json.loads(settings["covariates"]), int(settings["width"])
    network = EvidenceEnsemble(
        [EvidenceNetwork(len(names), covariates, width) for _ in range(int(settings["members"]))]
    )
    load_weights(path, network, tensors)
    return network.requires_grad_(False)

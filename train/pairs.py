"""Training of the pair scorer: one network over the evidence of all modalities."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from mixer_torch.fusion import LogOddsFusion
from mixer_torch.metrics.calibration import calibration_metrics
from mixer_torch.scorers.pair_network import (
    MAX_LOG_RATIO,
    EvidenceEnsemble,
    EvidenceNetwork,
    as_evidence,
    save_network,
)
from mixer_torch.train.base import PairModule
from mixer_torch.train.data import Rows, stack_covariates
from mixer_torch.train.evaluation import evaluate_scores, summary
from mixer_torch.train.listing import block, write_listing
from mixer_torch.train.tables import PairTable


class PairTraining(PairModule):
    """The networks of a :class:`~mixer_torch.scorers.pair_network.PairNetwork`, by log loss.

    The loss is at the base rate of training. The covariates are evidence here, once for all
    modalities. The inputs are the scores of the scorers, with the calibrators that the
    configuration gives them.

    Several members are trained side by side, each from initial weights of its own and without the
    objects of one of as many parts, so that what depends on one object or on the initial weights
    differs between members and is small in their mean.

    Args:
        covariates: Names of :data:`mixer_torch.scorers.covariates.COVARIATES`.
        width: Units of the hidden layer.
        learning_rate: Of Adam.
        weight_decay: Of Adam, decoupled.
        seed: Of the weights at the start, and of the parts.
        members: Networks whose log likelihood ratios are averaged; a single one sees all objects.

    Raises:
        ValueError: learning_rate is not positive, or members not 1 or more.
    """

    def __init__(
        self,
        covariates: Sequence[str] = ("time_gap", "box_size", "size_ratio"),
        width: int = 32,
        learning_rate: float = 5e-3,
        weight_decay: float = 1e-2,
        seed: int = 0,
        members: int = 1,
    ) -> None:
        super().__init__()
        if members < 1:
            raise ValueError(f"members: expected 1 or more, got {members}")
        if not learning_rate > 0:
            raise ValueError(f"learning_rate: expected a positive number, got {learning_rate}")
        self.names = tuple(covariates)
        self.width = width
        self.learning_rate = learning_rate
        self.weight_decay = weight_decay
        self.seed = seed
        self.members = members
        self.network: nn.Module = nn.Identity()
        self.parts = torch.zeros(0, dtype=torch.int64)
        self.priors: list[float] = []

    def setup(self, stage: str) -> None:
        data = self.data
        if isinstance(self.network, EvidenceEnsemble):
            return
        data.replace_evidence_by_scores()
        rows = Rows(data.tables("train"))
        covariates = rows.covariates_of(self.names)
        networks = []
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            for _ in range(self.members):
                network = EvidenceNetwork(len(data.modalities), self.names, self.width)
                network.covariates.learn(covariates)
                networks.append(network)
        self.network = EvidenceEnsemble(networks)
        self.parts = parts_of_objects(rows.objects, self.members, self.seed)
        self.priors = [
            base_rate_logit(rows.same[seen]) - math.log(data.kept)
            for seen in self.seen(rows.objects)
        ]

    def seen(self, objects: Tensor) -> Tensor:
        """(members, P) whether a member is trained on a pair of these objects (2, P)."""
        parts = torch.cat([self.parts, self.parts.new_full((1,), -1)]).to(objects.device)
        member = torch.arange(self.members, device=objects.device)[:, None, None]
        # Clutter is number -1, which is the last part: nobody's.
        return (parts[objects] != member).all(1)

    def forward(self, scores: Tensor, covariates: Tensor) -> Tensor:
        """Log likelihood ratios (P,) of scores (l, P), 0 where no modality says anything."""
        return self.network(as_evidence(scores), covariates).nan_to_num(0.0)

    def training_step(self, batch: Mapping[str, Any], batch_idx: int) -> Tensor:
        evidence, count = as_evidence(batch["evidence"]), len(batch["same"])
        covariates = stack_covariates(batch["covariates"], self.names, count)
        members: Any = self.network.members
        losses = []
        for network, prior, seen in zip(
            members, self.priors, self.seen(batch["objects"]), strict=True
        ):
            logit = network(evidence, covariates).nan_to_num(0.0) + prior
            truth = batch["same"].to(logit)
            each = binary_cross_entropy_with_logits(logit, truth, reduction="none")
            losses.append((each * seen).sum() / seen.sum().clamp(min=1))
        loss = torch.stack(losses).sum()  # the members have no weights in common
        self.log_loss(loss / self.members, count)
        return loss

    def validation_step(self, batch: Mapping[str, Any], batch_idx: int) -> None:
        covariates = stack_covariates(batch["covariates"], self.names, len(batch["same"]))
        found = calibration_metrics(self(batch["evidence"], covariates), batch["same"])
        self.log_once({f"val/{key}": value for key, value in found.items()})

    def on_test_end(self) -> None:
        """Figures and pictures against fixed fusion, into the folder of the run."""
        data = self.data
        compared = {
            "log odds": ((lambda table: table.evidence), LogOddsFusion()),
            "network": (self.scores, LogOddsFusion(cap=MAX_LOG_RATIO)),
        }
        found = evaluate_scores(self.test_folder, data.tables("test"), data.modalities, compared)
        self.report = summary(found)

    @torch.no_grad()
    def scores(self, table: PairTable) -> Tensor:
        """(1, P) of a table whose evidence is scores."""
        ratio = self(table.evidence, table.covariates_of(self.names))
        return torch.sigmoid(ratio)[None]

    def configure_optimizers(self) -> Any:
        return torch.optim.AdamW(
            self.network.parameters(), lr=self.learning_rate, weight_decay=self.weight_decay
        )

    def export(self, folder: Path, scorers: Sequence[Mapping[str, Any]]) -> list[Path]:
        """Write the networks, and ``scorers.yaml`` that ``mixer associate --config`` takes."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "pair_network.safetensors"
        save_network(path, self.network, self.data.modalities)  # type: ignore[arg-type]
        scorer = block("mixer_torch.scorers.PairNetwork", path=str(path), scorers=list(scorers))
        fusion = LogOddsFusion(cap=MAX_LOG_RATIO)
        return [path, write_listing(folder / "scorers.yaml", [scorer], fusion)]


def base_rate_logit(same: Tensor) -> float:
    """Logit of the share of same pairs.

    Raises:
        ValueError: All are of one kind.
    """
    count = int(same.sum())
    if not 0 < count < len(same):
        raise ValueError(
            f"train: expected same and different pairs for each member, "
            f"got {count} same of {len(same)}"
        )
    return math.log(count / (len(same) - count))


def parts_of_objects(objects: Tensor, count: int, seed: int) -> Tensor:
    """The part 0, 1, ..., count - 1 of each object, drawn at random; -1 where there is but one.

    Args:
        objects: Numbers of objects, -1 for clutter.
        count: Of parts.
        seed: Of the draw.

    Raises:
        ValueError: There are fewer objects than parts, and more than one part.
    """
    number = int(objects.max()) + 1 if objects.numel() else 0
    if count > max(number, 1):
        raise ValueError(f"members: expected at most one for each object, {number}, got {count}")
    order = torch.randperm(number, generator=torch.Generator().manual_seed(seed))
    part = torch.empty(number, dtype=torch.int64)
    part[order] = torch.arange(number) % count if count > 1 else -1
    return part

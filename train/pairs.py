"""Training of the pair scorer: one network over the evidence of all modalities."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import yaml
from lightning import LightningModule
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from mixer_torch.calibration_metrics import calibration_metrics
from mixer_torch.fusion import LogOddsFusion
from scorers.fitted import log_ratio_of
from scorers.learned import SURE, EvidenceNetwork, save_network
from train.data import PairData, Rows, stack_covariates
from train.evaluation import evaluate_scores, summary
from train.tables import PairTable


class PairTraining(LightningModule):
    """An :class:`~scorers.learned.EvidenceNetwork`, by log loss at the base rate of training.

    The covariates are evidence here, counted once for all modalities. The scores that go in are
    those of the scorers with the calibrators that the configuration gives them.

    Args:
        covariates: Names of :data:`scorers.covariates.COVARIATES`.
        width: Units of the hidden layer.
        learning_rate: Of Adam.
        weight_decay: Of Adam, decoupled.
        seed: Of the weights at the start.

    Raises:
        ValueError: learning_rate is not positive.
    """

    def __init__(
        self,
        covariates: Sequence[str] = ("time_gap", "box_size", "size_ratio"),
        width: int = 32,
        learning_rate: float = 5e-3,
        weight_decay: float = 1e-2,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if not learning_rate > 0:
            raise ValueError(f"learning_rate: expected a positive number, got {learning_rate}")
        self.names = tuple(covariates)
        self.width = width
        self.learning_rate = learning_rate
        self.weight_decay = weight_decay
        self.seed = seed
        self.network: nn.Module = nn.Identity()
        self.prior = 0.0
        self.report = ""

    def setup(self, stage: str) -> None:
        data = self._data()
        if isinstance(self.network, EvidenceNetwork):
            return
        data.replace_evidence_by_scores()
        rows = Rows(data.tables("train"))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            network = EvidenceNetwork(len(data.modalities), self.names, self.width)
        network.covariates.learn(rows.covariates_of(self.names))
        self.network = network
        rate = float(rows.same.double().mean())
        self.prior = math.log(rate / (1 - rate)) - math.log(data.kept)

    def _data(self) -> PairData:
        return self.trainer.datamodule  # type: ignore[attr-defined]

    def forward(self, scores: Tensor, covariates: Tensor) -> Tensor:
        """Log likelihood ratios (P,) of scores (l, P), 0 where no modality says anything."""
        ratio = log_ratio_of(scores).float()
        ratio = ratio.where(scores != 0.5, ratio.new_full((), torch.nan))
        return self.network(ratio, covariates).nan_to_num(0.0)

    def _of(self, batch: Mapping[str, Any]) -> Tensor:
        covariates = stack_covariates(batch["covariates"], self.names, len(batch["same"]))
        return self(batch["evidence"], covariates)

    def training_step(self, batch: Mapping[str, Any], batch_idx: int) -> Tensor:
        logit = self._of(batch) + self.prior
        loss = binary_cross_entropy_with_logits(logit, batch["same"].to(logit))
        self.log(
            "train/loss", loss, on_step=False, on_epoch=True, batch_size=len(logit), sync_dist=True
        )
        return loss

    def validation_step(self, batch: Mapping[str, Any], batch_idx: int) -> None:
        found = calibration_metrics(self._of(batch), batch["same"])
        self.log_dict(
            {f"val/{key}": value for key, value in found.items()}, batch_size=1, sync_dist=True
        )

    def test_step(self, batch: Mapping[str, Any], batch_idx: int) -> None:
        """All is measured at the end, sequence by sequence."""

    def on_test_end(self) -> None:
        """Figures and pictures against fixed fusion, into the folder of the run."""
        data = self._data()
        compared = {
            "log odds": ((lambda table: table.evidence), LogOddsFusion()),
            "network": (self.scores, LogOddsFusion(cap=SURE)),
        }
        folder = Path(self.trainer.default_root_dir) / "test"
        found = evaluate_scores(folder, data.tables("test"), data.modalities, compared)
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
        """Write the network, and ``scorers.yaml`` that ``mixer associate --config`` takes."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "pair_network.safetensors"
        save_network(path, self.network, self._data().modalities)  # type: ignore[arg-type]
        arguments = {"path": str(path), "scorers": list(scorers)}
        scorer = {"class_path": "scorers.learned.PairNetwork", "init_args": arguments}
        fusion = {"class_path": "mixer_torch.LogOddsFusion", "init_args": {"cap": SURE}}
        listing = folder / "scorers.yaml"
        listing.write_text(
            yaml.safe_dump({"scorers": [scorer], "fusion": fusion}, sort_keys=False),
            encoding="utf-8",
        )
        return [path, listing]

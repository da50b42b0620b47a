"""Training of fusion: what each modality weighs, and how much one may claim."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import yaml
from lightning import LightningModule
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, softplus

from mixer_torch.fusion import Fusion, LinearFusion, LogOddsFusion
from mixer_torch.io.files import write_json
from mixer_torch.train.data import PairData, Rows
from mixer_torch.train.dependence import dependence, worth
from mixer_torch.train.evaluation import evaluate_scores, solved, summary
from mixer_torch.train.tables import PairTable


class FusionTraining(LightningModule):
    """Weights w_k >= 0 and cap of log-odds fusion, from labelled pairs, judged by the clustering.

    Minimises the log loss of Σ_k w_k clamp(logit s_k, ±cap) + logit P(same): modalities that say
    the same thing twice get less weight than modalities that are independent given the truth, for
    which all weights would be 1. Epochs are judged by F1 of the solved validation sequences, and at
    the end what was learned is exported only where it does better there than the paper's fusion and
    than log-odds fusion as it comes.

    The scores are those of the scorers with the calibrators that the configuration gives them.

    Args:
        learning_rate: Of Adam.
        cap: Where the cap starts, nats.

    Raises:
        ValueError: learning_rate or cap is not positive.
    """

    def __init__(self, learning_rate: float = 0.05, cap: float = 4.0) -> None:
        super().__init__()
        if not (learning_rate > 0 and cap > 0):
            raise ValueError(
                f"learning_rate, cap: expected positive numbers, got {learning_rate}, {cap}"
            )
        self.learning_rate = learning_rate
        self.free_cap = nn.Parameter(torch.tensor(math.log(math.expm1(cap))))
        self.free_weights = nn.Parameter(torch.zeros(0))
        self.modalities: tuple[str, ...] = ()
        self.prior = 0.0
        self.report = ""

    @property
    def weights(self) -> Tensor:
        """(l,) all >= 0."""
        return softplus(self.free_weights)

    @property
    def cap(self) -> Tensor:
        """Largest log likelihood ratio of one modality, nats."""
        return softplus(self.free_cap)

    def setup(self, stage: str) -> None:
        data: PairData = self.trainer.datamodule  # type: ignore[attr-defined]
        self.modalities = data.modalities
        if not len(self.free_weights):
            ones = torch.full((len(self.modalities),), math.log(math.expm1(1.0)))
            self.free_weights = nn.Parameter(ones)
        same = Rows(data.tables("train")).same
        rate = float(same.double().mean())
        self.prior = math.log(rate / (1 - rate)) - math.log(data.kept)
        data.replace_evidence_by_scores()

    def forward(self, scores: Tensor) -> Tensor:
        """Fused log likelihood ratio (P,) of scores (l, P)."""
        ratio = torch.logit(scores, eps=1e-6)
        ratio = torch.maximum(torch.minimum(ratio, self.cap), -self.cap)
        return (self.weights[:, None] * ratio).sum(0)

    def training_step(self, batch: Mapping[str, Any], batch_idx: int) -> Tensor:
        logit = self(batch["evidence"]) + self.prior
        loss = binary_cross_entropy_with_logits(logit, batch["same"].to(logit))
        self.log(
            "train/loss", loss, on_step=False, on_epoch=True, batch_size=len(logit), sync_dist=True
        )
        return loss

    def validation_step(self, batch: Mapping[str, Any], batch_idx: int) -> None:
        """The figure of merit is F1 after solving, for each sequence."""
        data: PairData = self.trainer.datamodule  # type: ignore[attr-defined]
        found = mean_f1(data.tables("validate"), self.modalities, self.fusion())
        self.log("val/f1", found, batch_size=1, sync_dist=True)
        rows = zip(self.modalities, self.weights, strict=True)
        self.log_dict(
            {f"weight/{name}": weight for name, weight in rows}, batch_size=1, sync_dist=True
        )
        self.log("cap", self.cap, batch_size=1, sync_dist=True)

    def test_step(self, batch: Mapping[str, Any], batch_idx: int) -> None:
        """All is measured at the end, sequence by sequence."""

    def on_test_end(self) -> None:
        """Figures, dependence, and what each modality is worth, into the folder of the run."""
        data: PairData = self.trainer.datamodule  # type: ignore[attr-defined]
        folder = Path(self.trainer.default_root_dir) / "test"
        tables = data.tables("test")
        scores = {
            name: ((lambda table: table.evidence), fusion)
            for name, fusion in self.candidates().items()
        }
        found = summary(evaluate_scores(folder, tables, self.modalities, scores))
        self.report = f"{found}\n\nexported, as best in validation: {self.choose()}"
        report = {
            "dependence": dependence(tables, self.modalities),
            "worth": worth(tables, self.modalities, self.fusion()),
        }
        write_json(folder / "dependence.json", report)

    def fusion(self) -> LogOddsFusion:
        """What was learned, as a fusion for ``solve``."""
        weights = dict(zip(self.modalities, self.weights.detach().tolist(), strict=True))
        return LogOddsFusion(weights, float(self.cap.detach()))

    def candidates(self) -> dict[str, Fusion]:
        """What there is to choose from, the simplest first."""
        return {"linear": LinearFusion(), "log odds": LogOddsFusion(), "trained": self.fusion()}

    def choose(self) -> str:
        """The name of the candidate with the best mean F1 of the solved validation sequences."""
        data: PairData = self.trainer.datamodule  # type: ignore[attr-defined]
        tables = data.tables("validate")
        candidates = self.candidates().items()
        found = {name: mean_f1(tables, self.modalities, fusion) for name, fusion in candidates}
        return max(found, key=lambda name: found[name])

    def configure_optimizers(self) -> Any:
        return torch.optim.Adam(self.parameters(), lr=self.learning_rate)

    def export(self, folder: Path, scorers: Sequence[Mapping[str, Any]]) -> list[Path]:
        """Write ``fusion.yaml``, which ``mixer associate --config`` takes."""
        folder.mkdir(parents=True, exist_ok=True)
        chosen = self.candidates()[self.choose()]
        arguments: dict[str, Any] = {}
        if isinstance(chosen, LogOddsFusion):
            arguments = {"weights": chosen.weights, "cap": chosen.cap}
        block = {"class_path": f"mixer_torch.{type(chosen).__name__}", "init_args": arguments}
        path = folder / "fusion.yaml"
        path.write_text(
            yaml.safe_dump({"scorers": list(scorers), "fusion": block}, sort_keys=False),
            encoding="utf-8",
        )
        return [path]


def mean_f1(tables: Sequence[PairTable], modalities: Sequence[str], fusion: Fusion) -> float:
    """Of solved sequences whose evidence is scores."""
    found = [solved(table, table.evidence, modalities, fusion)["f1"] for table in tables]
    return sum(found) / len(found)

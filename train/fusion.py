"""Training of the fusion: the weight of each modality, and the cap of all."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, softplus

from mixer_torch.fusion import Fusion, LinearFusion, LogOddsFusion
from mixer_torch.io.files import write_json
from mixer_torch.train.base import PairModule
from mixer_torch.train.data import Rows
from mixer_torch.train.dependence import dependence, worth
from mixer_torch.train.evaluation import evaluate_scores, mean_f1, summary
from mixer_torch.train.listing import write_listing


class FusionTraining(PairModule):
    """Weights w_k >= 0 and cap of log-odds fusion, from labelled pairs, judged by the clustering.

    Minimises the log loss of Σ_k w_k clamp(logit s_k, ±cap) + logit P(same): modalities whose
    evidence is correlated get less weight than modalities that are independent given the truth, for
    which all weights would be 1. Epochs are judged by F1 of the solved validation sequences, and at
    the end what was learned is exported only where it does better there than the paper's fusion and
    than log-odds fusion with its defaults.

    The scores are those of the scorers with the calibrators that the configuration gives them.

    Args:
        learning_rate: Of Adam.
        cap: Initial value of the cap, nats.

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

    @property
    def weights(self) -> Tensor:
        """(l,) all >= 0."""
        return softplus(self.free_weights)

    @property
    def cap(self) -> Tensor:
        """Largest log likelihood ratio of one modality, nats."""
        return softplus(self.free_cap)

    def setup(self, stage: str) -> None:
        data = self.data
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
        self.log_loss(loss, len(logit))
        return loss

    def validation_step(self, batch: Mapping[str, Any], batch_idx: int) -> None:
        """The figure of merit is F1 after solving, for each sequence."""
        found = mean_f1(self.data.tables("validate"), self.modalities, self.fusion())
        rows = zip(self.modalities, self.weights, strict=True)
        weights = {f"weight/{name}": weight for name, weight in rows}
        self.log_once({"val/f1": found, "cap": self.cap, **weights})

    def on_test_end(self) -> None:
        """Figures, dependence, and what each modality is worth, into the folder of the run."""
        folder, tables = self.test_folder, self.data.tables("test")
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
        tables = self.data.tables("validate")
        candidates = self.candidates().items()
        found = {name: mean_f1(tables, self.modalities, fusion) for name, fusion in candidates}
        return max(found, key=lambda name: found[name])

    def configure_optimizers(self) -> Any:
        return torch.optim.Adam(self.parameters(), lr=self.learning_rate)

    def export(self, folder: Path, scorers: Sequence[Mapping[str, Any]]) -> list[Path]:
        """Write ``fusion.yaml``, which ``mixer associate --config`` takes."""
        folder.mkdir(parents=True, exist_ok=True)
        chosen = self.candidates()[self.choose()]
        return [write_listing(folder / "fusion.yaml", scorers, chosen)]

"""Training of calibrators, one for each modality, by gradient descent on labelled pairs."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import yaml
from lightning import LightningModule
from torch import Tensor, nn

from mixer_torch.fusion import LogOddsFusion
from mixer_torch.metrics.calibration import calibration_metrics
from mixer_torch.scorers.calibrators import MonotoneSpline
from mixer_torch.scorers.fitted import save_calibrator
from mixer_torch.scorers.likelihood_ratio import LikelihoodRatio
from mixer_torch.train.data import PairData, Rows
from mixer_torch.train.evaluation import Affinities, evaluate_scores, summary
from mixer_torch.train.tables import PairTable, calibrated


class CalibratorTraining(LightningModule):
    """Calibrators of all modalities of a :class:`~mixer_torch.train.data.PairData`, trained side by side.

    What is no matter of descent (ranges, knots, isotonic pools) comes from all pairs of training at
    the start; the rest minimises the log loss at the base rate; after each epoch the shrinkage of
    each is chosen on the pairs of validation.

    Args:
        calibrator: What to train for each modality.
        special: Another one for modalities by name.
        learning_rate: Of Adam.
        decay: Factor on the learning rate from one epoch to the next.

    Raises:
        ValueError: learning_rate or decay is out of range.
    """

    def __init__(
        self,
        calibrator: LikelihoodRatio | None = None,
        special: dict[str, LikelihoodRatio] | None = None,
        learning_rate: float = 0.1,
        decay: float = 0.9,
    ) -> None:
        super().__init__()
        if not learning_rate > 0 or not 0 < decay <= 1:
            raise ValueError(
                "learning_rate, decay: expected a positive number and one in (0, 1], "
                f"got {learning_rate}, {decay}"
            )
        self.prototype = [calibrator or MonotoneSpline()]
        self.special = dict(special or {})
        self.learning_rate = learning_rate
        self.decay = decay
        self.calibrators = nn.ModuleDict()
        self.kept = 1.0
        self.report = ""

    def setup(self, stage: str) -> None:
        """Make the calibrators and let them see the pairs of training."""
        if self.calibrators:
            return
        data = self._data()
        for name in self.special:
            if name not in data.modalities:
                raise KeyError(f"special: no modality {name!r}: {', '.join(data.modalities)}")
        rows = Rows(data.tables("train"))
        self.kept = data.kept
        for name, evidence in zip(data.modalities, rows.evidence, strict=True):
            calibrator = copy.deepcopy(self.special.get(name, self.prototype[0]))
            if has_both_kinds(evidence, rows.same):
                covariates = rows.covariates_of(calibrator.covariates.names)
                calibrator.learn_statistics(evidence, rows.same, covariates)
            self.calibrators[name] = calibrator

    def _data(self) -> PairData:
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        if not isinstance(data, PairData):
            raise TypeError(f"data: expected mixer_torch.train.PairData, got {type(data).__name__}")
        return data

    def _parts(self, batch: Mapping[str, Any]) -> Any:
        """Name, calibrator, evidence, truth and covariates of the pairs each has a say on."""
        count = len(batch["same"])
        for (name, calibrator), evidence in zip(
            self.calibrators.items(), batch["evidence"], strict=True
        ):
            if not isinstance(calibrator, LikelihoodRatio) or not bool(calibrator.counts.all()):
                continue
            known = evidence.isfinite()
            values = [batch["covariates"][key][known] for key in calibrator.covariates.names]
            covariates = torch.stack(values, 1) if values else evidence.new_zeros(count, 0)[known]
            yield name, calibrator, evidence[known], batch["same"][known], covariates

    def training_step(self, batch: Mapping[str, Any], batch_idx: int) -> Tensor:
        losses = {
            name: calibrator.loss(evidence, same, covariates, self.kept)
            for name, calibrator, evidence, same, covariates in self._parts(batch)
            if len(same)
        }
        self.log_dict(
            {f"train/loss/{name}": loss for name, loss in losses.items()},
            on_step=False,
            on_epoch=True,
            batch_size=len(batch["same"]),
            sync_dist=True,
        )
        return torch.stack(list(losses.values())).sum()

    def validation_step(self, batch: Mapping[str, Any], batch_idx: int) -> None:
        costs = []
        for name, calibrator, evidence, same, covariates in self._parts(batch):
            if not has_both_kinds(evidence, same):
                continue
            calibrator.shrink(evidence, same, covariates)
            ratio = calibrator.log_ratio(evidence, covariates)
            found = calibration_metrics(ratio, same)
            costs.append(found["cllr"])
            self.log_dict(
                {f"val/{key}/{name}": found[key] for key in ("cllr", "min_cllr", "ece")},
                batch_size=1,
                sync_dist=True,
            )
        if not costs:
            raise ValueError("validate: expected a modality with pairs of both kinds, found none")
        self.log("val/cllr", sum(costs) / len(costs), batch_size=1, sync_dist=True)

    def test_step(self, batch: Mapping[str, Any], batch_idx: int) -> None:
        """All is measured at the end, sequence by sequence."""

    def on_test_end(self) -> None:
        """Figures and pictures, before and after, into the folder of the run."""
        data = self._data()
        folder = Path(self.trainer.default_root_dir) / "test"
        found = evaluate_scores(folder, data.tables("test"), data.modalities, self.affinities(data))
        self.report = summary(found)

    def affinities(self, data: PairData) -> Affinities:
        """Scores (l, P) of a table, set by hand with the paper's fusion, and trained with log odds.

        Trained scores are likelihood ratios, whose logarithms add up; where the paper's sum of
        1 - 2 s gives all of 0.98, 0.99 and 0.999 the same say.
        """

        def by_hand(table: PairTable) -> Tensor:
            return calibrated(data.scorers, table)

        def trained(table: PairTable) -> Tensor:
            rows = []
            for calibrator, evidence in zip(self.calibrators.values(), table.evidence, strict=True):
                known = evidence.isfinite()
                names = calibrator.covariates.names  # type: ignore[union-attr]
                covariates = table.covariates_of(names)[known]  # type: ignore[arg-type]
                score = torch.full_like(evidence, 0.5)
                score[known] = calibrator(evidence[known], covariates).detach()
                rows.append(score)
            return torch.stack(rows)

        return {"by hand": (by_hand, None), "trained": (trained, LogOddsFusion())}

    def configure_optimizers(self) -> Any:
        learned = [parameter for parameter in self.parameters() if parameter.numel()]
        if not learned:
            return None
        optimiser = torch.optim.Adam(learned, lr=self.learning_rate)
        schedule = torch.optim.lr_scheduler.ExponentialLR(optimiser, self.decay)
        return {"optimizer": optimiser, "lr_scheduler": schedule}

    def export(self, folder: Path, scorers: Sequence[Mapping[str, Any]]) -> list[Path]:
        """Write each calibrator, and ``scorers.yaml`` that ``mixer associate --config`` takes.

        It asks for log-odds fusion, too, which is the one for likelihood ratios.

        Args:
            folder: Where to; it is made if it is not there.
            scorers: ``class_path`` and ``init_args`` of the scorer of each modality.
        """
        folder.mkdir(parents=True, exist_ok=True)
        blocks, written = [], []
        for (name, calibrator), scorer in zip(self.calibrators.items(), scorers, strict=True):
            path = folder / f"{name}.safetensors"
            save_calibrator(path, calibrator, scorer)  # type: ignore[arg-type]
            fitted = {
                "class_path": "mixer_torch.scorers.fitted.Fitted",
                "init_args": {"path": str(path)},
            }
            arguments = {**scorer.get("init_args", {}), "calibrator": fitted}
            blocks.append({"class_path": scorer["class_path"], "init_args": arguments})
            written.append(path)
        listing = folder / "scorers.yaml"
        settings = {"scorers": blocks, "fusion": {"class_path": "mixer_torch.LogOddsFusion"}}
        listing.write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
        return [*written, listing]


def has_both_kinds(evidence: Tensor, same: Tensor) -> bool:
    """Whether there are same and different pairs with evidence."""
    known = same[evidence.isfinite()]
    return bool(known.any()) and not bool(known.all())

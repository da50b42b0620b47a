"""Training of calibrators, one for each modality, by gradient descent on labelled pairs."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from mixer_torch.fusion import LogOddsFusion
from mixer_torch.metrics.calibration import calibration_metrics
from mixer_torch.scorers.calibrators import MonotoneSpline, save_calibrator
from mixer_torch.scorers.likelihood_ratio import LikelihoodRatio
from mixer_torch.scoring import NOTHING_TO_SAY
from mixer_torch.train.base import PairModule
from mixer_torch.train.data import PairData, Rows
from mixer_torch.train.evaluation import Affinities, evaluate_scores, summary
from mixer_torch.train.listing import with_calibrator, write_listing
from mixer_torch.train.tables import PairTable, calibrated


class CalibratorTraining(PairModule):
    """The calibrators of all modalities, trained side by side.

    What is not learned by gradient descent (ranges, knots, isotonic pools) is taken from all pairs
    of training at the start; the rest minimises the log loss at the base rate; after each epoch the
    shrinkage of each calibrator is chosen on the pairs of validation.

    Args:
        calibrator: The calibrator to train for each modality; a
            :class:`~mixer_torch.scorers.calibrators.MonotoneSpline` if None.
        special: Another one for some modalities, by name.
        learning_rate: Of Adam.
        decay: Factor of the learning rate from one epoch to the next.

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

    def setup(self, stage: str) -> None:
        """Make the calibrators and let them see the pairs of training."""
        if self.calibrators:
            return
        data = self.data
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

    def _parts(self, batch: Mapping[str, Any]) -> Any:
        """Name, calibrator, evidence, truth and covariates of the pairs with evidence."""
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
            self.log_once({f"val/{key}/{name}": found[key] for key in ("cllr", "min_cllr", "ece")})
        if not costs:
            raise ValueError("validate: expected a modality with pairs of both kinds, found none")
        self.log_once({"val/cllr": sum(costs) / len(costs)})

    def on_test_end(self) -> None:
        """Figures and pictures, before and after, into the folder of the run."""
        data = self.data
        compared = self.affinities(data)
        found = evaluate_scores(self.test_folder, data.tables("test"), data.modalities, compared)
        self.report = summary(found)

    def affinities(self, data: PairData) -> Affinities:
        """Scores (l, P) of a table, set by hand with the paper's fusion, and trained with log odds.

        Trained scores are likelihood ratios, whose logarithms add up. The paper's sum of 1 - 2 s
        hardly distinguishes 0.98 from 0.999.
        """

        def by_hand(table: PairTable) -> Tensor:
            return calibrated(data.scorers, table)

        def trained(table: PairTable) -> Tensor:
            rows = []
            for calibrator, evidence in zip(self.calibrators.values(), table.evidence, strict=True):
                known = evidence.isfinite()
                names = calibrator.covariates.names  # type: ignore[union-attr]
                covariates = table.covariates_of(names)[known]  # type: ignore[arg-type]
                score = torch.full_like(evidence, NOTHING_TO_SAY)
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
            blocks.append(with_calibrator(scorer, path))
            written.append(path)
        return [*written, write_listing(folder / "scorers.yaml", blocks, LogOddsFusion())]


def has_both_kinds(evidence: Tensor, same: Tensor) -> bool:
    """Whether there are same and different pairs with evidence."""
    known = same[evidence.isfinite()]
    return bool(known.any()) and not bool(known.all())

"""What the trainings over labelled pairs have in common."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightning import LightningModule
from torch import Tensor

from mixer_torch.train.data import PairData


class PairModule(LightningModule):
    """A training whose data is a :class:`~mixer_torch.train.data.PairData`.

    Attributes:
        report: What testing found, as Markdown.
    """

    report = ""

    @property
    def data(self) -> PairData:
        """The data of this run; TypeError if it is of another class."""
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        if not isinstance(data, PairData):
            raise TypeError(f"data: expected mixer_torch.train.PairData, got {type(data).__name__}")
        return data

    @property
    def test_folder(self) -> Path:
        """Where testing writes."""
        return Path(self.trainer.default_root_dir) / "test"

    def log_loss(self, loss: Tensor, pairs: int) -> None:
        """Log the mean loss of the epoch."""
        self.log("train/loss", loss, on_step=False, on_epoch=True, batch_size=pairs, sync_dist=True)

    def log_once(self, values: Mapping[str, Any]) -> None:
        """Log figures of all pairs at once."""
        self.log_dict(dict(values), batch_size=1, sync_dist=True)

    def test_step(self, batch: Mapping[str, Any], batch_idx: int) -> None:
        """Nothing: ``on_test_end`` measures sequence by sequence."""

"""Labelled pairs for training, split by sequence or by identity and never by pair."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import torch
from lightning import LightningDataModule
from torch import Tensor
from torch.utils.data import DataLoader, DistributedSampler
from torch.utils.data import Dataset as Batches

from mixer_torch.datasets.base import Dataset
from mixer_torch.pairs import Every, PairSelector
from mixer_torch.scoring import Scorer
from mixer_torch.train.tables import (
    PairTable,
    calibrated,
    modality_names,
    pair_table,
    stack_covariates,
)


class PairData(LightningDataModule):
    """Pairs of observations with the evidence of each modality and the truth.

    Without sequences for validation, a share of the identities of the training sequences is held
    out: a pair is used where both its observations are in one part, so that no object is in two.
    Clutter is split in the same proportion.

    Training visits every same pair once an epoch, and ``negatives`` different ones for each of
    them, drawn for each epoch from seed and epoch alone. They are drawn uniformly: picking the
    hard ones would distort the likelihood ratios that are to be learned.

    Args:
        scorers: One for each modality.
        train: Sequences to train on.
        validate: Sequences to validate on; held-out identities if None or empty.
        test: Sequences to test on.
        pairs: Which pairs to compare; every pair across views if None.
        held_out: Share of the identities held out for validation where no sequence is.
        negatives: Different pairs for each same pair in an epoch.
        batch_size: Pairs a batch.
        seed: Of the split and of the order of the pairs.
        cache: Folder in which raw evidence is kept between runs; none if None.

    Raises:
        ValueError: A list is empty or a number out of range.
    """

    def __init__(
        self,
        scorers: list[Scorer],
        train: list[Dataset],
        validate: list[Dataset] | None = None,
        test: list[Dataset] | None = None,
        pairs: PairSelector | None = None,
        held_out: float = 0.25,
        negatives: int = 10,
        batch_size: int = 4096,
        seed: int = 0,
        cache: Path | None = None,
    ) -> None:
        super().__init__()
        if not scorers or not train:
            raise ValueError("scorers, train: expected at least one of each")
        if not 0 < held_out < 1 or negatives < 1 or batch_size < 1:
            raise ValueError(
                "held_out, negatives, batch_size: expected a share in (0, 1) and integers >= 1, "
                f"got {held_out}, {negatives}, {batch_size}"
            )
        self.scorers = scorers
        self.sources = {"train": train, "validate": validate or [], "test": test or []}
        self.selector = pairs or Every()
        self.held_out = held_out
        self.negatives = negatives
        self.batch_size = batch_size
        self.seed = seed
        self.cache = cache
        self.modalities = modality_names(scorers)
        self._tables: dict[str, list[PairTable]] = {}
        self._scored = False

    @property
    def kept(self) -> float:
        """Share of the different pairs of training that an epoch visits."""
        return self._sampler(Rows(self.tables("train"))).kept

    def setup(self, stage: str) -> None:
        """Compare the pairs of all parts; those of testing only when testing."""
        evidence = torch.cat([table.evidence for table in self.tables("train")], 1)
        for scorer, row in zip(self.scorers, evidence, strict=True):
            if not bool(row.isfinite().any()):
                needed = ", ".join(scorer.needs)
                raise ValueError(f"train: {scorer.name} (needs {needed}) has no evidence anywhere")
        self.tables("validate")
        if stage == "test":
            self.tables("test")

    def tables(self, part: Literal["train", "validate", "test"]) -> list[PairTable]:
        """The pairs of ``train``, ``validate`` or ``test``, a table for each sequence.

        Raises:
            ValueError: There are none.
        """
        if part not in self._tables:
            self._tables[part] = [
                pair_table(dataset, self.scorers, self.selector, self.cache)
                for dataset in self.sources[part]
            ]
            if part == "train" and not self.sources["validate"]:
                split = [by_identity(t, self.held_out, self.seed) for t in self._tables["train"]]
                self._tables["train"] = [train for train, _ in split]
                self._tables["validate"] = [held_out for _, held_out in split]
        if not self._tables[part]:
            raise ValueError(f"{part}: expected at least one dataset")
        return self._tables[part]

    def replace_evidence_by_scores(self) -> None:
        """From now on the tables hold scores, by the calibrators that the scorers have."""
        if not self._scored:
            for part, tables in self._tables.items():
                scored = [replace(t, evidence=calibrated(self.scorers, t)) for t in tables]
                self._tables[part] = scored
            self._scored = True

    def train_dataloader(self) -> DataLoader:
        rows = Rows(self.tables("train"))
        return DataLoader(rows, sampler=self._sampler(rows), batch_size=None)

    def _sampler(self, rows: Rows) -> EpochSampler:
        return EpochSampler(rows.same, self.negatives, self.batch_size, self.seed, *self.place)

    @property
    def place(self) -> tuple[int, int]:
        """Number of this process, and of how many that train together."""
        trainer = self.trainer
        return (0, 1) if trainer is None else (trainer.global_rank, trainer.world_size)

    def val_dataloader(self) -> DataLoader:
        return self._whole("validate")

    def test_dataloader(self) -> DataLoader:
        return self._whole("test")

    def _whole(self, part: Literal["validate", "test"]) -> DataLoader:
        """All pairs of a part as one batch, for figures of all of them at once."""
        rows = Rows(self.tables(part))
        return DataLoader(rows, sampler=[torch.arange(len(rows))], batch_size=None)


class Rows(Batches):
    """Pairs of several sequences in a row; indexed by a tensor, it gives a batch.

    Attributes:
        objects: (2, P) number of the object of both observations, unique over all sequences; -1 for
            clutter.
    """

    def __init__(self, tables: Sequence[PairTable]) -> None:
        self.evidence = torch.cat([table.evidence for table in tables], 1)
        self.same = torch.cat([table.same for table in tables])
        self.objects = _objects(tables)
        names = [n for n in tables[0].covariates if all(n in t.covariates for t in tables)]
        self.covariates = {n: torch.cat([t.covariates[n] for t in tables]) for n in names}

    def __len__(self) -> int:
        return len(self.same)

    def __getitem__(self, index: Any) -> dict[str, Any]:
        return {
            "evidence": self.evidence[:, index],
            "same": self.same[index],
            "objects": self.objects[:, index],
            "covariates": {name: value[index] for name, value in self.covariates.items()},
        }

    def covariates_of(self, names: Sequence[str]) -> Tensor:
        """(P, c) raw values of covariates by name."""
        return stack_covariates(self.covariates, names, len(self))


def _objects(tables: Sequence[PairTable]) -> Tensor:
    """(2, P) numbers of the objects of the pairs, unique over all tables; -1 for clutter."""
    found, count = [], 0
    for table in tables:
        identity = table.observations["identity"][table.pairs]
        known, number = torch.unique(identity, return_inverse=True)
        clutter = int((known < 0).sum())
        found.append(torch.where(identity < 0, -1, number - clutter + count))
        count += len(known) - clutter
    return torch.cat(found, 1)


class EpochSampler(DistributedSampler):
    """Batches of an epoch: all same pairs and negatives, in an order of seed and epoch alone.

    Of n processes that train together, each takes every n-th batch; all take the same number of
    batches, for which some of the first are taken twice.
    """

    def __init__(
        self,
        same: Tensor,
        negatives: int,
        batch_size: int,
        seed: int,
        rank: int = 0,
        processes: int = 1,
    ) -> None:
        super().__init__(same, processes, rank)  # type: ignore[arg-type]
        self.same = same.nonzero()[:, 0]
        self.different = (~same).nonzero()[:, 0]
        self.count = min(len(self.different), max(negatives * len(self.same), batch_size))
        self.batch_size = batch_size
        self.seed = seed

    @property
    def kept(self) -> float:
        """The share of the different pairs that an epoch visits."""
        return self.count / max(len(self.different), 1)

    def set_epoch(self, epoch: int) -> None:
        """Called by the trainer before each epoch, also after a resumption."""
        self.epoch = epoch

    def __len__(self) -> int:
        batches = -(-(len(self.same) + self.count) // self.batch_size)
        return -(-batches // self.num_replicas)

    def __iter__(self) -> Iterator[Tensor]:
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        negatives = torch.randperm(len(self.different), generator=generator)[: self.count]
        chosen = torch.cat([self.same, self.different[negatives]])
        order = chosen[torch.randperm(len(chosen), generator=generator)]
        batches = order.split(self.batch_size)
        for k in range(len(self)):
            yield batches[(self.rank + k * self.num_replicas) % len(batches)]


def by_identity(table: PairTable, held_out: float, seed: int) -> tuple[PairTable, PairTable]:
    """Two tables that share no object; pairs between the two are in neither."""
    identity = table.observations["identity"]
    generator = torch.Generator().manual_seed(seed)
    objects = torch.unique(identity[identity >= 0])
    shuffled = objects[torch.randperm(len(objects), generator=generator)]
    held = torch.isin(identity, shuffled[: max(round(held_out * len(objects)), 1)])
    clutter = torch.rand(len(identity), generator=generator) < held_out
    held = torch.where(identity >= 0, held, clutter)
    return table.of_identities(~held), table.of_identities(held)

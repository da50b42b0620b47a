"""Crops of labelled objects for the training of embeddings, split by identity."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from lightning import LightningDataModule
from torch import Tensor
from torch.utils.data import DataLoader, Sampler
from torch.utils.data import Dataset as Batches

from mixer_torch.datasets.base import Dataset
from mixer_torch.observations import Observations
from mixer_torch.scorers.embedding import crops_of


class CropData(LightningDataModule):
    """Crops of a dataset with identities; no identity is in two parts.

    Of the identities in order, the last ``test`` are for testing and the ``validate`` before them
    for validation. A batch holds ``persons`` of training with ``crops`` each.

    Args:
        dataset: Crops with ``identity``; ``camera`` is used where there is one.
        validate: Number of identities.
        test: Number of identities.
        persons: Identities a batch.
        crops: Crops of each of them.
        height: Of the resized crops, pixels.
        width: Of the resized crops, pixels.
        seed: Of the order.

    Raises:
        ValueError: A number is out of range, or there are too few identities.
    """

    def __init__(
        self,
        dataset: Dataset,
        validate: int = 10,
        test: int = 16,
        persons: int = 16,
        crops: int = 4,
        height: int = 128,
        width: int = 48,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if min(validate, test) < 2 or min(persons, crops) < 2:
            raise ValueError(
                "validate, test, persons, crops: expected integers >= 2, "
                f"got {validate}, {test}, {persons}, {crops}"
            )
        self.dataset = dataset
        self.counts = validate, test
        self.batch = persons, crops
        self.size = height, width
        self.seed = seed
        self.parts: dict[str, Crops] = {}
        self.people = torch.zeros(0, dtype=torch.int64)

    def setup(self, stage: str) -> None:
        if self.parts:
            return
        seen = self.dataset.load()
        if "identity" not in seen.features:
            raise ValueError("dataset: training needs the feature 'identity'")
        identity = seen["identity"]
        people = torch.unique(identity[identity >= 0])
        validate, test = self.counts
        if len(people) < validate + test + 2:
            least = validate + test + 2
            raise ValueError(f"dataset: expected {least} identities or more, got {len(people)}")
        self.people = people[: len(people) - validate - test]
        ends = [0, len(people) - validate - test, len(people) - test, len(people)]
        for k, name in enumerate(("train", "validate", "test")):
            chosen = torch.isin(identity, people[ends[k] : ends[k + 1]])
            self.parts[name] = Crops(seen.select(chosen), self.size)

    def train_dataloader(self) -> DataLoader:
        crops = self.parts["train"]
        sampler = PersonSampler(crops.observations["identity"], *self.batch, self.seed)
        return DataLoader(crops, sampler=sampler, batch_size=None)

    def val_dataloader(self) -> DataLoader:
        return self._whole("validate")

    def test_dataloader(self) -> DataLoader:
        return self._whole("test")

    def _whole(self, name: str) -> DataLoader:
        crops = self.parts[name]
        return DataLoader(crops, sampler=[torch.arange(len(crops))], batch_size=None)


class Crops(Batches):
    """Crops in memory; indexed by a tensor, it gives a batch."""

    def __init__(self, observations: Observations, size: tuple[int, int]) -> None:
        self.observations = observations
        self.images = (255 * crops_of(observations.images, size)).to(torch.uint8)

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: Any) -> dict[str, Tensor]:
        camera = self.observations.camera
        return {
            "images": self.images[index].float() / 255,
            "identity": self.observations["identity"][index],
            "camera": camera[index],
        }


class PersonSampler(Sampler):
    """Batches of ``crops`` crops of each of ``persons`` persons, by seed and epoch alone."""

    def __init__(self, identity: Tensor, persons: int, crops: int, seed: int) -> None:
        self.members = [(identity == person).nonzero()[:, 0] for person in torch.unique(identity)]
        self.persons = min(persons, len(self.members))
        self.crops = crops
        self.count = max(len(identity) // (self.persons * crops), 1)
        self.seed = seed
        self.epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Called by the trainer before each epoch, also after a resumption."""
        self.epoch = epoch

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Tensor]:
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        for _ in range(self.count):
            chosen = torch.randperm(len(self.members), generator=generator)[: self.persons]
            yield torch.cat([self._some(self.members[int(k)], generator) for k in chosen])

    def _some(self, members: Tensor, generator: torch.Generator) -> Tensor:
        rounds = -(-self.crops // len(members))
        orders = [torch.randperm(len(members), generator=generator) for _ in range(rounds)]
        return members[torch.cat(orders)[: self.crops]]

"""Training of the appearance embedding, by a supervised contrastive loss."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import yaml
from jaxtyping import Bool, Float, Int64
from lightning import LightningModule
from torch import Tensor, nn

from mixer_torch.affinity import Affinity
from mixer_torch.calibration_metrics import calibration_metrics
from mixer_torch.metrics import evaluate
from mixer_torch.solvers.base import solve
from mixer_torch.solvers.threshold import AllPairs
from scorers.calibrators import MonotoneSpline
from scorers.embedding import EmbeddingNetwork, save_embedding
from scorers.fitted import save_calibrator
from train.evaluation import write_json


class EmbeddingTraining(LightningModule):
    """An :class:`~scorers.embedding.EmbeddingNetwork` from crops with identities.

    Its calibrator is fitted to the pairs of validation, whose persons training has not seen: to
    persons that it has seen, a network is surer than it may be.

    Args:
        dimension: Of the vectors.
        width: Channels of the first block.
        learning_rate: Of Adam, falling to 0 by a cosine over all epochs.
        temperature: Of the loss: lower looks harder at the nearest strangers.
        seed: Of the weights at the start and of the augmentations.

    Raises:
        ValueError: learning_rate or temperature is not positive.
    """

    def __init__(
        self,
        dimension: int = 128,
        width: int = 24,
        learning_rate: float = 2e-3,
        temperature: float = 0.1,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if not (learning_rate > 0 and temperature > 0):
            raise ValueError(
                "learning_rate, temperature: expected positive numbers, "
                f"got {learning_rate}, {temperature}"
            )
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = EmbeddingNetwork(dimension, width)
        self.calibrator = MonotoneSpline(direction="increasing")
        self.learning_rate = learning_rate
        self.temperature = temperature
        self.seed = seed
        self._augment = [augmentation()]

    def training_step(self, batch: Mapping[str, Tensor], batch_idx: int) -> Tensor:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed((self.seed * 1_000 + self.current_epoch) * 10_000 + batch_idx)
            images = self._augment[0](batch["images"])
        vectors = self.network(images)
        loss = supervised_contrastive(vectors, batch["identity"], self.temperature)
        self.log("train/loss", loss, on_step=False, on_epoch=True, batch_size=len(images))
        return loss

    def validation_step(self, batch: Mapping[str, Tensor], batch_idx: int) -> None:
        vectors = self.network(batch["images"])
        found = retrieval(vectors, batch["identity"], batch["camera"])
        cosine, same, _ = all_pairs(vectors, batch["identity"])
        with torch.enable_grad():
            self.calibrator.fit(cosine, same)
        found |= {"cllr": calibration_metrics(self.calibrator.log_ratio(cosine), same)["cllr"]}
        self.log_dict({f"val/{key}": value for key, value in found.items()}, batch_size=1)

    def test_step(self, batch: Mapping[str, Tensor], batch_idx: int) -> None:
        """Retrieval across cameras, and clusters with and without MIXER, into ``test/``."""
        vectors = self.network(batch["images"])
        found: dict[str, Any] = retrieval(vectors, batch["identity"], batch["camera"])
        cosine, same, pairs = all_pairs(vectors, batch["identity"])
        ratio = self.calibrator.log_ratio(cosine).detach()
        found["calibration"] = calibration_metrics(ratio, same)
        view = torch.full_like(batch["identity"], -1)
        affinity = Affinity(pairs, torch.sigmoid(ratio)[None], view, ("Embedding",))
        for name, solver in (("mixer", None), ("threshold", AllPairs())):
            metrics = evaluate(solve(affinity, solver), batch["identity"], view)
            found[name] = {key: metrics[key] for key in ("precision", "recall", "f1")}
        folder = Path(self.trainer.default_root_dir) / "test"
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "metrics.json", found)
        self.log_dict({f"test/{key}": found[key] for key in ("rank1", "map")}, batch_size=1)
        self.log("test/f1", found["mixer"]["f1"], batch_size=1)

    def configure_optimizers(self) -> Any:
        parameters = self.network.parameters()
        optimiser = torch.optim.AdamW(parameters, lr=self.learning_rate, weight_decay=1e-2)
        epochs = max(self.trainer.max_epochs or 1, 1)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs)
        return {"optimizer": optimiser, "lr_scheduler": schedule}

    def export(self, folder: Path, scorers: Sequence[Mapping[str, Any]]) -> list[Path]:
        """Write the network, its calibrator, and ``scorers.yaml`` for ``mixer associate``."""
        folder.mkdir(parents=True, exist_ok=True)
        network, calibrator = (folder / f"{n}.safetensors" for n in ("embedding", "calibrator"))
        height, width = self.trainer.datamodule.size  # type: ignore[attr-defined]
        arguments: dict[str, Any] = {"path": str(network), "height": height, "width": width}
        scorer = {"class_path": "scorers.embedding.Embedding", "init_args": arguments}
        save_embedding(network, self.network)
        save_calibrator(calibrator, self.calibrator, scorer)
        fitted = {"class_path": "scorers.fitted.Fitted", "init_args": {"path": str(calibrator)}}
        block = {**scorer, "init_args": {**arguments, "calibrator": fitted}}
        listing = folder / "scorers.yaml"
        listing.write_text(yaml.safe_dump({"scorers": [block]}, sort_keys=False), encoding="utf-8")
        return [network, calibrator, listing]


def augmentation() -> nn.Module:
    """Mirrored, shifted, recoloured, partly erased."""
    from kornia import augmentation as ka

    return nn.Sequential(
        ka.RandomHorizontalFlip(p=0.5),
        ka.RandomAffine(degrees=5.0, translate=(0.08, 0.06), scale=(0.9, 1.1), p=0.8),
        ka.ColorJiggle(0.3, 0.3, 0.3, 0.05, p=0.8),
        ka.RandomErasing(scale=(0.02, 0.2), p=0.5),
    )


def supervised_contrastive(
    vectors: Float[Tensor, "B d"], identity: Int64[Tensor, " B"], temperature: float
) -> Float[Tensor, ""]:
    """Supervised contrastive loss (Khosla et al. 2020) of unit vectors.

    Mean over crops, and over the others of the same identity, of -log of the share that the other
    has in Σ exp(cosine / temperature) over all crops but the one itself. The nearest strangers
    weigh most in it. 0 where nobody is there twice.
    """
    logit = vectors @ vectors.T / temperature
    self_pair = torch.eye(len(vectors), dtype=torch.bool, device=vectors.device)
    share = logit - logit.masked_fill(self_pair, -torch.inf).logsumexp(1, keepdim=True)
    same = (identity[:, None] == identity) & ~self_pair
    count = same.sum(1)
    loss = -share.where(same, share.new_zeros(())).sum(1) / count.clamp(min=1)
    return loss[count > 0].mean() if bool((count > 0).any()) else 0 * logit.sum()


def retrieval(
    vectors: Float[Tensor, "m d"], identity: Int64[Tensor, " m"], camera: Int64[Tensor, " m"]
) -> dict[str, float]:
    """Cross-camera ``rank1`` and ``map``: each crop asks for its person in the other cameras."""
    cosine = vectors @ vectors.T
    other = camera[:, None] != camera
    if not bool(other.any()):
        other = ~torch.eye(len(vectors), dtype=torch.bool, device=vectors.device)
    order = cosine.masked_fill(~other, -torch.inf).argsort(1, descending=True)
    hit = (identity[:, None] == identity).gather(1, order) & other.gather(1, order)
    return mean_precision(hit)


def mean_precision(hit: Bool[Tensor, "q m"]) -> dict[str, float]:
    """Rank-1 and mean average precision of ranked hits; queries without any hit are left out."""
    hit = hit[hit.any(1)]
    rank = torch.arange(1, hit.shape[1] + 1, device=hit.device)
    precision = hit.cumsum(1) / rank
    average = (precision * hit).sum(1) / hit.sum(1)
    return {"rank1": float(hit[:, 0].double().mean()), "map": float(average.mean())}


def all_pairs(
    vectors: Float[Tensor, "m d"], identity: Int64[Tensor, " m"]
) -> tuple[Float[Tensor, " P"], Bool[Tensor, " P"], Int64[Tensor, "2 P"]]:
    """Cosine, truth, and indices of all pairs."""
    m = len(vectors)
    pairs = torch.triu_indices(m, m, offset=1, device=vectors.device)
    cosine = (vectors[pairs[0]] * vectors[pairs[1]]).sum(1)
    return cosine, identity[pairs[0]] == identity[pairs[1]], pairs

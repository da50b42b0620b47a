"""Training of the appearance embedding, by metric learning and classification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int64
from lightning import LightningModule
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from mixer_torch.affinity import Affinity
from mixer_torch.extras import require
from mixer_torch.fusion import LogOddsFusion
from mixer_torch.io.files import write_json
from mixer_torch.metrics.calibration import calibration_metrics
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.metrics.retrieval import retrieval
from mixer_torch.observations import Observations
from mixer_torch.pairs import Every
from mixer_torch.scorers.calibrators import MonotoneSpline, save_calibrator
from mixer_torch.scorers.embedding import Embedding, EmbeddingNetwork, embed, save_embedding
from mixer_torch.solvers.base import solve
from mixer_torch.solvers.threshold import AllPairs
from mixer_torch.train.listing import block, with_calibrator, write_listing

LABEL_SMOOTHING = 0.1
"""Of the cross entropy, as in Luo et al. 2019."""
WARM_UP = 0.05
"""Share of the epochs in which the learning rate rises; a convention."""
PRIORS = (0.5, 0.4, 0.3, 0.25, 0.2, 0.15, 0.1)
"""Candidates for the prior of the fusion, from indifferent to cautious."""
CLOSE = 0.02
"""F1 that a lower, more cautious prior may cost: about the spread of F1 between trainings."""
CAP = 12.0
"""Of the fusion, nats: beyond all that the calibrator claims, which has bounds of its own."""
CHANNEL_ORDERS = tuple(permutations(range(3)))
"""Permutations of red, green and blue, the identity first."""


class EmbeddingTraining(LightningModule):
    """An :class:`~mixer_torch.scorers.embedding.EmbeddingNetwork` from crops with identities.

    The loss is the supervised contrastive one (Khosla et al. 2020) plus the cross entropy of
    classifying the persons of training, by a linear classifier behind a batch normalisation
    (Luo et al. 2019), with label smoothing. As persons are few, permuting the colour channels of
    all crops of a person (red for green, say) makes another person.

    The calibrator and the prior of the fusion are fitted to the pairs of validation, whose persons
    training has not seen, as a network is overconfident about persons that it has seen. The prior
    is needed because the errors of the pairs of two persons are correlated: persons who look alike
    do so in all crops. It is the one whose clusters have the best F1.

    Args:
        dimension: Of the vectors.
        width: Channels of the first block.
        strips: Horizontal strips in which features are pooled.
        learning_rate: Largest of AdamW: linear warm-up, then cosine decay to 0.
        temperature: Of the contrastive loss: lower gives the hardest negatives more weight.
        classification: Weight of the cross entropy.
        recoloured: Share of the persons of a batch whose channels are permuted.
        centre: Of the :class:`~mixer_torch.scorers.embedding.Embedding` that is exported.
        reciprocal: Of the same.
        seed: Of the weights at the start and of the augmentations.

    Raises:
        ValueError: learning_rate or temperature is not positive, classification is negative, or
            recoloured not in [0, 1].
    """

    prior: Tensor

    def __init__(
        self,
        dimension: int = 128,
        width: int = 24,
        strips: int = 8,
        learning_rate: float = 2e-3,
        temperature: float = 0.1,
        classification: float = 0.5,
        recoloured: float = 0.5,
        centre: bool = True,
        reciprocal: int = 16,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if not (learning_rate > 0 and temperature > 0 and classification >= 0):
            raise ValueError(
                "learning_rate, temperature, classification: expected positive numbers, the last "
                f"may be 0, got {learning_rate}, {temperature}, {classification}"
            )
        if not 0 <= recoloured <= 1:
            raise ValueError(f"recoloured: expected a share in [0, 1], got {recoloured}")
        losses = require("pytorch_metric_learning.losses", extra="train")
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = EmbeddingNetwork(dimension, width, strips)
        self.neck = nn.BatchNorm1d(dimension, affine=False)
        self.classifier: nn.Linear | None = None
        self.calibrator = MonotoneSpline(direction="increasing")
        self.register_buffer("prior", torch.tensor(0.5, dtype=torch.float64))
        self.learning_rate = learning_rate
        self.classification = classification
        self.recoloured = recoloured
        self.comparison: dict[str, Any] = {"centre": centre, "reciprocal": reciprocal}
        self._scorer = [Embedding(**self.comparison)]
        self.seed = seed
        self._contrast = losses.SupConLoss(temperature)
        self._augment = [augmentation()]

    def setup(self, stage: str) -> None:
        """Make the classifier, whose size depends on the number of persons of training."""
        if self.classifier is None:
            count = len(self.trainer.datamodule.people)  # type: ignore[attr-defined]
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(self.seed)
                classes = len(CHANNEL_ORDERS) * count
                self.classifier = nn.Linear(self.neck.num_features, classes, bias=False)

    def training_step(self, batch: Mapping[str, Tensor], batch_idx: int) -> Tensor:
        people = self.trainer.datamodule.people  # type: ignore[attr-defined]
        number = torch.searchsorted(people.to(self.device), batch["identity"])
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed((self.seed * 1_000 + self.current_epoch) * 10_000 + batch_idx)
            images, number = permute_channels(batch["images"], number, self.recoloured)
            images = self._augment[0](images)
        vectors = self.network(images)
        loss = self._contrast(vectors, number)
        if self.classification and self.classifier is not None:
            logit = self.classifier(self.neck(vectors))
            entropy = cross_entropy(logit, number, label_smoothing=LABEL_SMOOTHING)
            loss = loss + self.classification * entropy
        self.log("train/loss", loss, on_step=False, on_epoch=True, batch_size=len(images))
        return loss

    def _compared(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Evidence (P,), truth (P,) and indices (2, P) of all pairs, as the exported scorer has."""
        vectors = embed(self.network, batch["images"], mirror=True, device=self.device)
        view = torch.full_like(batch["identity"], -1)
        features = {"embedding": vectors, "camera": batch["camera"]}
        seen = Observations(view, features)
        pairs = Every()(seen)
        same = batch["identity"][pairs[0]] == batch["identity"][pairs[1]]
        return self._scorer[0].evidence(seen, pairs), same, pairs

    def validation_step(self, batch: Mapping[str, Tensor], batch_idx: int) -> None:
        evidence, same, pairs = self._compared(batch)
        found = ranked(evidence, pairs, batch)
        with torch.enable_grad():
            self.calibrator.fit(evidence, same)
        ratio = self.calibrator.log_ratio(evidence).detach()
        affinity = gallery(ratio, pairs, len(batch["identity"]))
        self.prior.fill_(best_prior(affinity, batch["identity"]))
        found |= {"cllr": calibration_metrics(ratio, same)["cllr"], "prior": float(self.prior)}
        logged = {f"val/{key}": found[key] for key in ("rank1", "map", "cllr", "prior")}
        self.log_dict(logged, batch_size=1)

    def test_step(self, batch: Mapping[str, Tensor], batch_idx: int) -> None:
        """Retrieval across cameras, and clusters with and without MIXER, into ``test/``."""
        evidence, same, pairs = self._compared(batch)
        found: dict[str, Any] = ranked(evidence, pairs, batch)
        ratio = self.calibrator.log_ratio(evidence).detach()
        found["calibration"] = calibration_metrics(ratio, same)
        affinity = gallery(ratio, pairs, len(batch["identity"]))
        for name, solver, fusion in (
            ("mixer", None, self.fusion()),
            ("threshold", AllPairs(), None),
        ):
            association = solve(affinity, solver, fusion)
            metrics = evaluate(association, batch["identity"], affinity.view)
            found[name] = {key: metrics[key] for key in ("precision", "recall", "f1")}
        folder = Path(self.trainer.default_root_dir) / "test"
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "metrics.json", found)
        self.log_dict({f"test/{key}": found[key] for key in ("rank1", "map")}, batch_size=1)
        self.log("test/f1", found["mixer"]["f1"], batch_size=1)

    def fusion(self) -> LogOddsFusion:
        """What was learned of the fusion."""
        return LogOddsFusion(cap=CAP, prior=round(float(self.prior), 6))

    def configure_optimizers(self) -> Any:
        parameters = [*self.network.parameters()]
        parameters += self.classifier.parameters() if self.classifier is not None else []
        optimiser = torch.optim.AdamW(parameters, lr=self.learning_rate, weight_decay=1e-2)
        epochs = max(self.trainer.max_epochs or 1, 1)
        rising = max(round(WARM_UP * epochs), 1)
        schedule = torch.optim.lr_scheduler.SequentialLR(
            optimiser,
            [
                torch.optim.lr_scheduler.LinearLR(optimiser, 1 / (rising + 1), 1.0, rising),
                torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(epochs - rising, 1)),
            ],
            [rising],
        )
        return {"optimizer": optimiser, "lr_scheduler": schedule}

    def export(self, folder: Path, scorers: Sequence[Mapping[str, Any]]) -> list[Path]:
        """Write the network, its calibrator, and ``scorers.yaml`` for ``mixer associate``."""
        folder.mkdir(parents=True, exist_ok=True)
        network, calibrator = (folder / f"{n}.safetensors" for n in ("embedding", "calibrator"))
        height, width = self.trainer.datamodule.size  # type: ignore[attr-defined]
        sizes = {"height": height, "width": width}
        scorer = block(
            "mixer_torch.scorers.Embedding",
            path=str(network),
            **sizes,
            mirror=True,
            **self.comparison,
        )
        save_embedding(network, self.network)
        save_calibrator(calibrator, self.calibrator, scorer)
        scorers = [with_calibrator(scorer, calibrator)]
        listing = write_listing(folder / "scorers.yaml", scorers, self.fusion())
        return [network, calibrator, listing]


def augmentation() -> nn.Module:
    """Mirroring, affine shifts, changes of light and colour, random erasing.

    The ranges are conventions of re-identification, kept to what a fixed camera sees.
    """
    ka = require("kornia.augmentation", extra="vision")

    return nn.Sequential(
        ka.RandomHorizontalFlip(p=0.5),
        ka.RandomAffine(
            5.0, translate=(0.08, 0.05), scale=(0.9, 1.1), padding_mode="border", p=0.9
        ),
        ka.RandomGamma((0.65, 1.5), (0.85, 1.15), p=0.8),
        ka.RandomSaturation((0.6, 1.4), p=0.8),
        ka.RandomRGBShift(0.1, 0.1, 0.1, p=0.8),
        ka.RandomErasing(scale=(0.02, 0.2), p=0.5),
    )


def permute_channels(
    images: Float[Tensor, "B 3 height width"], number: Int64[Tensor, " B"], share: float
) -> tuple[Float[Tensor, "B 3 height width"], Int64[Tensor, " B"]]:
    """Permute the channels of a share of the persons, in all crops of a person alike.

    The k-th of :data:`CHANNEL_ORDERS` makes person n the person 6 n + k.
    """
    people, place = torch.unique(number, return_inverse=True)
    kind = torch.randint(1, len(CHANNEL_ORDERS), people.shape)
    kind = torch.where(torch.rand(people.shape) < share, kind, 0).to(number.device)[place]
    order = torch.tensor(CHANNEL_ORDERS, device=number.device)[kind]
    exchanged = images.gather(1, order[:, :, None, None].expand_as(images))
    return exchanged, len(CHANNEL_ORDERS) * number + kind


def ranked(
    evidence: Float[Tensor, " P"], pairs: Int64[Tensor, "2 P"], batch: Mapping[str, Tensor]
) -> dict[str, Any]:
    """Retrieval across cameras by the evidence of all pairs."""
    count = len(batch["identity"])
    similarity = evidence.new_zeros(count, count)
    similarity[pairs[0], pairs[1]] = similarity[pairs[1], pairs[0]] = evidence
    return dict(retrieval(similarity, batch["identity"], batch["camera"]))


def gallery(ratio: Float[Tensor, " P"], pairs: Int64[Tensor, "2 P"], count: int) -> Affinity:
    """The affinity of crops without views, any two of which may show one person."""
    view = torch.full((count,), -1, device=ratio.device)
    return Affinity(pairs, torch.sigmoid(ratio.float())[None], view, ("Embedding",))


def best_prior(affinity: Affinity, identity: Int64[Tensor, " m"]) -> float:
    """The prior whose clusters have the best F1; the lowest one that is close to it."""
    found = {}
    for prior in PRIORS:
        association = solve(affinity, None, LogOddsFusion(cap=CAP, prior=prior))
        found[prior] = evaluate(association, identity, affinity.view)["f1"]
    best = max(found.values())
    return min(prior for prior, f1 in found.items() if f1 >= best - CLOSE)

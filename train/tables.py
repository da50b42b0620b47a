"""Labelled pairs: raw evidence of every modality and covariates, kept on disk once computed."""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from mixer_torch.datasets.base import Dataset
from mixer_torch.observations import Observations, load_npz, save_npz
from mixer_torch.pairs import PairSelector
from mixer_torch.scorers.covariates import COVARIATES, Covariates
from mixer_torch.scoring import NOTHING_TO_SAY, Scorer, unique_names

FORMAT = "mixer-torch evidence 1"


@dataclass(frozen=True)
class PairTable:
    """The pairs of one sequence.

    Args:
        observations: What was seen.
        pairs: (2, P).
        evidence: (l, P) raw evidence of each modality, NaN where it has none.
        covariates: (P,) raw values by name, of those that the observations allow.
        same: (P,) whether a pair shows one object; clutter matches nothing.
        known: (l, P) whether a modality has evidence; where it is finite if None.
    """

    observations: Observations
    pairs: Tensor
    evidence: Tensor
    covariates: Mapping[str, Tensor]
    same: Tensor
    known: Tensor = field(default=None)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.known is None:
            object.__setattr__(self, "known", self.evidence.isfinite())

    def __len__(self) -> int:
        return self.pairs.shape[1]

    def select(self, index: Tensor) -> PairTable:
        """Some of the pairs."""
        return replace(
            self,
            pairs=self.pairs[:, index],
            evidence=self.evidence[:, index],
            covariates={name: value[index] for name, value in self.covariates.items()},
            same=self.same[index],
            known=self.known[:, index],
        )

    def of_identities(self, chosen: Tensor) -> PairTable:
        """The pairs between observations that are chosen, (m,) bool."""
        return self.select(chosen[self.pairs].all(0).nonzero()[:, 0])

    def covariates_of(self, names: Sequence[str]) -> Tensor:
        """(P, c) raw values of covariates by name."""
        return stack_covariates(self.covariates, names, len(self))


def stack_covariates(values: Mapping[str, Tensor], names: Sequence[str], count: int) -> Tensor:
    """(P, c) of values by name.

    Raises:
        KeyError: The observations lack the feature that a covariate is made of.
    """
    for name in names:
        if name not in values:
            raise KeyError(
                f"covariate {name!r} needs the feature {COVARIATES[name][0]!r}, which not all "
                "observations have"
            )
    columns = [values[name] for name in names]
    return torch.stack(columns, 1) if columns else torch.zeros(count, 0, dtype=torch.float64)


def pair_table(
    dataset: Dataset,
    scorers: Sequence[Scorer],
    selector: PairSelector,
    cache: Path | None = None,
) -> PairTable:
    """Compare the pairs of a dataset in every modality, or read evidence that was kept.

    A modality has no evidence in a sequence that lacks a feature which it needs.

    Args:
        dataset: Observations with identities.
        scorers: One for each modality; their calibrators are not used.
        selector: Which pairs.
        cache: Folder in which evidence is kept, by a hash of its inputs; none if None.

    Raises:
        KeyError: There are no images, and a scorer needs them.
        ValueError: The observations have no identities.
    """
    seen = dataset.load()
    if "identity" not in seen.features:
        raise ValueError(f"{type(dataset).__name__}: training needs the feature 'identity'")
    pairs = selector(seen)
    rows = [_evidence(dataset, scorer, seen, pairs, cache) for scorer in scorers]
    identity = seen["identity"]
    same = (identity[pairs[0]] == identity[pairs[1]]) & (identity[pairs[0]] >= 0)
    known = Covariates([n for n, (needed, _) in COVARIATES.items() if needed in seen.features])
    values = known.of(known.describe(seen), pairs)
    covariates = {name: values[:, k] for k, name in enumerate(known.names)}
    return PairTable(seen, pairs, torch.stack(rows), covariates, same)


def calibrated(scorers: Sequence[Scorer], table: PairTable) -> Tensor:
    """Scores (l, P) by the calibrators that the scorers have, 0.5 where there is no evidence."""
    rows = []
    with torch.no_grad():
        for scorer, evidence in zip(scorers, table.evidence, strict=True):
            known = evidence.isfinite()
            context = scorer.calibrator.describe(table.observations)
            score = scorer.calibrator.calibrate(evidence.nan_to_num(), context, table.pairs)
            rows.append(score.float().where(known, NOTHING_TO_SAY))
    return torch.stack(rows)


def modality_names(scorers: Sequence[Scorer]) -> tuple[str, ...]:
    """Names of the modalities, distinct as ``score`` makes them."""
    return unique_names([scorer.name for scorer in scorers])


def _evidence(
    dataset: Dataset, scorer: Scorer, seen: Observations, pairs: Tensor, cache: Path | None
) -> Tensor:
    if any(key not in seen.features and key != "images" for key in scorer.needs):
        return torch.full((pairs.shape[1],), torch.nan)
    path = None if cache is None else cache / f"{_fingerprint(dataset, scorer, seen, pairs)}.npz"
    if path is not None and path.is_file():
        return torch.from_numpy(load_npz(path, FORMAT)["evidence"])
    with torch.no_grad():
        evidence = scorer.evidence(seen, pairs).float().cpu()
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_npz(path, {"format": np.array(FORMAT), "evidence": evidence.numpy()})
    return evidence


def _fingerprint(dataset: Dataset, scorer: Scorer, seen: Observations, pairs: Tensor) -> str:
    """A name that changes with settings, with observations, and with the source of the scorer."""
    digest = hashlib.sha256()
    for part in (dataset, scorer):
        digest.update(f"{type(part).__module__}.{type(part).__qualname__}".encode())
        digest.update(json.dumps(_plain(vars(part)), sort_keys=True).encode())
        digest.update(Path(inspect.getfile(type(part))).read_bytes())
    for name in sorted(seen.features):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(seen[name].cpu().numpy()).tobytes())
    digest.update(np.ascontiguousarray(pairs.cpu().numpy()).tobytes())
    return f"{scorer.name}-{digest.hexdigest()[:24]}"


def _plain(settings: Mapping[str, Any]) -> dict[str, str]:
    kinds = (bool, int, float, str, Path, tuple, list, type(None))
    return {name: repr(value) for name, value in settings.items() if isinstance(value, kinds)}

"""Fitted calibrators in files: safetensors, with the settings that made them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from mixer_torch.io.files import atomic_write
from mixer_torch.observations import Observations
from mixer_torch.scorers import calibrators
from mixer_torch.scorers.likelihood_ratio import LikelihoodRatio
from mixer_torch.scoring import Calibrator

FORMAT = "mixer-torch calibrator 1"


class Fitted(Calibrator):
    """A calibrator that was fitted and saved: one line in a configuration.

        calibrator: {class_path: mixer_torch.scorers.fitted.Fitted, init_args: {path: SIFT.safetensors}}

    Args:
        path: What :func:`save_calibrator` or ``mixer-train fit`` wrote.

    Attributes:
        scorer: The scorer whose evidence it was fitted to, as ``class_path`` and ``init_args``;
            None where it was not said.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is something else.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__()
        self.path = Path(path)
        self.fitted, self.scorer = load_calibrator(path)
        self.needs = self.fitted.needs

    def forward(self, evidence: Tensor) -> Tensor:
        return self.fitted(evidence)

    def describe(self, observations: Observations) -> Any:
        return self.fitted.describe(observations)

    def calibrate(self, evidence: Tensor, circumstances: Any, pairs: Tensor) -> Tensor:
        return self.fitted.calibrate(evidence, circumstances, pairs)

    def extra_repr(self) -> str:
        return f"path={str(self.path)!r}"


def save_calibrator(
    path: str | Path, calibrator: LikelihoodRatio, scorer: Mapping[str, Any] | None = None
) -> None:
    """Write a safetensors file: the tensors, and as metadata the class and what it was given.

    Args:
        path: File to write, whole or not at all.
        calibrator: One of :mod:`mixer_torch.scorers.calibrators`, or of a class of yours.
        scorer: ``class_path`` and ``init_args`` of the scorer whose evidence it was fitted to.
    """
    kind = type(calibrator)
    settings = {
        "format": FORMAT,
        "class_path": f"{kind.__module__}.{kind.__qualname__}",
        "init_args": json.dumps(calibrator.settings),
        "scorer": json.dumps(None if scorer is None else dict(scorer)),
    }
    write_safetensors(path, calibrator, settings)


def write_safetensors(path: str | Path, module: nn.Module, settings: Mapping[str, str]) -> None:
    """Write the tensors of a module, and settings as metadata: whole or not at all."""
    from safetensors.torch import save

    state = module.state_dict()
    tensors = {name: value.detach().cpu().contiguous() for name, value in state.items()}
    with atomic_write(path) as partial:
        partial.write_bytes(save(tensors, dict(settings)))


def read_safetensors(path: str | Path, kind: str) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and settings of a file that says it is of a kind.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is not safetensors, or of another kind.
    """
    from safetensors import SafetensorError, safe_open

    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: not found")
    try:
        with safe_open(path, framework="pt") as file:
            found = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(f"{path} is not a readable safetensors file: {error}") from error
    if found.get("format") != kind:
        got = found.get("format", "of no known kind")
        raise ValueError(f"{path}: expected a file of kind {kind!r}, got {got!r}")
    return tensors, found


def load_calibrator(path: str | Path) -> tuple[LikelihoodRatio, dict[str, Any] | None]:
    """Read what :func:`save_calibrator` wrote: the calibrator, and the scorer's settings.

    Nothing that the file names is imported or run: its class must be in
    :mod:`mixer_torch.scorers.calibrators`, or be a subclass of ``LikelihoodRatio`` that is imported already.
    """
    tensors, found = read_safetensors(path, FORMAT)
    known = _known_classes()
    if found["class_path"] not in known:
        raise ValueError(
            f"{path}: no calibrator {found['class_path']!r} is imported; there are "
            f"{', '.join(sorted(known))}"
        )
    calibrator = known[found["class_path"]](**json.loads(found["init_args"]))
    try:
        calibrator.load_state_dict(tensors)
    except RuntimeError as error:
        raise ValueError(f"{path}: {error}") from error
    calibrator.requires_grad_(False)
    return calibrator, json.loads(found["scorer"])


def _known_classes() -> dict[str, type[LikelihoodRatio]]:
    known: dict[str, type[LikelihoodRatio]] = {}
    todo: list[Any] = [value for value in vars(calibrators).values() if isinstance(value, type)]
    todo += LikelihoodRatio.__subclasses__()
    while todo:
        kind = todo.pop()
        if issubclass(kind, LikelihoodRatio) and kind is not LikelihoodRatio:
            known[f"{kind.__module__}.{kind.__qualname__}"] = kind
            todo += kind.__subclasses__()
    return known


def log_ratio_of(score: Tensor) -> Tensor:
    """The log likelihood ratio that a score stands for, finite."""
    return torch.logit(score.double(), eps=1e-6)

"""What a training exports for ``mixer associate``: a YAML file of scorers and their fusion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from mixer_torch.fusion import Fusion, LogOddsFusion

Block = dict[str, Any]
"""``class_path`` and ``init_args`` of one object."""


def block(class_path: str, **arguments: Any) -> Block:
    """One object of a configuration."""
    return {"class_path": class_path, "init_args": arguments}


def with_calibrator(scorer: Mapping[str, Any], path: Path) -> Block:
    """The block of a scorer with the calibrator that was saved at a path."""
    arguments = dict(scorer.get("init_args", {}))
    arguments["calibrator"] = block("mixer_torch.scorers.Fitted", path=str(path))
    return block(scorer["class_path"], **arguments)


def fusion_block(fusion: Fusion) -> Block:
    """The block of a fusion."""
    arguments: dict[str, Any] = {}
    if isinstance(fusion, LogOddsFusion):
        arguments = {"weights": fusion.weights, "cap": fusion.cap, "prior": fusion.prior}
    return block(f"mixer_torch.{type(fusion).__name__}", **arguments)


def write_listing(path: Path, scorers: Sequence[Mapping[str, Any]], fusion: Fusion) -> Path:
    """Write what ``mixer associate --config`` takes; the path comes back."""
    settings = {"scorers": list(scorers), "fusion": fusion_block(fusion)}
    path.write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
    return path

"""Tensors of modules in safetensors files that say what they hold."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor, nn

from mixer_torch.io.files import atomic_write


def write_weights(
    path: str | Path, kind: str, module: nn.Module, settings: Mapping[str, str]
) -> None:
    """Write the tensors of a module, with its kind and settings as metadata: whole or not at all.

    Args:
        path: File to write.
        kind: What :func:`read_weights` has to be asked for, such as "mixer-torch embedding 2".
        module: Its parameters and buffers are written.
        settings: What else is needed to make such a module.
    """
    from safetensors.torch import save

    state = module.state_dict()
    tensors = {name: value.detach().cpu().contiguous() for name, value in state.items()}
    with atomic_write(path) as partial:
        partial.write_bytes(save(tensors, {"format": kind, **settings}))


def read_weights(path: str | Path, kind: str) -> tuple[dict[str, Tensor], dict[str, str]]:
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


def load_weights(path: str | Path, module: nn.Module, tensors: Mapping[str, Tensor]) -> None:
    """Put the tensors of a file into a module; ValueError, naming the file, if they do not fit."""
    try:
        module.load_state_dict(tensors)
    except RuntimeError as error:
        raise ValueError(f"{path}: {error}") from error

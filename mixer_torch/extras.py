"""Packages that only some users need, and what is said where one is missing."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def require(module: str, extra: str) -> Any:
    """Import a package that an extra of mixer-torch brings.

    Call it where the package is used, not at the top of a file, so that all the rest works without:

        cv2 = require("cv2", extra="vision")

    Args:
        module: Dotted path of the module, such as ``"matplotlib.figure"``.
        extra: The extra that installs it: vision, train, plots, exact, tracking or all.

    Returns:
        The module.

    Raises:
        ImportError: It is not installed. The message names the extra. A package that is installed
            but fails to import something else raises its own error.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or module.split(".")[0] != error.name.split(".")[0]:
            raise
        raise ModuleNotFoundError(missing(module, extra), name=error.name) from error


def missing(module: str, extra: str) -> str:
    """The message for a package that is not installed."""
    package = module.split(".")[0]
    return f'this needs the package {package}: pip install "mixer-torch[{extra}]"'

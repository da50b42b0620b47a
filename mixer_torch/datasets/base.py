"""What a dataset is: a place that observations come from."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from pathlib import Path

from mixer_torch.observations import Observations


class Dataset(ABC):
    """A format. Its constructor takes a local path and what to read; :meth:`load` reads it."""

    @abstractmethod
    def load(self) -> Observations:
        """Read the observations; pixels stay on disk until they are asked for.

        Raises:
            FileNotFoundError: A file or folder is missing; the message names it.
            ValueError: A file is malformed; the message names the file and the line.
        """


def find(path: str | Path) -> Path:
    """A path as it stands, or, if relative and not there, inside the folder ``$MIXER_DATA``.

    Raises:
        FileNotFoundError: It is in neither place.
    """
    path = Path(path).expanduser()
    root = os.environ.get("MIXER_DATA")
    places = [path] if root is None or path.is_absolute() else [path, Path(root) / path]
    for place in places:
        if place.exists():
            return place
    hint = "" if root or path.is_absolute() else " (and MIXER_DATA, where else to look, is not set)"
    raise FileNotFoundError(f"{' and '.join(map(str, places))}: not found{hint}")


def check_file(path: Path, what: str = "") -> None:
    """That it is a file, which ``what`` says the use of.

    Raises:
        FileNotFoundError: There is no such file.
        IsADirectoryError: It is a folder.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{what}{path} is a folder, expected a file")
    if not path.is_file():
        raise FileNotFoundError(f"{what}{path} does not exist")

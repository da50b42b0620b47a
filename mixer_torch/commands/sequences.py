"""Tracks of sequences beside their truth: which file belongs to which, and the metrics."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mixer_torch.commands.text import table
from mixer_torch.datasets.base import Dataset
from mixer_torch.datasets.motchallenge import MOTChallenge
from mixer_torch.io.files import find
from mixer_torch.io.motchallenge import read_seqinfo
from mixer_torch.io.tracks import READERS, read_mot_truth, read_tracks
from mixer_torch.metrics.tracking import evaluate_sequences
from mixer_torch.tracks import Tracks

TRUTH_FILE = Path("gt", "gt.txt")
OWN_FILE = "tracks.txt"
"""The file of tracks in a folder that ``mixer associate`` wrote."""
COLUMNS = {
    "HOTA": "HOTA",
    "AssA": "AssA",
    "DetA": "DetA",
    "IDF1": "IDF1",
    "MOTA": "MOTA",
    "IDSW": "ID switches",
    "FP": "FP",
    "FN": "FN",
    "pairwise_f1": "pairwise F1",
    "bcubed_f1": "B-cubed F1",
}
"""The metrics in the table, and the titles of their columns."""


@dataclass(frozen=True)
class Truth:
    """The truth of one sequence.

    Args:
        tracks: The true tracks.
        cleaned: Takes a result, and leaves out the boxes that do not count (distractors).
        length: Number of frames of the sequence; None where it is not known.
    """

    tracks: Tracks
    cleaned: Callable[[Tracks], Tracks] = lambda result: result
    length: int | None = None


def measure_tracks(
    result: Path,
    truth: Path | None,
    dataset: Dataset | None,
    classes: Sequence[int] = (1,),
    min_overlap: float = 0.5,
) -> dict[str, Any]:
    """The metrics of result files, as :func:`evaluate_sequences` returns them.

    Args:
        result: A file of tracks, or a folder of such files.
        truth: The folder of a sequence, a folder of such folders, or a file of true tracks.
        dataset: Source of the truth if ``truth`` is None.
        classes: Classes that are to be found, where the truth has classes.
        min_overlap: Least intersection over union at which a box matches a true one.

    Raises:
        FileNotFoundError: A result or a truth is missing; the message names it.
        ValueError: A result has no truth, a file is malformed, or there is no truth at all.
    """
    if truth is not None:
        sources = _sources(find(truth))
        files = _files(result, list(sources), _is_folder_of_sequences(find(truth)))
        truths = {name: _read(sources[name], classes) for name in files}
    elif dataset is not None:
        name = dataset.folder.resolve().name if isinstance(dataset, MOTChallenge) else "dataset"
        files = _files(result, [name], False)
        truths = {name: _of_dataset(dataset)}
    else:
        raise ValueError(
            f"truth: expected --truth, or a dataset, to measure the tracks in {result}"
        )
    results = {}
    for name, file in files.items():
        tracks = read_tracks(file)
        _check_frames(file, tracks, truths[name].length)
        results[name] = truths[name].cleaned(tracks)
    return evaluate_sequences(
        results, {name: known.tracks for name, known in truths.items()}, min_overlap
    )


def tracks_table(metrics: Mapping[str, Any]) -> str:
    """A row for each sequence and, where there are several, one for all of them together."""
    rows = dict(metrics["sequences"])
    if len(rows) > 1:
        rows["combined"] = metrics["combined"]
    cells = [[name, *(_cell(row[key]) for key in COLUMNS)] for name, row in rows.items()]
    note = "in percent; pairwise and B-cubed over the boxes that are matched to the truth"
    return "\n".join([table(cells, ["sequence", *COLUMNS.values()]), "", note])


def _cell(value: float) -> str:
    """Counts as they are, percentages with one digit."""
    return f"{value:,d}" if isinstance(value, int) else f"{value:.1f}"


def _is_folder_of_sequences(path: Path) -> bool:
    return path.is_dir() and not (path / TRUTH_FILE).is_file()


def _is_of_sequence(file: Path) -> bool:
    return file.parts[-2:] == TRUTH_FILE.parts


def _sources(path: Path) -> dict[str, Path]:
    """The file of the truth of each sequence, by its name."""
    path = Path(os.path.abspath(path))
    if path.is_file():
        return {path.parent.parent.name if _is_of_sequence(path) else path.stem: path}
    if not _is_folder_of_sequences(path):
        return {path.name: path / TRUTH_FILE}
    sources = {file.parent.parent.name: file for file in sorted(path.glob(f"*/{TRUTH_FILE}"))}
    if not sources:
        raise FileNotFoundError(
            f"truth: expected {path / TRUTH_FILE}, or sequences inside of {path} that have one"
        )
    return sources


def _read(source: Path, classes: Sequence[int]) -> Truth:
    if source.suffix != ".txt":
        return Truth(read_tracks(source))
    truth = read_mot_truth(source, classes)
    length = None
    if _is_of_sequence(source):
        length = read_seqinfo(source.parent.parent / "seqinfo.ini", frame_rate=1.0).length
    return Truth(truth.tracks, truth.without_distractors, length)


def _of_dataset(dataset: Dataset) -> Truth:
    """The true boxes of a sequence; of a dataset that is none, observations with an identity.

    Of a sequence the frames that the dataset chooses count, and no others.
    """
    if isinstance(dataset, MOTChallenge):
        truth = read_mot_truth(dataset.folder / TRUTH_FILE, dataset.classes)

        def chosen(tracks: Tracks) -> Tracks:
            return tracks.select(dataset.chosen(tracks.frame))

        return Truth(chosen(truth.tracks), lambda result: truth.without_distractors(chosen(result)))
    observations = dataset.load()
    if "identity" not in observations.features:
        raise ValueError("dataset: expected known identities (a feature 'identity'), got none")
    return Truth(Tracks.from_labels(observations, observations["identity"]))


def _files(result: Path, names: Sequence[str], several: bool) -> dict[str, Path]:
    """The result of each sequence."""
    if result.is_file():
        if not several:
            return {names[0]: result}
        if result.stem not in names:
            raise ValueError(
                f"truth: no sequence is called {result.stem}, as {result} is; there is "
                f"{', '.join(names)}; name the one that it is of"
            )
        return {result.stem: result}
    if not several:
        return {names[0]: _file_of(result, names[0])}
    return _files_of_all(result, names)


def _file_of(folder: Path, name: str) -> Path:
    """The result of one sequence in a folder that may have those of others."""
    places = [folder / f"{name}{suffix}" for suffix in READERS]
    found = [place for place in [*places, folder / OWN_FILE] if place.is_file()]
    if not found:
        raise FileNotFoundError(f"result: expected {places[0]} or {folder / OWN_FILE}")
    return found[0]


def _files_of_all(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """The results of all sequences in a folder that has these and no others."""
    files = {
        suffix: {file.stem: file for file in sorted(folder.glob(f"*{suffix}"))}
        for suffix in READERS
    }
    suffix = max(files, key=lambda suffix: len(files[suffix].keys() & set(names)))
    found = files[suffix]
    if missing := [name for name in names if name not in found]:
        raise FileNotFoundError(
            f"result: {folder} has no {', '.join(name + suffix for name in missing)}, of which "
            "there is truth"
        )
    if extra := [file.name for name, file in found.items() if name not in names]:
        raise ValueError(f"truth: there is none of {', '.join(extra)} in {folder}")
    return {name: found[name] for name in names}


def _check_frames(file: Path, tracks: Tracks, length: int | None) -> None:
    if length is None:
        return
    outside = (tracks.frame < 1) | (tracks.frame > length)
    if outside.any():
        frame = tracks.frame[np.argmax(outside)]
        raise ValueError(
            f"{file}: expected frames 1 to {length}, as seqinfo.ini of the truth says, got {frame}"
        )

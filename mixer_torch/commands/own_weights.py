"""`mixer track --train`: weights of one's own, and what they gain on sequences held out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mixer_torch.commands.jobs import FRAME_RATE, TEXT, Options
from mixer_torch.commands.text import listing, table
from mixer_torch.datasets.motchallenge import MOTChallenge
from mixer_torch.io.files import atomic_write, check_folder
from mixer_torch.io.tracks import read_mot_truth
from mixer_torch.scoring import Progress
from mixer_torch.tracking.own import LEAST_OVERLAP, METRICS, Labelled, learn, mean_gain

BETTER = "use them: Tracker(weights={file!r})"
NOT_BETTER = "they are not better in both, so the shipped ones are the safer choice"


def own_weights(
    sources: Mapping[str, Path],
    classes: Sequence[int],
    options: Options,
    file: Path,
    progress: Progress,
) -> str:
    """Learn weights, write them, and tell what they gain.

    Args:
        sources: Sequences with truth, by name.
        classes: Classes to find.
        options: How to read them; pixels are not looked at.
        file: To be written.
        progress: Told what is done.

    Raises:
        FileNotFoundError: A sequence has no truth.
        ValueError: The file has another ending, or nothing can be learned.
    """
    if file.suffix != ".safetensors":
        raise ValueError(f"train: expected the name of a .safetensors file, got {file}")
    check_folder(file.parent)
    labelled = {name: _labelled(path, classes, options) for name, path in sources.items()}
    weights, gains = learn(labelled, progress=progress)
    file.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(file) as partial:
        weights.save(partial)
    rows = [
        [one.sequence, one.metric, f"{one.shipped:.1f}", f"{one.own:.1f}", f"{one.gain:+.1f}"]
        for one in gains
    ]
    means = {metric: mean_gain(gains, metric) for metric in METRICS}
    better = all(gain > 0 for gain in means.values())
    lines = [
        table(rows, ["sequence held out", "metric", "shipped", "own", "gain"]),
        "",
        "mean gain on sequences held out: "
        + ", ".join(f"{gain:+.1f} {metric}" for metric, gain in means.items()),
        "own weights: " + (BETTER.format(file=str(file)) if better else NOT_BETTER),
    ]
    return "\n".join([*lines, *listing(file.parent, [file.name])])


def _labelled(path: Path, classes: Sequence[int], options: Options) -> Labelled:
    """A sequence in the layout of MOTChallenge, and its truth in the frames chosen."""
    if path.is_file() and path.suffix.lower() not in TEXT:
        raise ValueError(f"train: expected sequences with gt/gt.txt beside them, got {path}")
    given = options.only(*vars(options)) | {
        "pixels": False,
        "frame_rate": options.frame_rate or FRAME_RATE,
    }
    dataset = MOTChallenge(path, classes=classes, min_overlap=LEAST_OVERLAP, **given)
    truth = read_mot_truth(dataset.folder / "gt" / "gt.txt", classes)
    counted = truth.tracks.select(dataset.chosen(truth.tracks.frame))
    return Labelled(dataset.read()[0], replace(truth, tracks=counted))

"""Files for commands to read, and what they say of those that they wrote."""

import csv
from pathlib import Path

import cv2
import numpy as np
import yaml

OWN_SCORERS = '''
import torch
from mixer_torch import Calibrator, Scorer

class Depth(Scorer):
    """Alike in depth.

    Args:
        scale: Metres.
    """

    needs = ("depth",)

    def __init__(self, scale: float = 1.0) -> None:
        super().__init__()
        self.scale = scale

    def compare(self, description, pairs):
        return torch.exp(-(description[pairs[0]] - description[pairs[1]]).abs() / self.scale)

class Silent(Scorer):
    """Never has anything to say."""

    needs = ("depth",)

    def compare(self, description, pairs):
        return description[pairs[0]] * torch.nan

class Shouting(Depth):
    """Out of range."""

    def compare(self, description, pairs):
        return 1 + super().compare(description, pairs)

class Broken(Calibrator):
    """Gives NaN."""

    def forward(self, evidence):
        return evidence * torch.nan

class Undefined(Depth):
    """NaN after calibration."""

    def __init__(self) -> None:
        super().__init__()
        self.calibrator = Broken()
'''


def write_table(path="seen.csv", rows=None):
    """Three objects at depths 10, 20, 30, seen in three frames; or the rows given."""
    if rows is None:
        rows = [(f, k, 10 * (k + 1) + 0.1 * f) for f in range(3) for k in range(3)]
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("frame", "identity", "depth"))
        writer.writerows(rows)


def one(class_path, **init_args):
    """A class_path block."""
    return {"class_path": class_path, "init_args": init_args}


def write_config(path="config.yaml", scorers=("own_scorers.Depth",), **other):
    Path("own_scorers.py").write_text(OWN_SCORERS)
    config = {
        "dataset": one("mixer_torch.datasets.Table", path="seen.csv"),
        "scorers": [one(scorer) for scorer in scorers],
        **other,
    }
    Path(path).write_text(yaml.safe_dump(config))
    return path


def write_sequence(folder, detections, size=(64, 48), frames=3):
    """A MOTChallenge folder with noise for frames; detections are (frame, left)."""
    folder = Path(folder)
    for part in ("det", "img1"):
        (folder / part).mkdir(parents=True)
    (folder / "seqinfo.ini").write_text(
        f"[Sequence]\nname=tiny\nimDir=img1\nframeRate=5\nseqLength={frames}\n"
        f"imWidth={size[0]}\nimHeight={size[1]}\nimExt=.jpg\n"
    )
    (folder / "det" / "det.txt").write_text(
        "".join(f"{frame},-1,{left},10,16,24,0.9,-1,-1,-1\n" for frame, left in detections)
    )
    noise = np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    for frame in range(1, frames + 1):
        cv2.imwrite(str(folder / "img1" / f"{frame:06d}.jpg"), noise)
    return one("mixer_torch.datasets.MOTChallenge", path=str(folder))


def labels_in(path):
    with open(path, newline="") as file:
        return [int(row["label"]) for row in csv.DictReader(file)]


def names_in(folder):
    return {path.name for path in Path(folder).iterdir()}

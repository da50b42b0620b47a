"""Sequences to track, and a tracker of one's own to track them with."""

import sys
from pathlib import Path

import cv2
import numpy as np
import yaml

# Objects of these sequences keep to lanes, 100 pixels wide: a label is a lane.
OWN_TRACKER = '''
import pathlib
import signal
import time

from mixer_torch.association import Association, Status, by_first_appearance
from mixer_torch.tracking.base import BaseTracker
from mixer_torch.tracks import Tracks

SEEN = []

class Lanes(BaseTracker):
    """Whoever keeps to a lane is one object.

    Args:
        width: Pixels.
        stop_at: Which call to be interrupted in.
        wait_at: Which call to wait in for longer than anyone does.
        latency: Seconds for each of 100 frames, but the last, which took ten times as long.
    """

    def __init__(
        self, width: float = 100, stop_at: int = 0, wait_at: int = 0, latency: float = 0
    ) -> None:
        self.width, self.stop_at, self.wait_at = width, stop_at, wait_at
        self.stats = {"latency": [latency] * 99 + [10 * latency]} if latency else {}

    def associate(self, observations, progress=None):
        SEEN.append(observations)
        if len(SEEN) == self.stop_at:
            signal.raise_signal(signal.SIGINT)
        if len(SEEN) == self.wait_at:
            pathlib.Path("waiting").touch()
            time.sleep(60)
        progress("lanes", 1, 1)
        lane = (observations["box"][:, 0] // self.width).long()
        return Association(by_first_appearance(lane), 0.0, Status.CONVERGED, None, self.stats)

    def finish(self, observations, association):
        return Tracks.from_labels(observations, association.labels)
'''
SEQINFO = "[Sequence]\nframeRate=10\nseqLength={length}\nimWidth=320\nimHeight=240\nimExt=.png\n"


def write_config(path, **init_args):
    tracker = {"class_path": "own_tracker.Lanes", "init_args": init_args}
    Path(path).write_text(yaml.safe_dump({"tracker": tracker}))
    return path


def seen():
    """What the tracker was shown, by call."""
    return sys.modules["own_tracker"].SEEN


def lines(frames=range(1, 6), lanes=(0, 1), score=0.9):
    """One box a lane and frame, moving a pixel a frame."""
    return [
        f"{frame},-1,{100 * lane + 10 + frame},20,30,60,{score},-1,-1,-1"
        for frame in frames
        for lane in lanes
    ]


def write_sequence(folder, rows=None, truth=None, length=5, seqinfo=True):
    folder = Path(folder)
    (folder / "det").mkdir(parents=True)
    text = "\n".join(lines() if rows is None else rows)
    (folder / "det" / "det.txt").write_text(text + "\n")
    if truth is not None:
        (folder / "gt").mkdir()
        (folder / "gt" / "gt.txt").write_text("\n".join(truth) + "\n")
    if seqinfo:
        (folder / "seqinfo.ini").write_text(SEQINFO.format(length=length))
    return folder


def true_lines(frames=range(1, 6), lanes=(0, 1)):
    return [f"{f},{k + 7},{100 * k + 10 + f},20,30,60,1,-1,-1,-1" for f in frames for k in lanes]


def write_frames(folder, count):
    (Path(folder) / "img1").mkdir()
    for k in range(1, count + 1):
        cv2.imwrite(f"{folder}/img1/{k:06d}.png", np.full((240, 320, 3), 90, np.uint8))


def files_in(folder):
    return {path.name for path in Path(folder).iterdir()}


def text_of(name):
    return Path("out", f"{name}.txt").read_text()

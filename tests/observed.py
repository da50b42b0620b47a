"""Observations, frames and videos that the tests make themselves."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch

from mixer_torch.observations import (
    Observations,
)


class Spy(Sequence):
    """Frames that count how often each is decoded; frame k is filled with k."""

    def __init__(self, count):
        self.count = count
        self.asked = []

    def __len__(self):
        return self.count

    def __getitem__(self, index):
        self.asked.append(index)
        return np.full((20, 30, 3), index, np.uint8)


NONE = torch.empty(0, dtype=torch.int64)


def write_video(path, count, codec="MJPG"):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 10, (64, 48))
    assert writer.isOpened()
    for k in range(count):
        writer.write(np.full((48, 64, 3), (0, 0, 20 * k), np.uint8))
    writer.release()


def write_frames(folder, count):
    paths = [folder / f"{k:03d}.png" for k in range(count)]
    for k, path in enumerate(paths):
        cv2.imwrite(str(path), np.full((20, 30, 3), (k, 0, 100 + k), np.uint8))
    return paths


def example(images=None):
    features = {
        "time": torch.tensor([0.0, 0.0, 0.5]),
        "frame": torch.tensor([0, 0, 5]),
        "box": torch.arange(12).reshape(3, 4) / 10,
        "position": torch.ones(3, 3, dtype=torch.float64),
        "identity": torch.tensor([1, -1, 1], dtype=torch.int32),
        "shape": torch.rand(3, 2, 2, generator=torch.Generator().manual_seed(0)),
    }
    return Observations(torch.tensor([0, 0, 5]), features, images)

"""Scorers, one modality a file. Each is also ``scorers.<Class>``."""

from mixer_torch.scorers.color import Color
from mixer_torch.scorers.iou import IoU
from mixer_torch.scorers.motion import Motion
from mixer_torch.scorers.proximity import Proximity
from mixer_torch.scorers.sift import SIFT
from mixer_torch.scorers.tracklet import Tracklet

__all__ = ["SIFT", "Color", "IoU", "Motion", "Proximity", "Tracklet"]

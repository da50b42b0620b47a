"""Scorers, one modality a file. Each is also ``scorers.<Class>``."""

from scorers.color import Color
from scorers.iou import IoU
from scorers.motion import Motion
from scorers.proximity import Proximity
from scorers.sift import SIFT
from scorers.tracklet import Tracklet

__all__ = ["SIFT", "Color", "IoU", "Motion", "Proximity", "Tracklet"]

"""Tracking as association: detections of a sequence in, who was where out."""

from mixer_torch.tracking.camera_motion import CameraMotion
from mixer_torch.tracking.camera_path import CameraPath
from mixer_torch.tracking.following import Linking
from mixer_torch.tracking.joining import Joining
from mixer_torch.tracking.measured import Measured
from mixer_torch.tracking.postprocessing import PostProcessing
from mixer_torch.tracking.tracker import Tracker
from mixer_torch.tracks import Tracks

__all__ = [
    "CameraMotion",
    "CameraPath",
    "Joining",
    "Linking",
    "Measured",
    "PostProcessing",
    "Tracker",
    "Tracks",
]

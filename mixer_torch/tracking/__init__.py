"""Tracking as association: the same three nouns, applied to frames and then to tracklets."""

from mixer_torch.tracking.camera_motion import CameraMotion
from mixer_torch.tracking.online import OnlineTracker
from mixer_torch.tracking.tracker import Tracker
from mixer_torch.tracks import Tracks

__all__ = ["CameraMotion", "OnlineTracker", "Tracker", "Tracks"]

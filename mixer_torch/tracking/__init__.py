"""Tracking as association: the same three nouns, applied to frames and then to tracklets."""

from mixer_torch.tracking.tracks import Tracks

__all__ = ["Tracks"]

"""Tracking as association: the same three nouns, applied to frames and then to tracklets."""

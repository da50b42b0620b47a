"""Scorers, one modality a file. Each is also ``scorers.<Class>``."""

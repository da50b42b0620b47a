"""Configurations, one YAML a file; installed as ``mixer_torch.configs``."""

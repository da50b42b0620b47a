"""How good an answer is: clusterings, calibration, retrieval, and tracks (``metrics.tracking``)."""

from mixer_torch.metrics.calibration import calibration_metrics
from mixer_torch.metrics.clustering import adjusted_rand, bcubed, evaluate, pairwise
from mixer_torch.metrics.retrieval import retrieval, retrieval_of_affinity

__all__ = [
    "adjusted_rand",
    "bcubed",
    "calibration_metrics",
    "evaluate",
    "pairwise",
    "retrieval",
    "retrieval_of_affinity",
]

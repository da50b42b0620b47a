"""Scorers, one modality a file, and the calibrators that turn their evidence into scores.

Of calibration: ``curves`` are fixed, ``calibrators`` are fitted to labelled pairs and saved,
``likelihood_ratio`` is their base class, ``covariates`` are the context of a pair, and
``pair_network`` learns one score from the evidence of all modalities.
"""

from mixer_torch.scorers.calibrators import Fitted, Isotonic, MonotoneSpline, Platt
from mixer_torch.scorers.color import Color
from mixer_torch.scorers.covariates import Covariates
from mixer_torch.scorers.curves import Logistic, PiecewiseLinear
from mixer_torch.scorers.embedding import Embedding, EmbeddingNetwork
from mixer_torch.scorers.iou import IoU
from mixer_torch.scorers.likelihood_ratio import LikelihoodRatio
from mixer_torch.scorers.pair_network import EvidenceEnsemble, EvidenceNetwork, PairNetwork
from mixer_torch.scorers.proximity import Proximity
from mixer_torch.scorers.sift import SIFT
from mixer_torch.scorers.sift_at_points import SIFTAtPoints

__all__ = [
    "SIFT",
    "Color",
    "Covariates",
    "Embedding",
    "EmbeddingNetwork",
    "EvidenceEnsemble",
    "EvidenceNetwork",
    "Fitted",
    "IoU",
    "Isotonic",
    "LikelihoodRatio",
    "Logistic",
    "MonotoneSpline",
    "PairNetwork",
    "PiecewiseLinear",
    "Platt",
    "Proximity",
    "SIFTAtPoints",
]

"""Training of what can be learned, with Lightning. Nothing imports this package.

A training is a LightningModule: of calibrators, of the fusion, of networks over pairs (``pairs``,
and ``clustering`` through the solver), or of an appearance embedding. Its data is ``data`` (pairs
with the evidence of each modality) or ``crops``. ``mixer-train`` (``cli``) runs them.
"""

from mixer_torch.train.calibration import CalibratorTraining
from mixer_torch.train.clustering import AssociationTraining, Relaxation, WindowData
from mixer_torch.train.crops import CropData
from mixer_torch.train.data import PairData
from mixer_torch.train.embedding import EmbeddingTraining
from mixer_torch.train.fusion import FusionTraining
from mixer_torch.train.pairs import PairTraining
from mixer_torch.train.selectors import AtGaps
from mixer_torch.train.tables import PairTable

__all__ = [
    "AssociationTraining",
    "AtGaps",
    "CalibratorTraining",
    "CropData",
    "EmbeddingTraining",
    "FusionTraining",
    "PairData",
    "PairTable",
    "PairTraining",
    "Relaxation",
    "WindowData",
]

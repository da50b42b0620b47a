"""mixer-torch: multimodal, multiway data association.

Scorers compare pairs of observations, one scorer for each modality. A solver turns the scores into
clusters that are cycle consistent, one-to-one and distinct within each view:

    import mixer_torch as mx

    affinity = mx.score(observations, scorers)
    association = mx.solve(affinity, mx.Mixer())

Importing this package imports torch, NumPy and SciPy; what else is needed is imported on use.
"""

from importlib.metadata import PackageNotFoundError, version

from mixer_torch.affinity import Affinity
from mixer_torch.association import Association, Status
from mixer_torch.fusion import Fusion, LinearFusion, LogOddsFusion
from mixer_torch.observations import FolderFrames, Images, Observations, VideoFrames
from mixer_torch.pairs import Every, Nearest, PairSelector, Reachable, Within
from mixer_torch.pipeline import associate
from mixer_torch.scoring import Calibrated, Calibrator, FunctionScorer, Scorer, score
from mixer_torch.solvers.base import solve
from mixer_torch.solvers.clear import Clear
from mixer_torch.solvers.exact import Exact
from mixer_torch.solvers.hungarian import Hungarian
from mixer_torch.solvers.matchals import MatchALS
from mixer_torch.solvers.matcheig import MatchEIG
from mixer_torch.solvers.matchlift import MatchLift
from mixer_torch.solvers.mixer import Mixer
from mixer_torch.solvers.problem import Solver
from mixer_torch.solvers.quickmatch import QuickMatch
from mixer_torch.solvers.spectral import Spectral
from mixer_torch.solvers.threshold import AllPairs, Consecutive

try:
    __version__ = version("mixer-torch")
except PackageNotFoundError:  # used from a folder, without being installed
    __version__ = "0+unknown"

__all__ = [
    "Affinity",
    "AllPairs",
    "Association",
    "Calibrated",
    "Calibrator",
    "Clear",
    "Consecutive",
    "Every",
    "Exact",
    "FolderFrames",
    "FunctionScorer",
    "Fusion",
    "Hungarian",
    "Images",
    "LinearFusion",
    "LogOddsFusion",
    "MatchALS",
    "MatchEIG",
    "MatchLift",
    "Mixer",
    "Nearest",
    "Observations",
    "PairSelector",
    "QuickMatch",
    "Reachable",
    "Scorer",
    "Solver",
    "Spectral",
    "Status",
    "VideoFrames",
    "Within",
    "__version__",
    "associate",
    "score",
    "solve",
]

"""Pictures of a result: its scores, its clusters, its frames. Matplotlib comes with the first."""

from mixer_torch.plots.affinity import affinity_figure
from mixer_torch.plots.clusters import clusters_figure
from mixer_torch.plots.frames import frames_figure, write_video
from mixer_torch.plots.style import save
from mixer_torch.plots.video import write_track_video

__all__ = [
    "affinity_figure",
    "clusters_figure",
    "frames_figure",
    "save",
    "write_track_video",
    "write_video",
]

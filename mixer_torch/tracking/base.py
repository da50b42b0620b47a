"""What a tracker is: observations of a sequence in, tracks out."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import nn

from mixer_torch.association import Association
from mixer_torch.observations import Observations
from mixer_torch.scoring import Progress
from mixer_torch.tracks import Tracks


class BaseTracker(ABC):
    """A way to track. Settings are constructor arguments; nothing is kept between sequences.

    Offline or online, a tracker answers two questions, one after the other: who is who among all
    observations (:meth:`associate`), and which of these clusters are objects, with which boxes
    (:meth:`finish`). :meth:`track` asks both.
    """

    @abstractmethod
    def associate(
        self, observations: Observations, progress: Progress | None = None
    ) -> Association:
        """A label for each observation, clutter included, and how the solve ended.

        The features ``identity`` and what else tells the truth are not read.

        Args:
            observations: A sequence, in any order, with ``frame`` and ``box``.
            progress: Told what is done while it goes on.
        """

    @abstractmethod
    def finish(self, observations: Observations, association: Association) -> Tracks:
        """The tracks of an association: weak and short clusters dropped, gaps filled if asked."""

    def track(self, observations: Observations, progress: Progress | None = None) -> Tracks:
        """From observations to tracks."""
        return self.finish(observations, self.associate(observations, progress))

    def to(self, device: torch.device | str) -> BaseTracker:
        """The same tracker with all modules among its settings moved to a device, in place."""
        for value in vars(self).values():
            for item in value if isinstance(value, list | tuple) else (value,):
                if isinstance(item, nn.Module):
                    item.to(device)
        return self

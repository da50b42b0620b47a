"""Local texture: one SIFT descriptor at a given point of each observation."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from mixer_torch.observations import Observations, distinct_views
from mixer_torch.scorers.curves import Logistic
from mixer_torch.scorers.sift_features import distance_of, points_of
from mixer_torch.scoring import Calibrator, Scorer


class SIFTAtPoints(Scorer):
    """Same texture, same point: Lowe's ratio test against the other points of either view.

    One descriptor an observation, at the feature ``point`` of its frame. With descriptor distance
    d, and r(a; b) the one nearest to a among those in b's view other than b, the evidence is

        min(log d(a, r(a; b)) - log d(a, b),  log d(b, r(b; a)) - log d(a, b)),

    positive where a and b are mutual nearest neighbours. d(a, r(a; b)) is at most ``unrelated``,
    which stands in where a view holds no other point.

    Args:
        size: Diameter of the neighbourhood of a point, pixels.
        root: RootSIFT instead of SIFT.
        unrelated: Distance of unit descriptors of unrelated points.
        calibrator: Takes the place of the one set by hand.

    Raises:
        ValueError: size or unrelated is not positive.
    """

    needs = ("images", "point")

    def __init__(
        self,
        size: float = 24.0,
        root: bool = True,
        unrelated: float = 1.0,
        calibrator: Calibrator | None = None,
    ) -> None:
        if not (size > 0 and unrelated > 0):
            raise ValueError(f"size, unrelated: expected positive numbers, got {size}, {unrelated}")
        super().__init__(calibrator or Logistic(10.0, 0.0, 0.02, 0.98))
        self.size = size
        self.root = root
        self.unrelated = unrelated

    @property
    def name(self) -> str:
        return "SIFT"

    def describe(self, observations: Observations) -> tuple[Tensor, ...]:
        """(m, 128) descriptors, (m,) views, and what :func:`nearest_in_views` says of them."""
        point = observations["point"].detach().cpu().numpy()
        described = points_of(observations.images, point, self.size, self.root)
        described = described.to(observations.device)
        view = distinct_views(observations.view)
        return described, view, *nearest_in_views(described, view)

    def compare(self, description: tuple[Tensor, ...], pairs: Tensor) -> Tensor:
        descriptors, view, nearest, second, which = description
        a, b = pairs
        distance = distance_of((descriptors[a] * descriptors[b]).sum(1))
        margins = []
        for one, other in ((a, b), (b, a)):
            place = (one, view[other])
            best_other = torch.where(which[place] == other, second[place], nearest[place])
            margins.append(distance_of(best_other).clamp(max=self.unrelated).log() - distance.log())
        return torch.minimum(*margins)


def nearest_in_views(
    descriptors: Float[Tensor, "m d"], view: Int64[Tensor, " m"]
) -> tuple[Float[Tensor, "m views"], Float[Tensor, "m views"], Int64[Tensor, "m views"]]:
    """The greatest and second greatest similarity to each observation within each view, and which
    has the greatest; -inf where there is none. Nothing is its own neighbour.
    """
    m, views = len(view), int(view.max()) + 1 if len(view) else 0
    nearest = descriptors.new_full((m, views), -torch.inf)
    second, which = nearest.clone(), view.new_full((m, views), -1)
    known = descriptors.isfinite().all(1)
    for number in range(views):
        members = ((view == number) & known).nonzero()[:, 0]
        if not len(members):
            continue
        similarity = descriptors.nan_to_num() @ descriptors[members].T
        similarity[members, torch.arange(len(members), device=members.device)] = -torch.inf
        best = similarity.topk(min(2, len(members)), dim=1)
        nearest[:, number] = best.values[:, 0]
        which[:, number] = members[best.indices[:, 0]]
        if len(members) > 1:
            second[:, number] = best.values[:, 1]
    return nearest, second, which

"""Tracklets: clusters of observations that are observations again."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from mixer_torch.observations import Observations
from mixer_torch.tracking.appearance import APPEARANCE, pooled
from mixer_torch.tracking.motion import (
    MotionModel,
    State,
    box_position,
    filtered,
    first_state,
    log_ratio,
    resolution,
)

PATH_FEATURES = ("span", "entry", "exit")
"""Features that tell how something came and went: ``span`` (m, 2), the times of its first and last
sight, and the packed states ``entry``, judged by what followed the first, and ``exit``, by what
preceded the last (see :class:`mixer_torch.tracking.motion.State`)."""

TRACKLET_FEATURES = ("tracklet", *(f"tracklet_{name}" for name in PATH_FEATURES))
"""Features that tell which tracklet an observation is of, by number, and how that came and went:
span, entry and exit of the whole tracklet."""


def with_paths(
    observations: Observations,
    labels: Int64[Tensor, " m"],
    model: MotionModel,
    memory: int = 12,
    inflation: float = 1.0,
) -> Observations:
    """The observations with :data:`PATH_FEATURES`, fitted on those of the same label.

    The exit of an observation is judged by those before it in its cluster and by itself, its
    entry by itself and those after it: each as if the cluster were cut there, so that comparing
    the exit of one with the entry of the next asks whether it should be.

    Args:
        observations: With ``box`` and ``time``.
        labels: Clusters of links that are confident.
        model: How things move.
        memory: How many observations before and after are looked at.
        inflation: By how much the measured error of the detector is taken to be larger than it is:
            errors of successive boxes are alike, and those next to an occlusion are larger.
    """
    position, height = box_position(observations["box"])
    time = observations["time"].double()
    blur = inflation * measured_resolution(observations, labels, model)
    states = [
        filtered(position, height, time, labels, model, blur, memory, backwards).packed
        for backwards in (True, False)
    ]
    span = torch.stack([time, time], 1)
    return observations.with_features(span=span, entry=states[0], exit=states[1])


def path_log_ratio(
    span: Float[Tensor, "m 2"],
    entry: Float[Tensor, "m 3 5"],
    leaving: Float[Tensor, "m 3 5"],
    pairs: Int64[Tensor, "2 P"],
    model: MotionModel,
) -> tuple[Float[Tensor, " P"], Float[Tensor, " P"]]:
    """Does a path lead from the exit of the one that came first to the entry of the other?

    Args:
        span: Feature, one of :data:`PATH_FEATURES`.
        entry: Feature.
        leaving: The feature ``exit``.
        pairs: Which to compare.
        model: How things move.

    Returns:
        The log likelihood ratio (:func:`~mixer_torch.tracking.motion.log_ratio`, all axes), nats,
        and the seconds between exit and entry: not positive where both overlap in time, and then
        the ratio means nothing.
    """
    first = span[pairs[0], 0] <= span[pairs[1], 0]
    a, b = torch.where(first, pairs, pairs.flip(0))
    seconds = span[b, 0] - span[a, 1]
    earlier, later = State.unpacked(leaving[a]), State.unpacked(entry[b])
    height = ((earlier.mean[:, 2, 0] + later.mean[:, 2, 0]) / 2).exp()
    return log_ratio(earlier, later, seconds, height, model).sum(1), seconds


def without_paths(observations: Observations, model: MotionModel) -> Observations:
    """The observations with :data:`PATH_FEATURES` that tell of no velocity: each is alone."""
    position, height = box_position(observations["box"])
    time = observations["time"].double()
    alone = torch.arange(len(observations), device=observations.device)
    blur = measured_resolution(observations, alone, model)
    state = first_state(position, height, model, blur).packed
    return observations.with_features(span=torch.stack([time, time], 1), entry=state, exit=state)


def measured_resolution(
    observations: Observations, labels: Int64[Tensor, " m"], model: MotionModel
) -> float:
    """Error of the detector in pixels, see :func:`mixer_torch.tracking.motion.resolution`."""
    position, height = box_position(observations["box"])
    return resolution(position, height, observations["time"].double(), labels, model)


def summarised(observations: Observations, labels: Int64[Tensor, " m"]) -> Observations:
    """One observation for each cluster, whose features tell its two ends and what it is made of.

    Args:
        observations: With :data:`PATH_FEATURES`, as from :func:`with_paths` with these labels.
        labels: Clusters 0.., each used.

    Returns:
        As many observations as there are clusters, of no view (what may not be joined overlaps in
        time, see :func:`overlapping`), with features ``span``, ``entry``, ``exit``; ``time`` and
        ``box`` of the first sight; ``camera``; ``boxes``, how many there are; ``first`` and
        ``last``, the observations at its ends; and the mean of ``confidence``, ``embedding`` and
        descriptions of looks where there are any.
    """
    count = int(labels.max()) + 1 if len(labels) else 0
    order = torch.argsort(observations["time"], stable=True)
    order = order[torch.argsort(labels[order], stable=True)]
    size = torch.bincount(labels, minlength=count)
    end = torch.cumsum(size, 0)
    first, last = order[end - size], order[end - 1]
    span = observations["span"]
    features = {
        "span": torch.stack([span[first, 0], span[last, 1]], 1),
        "entry": observations["entry"][first],
        "exit": observations["exit"][last],
        "time": observations["time"][first],
        "box": observations["box"][first],
        "boxes": size,
        "first": first,
        "last": last,
    }
    if "camera" in observations.features:
        features["camera"] = observations["camera"][first]
    for name, value in observations.features.items():
        if name in ("confidence", "embedding") or name.startswith(APPEARANCE):
            features[name] = pooled(value, labels, count)
    return Observations(torch.full((count,), -1, device=labels.device), features)


def tracklet_features(tracklets: Observations, labels: Int64[Tensor, " m"]) -> dict[str, Tensor]:
    """:data:`TRACKLET_FEATURES` of observations of the tracklets ``labels``.

    Args:
        tracklets: From :func:`summarised`.
        labels: Of which tracklet each is.
    """
    path = (tracklets[name][labels] for name in PATH_FEATURES)
    return dict(zip(TRACKLET_FEATURES, (labels, *path), strict=True))


def overlapping(span: Tensor, camera: Int64[Tensor, " n"] | None = None) -> Int64[Tensor, "2 K"]:
    """Pairs of tracklets of one camera that overlap in time and so are not one object.

    Args:
        span: (n, 2) times of first and last sight.
        camera: (n,) one camera if None.
    """
    camera = (
        torch.zeros(len(span), dtype=torch.int64, device=span.device) if camera is None else camera
    )
    order = torch.argsort(span[:, 0], stable=True)
    start = span[order, 0].contiguous()
    place = torch.arange(len(span), device=span.device)
    after = torch.searchsorted(start, span[order, 1].contiguous(), right=True)
    count = (after - place - 1).clamp(min=0)
    first = torch.repeat_interleave(place, count)
    rank = torch.arange(len(first), device=span.device)
    second = first + 1 + rank - torch.repeat_interleave(torch.cumsum(count, 0) - count, count)
    pairs = order[torch.stack([first, second])]
    pairs = pairs[:, camera[pairs[0]] == camera[pairs[1]]]
    return torch.stack([pairs.min(0).values, pairs.max(0).values])


def successive(
    tracklets: Observations, gap: float, reach: float, speed: float, growth: float
) -> Int64[Tensor, "2 P"]:
    """Pairs of tracklets of which one may go on where the other ended.

    The later one starts at most ``gap`` seconds after the end of the earlier one, at most
    (reach + speed * seconds) heights from where that one ended or would by then be, and is not
    larger or smaller by more than ``growth`` nats.
    """
    span, entry, leaving = (tracklets[key] for key in PATH_FEATURES)
    camera = tracklets.camera
    order = torch.argsort(span[:, 0], stable=True)
    start = span[order, 0].contiguous()
    low = torch.searchsorted(start, span[:, 1].contiguous(), right=True)
    high = torch.searchsorted(start, span[:, 1].contiguous() + gap, right=True)
    count = (high - low).clamp(min=0)
    place = torch.arange(len(span), device=span.device)
    a = torch.repeat_interleave(place, count)
    rank = torch.arange(len(a), device=span.device)
    b = order[low[a] + rank - (torch.cumsum(count, 0) - count)[a]]
    seconds = span[b, 0] - span[a, 1]
    from_, to = leaving[a][..., 0], entry[b][..., 0]
    height = ((from_[:, 2] + to[:, 2]) / 2).exp()
    distance = torch.linalg.vector_norm(to[:, :2] - from_[:, :2], dim=1)
    near = distance <= (reach + speed * seconds) * height
    near &= (camera[a] == camera[b]) & ((to[:, 2] - from_[:, 2]).abs() <= growth)
    pairs = torch.stack([a, b])[:, near]
    pairs = torch.stack([pairs.min(0).values, pairs.max(0).values])
    return pairs[:, torch.argsort(pairs[0] * len(span) + pairs[1])]

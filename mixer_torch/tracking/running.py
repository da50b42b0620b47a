"""Measuring while a sequence is still being seen: from the frames so far, the latest ones."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from mixer_torch.tracking.camera_steps import (
    AT_REST,
    LEAST_GAIN,
    WINDOW,
    camera_step,
    moved,
    mutual_best,
)
from mixer_torch.tracking.measured import (
    COMMON_CHANGE,
    COMMON_MOTION,
    CONTINUES_REACH,
    PRIOR_CONTINUES,
    Measured,
    Sequence,
    continuity,
    displacement_of,
    meaning_of,
    motion_of,
    score_meaning,
)

REMEMBERED = 300
"""Frames that are measured on: ten seconds of usual video."""
PRIOR_CONTINUITY = float(np.log(PRIOR_CONTINUES / (1 - PRIOR_CONTINUES)))
RENEWED = 10  # frames after which figures are computed anew; each frame at first


@dataclass
class _Seen:
    """One frame: boxes and scores, the rows that go on as boxes of the next one, and the camera."""

    box: np.ndarray
    score: np.ndarray
    category: np.ndarray
    step: np.ndarray
    link: np.ndarray  # (rows of this frame,) row of the next one, -1 for none


class Running:
    """What is measured of a sequence so far.

    Args:
        unit: Pixels of the unit of length of all boxes that come.
    """

    def __init__(self, unit: float) -> None:
        nothing = np.zeros(0)
        self.measured = Measured(
            nothing, nothing, COMMON_MOTION, COMMON_CHANGE, COMMON_CHANGE / 2, 0.0,
            PRIOR_CONTINUITY, AT_REST[None], 0, unit,
        )  # fmt: skip
        self.seen: deque[_Seen] = deque(maxlen=REMEMBERED)
        self.gains: deque[tuple[float, int]] = deque(maxlen=WINDOW)
        self.previous = np.zeros(2)
        self.count = 0

    def add(
        self,
        box: Float64[np.ndarray, "m 4"],
        score: Float64[np.ndarray, " m"],
        category: np.ndarray,
        camera: Float64[np.ndarray, " 3"] | None = None,
    ) -> Float64[np.ndarray, " 3"]:
        """Take in the detections of the next frame.

        Args:
            box: cx cy w h.
            score: Of the detector.
            category: Of the detections.
            camera: The camera's step, where it is known.

        Returns:
            The camera's step from the frame before, as far as boxes tell it.
        """
        step = AT_REST
        if self.seen:
            last = self.seen[-1]
            step = self._camera(last, box, score) if camera is None else camera
            last.link = mutual_best(moved(last.box, step), box, np.zeros(2), CONTINUES_REACH)
        self.seen.append(_Seen(box, score, category, step, np.full(len(box), -1)))
        self.count += 1
        if self.count <= RENEWED or self.count % RENEWED == 0:
            self._renew()
        return step

    def _camera(self, last: _Seen, box: np.ndarray, score: np.ndarray) -> np.ndarray:
        before, now = (np.clip(self.measured.means(s), 0.02, 1) ** 2 for s in (last.score, score))
        step, gain, links = camera_step(last.box, box, before, now, self.previous)
        self.previous = displacement_of(step, box, self.previous)
        self.gains.append((gain, links))
        total, count = np.sum(self.gains, 0)
        return step if total > LEAST_GAIN * max(count, 1) else AT_REST

    def _renew(self) -> None:
        seen = list(self.seen)
        size = [len(one.box) for one in seen]
        start = np.concatenate([[0], np.cumsum(size)])
        box, score, category = (
            np.concatenate([getattr(one, name) for one in seen])
            for name in ("box", "score", "category")
        )
        sequence = Sequence(np.arange(len(seen)), start, box, score, self.measured.unit, category)
        forward = np.full(len(box), -1)
        for k, one in enumerate(seen[:-1]):
            linked = np.flatnonzero(one.link >= 0)
            forward[start[k] + linked] = start[k + 1] + one.link[linked]
        backward = np.full(len(box), -1)
        backward[forward[forward >= 0]] = np.flatnonzero(forward >= 0)
        levels, meaning = score_meaning(sequence, forward, backward)
        steps = np.stack([one.step for one in seen])
        means = meaning_of(score, levels, meaning)
        motion, change, jitter, links = motion_of(sequence, steps, forward, means > 0.6)
        alone = float(((forward < 0) & (backward < 0)).sum()) / len(seen)
        self.measured = Measured(
            levels, meaning, motion, change, jitter, alone,
            continuity(sequence, forward, backward), steps, links, self.measured.unit,
            len(box) / len(seen),
        )  # fmt: skip

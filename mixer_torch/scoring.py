"""The extension points: what a scorer is, what a calibrator is, and how pairs get scores."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from mixer_torch.affinity import Affinity, check_pairs
from mixer_torch.observations import Observations
from mixer_torch.pairs import Every, PairSelector

NOTHING_TO_SAY = 0.5
Progress = Callable[[str, int, int], None]
"""Called as ``progress(what, done, of)`` while long work goes on."""


class Calibrator(nn.Module):
    """Turns raw evidence into a score; this one passes on evidence that is a score already.

    A score is LR / (1 + LR) with LR = p(evidence | same) / p(evidence | different), so 0.5 is a
    likelihood ratio of 1: the evidence has nothing to say. It is not a posterior probability.

    Most look at nothing but the evidence and define :meth:`forward`. One that depends on
    context as well (the time between two sightings, the size of the boxes) names the features
    that tell them in :attr:`needs` and defines :meth:`describe` and :meth:`calibrate`.

    Attributes:
        needs: Feature keys that it reads beside the evidence.
    """

    needs: ClassVar[tuple[str, ...]] | tuple[str, ...] = ()

    def forward(self, evidence: Float[Tensor, " P"]) -> Float[Tensor, " P"]:
        """Scores in [0, 1] of finite evidence, elementwise."""
        return evidence

    def describe(self, observations: Observations) -> Any:
        """What to know of the context of each observation; None by default."""
        return None

    def calibrate(self, evidence: Tensor, context: Any, pairs: Tensor) -> Tensor:
        """Scores (P,) of finite evidence (P,) of pairs (2, P) under the context described."""
        return self(evidence)


class Scorer(nn.Module):
    """One modality: how alike two observations are, as a score in [0, 1]; 0.5 says nothing.

    To write one, set :attr:`needs` and define :meth:`compare`; define :meth:`describe` where there
    is work to do for each observation. :meth:`forward` is not for overriding: it checks, chunks,
    fills in 0.5 and calibrates, so that a subclass cannot get the convention wrong.

    Attributes:
        needs: Feature keys it reads, and ``"images"`` if it reads pixels.
        calibrator: Evidence to score; assign another (a learned one) to replace it.
        chunk: Pairs compared at a time, which bounds the memory.
    """

    needs: ClassVar[tuple[str, ...]] | tuple[str, ...] = ()
    chunk: int = 1 << 16

    def __init__(self, calibrator: Calibrator | None = None) -> None:
        super().__init__()
        self.calibrator = calibrator or Calibrator()

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "forward" in cls.__dict__:
            raise TypeError(f"{cls.__name__}.forward: define describe and compare instead")

    @property
    def name(self) -> str:
        """Name of the modality: the class's."""
        return type(self).__name__

    def describe(self, observations: Observations) -> Any:
        """What to know of each observation: O(m), done once and shared by all pairs.

        Returns a tensor, or a tuple of tensors; by default the needed features as they are.
        """
        described = tuple(observations[key] for key in self.needs if key != "images")
        return described[0] if len(described) == 1 else described

    def compare(self, description: Any, pairs: Tensor) -> Tensor:
        """Raw evidence (P,) of pairs (2, P): NaN where there is nothing to say."""
        raise NotImplementedError(f"{type(self).__name__} must define compare")

    def forward(self, observations: Observations, pairs: Tensor) -> Tensor:
        """Scores (P,) in [0, 1] of the pairs (2, P), on the device of the observations.

        Raises:
            KeyError: A feature that it needs is missing; the message names both.
            ValueError: Pairs are malformed, or a score is not in [0, 1].
        """
        check_needs(self, observations)
        check_pairs(pairs, observations.view)
        context = self.calibrator.describe(observations)
        return self.score_described(self.describe(observations), pairs, None, context)

    @final
    def evidence(
        self, observations: Observations, pairs: Tensor, progress: Progress | None = None
    ) -> Tensor:
        """Raw evidence (P,) of the pairs (2, P), NaN where there is nothing to say.

        It is what a calibrator is fitted to. Arguments and errors are those of :meth:`forward`.
        """
        for key in self.needs:
            _check_need(self.name, key, observations)
        check_pairs(pairs, observations.view)
        description = self.describe(observations)
        return self._in_chunks(lambda chunk: self._evidence(description, chunk), pairs, progress)

    @final
    def score_described(
        self,
        description: Any,
        pairs: Tensor,
        progress: Progress | None = None,
        context: Any = None,
    ) -> Tensor:
        """:meth:`forward` after :meth:`describe`: for descriptions that were kept.

        ``context`` is what the calibrator's ``describe`` returned.
        """
        return self._in_chunks(
            lambda chunk: self._score_chunk(description, context, chunk), pairs, progress
        )

    def _in_chunks(
        self, work: Callable[[Tensor], Tensor], pairs: Tensor, progress: Progress | None
    ) -> Tensor:
        results, done = [], 0
        for chunk in pairs.split(self.chunk, dim=1):
            results.append(work(chunk))
            done += chunk.shape[1]
            if progress is not None:
                progress(f"{self.name}: pairs", done, pairs.shape[1])
        return torch.cat(results) if results else torch.zeros(0, device=pairs.device)

    def _evidence(self, description: Any, pairs: Tensor) -> Tensor:
        evidence = self.compare(description, pairs)
        if evidence.shape != (pairs.shape[1],):
            raise ValueError(
                f"{self.name}.compare: expected evidence of shape ({pairs.shape[1]},), "
                f"got {tuple(evidence.shape)}"
            )
        return evidence if evidence.is_floating_point() else evidence.float()

    def _score_chunk(self, description: Any, context: Any, pairs: Tensor) -> Tensor:
        evidence = self._evidence(description, pairs)
        says = ~evidence.isnan()
        finite = evidence.where(says, evidence.new_zeros(()))
        score = self.calibrator.calibrate(finite, context, pairs)
        score = score.where(says, score.new_full((), NOTHING_TO_SAY))
        if not bool(((score >= 0) & (score <= 1)).all()):
            wrong = score[~((score >= 0) & (score <= 1))][0].item()
            raise ValueError(f"{self.name}: expected scores in [0, 1], got {wrong}")
        return score


class Calibrated(Scorer):
    """A scorer with another calibrator, the scorer itself left as it is.

    Args:
        scorer: Gives the evidence.
        calibrator: Turns it into scores.
    """

    def __init__(self, scorer: Scorer, calibrator: Calibrator) -> None:
        super().__init__(calibrator)
        self.scorer = scorer
        self.needs = scorer.needs
        self.chunk = scorer.chunk

    @property
    def name(self) -> str:
        return self.scorer.name

    def describe(self, observations: Observations) -> Any:
        return self.scorer.describe(observations)

    def compare(self, description: Any, pairs: Tensor) -> Tensor:
        return self.scorer.compare(description, pairs)


class FunctionScorer(Scorer):
    """Any function of two batches of features is a scorer.

    Args:
        fn: ``fn(a, b) -> (P,)``: scores, or evidence if a calibrator is given; NaN for nothing to
            say. ``a`` and ``b`` are (P, ...) tensors of the one feature in ``needs``, or, where it
            names several, dicts of them by name.
        needs: Feature key or keys.
        calibrator: Evidence to score; None if ``fn`` returns scores.
        name: Name of the modality; the function's if None.
    """

    def __init__(
        self,
        fn: Callable[[Any, Any], Tensor],
        needs: str | Sequence[str],
        calibrator: Calibrator | None = None,
        name: str | None = None,
    ) -> None:
        super().__init__(calibrator)
        self.fn = fn
        self.needs = (needs,) if isinstance(needs, str) else tuple(needs)
        self._name = str(name or getattr(fn, "__name__", type(fn).__name__))
        if not self.needs or "images" in self.needs:
            raise ValueError(f"needs: expected one or more feature keys, got {self.needs}")

    @property
    def name(self) -> str:
        return self._name

    def compare(self, description: Any, pairs: Tensor) -> Tensor:
        if len(self.needs) == 1:
            return self.fn(description[pairs[0]], description[pairs[1]])
        features = dict(zip(self.needs, description, strict=True))
        a, b = ({name: value[side] for name, value in features.items()} for side in pairs)
        return self.fn(a, b)


def score(
    observations: Observations,
    scorers: Iterable[Scorer] | Scorer,
    pairs: Tensor | PairSelector | None = None,
    progress: Progress | None = None,
) -> Affinity:
    """Compare observations in every modality.

    Args:
        observations: What was seen.
        scorers: One for each modality.
        pairs: (2, P) which pairs to compare, or a rule that picks them; every pair across views if
            None.
        progress: Told what is done while it goes on.

    Returns:
        An affinity with one row of scores for each scorer. Scorers of one name are told apart by a
        number.

    Raises:
        KeyError: A scorer needs a feature that is missing.
        TypeError: One of the scorers is not a Scorer.
        ValueError: There is no scorer, pairs are malformed, or a score is not in [0, 1].
    """
    scorers = [scorers] if isinstance(scorers, Scorer) else list(scorers)
    if not scorers:
        raise ValueError("scorers: expected at least one, got none")
    for scorer in scorers:
        if not isinstance(scorer, Scorer):
            raise TypeError(f"scorers: expected instances of Scorer, got {scorer!r}")
        check_needs(scorer, observations)
    selector = pairs if pairs is not None else Every()
    chosen = selector if isinstance(selector, Tensor) else selector(observations)
    check_pairs(chosen, observations.view)
    rows = []
    for number, scorer in enumerate(scorers):
        if progress is not None:
            progress(f"{scorer.name}: observations", number, len(scorers))
        context = scorer.calibrator.describe(observations)
        description = scorer.describe(observations)
        rows.append(scorer.score_described(description, chosen, progress, context))
    scores = torch.stack([row.float() for row in rows])
    return Affinity(chosen, scores, observations.view, unique_names([s.name for s in scorers]))


def check_needs(scorer: Scorer, observations: Observations) -> None:
    """KeyError, naming the scorer and the feature, where one is missing."""
    for key in scorer.needs:
        _check_need(scorer.name, key, observations)
    for key in scorer.calibrator.needs:
        _check_need(f"the calibrator of {scorer.name}", key, observations)


def _check_need(who: str, key: str, observations: Observations) -> None:
    missing = observations.images is None if key == "images" else key not in observations.features
    if missing:
        have = [
            *observations.features,
            *(["images"] if observations.images is not None else []),
        ]
        raise KeyError(
            f"{who} needs {key!r}, which the observations do not have "
            f"(they have: {', '.join(have) or 'nothing'})"
        )


def unique_names(names: Sequence[str]) -> tuple[str, ...]:
    """Names with a number added to the second and later uses of one, and none twice."""
    repeats: Counter[str] = Counter()
    unique: list[str] = []
    for name in names:
        candidate = name
        while candidate in unique:
            repeats[name] += 1
            candidate = f"{name}_{repeats[name] + 1}"
        unique.append(candidate)
    return tuple(unique)

"""score() and the extension points: what the template method takes off a scorer's hands."""

import importlib
import math

import pytest
import torch

from mixer_torch.observations import Observations
from mixer_torch.pairs import Every, Within
from mixer_torch.scoring import (
    Calibrated,
    Calibrator,
    FunctionScorer,
    Scorer,
    score,
    unique_names,
)


def seen(m=6):
    return Observations(
        torch.arange(m) // 2,
        {"frame": torch.arange(m) // 2, "depth": torch.arange(m).double(), "tag": torch.ones(m)},
    )


def closeness(a, b):
    return torch.exp(-(a - b).abs())


class Depth(Scorer):
    """Counts how often it describes and compares."""

    needs = ("depth",)

    def __init__(self, calibrator=None):
        super().__init__(calibrator)
        self.described = self.compared = 0

    def describe(self, observations):
        self.described += 1
        return observations["depth"]

    def compare(self, description, pairs):
        self.compared += 1
        return closeness(*description[pairs])


def test_function_of_one_feature():
    observations = seen()
    pairs = Every()(observations)
    scorer = FunctionScorer(closeness, "depth")
    expected = [math.exp(-abs(a - b)) for a, b in pairs.T.tolist()]
    assert scorer(observations, pairs).tolist() == pytest.approx(expected)
    assert scorer.name == "closeness"


def test_function_of_several_features():
    def fn(a, b):
        assert set(a) == set(b) == {"depth", "tag"}
        return closeness(a["depth"], b["depth"]) * (a["tag"] == b["tag"])

    scorer = FunctionScorer(fn, ["depth", "tag"], name="both")
    observations = seen().with_features(tag=torch.tensor([1, 1, 1, 2, 2, 2]))
    result = scorer(observations, torch.tensor([[0, 0], [2, 4]]))
    assert result.tolist() == pytest.approx([math.exp(-2), 0.0])
    assert scorer.name == "both"


@pytest.mark.parametrize("needs", [[], "images", ["depth", "images"]])
def test_function_needs_features(needs):
    with pytest.raises(ValueError, match="needs"):
        FunctionScorer(closeness, needs)


def test_calibrated_leaves_the_scorer_as_it_is():
    class Half(Calibrator):
        def forward(self, evidence):
            return evidence / 2

    scorer = Depth()
    halved = Calibrated(scorer, Half())
    observations = seen()
    pairs = Every()(observations)
    torch.testing.assert_close(halved(observations, pairs), scorer(observations, pairs) / 2)
    assert halved.name == "Depth"
    assert halved.needs == ("depth",)


def test_calibrator_is_given_only_finite_evidence():
    class Picky(Calibrator):
        def forward(self, evidence):
            if not bool(evidence.isfinite().all()):
                raise RuntimeError("evidence is not finite")
            return evidence

    fn = FunctionScorer(lambda a, b: torch.where(b > 3, torch.nan, 0.25 + 0 * a), "depth", Picky())
    assert fn(seen(), torch.tensor([[0, 0], [3, 4]])).tolist() == [0.25, 0.5]


def test_affinity_has_a_row_for_each_scorer_and_names_of_their_own():
    affinity = score(seen(), [Depth(), FunctionScorer(closeness, "depth"), Depth()])
    assert affinity.modalities == ("Depth", "closeness", "Depth_2")
    assert affinity.scores.shape == (3, 12)
    assert affinity.scores.dtype == torch.float32
    torch.testing.assert_close(affinity.scores[0], affinity.scores[1])


@pytest.mark.parametrize(
    ("names", "unique"),
    [
        ([], ()),
        (["a", "b"], ("a", "b")),
        (["a", "a", "b", "a"], ("a", "a_2", "b", "a_3")),
        (["a_2", "a", "a"], ("a_2", "a", "a_3")),
        (["a", "a", "a_2"], ("a", "a_2", "a_2_2")),
    ],
)
def test_names_are_unique(names, unique):
    assert unique_names(names) == unique


def test_one_scorer_and_a_rule_for_pairs():
    affinity = score(seen(), Depth(), Within(1.0))
    assert affinity.pairs.tolist() == Within(1.0)(seen()).tolist()
    given = torch.tensor([[0], [5]])
    assert score(seen(), Depth(), given).scores.tolist() == [[pytest.approx(math.exp(-5))]]


def test_describe_is_called_once_and_compare_for_each_chunk():
    scorer = Depth()
    scorer.chunk = 5
    affinity = score(seen(), scorer)
    assert (scorer.described, scorer.compared) == (1, 3)
    assert torch.equal(affinity.scores, score(seen(), Depth()).scores)


def test_progress_is_told():
    told = []
    scorer = Depth()
    scorer.chunk = 5
    score(seen(), [scorer], progress=lambda *message: told.append(message))
    assert told[-1] == ("Depth: pairs", 12, 12)
    assert [done for _, done, of in told if of == 12] == [5, 10, 12]


def test_missing_feature_names_scorer_and_feature_before_any_work():
    scorer = Depth()
    with pytest.raises(KeyError, match=r"far needs 'distance'.*frame, depth, tag"):
        score(seen(), [scorer, FunctionScorer(closeness, "distance", name="far")])
    assert scorer.described == 0


@pytest.mark.parametrize("wrong", [1.5, -0.1, math.inf, -math.inf])
def test_scores_out_of_range_are_refused(wrong):
    scorer = FunctionScorer(lambda a, b: torch.full_like(a, wrong), "depth", name="wild")
    with pytest.raises(ValueError, match=r"wild: expected scores in \[0, 1\], got"):
        score(seen(), scorer)


def test_calibrator_that_returns_nan_is_refused():
    class Broken(Calibrator):
        def forward(self, evidence):
            return evidence * torch.nan

    with pytest.raises(ValueError, match="got nan"):
        score(seen(), Depth(Broken()))


def test_evidence_of_the_wrong_shape_is_refused():
    scorer = FunctionScorer(lambda a, b: a[:1], "depth", name="short")
    with pytest.raises(ValueError, match=r"short.compare: expected evidence of shape \(12,\)"):
        score(seen(), scorer)


def test_integers_and_booleans_are_evidence():
    scorer = FunctionScorer(lambda a, b: a == b, "tag")
    assert score(seen(), scorer).scores.unique().tolist() == [1.0]


@pytest.mark.parametrize("scorers", [[], ()])
def test_no_scorer_is_refused(scorers):
    with pytest.raises(ValueError, match="scorers"):
        score(seen(), scorers)


def test_what_is_no_scorer_is_refused():
    with pytest.raises(TypeError, match="scorers"):
        score(seen(), [Depth(), closeness])


@pytest.mark.parametrize("m", [0, 1])
def test_nothing_to_compare(m):
    affinity = score(seen(m), [Depth(), FunctionScorer(closeness, "depth")])
    assert affinity.scores.shape == (2, 0)
    assert len(affinity) == m


def test_malformed_pairs_are_refused():
    with pytest.raises(ValueError, match="expected pairs"):
        score(seen(), Depth(), torch.tensor([[3], [0]]))
    with pytest.raises(ValueError, match="within one view"):
        Depth()(seen(), torch.tensor([[0], [1]]))


def test_a_scorer_without_compare_says_what_is_missing():
    class Lazy(Scorer):
        needs = ("depth",)

    with pytest.raises(NotImplementedError, match="Lazy must define compare"):
        score(seen(), Lazy())


def test_forward_is_not_for_overriding():
    with pytest.raises(TypeError, match=r"Eager\.forward"):

        class Eager(Scorer):
            def forward(self, observations, pairs):
                return pairs[0].float()


def test_features_by_default_describe():
    class Plain(Scorer):
        needs = ("depth", "tag")

        def compare(self, description, pairs):
            depth, tag = description
            return (tag[pairs[0]] == tag[pairs[1]]) * closeness(*depth[pairs])

    torch.testing.assert_close(score(seen(), Plain()).scores, score(seen(), Depth()).scores)


def test_gradient_reaches_features_and_calibrator():
    class Scale(Calibrator):
        def __init__(self):
            super().__init__()
            self.weight = torch.nn.Parameter(torch.tensor(0.5, dtype=torch.float64))

        def forward(self, evidence):
            return evidence * self.weight

    depth = torch.arange(6.0, dtype=torch.float64).requires_grad_()
    scorer = FunctionScorer(closeness, "depth", Scale())
    observations = seen().with_features(depth=depth)
    scorer(observations, Every()(observations)).sum().backward()
    assert bool((depth.grad != 0).any())
    assert float(scorer.calibrator.weight.grad) > 0
    assert list(scorer.state_dict()) == ["calibrator.weight"]


OWN_FILE = '''
"""Likeness of heights."""

import torch

from mixer_torch import Scorer


class Height(Scorer):
    """Same height, same person."""

    needs = ("height",)

    def compare(self, description, pairs):
        a, b = description[pairs]
        return torch.exp(-((a - b) ** 2) / 2)
'''


def test_a_scorer_in_a_file_of_its_own(tmp_path, monkeypatch):
    (tmp_path / "my_height.py").write_text(OWN_FILE)
    monkeypatch.syspath_prepend(tmp_path)
    scorer = importlib.import_module("my_height").Height()
    height = torch.tensor([1.0, 2.0, 1.0, torch.nan])
    affinity = score(Observations(torch.arange(4), {"height": height}), scorer)
    near = math.exp(-0.5)
    assert affinity.modalities == ("Height",)
    assert affinity.scores[0].tolist() == pytest.approx([near, 1, 0.5, near, 0.5, 0.5])

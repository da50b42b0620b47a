"""What holds for every algorithm of the paper's comparison."""

from itertools import permutations

import numpy as np
import pytest
import torch

import mixer_torch as mx
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.solvers.clear import Clear
from mixer_torch.solvers.hungarian import Hungarian
from mixer_torch.solvers.matchals import MatchALS
from mixer_torch.solvers.matcheig import MatchEIG
from mixer_torch.solvers.matchlift import MatchLift
from mixer_torch.solvers.problem import is_distinct, problem_of
from mixer_torch.solvers.quickmatch import QuickMatch
from mixer_torch.solvers.spectral import Spectral
from mixer_torch.solvers.synchronization import best_matches, evidence_matrix, universe_size
from mixer_torch.solvers.threshold import AllPairs, Consecutive

MULTIWAY = [AllPairs, Spectral, MatchEIG, MatchALS, MatchLift, QuickMatch, Clear]
CONSISTENT = [Hungarian, Spectral, MatchLift, QuickMatch, Clear]
EVERY = [*MULTIWAY, Hungarian, Consecutive]


def scene(seed, objects=7, views=6, visible=0.7, noise=0.0, wrong=0.0, unsaid=0.0, modalities=1):
    """Scores of partial views of some objects, and the objects."""
    generator = np.random.default_rng(seed)
    seen = generator.random((views, objects)) < visible
    seen[generator.integers(views, size=objects), np.arange(objects)] = True
    view, identity = np.nonzero(seen)
    order = generator.permutation(len(view))
    view, identity = view[order], identity[order]
    same = identity[:, None] == identity
    scores = []
    for _ in range(modalities):
        flip, error, silent = (np.triu(generator.random(same.shape), 1) for _ in range(3))
        flip, error, silent = (half + half.T for half in (flip, error, silent))
        score = np.where((flip < wrong) ^ same, 1 - noise * error, noise * error)
        scores.append(np.where(silent < unsaid, 0.5, score))
    return mx.Affinity.from_dense(np.stack(scores), view), torch.from_numpy(identity)


@pytest.mark.parametrize("solver", MULTIWAY)
@pytest.mark.parametrize("seed", range(4))
def test_recovers_noiseless_matches_of_partial_views(solver, seed):
    affinity, identity = scene(seed)
    metrics = evaluate(mx.solve(affinity, solver()), identity, affinity.view)
    assert (metrics["precision"], metrics["recall"]) == (1, 1)
    assert metrics["clusters"] == 7


def test_chain_recovers_objects_that_are_never_missed_in_between():
    first, last = torch.tensor([0, 1, 0, 2, 3]), torch.tensor([4, 3, 2, 5, 5])
    seen = [(v, o) for v in range(6) for o in range(5) if first[o] <= v <= last[o]]
    view, identity = torch.tensor(seen).T
    affinity = mx.Affinity.from_dense((identity[:, None] == identity).float(), view)
    metrics = evaluate(mx.solve(affinity, Hungarian()), identity, view)
    assert metrics["f1"] == 1
    assert metrics["clusters"] == 5


@pytest.mark.parametrize("solver", EVERY)
def test_no_evidence_means_no_links(solver):
    view = torch.tensor([0, 0, 1, 1, 2])
    unsaid = mx.Affinity(torch.zeros(2, 0, dtype=torch.int64), torch.zeros(2, 0), view, ("a", "b"))
    assert mx.solve(unsaid, solver()).labels.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("solver", EVERY)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_one_observation(solver, dtype):
    one = mx.Affinity.from_dense(torch.ones(1, 1, dtype=dtype), [0])
    assert mx.solve(one, solver()).labels.tolist() == [0]


@pytest.mark.parametrize("solver", CONSISTENT)
def test_labels_are_feasible_however_bad_the_scores(solver):
    for seed in range(3):
        generator = torch.Generator().manual_seed(seed)
        view = torch.randint(5, (30,), generator=generator)
        scores = torch.rand(30, 30, generator=generator)
        affinity = mx.Affinity.from_dense((scores + scores.T) / 2, view)
        association = mx.solve(affinity, solver())
        assert is_distinct(association.labels, view)


@pytest.mark.parametrize("solver", EVERY)
def test_same_answer_again_and_inputs_are_left_alone(solver):
    affinity, _ = scene(5, noise=0.6, wrong=0.1)
    before = [tensor.clone() for tensor in (affinity.pairs, affinity.scores, affinity.view)]
    first, second = mx.solve(affinity, solver()), mx.solve(affinity, solver())
    assert torch.equal(first.links, second.links)
    after = (affinity.pairs, affinity.scores, affinity.view)
    assert all(torch.equal(*both) for both in zip(before, after, strict=True))


@pytest.fixture(scope="module")
def mean_f1():
    """Mean F1 of each algorithm over ten scenes in which a seventh of the matches are wrong."""
    scenes = [scene(s, objects=8, views=8, noise=0.55, wrong=0.05) for s in range(10)]
    return {
        solver: np.mean(
            [evaluate(mx.solve(a, solver()), identity, a.view)["f1"] for a, identity in scenes]
        )
        for solver in EVERY
    }


@pytest.mark.parametrize("solver", [Spectral, MatchEIG, MatchALS, MatchLift, Clear])
def test_multiway_beats_pairwise_under_noise(mean_f1, solver):
    assert mean_f1[solver] > mean_f1[AllPairs] + 0.05


def test_noise_ranks_the_algorithms_sanely(mean_f1):
    assert mean_f1[MatchLift] >= max(mean_f1.values()) - 0.02  # the tightest relaxation of them
    assert mean_f1[Consecutive] < mean_f1[Hungarian] < mean_f1[AllPairs]
    assert mean_f1[MatchALS] > mean_f1[MatchEIG]  # more constraints on the same low rank


@pytest.mark.parametrize("solver", [Spectral, MatchEIG, Clear, MatchLift])
def test_more_modalities_help(solver):
    f1 = []
    for modalities in (1, 4):
        scenes = [scene(s, noise=0.7, wrong=0.1, modalities=modalities) for s in range(5)]
        answers = [(mx.solve(a, solver()), identity, a.view) for a, identity in scenes]
        f1.append(np.mean([evaluate(*answer)["f1"] for answer in answers]))
    assert f1[1] > f1[0] + 0.1


@pytest.mark.parametrize("solver", [Spectral, MatchEIG, Clear, MatchLift])
def test_universe_can_be_given(solver):
    affinity, identity = scene(3)
    association = mx.solve(affinity, solver(universe=7))
    assert association.stats["universe"] == 7
    assert evaluate(association, identity, affinity.view)["f1"] == 1
    assert mx.solve(affinity, solver(universe=1)).stats["universe"] == int(
        torch.bincount(affinity.view).max()
    )


def test_universe_is_estimated_exactly_from_noiseless_matches():
    for seed in range(5):
        affinity, identity = scene(seed, objects=5 + seed)
        weight = evidence_matrix(problem_of(affinity), "match")
        assert universe_size(weight, affinity.view) == len(identity.unique())


def test_evidence_by_hand():
    view = torch.tensor([0, 0, 1, 1])
    pairs = torch.tensor([[0, 0, 1], [2, 3, 2]])
    scores = torch.tensor([[0.8, 0.2, 0.9]])
    problem = problem_of(mx.Affinity(pairs, scores, view, ("one",)))
    expected = {
        "match": {(0, 2): 1, (1, 2): 1},
        "assignment": {(1, 2): 1},  # 0.9 wins observation 2 over 0.8
        "attraction": {(0, 2): 0.6, (1, 2): 0.8},
        "score": {(0, 2): 0.8, (0, 3): 0.2, (1, 2): 0.9, (1, 3): 0.5},
    }
    for evidence, entries in expected.items():
        full = torch.zeros(4, 4)
        for (a, b), value in entries.items():
            full[a, b] = full[b, a] = value
        torch.testing.assert_close(evidence_matrix(problem, evidence), full)


def test_matches_between_views_against_enumeration():
    for seed in range(20):
        generator = torch.Generator().manual_seed(seed)
        table = torch.rand(3, 4, generator=generator, dtype=torch.float64) - (0.4, 0.8)[seed % 2]
        view = torch.tensor([1, 1, 1, 0, 0, 0, 0])
        pairs = torch.tensor([[a, b] for a in range(3) for b in range(3, 7)]).T
        matches = best_matches(pairs, table.flatten(), view)
        best = max(
            sum(max(float(table[row, column]), 0) for row, column in enumerate(columns))
            for columns in permutations(range(4), 3)
        )
        gains = table[matches[0], matches[1] - 3]
        assert float(gains.sum()) == pytest.approx(best)
        assert bool((gains > 0).all())
        assert len(matches[0].unique()) == len(matches[1].unique()) == matches.shape[1]


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Spectral(evidence="matches"), "evidence"),
        (lambda: Clear(universe=0), "universe"),
        (lambda: MatchLift(max_iterations=0), "max_iterations"),
        (lambda: MatchLift(tolerance=0.0), "tolerance"),
        (lambda: MatchALS(rank=0), "rank"),
        (lambda: MatchALS(max_iterations=0), "max_iterations"),
        (lambda: MatchALS(tolerance=-1.0), "tolerance"),
        (lambda: QuickMatch(ratio=0.0), "ratio"),
        (lambda: QuickMatch(bandwidth=-1.0), "bandwidth"),
        (lambda: AllPairs(threshold=2.0), "threshold"),
        (lambda: Hungarian(threshold=-1.0), "threshold"),
    ],
)
def test_bad_arguments_are_named(make, named):
    with pytest.raises(ValueError, match=f"{named}: expected"):
        make()


@pytest.mark.cuda
@pytest.mark.parametrize("solver", EVERY)
def test_gpu_gives_what_the_cpu_gives(solver):
    affinity, _ = scene(2, modalities=2)
    on_gpu = mx.solve(affinity.to("cuda"), solver())
    assert on_gpu.links.is_cuda
    assert torch.equal(on_gpu.links.cpu(), mx.solve(affinity, solver()).links)

"""Selection of pairs: against all pairs, filtered one by one."""

import itertools

import pytest
import torch

import mixer_torch as mx
from mixer_torch.pairs import canonical, within_view


def observations(m, seed=0, views=4):
    generator = torch.Generator().manual_seed(seed)
    view = torch.randint(-1, views, (m,), generator=generator)
    position = torch.rand(m, 3, generator=generator)
    if m > 4:
        position[4] = torch.nan
    return mx.Observations(
        view,
        {
            "frame": torch.randint(0, 12, (m,), generator=generator),
            "time": torch.rand(m, generator=generator, dtype=torch.float64),
            "position": position,
        },
    )


def across(obs):
    view = obs.view.tolist()
    for a, b in itertools.combinations(range(len(obs)), 2):
        if view[a] < 0 or view[a] != view[b]:
            yield a, b


@pytest.mark.parametrize("m", [0, 1, 2, 13])
@pytest.mark.parametrize("seed", [0, 1])
def test_selectors_find_what_a_loop_finds(m, seed):
    obs = observations(m, seed)
    every = list(across(obs))
    assert [tuple(p) for p in mx.Every()(obs).T.tolist()] == every
    frame, time = obs["frame"].tolist(), obs["time"].tolist()
    near = [(a, b) for a, b in every if abs(frame[a] - frame[b]) <= 3]
    assert [tuple(p) for p in mx.Within(3)(obs).T.tolist()] == near
    near = [(a, b) for a, b in every if abs(time[a] - time[b]) <= 0.25]
    assert [tuple(p) for p in mx.Within(0.25, "time")(obs).T.tolist()] == near


@pytest.mark.parametrize("chunk", [1, 5, 1024])
def test_nearest_takes_a_pair_if_either_names_the_other(chunk):
    obs = observations(13)
    every = set(across(obs))
    position = obs["position"]
    wanted = set()
    for a in range(13):
        others = [
            (float((position[a] - position[b]).norm()), b)
            for b in range(13)
            if 4 not in (a, b) and (min(a, b), max(a, b)) in every
        ]
        wanted |= {(min(a, b), max(a, b)) for _, b in sorted(others)[:2]}
    found = mx.Nearest(2, chunk=chunk)(obs)
    assert [tuple(p) for p in found.T.tolist()] == sorted(wanted)


@pytest.mark.parametrize("m", [0, 1, 2])
def test_nearest_of_few(m):
    found = mx.Nearest(5)(observations(m, seed=3))
    assert found.shape[0] == 2
    assert found.dtype == torch.int64


def test_arguments_are_checked():
    with pytest.raises(ValueError, match="window: expected a number >= 0, got -1"):
        mx.Within(-1)
    with pytest.raises(ValueError, match="k and chunk: expected integers >= 1, got 0"):
        mx.Nearest(0)
    with pytest.raises(ValueError, match="expected one number an observation, got 'position'"):
        mx.Within(1, "position")(observations(5))
    with pytest.raises(KeyError, match="no feature 'embedding'"):
        mx.Nearest(1, "embedding")(observations(3))


def test_canonical_pairs_are_ordered_unique_and_across_views():
    view = torch.tensor([0, 0, 1, -1, -1])
    pairs = torch.tensor([[2, 0, 4, 0, 3, 3], [0, 2, 3, 1, 3, 0]])
    assert canonical(pairs, view).tolist() == [[0, 0, 3], [2, 3, 4]]
    assert within_view(view, torch.tensor([[0, 3], [1, 4]])).tolist() == [True, False]

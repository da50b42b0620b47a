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


def boxes_in_time(m, seed):
    rng = torch.Generator().manual_seed(seed)
    frame = torch.randint(0, 10, (m,), generator=rng)
    corner = 100 * torch.rand(m, 2, generator=rng)
    size = 10 + 30 * torch.rand(m, 2, generator=rng)
    return mx.Observations(
        torch.randint(-1, 10, (m,), generator=rng),
        {
            "time": frame.double() * 0.1,
            "box": torch.cat([corner, corner + size], 1),
            "camera": torch.randint(0, 2, (m,), generator=rng),
        },
    )


@pytest.mark.parametrize("chunk", [1, 7, 1 << 20])
@pytest.mark.parametrize(("m", "seed"), [(0, 0), (1, 0), (2, 1), (40, 2)])
@pytest.mark.parametrize("most_views", [None, 2])
def test_reachable_is_what_a_loop_finds(m, seed, chunk, most_views):
    obs = boxes_in_time(m, seed)
    limits = {"window": 0.3, "reach": 0.5, "speed": 3.0, "growth": 0.6, "views": 4}
    found = mx.Reachable(**limits, most_views=most_views, chunk=chunk)(obs)
    time, box, camera = obs["time"].tolist(), obs["box"].double(), obs["camera"].tolist()
    moments = sorted(set(time))
    expected = []
    for a, b in across(obs):
        seconds = abs(time[a] - time[b])
        apart = abs(moments.index(time[a]) - moments.index(time[b]))
        in_time = seconds <= 0.3 or apart <= 4
        if most_views is not None:
            in_time = in_time and apart <= most_views
        h = [float(box[i, 3] - box[i, 1]) for i in (a, b)]
        far = float((box[a].view(2, 2).mean(0) - box[b].view(2, 2).mean(0)).norm())
        near = far <= (0.5 + 3 * seconds) * (h[0] * h[1]) ** 0.5
        alike = max(h) / min(h) <= 2.718281828459045**0.6
        if in_time and near and alike and camera[a] == camera[b]:
            expected.append((a, b))
    assert [tuple(p) for p in found.T.tolist()] == expected
    if m == 40 and most_views is None:
        assert len(expected) > 10


def test_pairs_in_reach_grow_with_the_length_and_not_with_its_square():
    def count(frames):
        frame = torch.arange(frames).repeat_interleave(3)
        corner = torch.tensor([[0.0, 0], [100, 0], [200, 0]]).repeat(frames, 1)
        obs = mx.Observations(
            frame, {"time": frame.double(), "box": torch.cat([corner, corner + 10], 1)}
        )
        return mx.Reachable(window=2.0, speed=0.0)(obs).shape[1]

    assert count(100) == 3 * (99 + 98)
    assert count(200) == 3 * (199 + 198)


@pytest.mark.parametrize("name", ["window", "reach", "speed", "growth", "views", "most_views"])
def test_reachable_refuses_what_is_negative(name):
    with pytest.raises(ValueError, match=name):
        mx.Reachable(**{name: -1})


def test_reachable_refuses_empty_chunks():
    with pytest.raises(ValueError, match="chunk"):
        mx.Reachable(chunk=0)

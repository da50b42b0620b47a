"""SIFT: matching against brute force, pictures that are known to match, both backends."""

import numpy as np
import pytest
import torch

from mixer_torch.observations import Images, Observations
from mixer_torch.pairs import Every
from mixer_torch.scorers import SIFT, SIFTAtPoints
from mixer_torch.scorers.sift import count_matches
from mixer_torch.scorers.sift_at_points import nearest_in_views
from mixer_torch.scorers.sift_features import unit


def matches_by_loop(a, b, ratio):
    """Mutual nearest neighbours of which one passes Lowe's ratio test, pair by pair."""
    distance = torch.cdist(a, b)
    count = 0
    for i in range(len(a)):
        for j in range(len(b)):
            if distance[i].argmin() != j or distance[:, j].argmin() != i:
                continue
            row, column = distance[i].sort().values, distance[:, j].sort().values
            passes = [v[0] < ratio * v[1] for v in (row, column) if len(v) > 1]
            count += any(passes)
    return count


@pytest.mark.parametrize("ratio", [0.7, 0.9, 1.0])
def test_matches_are_those_of_the_loop(ratio):
    generator = torch.Generator().manual_seed(0)
    base = torch.rand(12, 8, generator=generator, dtype=torch.float64)
    counts = [12, 7, 1, 2, 9]
    described = torch.zeros(5, 12, 8, dtype=torch.float64)
    for number, count in enumerate(counts):
        noise = torch.rand(count, 8, generator=generator, dtype=torch.float64)
        described[number, :count] = unit(base[:count] + 0.5 * noise, root=False)
    a, b = torch.triu_indices(5, 5, 1)
    count = torch.tensor(counts)
    found = count_matches(described[a] @ described[b].transpose(1, 2), count[a], count[b], ratio)
    expected = [
        matches_by_loop(described[i, : counts[i]], described[j, : counts[j]], ratio)
        for i, j in zip(a.tolist(), b.tolist(), strict=True)
    ]
    assert found.tolist() == expected
    assert max(expected) > 3


def test_padding_and_order_of_work_do_not_matter():
    generator = torch.Generator().manual_seed(1)
    described = unit(torch.rand(40, 20, 128, generator=generator), root=True)
    count = torch.randint(0, 21, (40,), generator=generator)
    described[torch.arange(20) >= count[:, None]] = 0
    pairs = torch.triu_indices(40, 40, 1)
    scorer = SIFT(ratio=1.0)
    whole = scorer.compare((described, count), pairs)
    for i in torch.arange(0, pairs.shape[1], 37).tolist():
        a, b = pairs[:, i].tolist()
        if count[a] == 0 or count[b] == 0:
            assert bool(whole[i].isnan())
        else:
            expected = matches_by_loop(described[a, : count[a]], described[b, : count[b]], 1.0)
            assert int(whole[i]) == expected


def test_root_sift_has_unit_length_and_the_hellinger_product():
    raw = torch.rand(3, 128, dtype=torch.float64)
    root = unit(raw, root=True)
    torch.testing.assert_close(root.norm(dim=1), torch.ones(3, dtype=torch.float64))
    p = raw / raw.sum(1, keepdim=True)
    torch.testing.assert_close(root[0] @ root[1], (p[0] * p[1]).sqrt().sum())


def test_nearest_in_views_is_that_of_the_loop():
    generator = torch.Generator().manual_seed(2)
    described = unit(torch.rand(11, 128, generator=generator), root=False)
    described[4] = torch.nan
    view = torch.tensor([0, 0, 0, 1, 1, 2, 2, 2, 2, 3, 1])
    nearest, second, which = nearest_in_views(described, view)
    for i in range(11):
        for number in range(4):
            others = [j for j in range(11) if view[j] == number and j != i and j != 4]
            ranked = sorted(others, key=lambda j: -float(described[i].nan_to_num() @ described[j]))
            if ranked and i != 4:
                assert which[i, number] == ranked[0]
                assert nearest[i, number] == pytest.approx(
                    float(described[i] @ described[ranked[0]]), abs=1e-6
                )
            assert bool(second[i, number].isfinite()) == (len(ranked) > 1)


def textures(count, size=96):
    """Pictures of blobs, each its own."""
    import cv2

    generator = np.random.default_rng(4)
    made = []
    for _ in range(count):
        image = np.zeros((size, size, 3))
        for scale in (5, 9, 17):
            noise = generator.normal(size=(size // scale + 2, size // scale + 2, 3))
            image += cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
        made.append((127 + 70 * image).clip(0, 255).astype(np.uint8))
    return made


def shifted(picture, seed):
    """Seen again: a few pixels aside, darker, with noise of the camera."""
    generator = np.random.default_rng(seed)
    moved = np.roll(picture, (3, -4), (0, 1)) * 0.8 + generator.normal(0, 3, picture.shape)
    return moved.clip(0, 255).astype(np.uint8)


def seen_twice(count=3, size=96):
    first = textures(count, size)
    crops = first + [shifted(picture, seed) for seed, picture in enumerate(first)]
    box = np.array([[0, 0, size, size]] * len(crops))
    return Observations(
        torch.arange(2 * count) // count,
        {"identity": torch.arange(2 * count) % count},
        Images(crops, np.arange(len(crops)), box),
    )


@pytest.mark.parametrize("backend", ["opencv", "kornia"])
def test_same_texture_matches_and_strangers_say_nothing(backend):
    observations = seen_twice()
    contrast = 0.03 if backend == "opencv" else 0.01
    pairs = Every()(observations)
    same = (observations["identity"][pairs[0]] == observations["identity"][pairs[1]]).tolist()
    result = SIFT(backend=backend, contrast=contrast)(observations, pairs).tolist()
    for score, alike in zip(result, same, strict=True):
        assert score > 0.9 if alike else score < 0.65


def test_no_match_speaks_only_where_it_is_asked_to():
    observations = seen_twice()
    pairs = Every()(observations)
    assert float(SIFT()(observations, pairs).min()) == 0.5
    assert float(SIFT(none=0.1)(observations, pairs).min()) < 0.5


def test_nothing_to_hold_on_to_says_nothing():
    flat = np.full((40, 40, 3), 90, dtype=np.uint8)
    box = np.array([[0, 0, 40, 40]] * 3)
    observations = Observations(
        torch.arange(3), images=Images([flat, flat, textures(1)[0]], np.arange(3), box)
    )
    result = SIFT(none=0.1)(observations, Every()(observations))
    assert result.tolist() == [0.5, 0.5, 0.5]


def test_small_crops_are_enlarged_to_have_keypoints():
    observations = seen_twice(size=24)
    counts = [int(SIFT(enlarge=e).describe(observations)[1].sum()) for e in (1, 160)]
    assert counts[1] > 1.2 * counts[0]


def landmarks():
    """Five points of a picture, and the same five of the picture moved by (3, 4)."""
    picture = textures(1, 200)[0]
    frames = [picture, np.roll(picture, (4, 3), (0, 1))]
    point = torch.tensor([[60, 50], [140, 60], [90, 100], [50, 150], [150, 140]]).float()
    return Observations(
        torch.arange(10) // 5,
        {"point": torch.cat([point, point + torch.tensor([3.0, 4.0])])},
        Images(frames, (torch.arange(10) // 5).numpy()),
    )


def test_points_are_matched_by_the_ratio_to_the_best_other():
    observations = landmarks()
    scorer = SIFTAtPoints()
    pairs = Every()(observations)
    result = scorer(observations, pairs)
    same = pairs[1] - pairs[0] == 5
    assert float(result[same].min()) > 0.95
    assert float(result[~same].max()) < 0.05


def test_evidence_at_points_by_hand():
    # Unit vectors in the plane: 0 is seen in view 0, 1 and 2 in view 1.
    angle = torch.tensor([0.0, 0.2, 0.8], dtype=torch.float64)
    described = torch.stack([angle.cos(), angle.sin()], 1)
    view = torch.tensor([0, 1, 1])
    description = (described, view, *nearest_in_views(described, view))
    distance = [2 * np.sin(0.1), 2 * np.sin(0.4)]
    evidence = SIFTAtPoints(unrelated=0.9).compare(description, torch.tensor([[0, 0], [1, 2]]))
    # 0 is alone in its view: from the other side the best other is an unrelated point at 0.9.
    expected = [
        min(np.log(distance[1] / distance[0]), np.log(0.9 / distance[0])),
        min(np.log(distance[0] / distance[1]), np.log(0.9 / distance[1])),
    ]
    assert evidence.tolist() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"backend": "matlab"}, "backend"),
        ({"ratio": 0.0}, "ratio"),
        ({"keypoints": 0}, "keypoints"),
        ({"weak": 9.0, "strong": 5.0}, "weak"),
        ({"none": 0.8}, "none"),
    ],
)
def test_refuses(arguments, name):
    with pytest.raises((ValueError, TypeError), match=name):
        SIFT(**arguments)


def test_refuses_at_points():
    with pytest.raises(ValueError, match="size"):
        SIFTAtPoints(size=0.0)
    with pytest.raises(ValueError, match="unrelated"):
        SIFTAtPoints(unrelated=-1.0)

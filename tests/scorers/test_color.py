"""Colour: painted crops whose answer is known."""

import colorsys

import numpy as np
import pytest
import torch

from mixer_torch.observations import Images, Observations
from mixer_torch.pairs import Every
from mixer_torch.scorers import Color
from mixer_torch.scorers.color import dominant_color, part_histograms

PAINTS = {
    "red": (200, 30, 30),
    "orange": (235, 130, 20),
    "yellow": (230, 210, 40),
    "green": (40, 150, 60),
    "blue": (30, 60, 180),
    "purple": (140, 40, 170),
    "black": (25, 25, 28),
    "white": (225, 225, 228),
    "grey": (128, 126, 130),
}


def paint(color, height=40, width=30):
    return np.full((height, width, 3), color, dtype=np.uint8)


def seen(crops, view=None):
    box = [[0, 0, crop.shape[1], crop.shape[0]] for crop in crops]
    view = torch.arange(len(crops)) if view is None else view
    return Observations(view, images=Images(crops, np.arange(len(crops)), np.array(box)))


@pytest.mark.parametrize("name", PAINTS)
def test_paint_has_its_name(name):
    assert dominant_color(paint(PAINTS[name])) == name


@pytest.mark.parametrize("hue", range(2, 360, 6))
def test_every_hue_has_one_name_whatever_the_light(hue):
    names = set()
    for value in (0.4, 0.7, 1.0):
        color = 255 * np.array(colorsys.hsv_to_rgb(hue / 360, 0.8, value))
        names.add(dominant_color(paint(color.round())))
    assert len(names) == 1
    assert names <= set(PAINTS) - {"black", "white", "grey"}


def test_background_and_highlights_do_not_decide():
    crop = paint(PAINTS["green"], 60, 60)
    crop[15:45, 15:45] = PAINTS["blue"]  # a quarter of the area, in the middle
    crop[20:26, 18:42] = 255  # sun on it
    assert dominant_color(crop) == "blue"


def test_dark_windows_do_not_make_a_red_car_black():
    crop = paint(PAINTS["black"], 60, 90)
    crop[25:50] = PAINTS["red"]
    assert dominant_color(crop) == "red"


def test_semantic_scores_are_the_papers():
    crops = [paint(PAINTS[name]) for name in ("red", "red", "blue", "grey")]
    result = Color()(seen(crops), Every()(seen(crops)))
    assert result.tolist() == [1.0, 0.0, 0.5, 0.0, 0.5, 0.5]
    assert Color().names(seen(crops)) == ["red", "red", "blue", "grey"]


@pytest.mark.parametrize("mode", ["semantic", "histogram"])
def test_a_crop_of_few_pixels_says_nothing(mode):
    crops = [paint(PAINTS["red"]), paint(PAINTS["red"], 2, 2), paint(PAINTS["blue"])]
    observations = seen(crops)
    result = Color(mode)(observations, torch.tensor([[0, 1], [1, 2]]))
    assert result.tolist() == [0.5, 0.5]


def test_histograms_are_unit_vectors_part_by_part():
    generator = np.random.default_rng(0)
    crop = generator.integers(0, 256, (50, 20, 3), dtype=np.uint8)
    histograms = part_histograms(crop, 5, 0.2)
    assert histograms.shape[0] == 5
    np.testing.assert_allclose((histograms**2).sum(1), 1, rtol=1e-5)


def test_histogram_changes_little_with_a_little_of_light():
    # Soft bins: a step of brightness across the border of a bin moves little of the mass.
    dim, bright, blue = (
        part_histograms(paint(c), 2, 0.2) for c in [(95,) * 3, (97,) * 3, (30, 60, 180)]
    )
    assert (dim * bright).sum() / 2 > 0.95
    assert (dim * blue).sum() / 2 < 0.5


def people():
    """Three persons of other clothes, in three views of other noise."""
    generator = np.random.default_rng(1)
    clothes = [("red", "blue"), ("blue", "red"), ("green", "black")]
    crops, view, identity = [], [], []
    for number in range(3):
        for person, (shirt, trousers) in enumerate(clothes):
            crop = paint(PAINTS["grey"], 80, 30)
            crop[:40, 8:22], crop[40:, 8:22] = PAINTS[shirt], PAINTS[trousers]
            noise = generator.normal(0, 12, crop.shape)
            crops.append((crop + noise).clip(0, 255).astype(np.uint8))
            view.append(number)
            identity.append(person)
    return seen(crops, torch.tensor(view)), torch.tensor(identity)


def test_histogram_tells_shirt_from_trousers():
    observations, identity = people()
    pairs = Every()(observations)
    same = identity[pairs[0]] == identity[pairs[1]]
    result = Color("histogram")(observations, pairs)
    assert float(result[same].min()) > 0.9
    assert float(result[~same].max()) < 0.4
    # With one part the first two persons wear the same.
    swapped = (identity[pairs] < 2).all(0) & ~same
    assert float(Color("histogram", parts=1)(observations, pairs)[swapped].min()) > 0.9


def test_strangers_have_no_evidence_on_average():
    # Uncentred, the grey that all stand in front of makes every two of them alike.
    observations, identity = people()
    described = Color("histogram").describe(observations)
    strangers = (described @ described.T)[identity[:, None] != identity]
    assert float(strangers.mean()) < 0.05


@pytest.mark.parametrize("count", [2, 12])
def test_all_alike_are_alike(count):
    # With the plain mean taken off, nothing would be left of them.
    crops = [paint(PAINTS["red"])] * count
    assert float(Color("histogram")(seen(crops), Every()(seen(crops))).min()) > 0.95


def test_two_that_differ_are_different():
    crops = [paint(PAINTS["red"]), paint(PAINTS["blue"])]
    assert float(Color("histogram")(seen(crops), torch.tensor([[0], [1]]))) < 0.2


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"mode": "rgb"}, "mode"),
        ({"parts": 0}, "parts"),
        ({"focus": 0.0}, "focus"),
        ({"min_pixels": 0}, "min_pixels"),
    ],
)
def test_refuses(arguments, name):
    with pytest.raises((ValueError, TypeError), match=name):
        Color(**arguments)

"""Landmarks: rows are identities, files and images go together by their numbers."""

import cv2
import numpy as np
import pytest
import torch

from mixer_torch.datasets.landmarks import Landmarks


@pytest.fixture
def folder(tmp_path):
    """12 frames of 3 points, whose alphabetical order is not the order of their numbers."""
    (tmp_path / "landmarks").mkdir()
    (tmp_path / "images").mkdir()
    for k in range(12):
        points = np.array([[10, 10], [20 + k, 12], [30, 14]])
        np.savetxt(tmp_path / "landmarks" / f"toy{k + 1}.txt", points)
        image = np.full((40, 60), 20 * k, np.uint8)
        cv2.imwrite(str(tmp_path / "images" / f"toy.seq{k}.png"), image)
    return tmp_path


def test_points(folder):
    seen = Landmarks(folder, step=5, box_size=8.0).load()
    assert seen.view.tolist() == [0, 0, 0, 5, 5, 5, 10, 10, 10]
    assert seen["frame"].tolist() == seen.view.tolist()
    assert seen["identity"].tolist() == [0, 1, 2] * 3
    assert seen["point"][4].tolist() == [25, 12]
    assert seen["point"].dtype == torch.float32
    assert seen["box"][4].tolist() == [21, 8, 29, 16]
    assert seen["time"].tolist() == [0, 0, 0, 5, 5, 5, 10, 10, 10]
    assert [int(seen.images.frame(i)[0, 0, 0]) for i in (0, 4, 8)] == [0, 100, 200]
    assert seen.images.crop(0).shape == (8, 8, 3)


def test_choice_of_frames(folder):
    seen = Landmarks(folder, start=2, stop=6, step=2, frame_rate=10.0, images=False).load()
    assert seen.view.unique().tolist() == [2, 4, 6]
    assert seen["time"][-1] == pytest.approx(0.6)
    assert seen.images is None
    assert len(Landmarks(folder, start=50).load()) == 0


def test_unseen_points_are_no_observations(folder):
    (folder / "landmarks" / "toy1.txt").write_text("1 2\nnan nan\n5 6\n")
    seen = Landmarks(folder, stop=0).load()
    assert seen["identity"].tolist() == [0, 2]
    (folder / "landmarks" / "toy1.txt").write_text("")
    seen = Landmarks(folder, stop=0).load()
    assert len(seen) == 0
    assert seen["point"].shape == (0, 2)


def test_other_names(folder):
    (folder / "landmarks").rename(folder / "points")
    seen = Landmarks(folder, points_pattern="points/toy*.txt", images=False).load()
    assert len(seen) == 6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2\n3 x\n", r"toy1\.txt, line 2: expected a number, got 'x'"),
        ("1 2\n3\n", r"toy1\.txt, line 2: expected 2 numbers, got 1"),
        ("1 2 3\n", r"toy1\.txt: expected 2 numbers a line"),
        ("1\n", r"toy1\.txt, line 1: expected at least 2 numbers, got 1"),
    ],
)
def test_malformed_points(folder, text, message):
    (folder / "landmarks" / "toy1.txt").write_text(text)
    with pytest.raises(ValueError, match=message):
        Landmarks(folder).load()


def test_missing_files(folder):
    with pytest.raises(FileNotFoundError, match=r"no file matches images/\*\.jpg"):
        Landmarks(folder, images_pattern="images/*.jpg").load()
    (folder / "images" / "toy.seq3.png").unlink()
    with pytest.raises(ValueError, match=r"one image for each of 12 files.*got 11"):
        Landmarks(folder).load()
    (folder / "landmarks" / "notes.txt").write_text("")
    with pytest.raises(ValueError, match=r"notes\.txt: expected a number in the name"):
        Landmarks(folder).load()
    with pytest.raises(FileNotFoundError, match="nowhere"):
        Landmarks(folder / "nowhere").load()


@pytest.mark.parametrize(
    "arguments", [{"start": -1}, {"step": 0}, {"box_size": 0.0}, {"frame_rate": -1.0}]
)
def test_bad_arguments(arguments):
    (name,) = arguments
    with pytest.raises(ValueError, match=name):
        Landmarks("anywhere", **arguments)


@pytest.mark.real_data
def test_cmu_hotel(real_data):
    seen = Landmarks(real_data / "cmu_hotel").load()
    assert len(seen) == 330
    assert seen.view.unique().tolist() == list(range(0, 101, 10))
    assert seen["identity"].unique().tolist() == list(range(30))
    assert seen.images.frame(0).shape == (480, 512, 3)
    # Neighbouring frames are alike: the pixels about a point hardly change from one to the next.
    seen = Landmarks(real_data / "cmu_hotel", stop=1, step=1, box_size=16.0).load()
    crops = {i: crop.astype(float) for i, crop in seen.images.crops()}
    same = np.mean([np.abs(crops[i] - crops[i + 30]).mean() for i in range(30)])
    other = np.mean([np.abs(crops[i] - crops[30 + (i + 7) % 30]).mean() for i in range(30)])
    assert same < other / 3

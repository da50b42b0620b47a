"""Persons: numbers from names, in order, with whole images."""

import cv2
import numpy as np
import pytest

from mixer_torch.datasets.persons import Persons
from mixer_torch.pairs import Every


@pytest.fixture
def folder(tmp_path):
    for person in (10, 9, 1):
        (tmp_path / f"{person:03d}").mkdir()
        for camera in (1, 2):
            for orientation in (1, 10):
                image = np.full((8, 4 + camera, 3), person, np.uint8)
                name = f"{camera:02d}_{orientation}.png"
                cv2.imwrite(str(tmp_path / f"{person:03d}" / name), image)
    (tmp_path / "001" / "readme.txt").touch()
    return tmp_path


def test_all(folder):
    seen = Persons(folder).load()
    assert seen["identity"].tolist() == [1] * 4 + [9] * 4 + [10] * 4
    assert seen["camera"].tolist() == [1, 1, 2, 2] * 3
    assert seen["orientation"].tolist() == [1, 10] * 6
    assert seen["box"][1:3].tolist() == [[0, 0, 5, 8], [0, 0, 6, 8]]
    assert [int(seen.images.crop(i)[0, 0, 0]) for i in (0, 4, 8)] == [1, 9, 10]
    assert seen.images.crop(2).shape == (8, 6, 3)


def test_any_two_may_be_the_same(folder):
    seen = Persons(folder).load()
    assert seen.view.tolist() == [-1] * 12
    assert Every()(seen).shape[1] == 12 * 11 // 2


def test_choice(folder):
    seen = Persons(folder, cameras=[2], orientations=[1, 10], limit=2).load()
    assert seen["identity"].tolist() == [1, 1, 9, 9]
    assert seen["camera"].unique().tolist() == [2]
    seen = Persons(folder, skip=1, limit=1).load()
    assert seen["identity"].unique().tolist() == [9]
    assert len(Persons(folder, skip=3).load()) == 0
    seen = Persons(folder, limit=0, balance=True).load()
    assert len(seen) == len(seen.images) == 0
    assert seen["box"].shape == (0, 4)


def test_balanced_cameras_look_alike(tmp_path):
    generator = np.random.default_rng(0)
    for person in range(30):
        (tmp_path / f"{person}").mkdir()
        image = generator.integers(0, 120, (16, 8, 3))
        for camera in (1, 2):
            cv2.imwrite(str(tmp_path / f"{person}" / f"{camera}_1.png"), camera * image)
    for balance, alike in ((False, 110), (True, 4)):
        seen = Persons(tmp_path, balance=balance).load()
        crops = np.stack([seen.images.crop(i).astype(int) for i in range(60)])
        worst = np.abs(crops[::2] - crops[1::2]).max()
        assert (worst <= alike) == balance


def test_errors(folder):
    (folder / "001" / "01_2.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match=r"01_2\.png does not decode"):
        Persons(folder).load()
    (folder / "001" / "front.png").touch()
    with pytest.raises(ValueError, match=r"front\.png: expected a name like"):
        Persons(folder).load()
    with pytest.raises(FileNotFoundError, match="no image"):
        Persons(folder / "001").load()
    with pytest.raises(FileNotFoundError, match="nowhere"):
        Persons(folder / "nowhere").load()
    with pytest.raises(ValueError, match="limit"):
        Persons(folder, limit=-1)
    with pytest.raises(ValueError, match="skip"):
        Persons(folder, skip=-1)


@pytest.mark.real_data
def test_reid_persons(real_data):
    seen = Persons(real_data / "reid_persons").load()
    assert len(seen) == 62 * 16
    assert len(seen["identity"].unique()) == 62
    assert seen["box"].unique(dim=0).tolist() == [[0, 0, 48, 128]]

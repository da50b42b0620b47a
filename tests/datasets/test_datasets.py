"""What holds for all datasets."""

import subprocess
import sys

import pytest
from jsonargparse import ArgumentParser

import mixer_torch.datasets
from mixer_torch.datasets.base import Dataset
from mixer_torch.io.files import find


@pytest.mark.parametrize("name", mixer_torch.datasets.__all__)
def test_exported_classes_are_datasets(name):
    assert issubclass(getattr(mixer_torch.datasets, name), Dataset)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("Crowd", {"num_people": 10, "source": "gt"}),
        ("Landmarks", {"path": "hotel", "step": 5, "box_size": 32}),
        (
            "MOTChallenge",
            {"path": "pets", "start": 160, "stop": 780, "step": 20, "classes": [1, 7]},
        ),
        (
            "MultiCamera",
            {"cameras": [{"boxes": "a.txt"}, {"boxes": "b.json.gz", "delay": 3}], "frame_rate": 25},
        ),
        ("ParkingLot", {"seed": 3}),
        ("Persons", {"path": "persons", "cameras": [1], "limit": 10}),
        ("Table", {"path": "table.csv", "frame_rate": 10, "images": "{frame:06d}.jpg"}),
    ],
)
def test_configuration(name, arguments):
    parser = ArgumentParser(exit_on_error=False)
    parser.add_subclass_arguments(Dataset, "dataset")
    block = {"class_path": f"mixer_torch.datasets.{name}", "init_args": arguments}
    dataset = parser.instantiate(parser.parse_object({"dataset": block})).dataset
    assert type(dataset).__name__ == name
    with pytest.raises(Exception, match="stepp"):
        parser.parse_object({"dataset": block | {"init_args": arguments | {"stepp": 1}}})


def test_importing_datasets_imports_no_opencv():
    heavy = "cv2", "matplotlib", "lightning"
    code = f"import sys, mixer_torch.datasets; print([n for n in {heavy} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_find(tmp_path, monkeypatch):
    (tmp_path / "data" / "a").mkdir(parents=True)
    (tmp_path / "b").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MIXER_DATA", raising=False)
    assert find("b").is_dir()
    with pytest.raises(FileNotFoundError, match="MIXER_DATA, where else to look, is not set"):
        find("a")
    monkeypatch.setenv("MIXER_DATA", str(tmp_path / "data"))
    assert find("a") == tmp_path / "data" / "a"
    assert find("b").is_dir()
    with pytest.raises(FileNotFoundError, match=r"c and .*data/c: not found$"):
        find("c")
    with pytest.raises(FileNotFoundError, match=r"^/nowhere/at/all: not found$"):
        find("/nowhere/at/all")

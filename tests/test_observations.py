"""Observations: what is checked, kept and written."""

import copy
import dataclasses
import json
import pickle

import numpy as np
import pytest
import torch
from observed import NONE, Spy, example, write_frames, write_video

from mixer_torch.observations import (
    FolderFrames,
    Images,
    Observations,
    VideoFrames,
    distinct_views,
    integers,
    load_npz,
    save_npz,
)


def test_standard_features_have_their_types():
    seen = example()
    assert seen.view.dtype == seen["frame"].dtype == seen["identity"].dtype == torch.int64
    assert seen["time"].dtype == torch.float64
    assert seen["box"].dtype == seen["position"].dtype == torch.float32
    assert len(seen) == 3
    assert seen.device.type == "cpu"


def test_no_observations():
    seen = Observations(NONE, {"box": torch.empty(0, 4), "identity": NONE})
    assert len(seen) == 0
    assert len(seen.select(torch.tensor([]))) == 0
    assert len(seen.select(torch.zeros(0, dtype=torch.bool))) == 0


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ({"box": torch.ones(3)}, r"features\['box'\]: expected shape \(3, 4\), got \(3,\)"),
        ({"box": torch.ones(3, 5)}, r"expected shape \(3, 4\), got \(3, 5\)"),
        ({"position": torch.ones(3, 2)}, r"expected shape \(3, 3\), got \(3, 2\)"),
        ({"time": torch.ones(3, 1)}, r"features\['time'\]: expected shape \(3,\), got \(3, 1\)"),
        ({"confidence": torch.ones(3, 1)}, r"expected shape \(3,\), got \(3, 1\)"),
        ({"embedding": torch.ones(3)}, r"features\['embedding'\]: expected shape \(3, d\)"),
        ({"other": torch.ones(2)}, r"features\['other'\]: expected leading dimension 3"),
        ({"other": torch.tensor(1.0)}, r"expected leading dimension 3, got shape \(\)"),
        ({"identity": torch.ones(3)}, r"features\['identity'\]: expected integers"),
        ({"frame": torch.ones(3, 1, dtype=torch.int64)}, r"features\['frame'\]: expected int"),
        ({"box": torch.ones(3, 4, device="meta")}, "expected the device of view, cpu, got meta"),
    ],
)
def test_bad_features(features, message):
    with pytest.raises(ValueError, match=message):
        Observations(torch.arange(3), features)


@pytest.mark.parametrize(
    "view", [[0.5], [True], [[0]], torch.tensor(0), ["a"], [float("nan")], None]
)
def test_bad_view(view):
    with pytest.raises(ValueError, match=r"^view: expected"):
        integers("view", view)


@pytest.mark.parametrize("view", [[1, 2], np.array([1, 2], np.uint8), torch.tensor([1, 2])])
def test_integers(view):
    assert integers("view", view).tolist() == [1, 2]
    assert integers("view", view).dtype == torch.int64


def test_as_many_images_as_observations():
    with pytest.raises(ValueError, match="images: expected one for each of 2 observations, got 1"):
        Observations(torch.arange(2), images=Images(Spy(1), [0]))


def test_an_unknown_feature_names_the_known():
    with pytest.raises(KeyError, match="no feature 'bax'; features: time, frame, box"):
        example()["bax"]
    with pytest.raises(KeyError, match="features: none"):
        Observations(torch.zeros(1, dtype=torch.int64))["box"]


def test_frozen():
    seen = example()
    with pytest.raises(dataclasses.FrozenInstanceError):
        seen.view = torch.zeros(3)
    with pytest.raises(TypeError):
        seen.features["time"] = torch.zeros(3)
    given = {"time": torch.zeros(1)}
    seen = Observations(torch.zeros(1, dtype=torch.int64), given)
    given["frame"] = torch.zeros(1)
    assert set(seen.features) == {"time"}


def test_select_by_mask_and_by_order():
    seen = example(Images(Spy(6), [0, 1, 5]))
    picked = seen.select(torch.tensor([2, 0]))
    assert picked.view.tolist() == [5, 0]
    assert torch.equal(picked["box"], seen["box"][[2, 0]])
    assert picked.images.frame_index.tolist() == [5, 0]
    masked = seen.select(seen["identity"] == 1)
    assert masked.view.tolist() == [0, 5]
    assert len(masked.images) == 2
    assert len(seen.select(torch.tensor([]))) == 0
    with pytest.raises(ValueError, match=r"index: expected a mask of shape \(3,\), got \(2,\)"):
        seen.select(torch.tensor([True, False]))
    with pytest.raises(ValueError, match="index: expected integers"):
        seen.select(torch.tensor([0.0]))


def test_with_features_leaves_the_original():
    seen = example(Images(Spy(6), [0, 1, 5]))
    more = seen.with_features(embedding=torch.ones(3, 8), time=torch.zeros(3))
    assert "embedding" not in seen.features
    assert seen["time"].tolist() == [0, 0, 0.5]
    assert more["time"].tolist() == [0, 0, 0]
    assert more.images is seen.images
    with pytest.raises(ValueError, match="box"):
        seen.with_features(box=torch.ones(3))


def test_to_moves_every_tensor():
    moved = example().to("meta")
    assert moved.device.type == "meta"
    assert {value.device.type for value in moved.features.values()} == {"meta"}


@pytest.mark.cuda
def test_to_a_device_and_back(tmp_path):
    seen = example().to("cuda")
    assert seen["box"].is_cuda
    assert torch.equal(seen.to("cpu")["box"], example()["box"])
    seen.save(tmp_path / "seen.npz")
    assert torch.equal(Observations.load(tmp_path / "seen.npz")["box"], example()["box"])


def test_negative_views_are_views_of_their_own():
    view = torch.tensor([3, -1, 3, 0, -1, -7])
    distinct = distinct_views(view).tolist()
    assert distinct[0] == distinct[2]
    assert sorted(set(distinct)) == list(range(5))
    assert distinct_views(torch.empty(0, dtype=torch.int64)).tolist() == []
    assert distinct_views(torch.tensor([-1, -1])).tolist() == [0, 1]


# Files


def assert_same(a, b):
    assert torch.equal(a.view, b.view)
    assert list(a.features) == list(b.features)
    for name, value in a.features.items():
        assert value.dtype == b[name].dtype
        assert torch.equal(value, b[name])


def test_save_and_load(tmp_path):
    seen = example()
    seen.save(tmp_path / "seen.npz")
    assert_same(seen, Observations.load(tmp_path / "seen.npz"))
    assert [path.name for path in tmp_path.iterdir()] == ["seen.npz"]


def test_save_and_load_nothing(tmp_path):
    seen = Observations(NONE, {"box": torch.empty(0, 4)})
    seen.save(tmp_path / "seen.npz")
    assert_same(seen, Observations.load(tmp_path / "seen.npz"))


def test_save_features_that_require_gradients(tmp_path):
    seen = Observations(
        torch.zeros(1, dtype=torch.int64), {"embedding": torch.ones(1, 2, requires_grad=True)}
    )
    seen.save(tmp_path / "seen.npz")
    assert Observations.load(tmp_path / "seen.npz")["embedding"].tolist() == [[1, 1]]


@pytest.mark.parametrize("kind", ["folder", "video"])
@pytest.mark.parametrize("box", [None, [[0, 0, 5, 5], [2, 2, 9, 8], [1, 1, 4, 4]]])
def test_save_and_load_images(tmp_path, monkeypatch, kind, box):
    monkeypatch.chdir(tmp_path)
    if kind == "folder":
        paths = write_frames(tmp_path, 3)
        frames = FolderFrames([path.name for path in paths])
    else:
        write_video(tmp_path / "v.avi", 3)
        frames = VideoFrames("v.avi")
    seen = example(Images(frames, [2, 0, 1], box))
    seen.save("seen.npz")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    loaded = Observations.load(tmp_path / "seen.npz")
    monkeypatch.chdir(tmp_path)
    for i in range(3):
        np.testing.assert_array_equal(loaded.images.crop(i), seen.images.crop(i))


def test_images_in_memory_are_not_saved(tmp_path):
    seen = example(Images(Spy(6), [0, 1, 5]))
    with pytest.raises(ValueError, match="only frames from files can be saved"):
        seen.save(tmp_path / "seen.npz")
    assert list(tmp_path.iterdir()) == []


def test_nothing_in_the_file_is_pickled(tmp_path):
    example(Images(FolderFrames(write_frames(tmp_path, 6)), [0, 1, 5])).save(tmp_path / "s.npz")
    with np.load(tmp_path / "s.npz", allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    assert set(arrays) == {"format", "view", "images", "images/frame"} | {
        f"feature/{name}" for name in example().features
    }
    assert len(json.loads(str(arrays["images"]))["folder"]) == 6


def test_pickled_content_is_refused(tmp_path):
    np.savez(tmp_path / "s.npz", format=np.array({"a": 1}, dtype=object))
    with pytest.raises(ValueError, match=r"s\.npz is not a readable npz file"):
        Observations.load(tmp_path / "s.npz")


def test_files_of_other_kinds_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        Observations.load(tmp_path / "nowhere.npz")
    save_npz(tmp_path / "other.npz", {"format": np.array("mixer-torch affinity 1")})
    with pytest.raises(ValueError, match="expected a file of kind 'mixer-torch observations 1'"):
        Observations.load(tmp_path / "other.npz")
    for content in (b"", b"nonsense"):
        (tmp_path / "bad.npz").write_bytes(content)
        with pytest.raises(ValueError, match=r"bad\.npz is not a readable npz file"):
            Observations.load(tmp_path / "bad.npz")


def test_a_half_written_file_never_stands(tmp_path):
    class Breaks:
        def __array__(self, *args, **kwargs):
            raise RuntimeError("in the middle")

    path = tmp_path / "s.npz"
    save_npz(path, {"format": np.array("x"), "a": np.arange(3)})
    with pytest.raises(RuntimeError, match="in the middle"):
        save_npz(path, {"format": np.array("x"), "a": np.arange(5), "b": Breaks()})
    assert load_npz(path, "x")["a"].tolist() == [0, 1, 2]
    assert [file.name for file in tmp_path.iterdir()] == ["s.npz"]


@pytest.mark.parametrize("kind", ["none", "folder", "video"])
@pytest.mark.parametrize("how", ["pickle", "copy", "deepcopy"])
def test_pickled_and_copied_is_the_same(tmp_path, kind, how):
    images = None
    if kind != "none":
        write_video(tmp_path / "v.avi", 3)
        video = kind == "video"
        frames = (
            VideoFrames(tmp_path / "v.avi") if video else FolderFrames(write_frames(tmp_path, 3))
        )
        images = Images(frames, [2, 0, 1])
        images.crop(1)
    seen = example(images)
    again = pickle.loads(pickle.dumps(seen)) if how == "pickle" else getattr(copy, how)(seen)
    assert torch.equal(again.view, seen.view)
    assert again.features.keys() == seen.features.keys()
    for name, value in seen.features.items():
        torch.testing.assert_close(again[name], value, equal_nan=True, rtol=0, atol=0)
    with pytest.raises(TypeError):
        again.features["new"] = again.view
    if images is not None:
        for i in range(3):
            np.testing.assert_array_equal(again.images.crop(i), seen.images.crop(i))


def test_repr_is_one_short_line():
    seen = Observations(
        torch.tensor([4, 4, 0, -1]), {"time": torch.zeros(4), "box": torch.ones(4, 4)}
    )
    assert repr(seen) == (
        "Observations(4 observations in 2 views, 1 of them without a view; "
        "features: time, box; cpu)"
    )
    nothing = Observations(torch.zeros(0))
    assert repr(nothing) == "Observations(0 observations in 0 views; cpu)"
    with_images = Observations(torch.zeros(1, dtype=torch.int64), images=Images(Spy(1), [0]))
    assert repr(with_images) == "Observations(1 observations in 1 views; images; cpu)"

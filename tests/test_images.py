"""Pixels of observations: what is read, how often, and from where."""

import cv2
import numpy as np
import pytest
import torch
from observed import Spy, example, write_frames, write_video

from mixer_torch.observations import (
    FolderFrames,
    Images,
    VideoFrames,
)


def test_nothing_is_read_before_it_is_asked_for():
    frames = Spy(6)
    seen = example(Images(frames, [0, 1, 5])).select(torch.tensor([2])).to("cpu")
    assert frames.asked == []
    assert seen.images.crop(0)[0, 0, 0] == 5
    assert frames.asked == [5]


def test_each_frame_is_decoded_once_a_pass_in_order():
    frames = Spy(5)
    index = [4, 0, 2, 0, 4, 2, 2]
    images = Images(frames, index, [[1, 1, 4, 4]] * 7)
    crops = dict(images.crops())
    assert frames.asked == [0, 2, 4]
    assert sorted(crops) == list(range(7))
    assert [int(crops[i][0, 0, 0]) for i in range(7)] == index


def test_a_pass_holds_one_frame_at_a_time():
    alive = set()

    class Tracked(np.ndarray):
        def __del__(self):
            alive.discard(id(self))

    class Frames(Spy):
        def __getitem__(self, index):
            frame = super().__getitem__(index).view(Tracked)
            alive.add(id(frame))
            return frame

    images = Images(Frames(10), np.arange(10), [[0, 0, 5, 5]] * 10)
    kept = []
    for _, crop in images.crops():
        kept.append(np.asarray(crop).copy())
        # The one that is read, and the one before it until that is replaced.
        assert len(alive) <= 2
    assert len(kept) == 10


def test_a_crop_is_a_copy():
    frames = [np.zeros((20, 30, 3), np.uint8)]
    for box in (None, [[2, 3, 8, 9]]):
        Images(frames, [0], box).crop(0)[:] = 255
    assert not frames[0].any()


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        ([2, 3, 7, 9], (2, 3, 7, 9)),
        ([2.6, 3.2, 6.1, 8.5], (2, 3, 7, 9)),
        ([-5, -5, 4, 4], (0, 0, 4, 4)),
        ([25, 15, 99, 99], (25, 15, 30, 20)),
        ([50, 50, 60, 60], (29, 19, 30, 20)),
        ([-9, -9, -5, -5], (0, 0, 1, 1)),
        ([5, 5, 5, 5], (5, 5, 6, 6)),
        ([np.nan] * 4, (0, 0, 1, 1)),
        ([-np.inf, -np.inf, np.inf, np.inf], (0, 0, 30, 20)),
    ],
)
def test_crops_are_clipped_and_never_empty(box, expected):
    y, x = np.mgrid[:20, :30]
    frame = np.stack([x, y, 0 * x], -1).astype(np.uint8)
    crop = Images([frame], [0], [box]).crop(0)
    x1, y1, x2, y2 = expected
    np.testing.assert_array_equal(crop, frame[y1:y2, x1:x2])


@pytest.mark.parametrize(
    ("frame", "box", "message"),
    [
        ([[0]], None, r"frame: expected shape \(m,\), got \(1, 1\)"),
        ([0, 3], None, r"frame: expected values in 0\.\.2, got 0\.\.3"),
        ([-1], None, r"frame: expected values in 0\.\.2, got -1"),
        ([0], [[1, 2, 3]], r"box: expected shape \(1, 4\), got \(1, 3\)"),
    ],
)
def test_bad_images(frame, box, message):
    with pytest.raises(ValueError, match=message):
        Images(Spy(3), frame, box)


def test_no_images():
    assert list(Images([], []).crops()) == []


# Frames in files


def test_folder_is_rgb(tmp_path):
    frames = FolderFrames(write_frames(tmp_path, 3))
    assert len(frames) == 3
    assert frames[2][0, 0].tolist() == [102, 0, 2]
    assert frames[2].shape == (20, 30, 3)


def test_folder_errors(tmp_path):
    paths = write_frames(tmp_path, 2)
    with pytest.raises(FileNotFoundError, match=r"nowhere\.png does not exist"):
        FolderFrames([*paths, tmp_path / "nowhere.png"])
    whole = paths[1].read_bytes()
    frames = FolderFrames(paths)
    for content in (b"", b"this is no image", whole[: len(whole) // 2]):
        paths[1].write_bytes(content)
        with pytest.raises(ValueError, match=r"001\.png does not decode as an image"):
            frames[1]
    assert frames[0].any()


@pytest.mark.parametrize("order", [range(6), [0, 3, 4], [5, 2, 2, 0], [3, 3]])
def test_video_gives_the_frame_asked_for(tmp_path, order):
    write_video(tmp_path / "v.avi", 6)
    frames = VideoFrames(tmp_path / "v.avi")
    assert len(frames) == 6
    for k in order:
        red, green, blue = frames[k].reshape(-1, 3).mean(0)
        assert red == pytest.approx(20 * k, abs=4)
        assert green == pytest.approx(0, abs=4)
        assert blue == pytest.approx(0, abs=4)
        assert frames[k].shape == (48, 64, 3)


def test_video_between_key_frames(tmp_path):
    """MPEG-4 stores most frames as differences; they come out the same forwards and after a step
    back."""
    write_video(tmp_path / "v.mp4", 12, "mp4v")
    frames = VideoFrames(tmp_path / "v.mp4")
    forwards = [frames[k] for k in range(12)]
    assert np.mean([abs(float(f[..., 0].mean()) - 20 * k) for k, f in enumerate(forwards)]) < 4
    for k in (11, 7, 3, 10):
        np.testing.assert_array_equal(frames[k], forwards[k])


def test_video_decodes_each_frame_once_a_pass(tmp_path, monkeypatch):
    write_video(tmp_path / "v.avi", 6)
    grabbed = []
    opened = cv2.VideoCapture

    class Capture:
        def __init__(self, path):
            self.capture = opened(path)
            grabbed.append("open")

        def grab(self):
            grabbed.append("grab")
            return self.capture.grab()

        def read(self):
            grabbed.append("read")
            return self.capture.read()

        def __getattr__(self, name):
            return getattr(self.capture, name)

    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    images = Images(VideoFrames(tmp_path / "v.avi"), [4, 1, 4, 1])
    assert len(list(images.crops())) == 4
    assert grabbed == ["open", "grab", "read", "grab", "grab", "read"]


def test_video_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.mp4 does not exist"):
        VideoFrames(tmp_path / "nowhere.mp4")
    (tmp_path / "bad.mp4").write_bytes(b"this is no video")
    with pytest.raises(ValueError, match=r"bad\.mp4 does not open as a video"):
        VideoFrames(tmp_path / "bad.mp4")
    write_video(tmp_path / "v.avi", 2)
    frames = VideoFrames(tmp_path / "v.avi")
    for index in (-1, 2):
        with pytest.raises(IndexError, match=rf"frame {index} of .*v\.avi, which has 2"):
            frames[index]


def test_video_frame_that_does_not_decode(tmp_path, monkeypatch):
    write_video(tmp_path / "v.avi", 3)
    frames = VideoFrames(tmp_path / "v.avi")
    # As if the header promised more frames than the stream holds.
    monkeypatch.setattr(frames, "_length", 5)
    with pytest.raises(ValueError, match=r"frame 4 of video .*v\.avi does not decode"):
        frames[4]
    assert frames[1].any()

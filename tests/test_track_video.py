"""Videos of tracks, read back: boxes, numbers, trails, and frames in which there is nothing."""

import numpy as np
import pytest
import torch

from mixer_torch import plots
from mixer_torch.io.frames import NumberedFrames
from mixer_torch.observations import Images, Observations, VideoFrames
from mixer_torch.plots.style import FADED, colors
from mixer_torch.plots.video import Drawing, drawn_frames
from mixer_torch.tracks import Tracks

GREY = 90
RATE = 10.0


def walk(frames=range(1, 13), identity=1, left=20.0, step=8.0, missing=(), top=60.0):
    """A box of 30 x 80 that moves to the right; those of missing frames are interpolated."""
    frame = np.array(list(frames))
    x = left + step * (frame - frame[0])
    box = np.stack([x, np.full(len(x), top), x + 30, np.full(len(x), top + 80)], 1)
    observation = np.where(np.isin(frame, list(missing)), -1, np.arange(len(frame)))
    return Tracks(frame, np.full(len(frame), identity), box, observation=observation)


def together(*parts):
    names = ("frame", "identity", "box", "confidence", "camera", "observation")
    return Tracks(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def grey(numbers, size=(240, 320)):
    frames = [np.full((*size, 3), GREY, np.uint8) for _ in numbers]
    return NumberedFrames(np.array(numbers), np.arange(len(frames)), frames)


def drawn(tracks, frames, rate=RATE):
    """What is drawn, RGB as signed numbers, without captions."""
    pictures = drawn_frames(Drawing.of_tracks(tracks), frames, [""] * len(frames), rate)
    return [picture[:, :, ::-1].astype(int) for picture in pictures]


def is_color(picture, identity, tolerance=30):
    """Where a picture has the colour of an identity."""
    color = np.rint(colors(np.array([identity]))[0] * 255)
    return np.abs(picture - color).max(-1) <= tolerance


def test_what_is_written_reads_back(tmp_path):
    tracks, told = walk(range(3, 8)), []
    path = tmp_path / "walk.mp4"
    plots.write_track_video(path, tracks, grey(range(1, 10)), RATE, lambda *w: told.append(w))
    frames = VideoFrames(path)
    assert len(frames) == 9
    assert told[-1] == ("video: frames", 9, 9)
    for number in range(1, 10):
        picture = frames[number - 1].astype(int)[:, :, :]
        edge = 20 + 8 * (number - 3)
        assert is_color(picture[80:120, max(edge - 1, 0) : edge + 2], 1, 60).any() == (
            3 <= number <= 7
        )
        caption = picture[-14:, :60]
        assert caption.min() < 60
        assert caption.max() > 180


@pytest.mark.parametrize("size", [(60, 80), (480, 640), (1080, 1920)])
def test_any_size(tmp_path, size):
    plots.write_track_video(tmp_path / "walk.mp4", walk(), grey([1, 2], size), RATE)
    assert VideoFrames(tmp_path / "walk.mp4")[1].shape == (*size, 3)


def test_lines_grow_with_the_frame():
    def thickness(size):
        (picture,) = drawn(walk([5, 6], top=size[0] / 2), grey([5], size))
        row = round(size[0] / 2) + 20
        return is_color(picture[row, 10:40], 1).sum()

    small, middle, large = (thickness((height, 2 * height)) for height in (240, 480, 1080))
    assert 1 <= small < middle < large <= 6


def test_an_identity_has_one_colour_in_all_frames_and_others_have_others():
    tracks = together(walk(identity=3), walk(identity=4, left=150.0))
    for picture in drawn(tracks, grey([1, 7, 12])):
        left, right = is_color(picture, 3), is_color(picture, 4)
        assert left[:, :150].sum() > 100
        assert right[:, 150:].sum() > 100
        assert not left[:, 150:].any()
        assert not right[:, :150].any()


def test_the_number_stands_above_the_box_and_inside_of_the_frame():
    (picture,) = drawn(walk([1, 2], top=60), grey([1]))
    assert is_color(picture[45:58, 20:28], 1).mean() > 0.3
    (picture,) = drawn(walk([1, 2], top=-20, left=-10), grey([1]))
    assert is_color(picture[:12, :8], 1).mean() > 0.3


def test_a_trail_of_the_last_second_fades():
    picture = drawn(walk(range(1, 31), left=20.0), grey(range(1, 31)))[29]
    foot = np.abs(picture[139:142] - GREY).max((0, 2))
    now = 20 + 8 * 29 + 15
    assert foot[now - 75 : now - 30].min() > 5
    assert foot[: now - 90].max() == 0
    assert foot[now - 30] > 1.5 * foot[now - 70]


def test_a_trail_stays_for_a_second_after_its_object_has_gone():
    pictures = drawn(walk(range(1, 6)), grey(range(1, 30)))
    changed = [bool((picture != GREY).any()) for picture in pictures]
    # The last line, from the foot in frame 4 to that in 5, is as old as the box in frame 4.
    assert changed == [frame <= 4 + RATE for frame in range(1, 30)]


def test_interpolated_boxes_are_dashed_unless_all_are_of_no_observation():
    def edge(missing):
        picture = drawn(walk(missing=missing), grey(range(1, 13)))[4]
        return is_color(picture[66:134, 20 + 8 * 4], 1)

    assert edge(()).all()
    assert edge(range(1, 13)).all()
    dashed = edge([5])
    assert 0.3 < dashed.mean() < 0.8
    assert np.abs(np.diff(dashed.astype(int))).sum() >= 4


def test_who_is_seen_once_is_grey_and_has_no_number():
    (picture,) = drawn(walk([1]), grey([1]))
    assert not is_color(picture, 1).any()
    faded = np.abs(picture - np.array(FADED) * 255).max(-1) < 30
    assert faded[60:141].any()
    assert (picture[:58] == GREY).all()
    assert (picture[70, 22:48] == GREY).all()


def test_who_is_in_front_is_drawn_in_front():
    near, far = walk([1, 2], identity=1, top=70), walk([1, 2], identity=2, top=60, left=35)
    (picture,) = drawn(together(far, near), grey([1]))
    # The right edge of the nearer one crosses the lower edge of the other: its colour is on top.
    assert is_color(picture[139:142, 50], 1).all()


def test_boxes_far_outside_are_no_obstacle(tmp_path):
    far = walk(left=-1e12, step=1e11)
    plots.write_track_video(tmp_path / "far.mp4", far, grey([1, 2]), RATE)
    assert len(VideoFrames(tmp_path / "far.mp4")) == 2


def test_frames_that_are_apart_play_as_fast_as_they_passed(tmp_path):
    import cv2

    def rate(numbers, frame_rate):
        plots.write_track_video(tmp_path / "v.mp4", walk(), grey(numbers), frame_rate)
        return cv2.VideoCapture(str(tmp_path / "v.mp4")).get(cv2.CAP_PROP_FPS)

    assert rate([1, 2, 3], 25.0) == pytest.approx(25)
    assert rate([1, 6, 11], 25.0) == pytest.approx(5)
    assert rate([1], 25.0) == pytest.approx(25)
    assert rate([1, 101], 25.0) == pytest.approx(2)


def test_a_frame_of_another_size_is_fitted(tmp_path):
    frames = [np.full((60, 80, 3), GREY, np.uint8), np.full((120, 160, 3), GREY, np.uint8)]
    shown = NumberedFrames(np.array([1, 2]), np.arange(2), frames)
    plots.write_track_video(tmp_path / "v.mp4", walk(), shown, RATE)
    assert VideoFrames(tmp_path / "v.mp4")[1].shape == (60, 80, 3)


def test_what_cannot_be_shown(tmp_path):
    path = tmp_path / "v.mp4"
    with pytest.raises(ValueError, match="frames: expected one or more"):
        plots.write_track_video(path, walk(), grey([]), RATE)
    two = Tracks([1, 1], [1, 1], np.zeros((2, 4)), camera=[0, 3])
    with pytest.raises(ValueError, match=r"expected one camera, got \[0, 3\]"):
        plots.write_track_video(path, two, grey([1]), RATE)
    with pytest.raises(OSError, match="cannot write this video"):
        plots.write_track_video(tmp_path / "nowhere" / "v.mp4", walk(), grey([1]), RATE)
    assert not path.exists()


def observed(index, frames, camera=None):
    """One box in each of these frames of a list, in one place."""
    index = torch.as_tensor(index)
    box = torch.tensor([[20.0, 20, 50, 100]]).expand(len(index), 4)
    features = {"box": box, "frame": index, "time": index / RATE}
    if camera is not None:
        features["camera"] = torch.as_tensor(camera)
    pixels = [np.full((120, 160, 3), GREY, np.uint8) for _ in range(frames)]
    return Observations(index, features, Images(pixels, index.numpy(), box.numpy()))


def test_the_video_of_an_association_shows_frames_without_observations(tmp_path):
    path = tmp_path / "v.mp4"
    plots.write_video(path, observed([1, 2, 5], 9), torch.zeros(3, dtype=torch.int64))
    frames = VideoFrames(path)
    assert len(frames) == 5
    has_box = [bool(is_color(frames[k][40:80, 19:22].astype(int), 0, 60).any()) for k in range(5)]
    assert has_box == [True, True, False, False, True]
    plots.write_video(path, observed([0, 4, 8], 9), torch.zeros(3, dtype=torch.int64))
    assert len(VideoFrames(path)) == 3


def test_cameras_that_take_turns_have_trails_of_their_own():
    box = np.array([[20.0, 20, 50, 100], [200, 20, 230, 100]] * 3)
    camera = np.array([0, 1] * 3)
    drawing = Drawing(np.arange(6), camera, np.zeros(6, int), box, np.zeros(6, bool))
    frames = grey(range(6))
    pictures = list(drawn_frames(drawing, frames, [""] * 6, RATE))
    assert (pictures[4][:, 70:] == GREY).all()
    assert (pictures[5][:, :180] == GREY).all()

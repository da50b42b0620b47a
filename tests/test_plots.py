import numpy as np
import pytest
import torch

from mixer_torch import plots
from mixer_torch.affinity import Affinity
from mixer_torch.association import Association, Status
from mixer_torch.observations import Images, Observations, VideoFrames
from mixer_torch.plots.clusters import clusters_figure
from mixer_torch.plots.frames import frames_figure, write_video
from mixer_torch.plots.style import (
    INK,
    MISSED,
    WRONG,
    by_size,
    colors,
    groups,
    is_wrong,
    wrong_by_truth,
)


class CountedFrames(list):
    """Frames that count how often each is read."""

    def __init__(self, frames):
        super().__init__(frames)
        self.reads = np.zeros(len(frames), dtype=int)

    def __getitem__(self, index):
        self.reads[index] += 1
        return super().__getitem__(index)


def found(labels):
    return Association(torch.as_tensor(labels, dtype=torch.int64), -1.0, Status.CONVERGED)


def scene(m=12, frames=4, identity=True):
    """m squares in a few grey frames, each filled with the colour of its object (i modulo 3)."""
    frame = np.arange(m) * frames // max(m, 1)
    pixels = [np.full((60, 80, 3), 90, dtype=np.uint8) for _ in range(frames)]
    box = np.zeros((m, 4), dtype=np.float32)
    for i in range(m):
        x = 8 + 22 * (i % 3)
        box[i] = (x, 20, x + 14, 48)
        pixels[frame[i]][20:48, x : x + 14] = (200, 60, 60) if i % 3 else (60, 60, 200)
    frame = torch.from_numpy(frame)
    features = {"box": torch.from_numpy(box), "frame": frame, "time": frame.double() / 5}
    if identity:
        features["identity"] = torch.arange(m) % 3
    images = Images(CountedFrames(pixels), frame.numpy(), box)
    return Observations(frame, features, images)


def block_means(full, block):
    kinds = np.unique(block)
    return [[full[np.ix_(block == a, block == b)].mean() for b in kinds] for a in kinds]


def drawn(axis):
    """The pixels that an axis shows as an image."""
    return np.asarray(axis.images[0].get_array())


def test_colours_depend_on_the_label_alone_and_are_told_apart():
    labels = np.arange(24)
    color = colors(labels)
    assert ((color >= 0) & (color <= 1)).all()
    assert np.array_equal(color[[5, 2]], colors(np.array([5, 2])))
    distance = np.linalg.norm(color[:, None] - color[None], axis=2) + 10 * np.eye(24)
    assert distance.min() > 0.12
    assert distance[:8, :8].min() > 0.2
    assert np.linalg.norm(color - WRONG, axis=1).min() > 0.25


def test_clusters_are_ranked_by_size_then_label():
    labels = np.array([3, 1, 1, 0, 3, 2])
    assert by_size(labels).tolist() == [1, 3, 0, 2]
    assert [members.tolist() for members in groups(labels)] == [[1, 2], [0, 4], [3], [5]]
    assert groups(labels[:0]) == []


@pytest.mark.parametrize(
    ("labels", "identity", "wrong"),
    [
        ([0, 0, 0], [5, 5, 6], [0, 0, 1]),
        ([0, 1, 2], [5, -1, 5], [0, 0, 0]),
        ([0, 0, 0], [-1, -1, 5], [1, 1, 0]),
        ([0, 0], [-1, -1], [1, 1]),
        ([], [], []),
    ],
)
def test_wrong_is_another_object_than_most_of_the_cluster(labels, identity, wrong):
    labels, identity = (np.array(value, dtype=np.int64) for value in (labels, identity))
    assert is_wrong(labels, identity).tolist() == [bool(value) for value in wrong]


def test_nothing_is_wrong_where_the_truth_is_not_known():
    assert not wrong_by_truth(scene(identity=False), np.zeros(12, dtype=np.int64)).any()


def test_the_affinity_is_drawn_in_the_order_of_the_clusters():
    labels = np.array([0, 1, 1, 0, 1])
    identity = torch.tensor([7, 8, 8, 7, 7])
    order = [1, 2, 4, 0, 3]
    rng = np.random.default_rng(0)
    score = rng.random((5, 5))
    score = (score + score.T) / 2
    affinity = Affinity.from_dense(score, np.arange(5))
    figure = plots.affinity_figure(affinity, found(labels), identity)
    evidence, clusters, truth = (drawn(axis) for axis in figure.axes[:3])
    expected = (2 * score - 1) * (1 - np.eye(5))
    np.testing.assert_allclose(evidence, expected[np.ix_(order, order)], atol=1e-6)
    vmin, vmax = figure.axes[0].images[0].get_clim()
    assert vmin == -vmax == pytest.approx(-np.abs(expected).max(), rel=1e-6)
    same = np.array([0, 0, 0, 1, 1])
    assert np.array_equal((clusters < 1).any(2), same[:, None] == same)
    np.testing.assert_allclose(clusters[0, 0], colors(np.array([1]))[0])
    np.testing.assert_allclose(truth[0, 1], INK)
    np.testing.assert_allclose(truth[0, 2], WRONG)
    np.testing.assert_allclose(truth[2, 3], MISSED)
    np.testing.assert_allclose(truth[0, 3], 1)


def test_there_is_no_panel_of_a_truth_that_is_not_known():
    affinity = Affinity.from_dense(np.full((3, 3), 0.5), np.arange(3))
    figure = plots.affinity_figure(affinity, found([0, 1, 2]))
    assert len([axis for axis in figure.axes if axis.images]) == 2


def test_links_without_labels_are_drawn_by_connected_component():
    affinity = Affinity.from_dense(np.full((4, 4), 0.5), np.arange(4))
    links = torch.tensor([[0, 2], [2, 3]])
    association = Association(None, 0.0, Status.INCONSISTENT, declared_links=links)
    clusters = drawn(plots.affinity_figure(affinity, association).axes[1])
    assert (clusters < 1).any(2).sum() == 9 + 1


def test_many_observations_are_averaged_in_blocks(monkeypatch):
    labels = np.sort(np.random.default_rng(1).integers(0, 5, 23))
    full = plots.affinity._together(labels)
    assert np.array_equal(full, labels[:, None] == labels)
    monkeypatch.setattr(plots.affinity, "LARGEST_MAP", 6)
    block = np.arange(23) * 6 // 23
    np.testing.assert_allclose(plots.affinity._together(labels), block_means(full, block))
    affinity = Affinity.from_dense(full.astype(float), np.arange(23))
    evidence = drawn(plots.affinity_figure(affinity, found(labels)).axes[0])
    order = np.concatenate([np.flatnonzero(labels == label) for label in by_size(labels)])
    sorted_full = (2.0 * full - 1 - np.eye(23))[np.ix_(order, order)]
    expected = block_means(sorted_full, block)
    np.testing.assert_allclose(evidence, expected, atol=1e-6)


def test_the_montage_shows_each_crop_in_the_frame_of_its_cluster():
    observations = scene()
    labels = torch.arange(12) % 3
    canvas = drawn(clusters_figure(observations, labels).axes[0])
    shown = {tuple(color) for color in canvas.reshape(-1, 3)}
    for color in colors(np.arange(3)):
        assert tuple(np.round(color * 255)) in shown
    assert tuple(np.round(np.array(WRONG) * 255)) not in shown
    assert (200, 60, 60) in shown
    assert (60, 60, 200) in shown


def test_the_montage_reads_frame_by_frame():
    observations = scene(24)
    observations.images.frames.reads[:] = 0
    clusters_figure(observations, torch.arange(24) % 6)
    # Cluster by cluster it would be 6 x 4 reads; the type checker of the tests reads some, too.
    assert observations.images.frames.reads.sum() < 12


def test_the_montage_frames_wrong_crops_in_red_and_says_how_many():
    labels = torch.arange(12) % 3
    labels[3] = 1
    axis = clusters_figure(scene(), labels).axes[0]
    shown = {tuple(color) for color in drawn(axis).reshape(-1, 3)}
    assert tuple(np.round(np.array(WRONG) * 255)) in shown
    assert "5 seen, 1 wrong" in [text.get_text() for text in axis.texts]


def test_the_montage_counts_what_it_has_no_room_for():
    axis = clusters_figure(scene(60, 60), torch.zeros(60, dtype=torch.int64), width=600).axes[0]
    texts = [text.get_text() for text in axis.texts]
    shown = 60 - int(next(text for text in texts if text.startswith("+"))[1:])
    assert "60 seen, 40 wrong" in texts
    assert 5 <= shown <= 10
    few = clusters_figure(scene(40, 40), torch.arange(40) // 2, lines=2, width=400).axes[0]
    assert "Not shown: 36 observations in smaller clusters." in few.texts[0].get_text()


def test_frames_have_a_box_for_each_observation_numbered_unless_alone():
    observations = scene()
    labels = torch.arange(12) % 3
    labels[11] = 3
    figure = frames_figure(observations, labels, most=3)
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["frame 0", "frame 2", "frame 3"]
    assert [len(axis.patches) for axis in figure.axes] == [3, 3, 3]
    texts = [[text.get_text() for text in axis.texts] for axis in figure.axes]
    assert texts == [["0", "1", "2"], ["0", "1", "2"], ["0", "1"]]
    box = figure.axes[1].patches[2]
    assert (box.get_x(), box.get_y(), box.get_width(), box.get_height()) == (52, 20, 14, 28)


def test_a_video_has_a_frame_for_each_frame_with_boxes_drawn(tmp_path):
    observations, told = scene(), []
    path = tmp_path / "tracks.mp4"
    write_video(path, observations, torch.arange(12) % 3, lambda *what: told.append(what))
    frames = VideoFrames(path)
    assert len(frames) == 4
    assert frames[0].shape == (60, 80, 3)
    assert told[-1] == ("video: frames", 4, 4)
    edge = frames[0][34, 8].astype(float) / 255
    assert np.abs(edge - colors(np.array([0]))[0]).max() < 0.35
    assert np.abs(edge - 90 / 255).max() > 0.15


@pytest.mark.parametrize("m", [0, 1])
def test_pictures_of_nothing_and_of_one(m, tmp_path):
    observations, labels = scene(m, 1), torch.zeros(m, dtype=torch.int64)
    affinity = Affinity.from_dense(np.full((m, m), 0.5), np.zeros(m, dtype=np.int64))
    figures = {
        "affinity": plots.affinity_figure(affinity, found(labels), observations["identity"]),
        "clusters": clusters_figure(observations, labels),
        "frames": frames_figure(observations, labels),
    }
    for name, figure in figures.items():
        plots.save(figure, tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").read_bytes()[:4] == b"\x89PNG"


def test_pictures_need_pixels_and_say_so():
    bare = Observations(torch.arange(2))
    labels = torch.zeros(2, dtype=torch.int64)
    with pytest.raises(ValueError, match="expected images"):
        clusters_figure(bare, labels)
    with pytest.raises(ValueError, match="expected images with boxes"):
        frames_figure(bare, labels)
    with pytest.raises(ValueError, match="at least one"):
        write_video("none.mp4", scene(0, 1), labels[:0])

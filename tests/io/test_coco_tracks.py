import json
import re

import numpy as np
import pytest
import torch
from drawn_tracks import assert_same, drawn_tracks
from hypothesis import given

from mixer_torch.datasets import COCO
from mixer_torch.io.tracks import read_coco, read_tracks, write_coco, write_tracks
from mixer_torch.observations import Observations
from mixer_torch.tracking import Tracks


@given(drawn_tracks(cameras=3))
def test_what_is_written_is_read(tmp_path_factory, columns):
    path = tmp_path_factory.mktemp("coco") / "tracks.json"
    write_coco(path, Tracks(**columns))
    assert_same(read_coco(path), Tracks(**columns), leave_out=("observation",))


def test_annotations_are_as_coco_has_them(tmp_path):
    path = tmp_path / "a.json"
    write_coco(path, Tracks([7, 7], [2, 1], [[0, 0, 2, 3], [5, 5, 6, 7]], [0.5, np.nan]), "person")
    content = json.loads(path.read_text())
    assert content["images"] == [{"id": 1, "video_id": 0, "frame_id": 7}]
    assert content["categories"] == [{"id": 1, "name": "person"}]
    assert content["annotations"] == [
        {"id": 1, "image_id": 1, "category_id": 1, "iscrowd": 0, "bbox": [5, 5, 1, 2], "area": 2,
         "track_id": 1},
        {"id": 2, "image_id": 1, "category_id": 1, "iscrowd": 0, "bbox": [0, 0, 2, 3], "area": 6,
         "score": 0.5, "track_id": 2},
    ]  # fmt: skip


def test_it_reads_with_pycocotools(tmp_path, capsys):
    coco = pytest.importorskip("pycocotools.coco")
    write_coco(tmp_path / "a.json", Tracks([7, 8], [2, 2], [[0, 0, 2, 3], [5, 5, 6, 7]]))
    read = coco.COCO(str(tmp_path / "a.json"))
    assert [one["bbox"] for one in read.loadAnns(read.getAnnIds(imgIds=[2]))] == [[5, 5, 1, 2]]
    capsys.readouterr()


def test_observations_go_out_and_come_back(tmp_path):
    box = torch.tensor([[0, 0, 2, 3], [1, 1, 4, 4], [torch.nan] * 4, [5, 5, 9, 9]])
    seen = Observations(
        torch.tensor([0, 1, 2, 2]),
        {
            "frame": torch.tensor([3, 3, 5, 5]),
            "camera": torch.tensor([0, 1, 0, 0]),
            "box": box,
            "confidence": torch.tensor([0.5, torch.nan, 1, 0.25]),
            "identity": torch.tensor([4, -1, 4, 0]),
        },
    )
    write_coco(tmp_path / "a.json", seen)
    back = COCO(tmp_path / "a.json").load()
    rows = [0, 3, 1]  # in order of camera and frame
    for name in ("frame", "camera", "box", "identity"):
        assert back[name].equal(seen[name][rows]), name
    np.testing.assert_array_equal(back["confidence"], seen["confidence"][rows])
    plain = Observations(seen.view, {"frame": seen["frame"], "box": box})
    write_coco(tmp_path / "b.json", plain)
    assert set(COCO(tmp_path / "b.json").load().features) == {"frame", "camera", "box", "category"}
    with pytest.raises(KeyError, match="'box'"):
        write_coco(tmp_path / "c.json", Observations(seen.view, {"frame": seen["frame"]}))


def annotated(folder, *annotations):
    images = [{"id": 10, "frame_id": 1}, {"id": 11, "frame_id": 2}]
    path = folder / "a.json"
    path.write_text(json.dumps({"images": images, "annotations": annotations}))
    return path


def one(image, **keys):
    return {"image_id": image, "bbox": [0, 0, 1, 1], **keys}


def test_tracks_of_other_people(tmp_path):
    path = annotated(
        tmp_path,
        one(11, instance_id=0, conf=0.5),
        one(10, instance_id=7),
        one(10),
        one(10, instance_id=7, iscrowd=1),
    )
    tracks = read_coco(path)
    assert tracks.frame.tolist() == [1, 2]
    assert tracks.identity.tolist() == [8, 1]
    np.testing.assert_array_equal(tracks.confidence, [np.nan, 0.5])
    assert len(read_coco(annotated(tmp_path))) == 0


def test_a_list_of_results_is_of_frames_by_their_image(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps([one(5, track_id=1, score=1), one(3, track_id=1, score=0.5)]))
    tracks = read_coco(path)
    assert tracks.frame.tolist() == [3, 5]
    assert tracks.confidence.tolist() == [0.5, 1]


def test_detections_and_twins_are_no_tracks(tmp_path):
    with pytest.raises(ValueError, match="no annotation has a 'track_id'"):
        read_coco(annotated(tmp_path, one(10)))
    path = annotated(
        tmp_path, one(10, track_id=2), one(10), one(11, track_id=2), one(10, track_id=2)
    )
    with pytest.raises(ValueError, match=re.escape(f"{path}: annotations[3]: track_id")):
        read_coco(path)


def test_a_writer_that_fails_leaves_what_was_there(tmp_path):
    path = annotated(tmp_path, one(10, track_id=1))
    before = path.read_text()
    tracks = Tracks([1], [1], np.ones((1, 4)))
    tracks.box[:, 2:] = np.inf
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_coco(path, tracks)
    assert path.read_text() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["a.txt", "a.json", "a.csv", "a.parquet"])
def test_the_file_name_says_the_format(tmp_path, name):
    tracks = Tracks([1, 2], [1, 1], [[0, 0, 1, 1], [1, 1, 2, 2]])
    write_tracks(tmp_path / name, tracks)
    assert_same(read_tracks(tmp_path / name), tracks)


def test_a_format_that_is_not_known_is_named(tmp_path):
    for call in (read_tracks, lambda path: write_tracks(path, Tracks([], [], []))):
        with pytest.raises(ValueError, match=r"expected a file name in \.txt, .*got .*a\.xml"):
            call(tmp_path / "a.xml")

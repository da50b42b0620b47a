import json
import re

import cv2
import numpy as np
import pytest
import torch

from mixer_torch.datasets import COCO


def image(number, **keys):
    return {"id": number, **keys}


def box(image_id, left=0, **keys):
    return {"image_id": image_id, "bbox": [left, 10, 20, 30], **keys}


def file_of(folder, annotations, images=None, **other):
    path = folder / "a.json"
    content = annotations if images is None else {"images": images, "annotations": annotations}
    path.write_text(json.dumps(content if images is None else content | other))
    return path


def test_detections_without_tracks(tmp_path):
    path = file_of(
        tmp_path, [box(7, 5, score=0.5), box(4, 1, score=1), box(7, 3)], [image(7), image(4)]
    )
    seen = COCO(path).load()
    assert seen.view.tolist() == [0, 1, 1]
    assert seen["frame"].tolist() == [4, 7, 7]
    assert seen["box"].tolist() == [[1, 10, 21, 40], [5, 10, 25, 40], [3, 10, 23, 40]]
    np.testing.assert_array_equal(seen["confidence"], [1, 0.5, np.nan])
    assert set(seen.features) == {"frame", "camera", "box", "confidence", "category"}
    assert seen.images is None


def test_videos_are_cameras_and_tracks_are_identities(tmp_path):
    images = [
        image("x", video_id=2, frame_id=0),
        image("y", video_id=1, frame_id=1),
        image("z", video_id=1, frame_id=0),
        image("w", video_id=2, frame_id=1),
    ]
    path = file_of(tmp_path, [box("x", track_id=3), box("y", track_id=3), box("w")], images)
    seen = COCO(path, frame_rate=10).load()
    assert seen["camera"].tolist() == [1, 2, 2]
    assert seen["frame"].tolist() == [1, 0, 1]
    assert seen["time"].tolist() == [0.1, 0, 0.1]
    assert seen.view.tolist() == [1, 2, 3]
    assert seen["identity"].tolist() == [3, 3, -1]


def test_results_without_images(tmp_path):
    seen = COCO(file_of(tmp_path, [box(9), box(2), box(9)])).load()
    assert seen["frame"].tolist() == [2, 9, 9]
    assert "confidence" not in seen.features
    empty = COCO(file_of(tmp_path, [])).load()
    assert len(empty) == 0
    assert empty["box"].shape == (0, 4)


def test_what_to_read(tmp_path):
    categories = [{"id": 1, "name": "person"}, {"id": 3, "name": "car"}]
    path = file_of(
        tmp_path,
        [box(k, score=k / 10, category_id=1 + 2 * (k % 2)) for k in range(8)]
        + [box(0, iscrowd=1, category_id=1, score=1)],
        [image(k) for k in range(8)],
        categories=categories,
    )
    assert COCO(path, start=1, stop=6, step=2).load()["frame"].tolist() == [1, 3, 5]
    assert COCO(path, step=4).load()["frame"].tolist() == [0, 4]
    assert COCO(path, min_confidence=0.6).load()["frame"].tolist() == [6, 7]
    for chosen in (["car"], [3], ["car", 3]):
        assert COCO(path, categories=chosen).load()["category"].tolist() == [3] * 4
    assert len(COCO(path, categories=["car", 1]).load()) == 8
    with pytest.raises(ValueError, match=r"some of person \(1\), car \(3\), got 'cart'"):
        COCO(path, categories=["cart"]).load()


def test_pixels_are_read_where_there_are_any(tmp_path):
    (tmp_path / "frames").mkdir()
    for k, value in ((1, 50), (2, 200)):
        frame = np.full((60, 80, 3), value, dtype=np.uint8)
        cv2.imwrite(str(tmp_path / "frames" / f"{k}.png"), frame)
    images = [image(k, file_name=f"{k}.png") for k in (1, 2, 3)]
    path = file_of(tmp_path, [box(2), box(1)], images)
    seen = COCO(path, images=tmp_path / "frames").load()
    crops = [seen.images.crop(i) for i in range(2)]
    assert [crop.shape for crop in crops] == [(30, 20, 3)] * 2
    assert [int(crop.max()) for crop in crops] == [50, 200]
    assert COCO(path, images=tmp_path / "frames", pixels=False).load().images is None
    assert COCO(path).load().images is None
    with pytest.raises(FileNotFoundError, match=r"1\.png does not exist"):
        COCO(path, pixels=True).load()
    nameless = file_of(tmp_path, [box(1)], [image(1)])
    with pytest.raises(ValueError, match="expected a 'file_name' of every image"):
        COCO(nameless, pixels=True).load()


def test_it_is_found_in_the_data_folder(tmp_path, monkeypatch):
    file_of(tmp_path, [box(1)])
    monkeypatch.setenv("MIXER_DATA", str(tmp_path))
    assert COCO("a.json").load().view.equal(torch.tensor([0]))
    with pytest.raises(FileNotFoundError, match=r"none\.json"):
        COCO("none.json").load()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"images": []}, "expected a list 'annotations', got none"),
        ({"annotations": {}}, "expected a list 'annotations', got dict"),
        ([[]], r"annotations\[0\]: expected an object, got list"),
        ("text", "expected an object or a list, got str"),
        ([{"bbox": [0, 0, 1, 1]}], r"annotations\[0\]: 'image_id' is missing"),
        ([{"image_id": 1}], r"annotations\[0\]: 'bbox' is missing"),
        ([box(1), box("b")], r"annotations\[1\]: image_id: expected a finite number, got 'b'"),
        ([box(1) | {"bbox": [0, 1, 2]}], r"annotations\[0\]: bbox: expected \[left, top"),
        ([box(1) | {"bbox": [0, 1, 2, None]}], r"bbox: expected a finite number, got None"),
        ([box(1) | {"bbox": [0, 0, 0, 5]}], r"\[0\]: bbox: expected a positive width and height"),
        ([box(1, track_id=1.5)], "track_id: expected a whole number, got 1.5"),
        ([box(1, score="high")], "score: expected a finite number, got 'high'"),
        ({"images": [image(1)], "annotations": [box(2)]}, r"\[0\]: there is no image 2"),
        ({"images": [image(1), image(1)], "annotations": []}, r"images\[1\]: id 1 is there"),
        ({"images": [{}], "annotations": []}, r"images\[0\]: 'id' is missing"),
        (
            {"images": [image(k, frame_id=5, video_id=2) for k in (1, 2)], "annotations": []},
            r"images\[1\]: frame 5 of video 2 is there already",
        ),
    ],
)
def test_mistakes_are_named(tmp_path, content, message):
    path = file_of(tmp_path, content)
    with pytest.raises(ValueError, match=re.escape(str(path)) + f".*{message}"):
        COCO(path).load()


def test_what_is_no_json_is_named_by_line(tmp_path):
    (tmp_path / "a.json").write_text('{"images": [],\n"annotations" []}')
    with pytest.raises(ValueError, match=r"a\.json, line 2: not readable as JSON"):
        COCO(tmp_path / "a.json").load()
    (tmp_path / "a.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"a\.json is not readable as text"):
        COCO(tmp_path / "a.json").load()


@pytest.mark.parametrize(
    ("argument", "message"),
    [({"step": 0}, "step: expected 1"), ({"frame_rate": 0}, "frame_rate: expected a positive")],
)
def test_arguments_out_of_range_are_named(argument, message):
    with pytest.raises(ValueError, match=message):
        COCO("a.json", **argument)

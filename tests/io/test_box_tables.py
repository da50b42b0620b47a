"""Tables of boxes: what each format says comes through, and malformed ones are named."""

import gzip
import json

import numpy as np
import pytest

from mixer_torch.io.box_tables import read_boxes

VATIC = """\
7 10 20 30 60 0 0 0 0 "PERSON"
7 12 20 32 60 1 1 0 1 "PERSON"
8 100 20 130 90 1 0 1 1 "PERSON on a bicycle"
"""
MOT = "1,-1,10,20,20,40,0.9,-1,-1,-1\n3,-1,12,20,20,40,0.4,-1,-1,-1\n"


def detections(*frames, width=200, height=100):
    return {
        "video_info": {"width": width, "height": height},
        "frames": [
            {
                "frame_number": number,
                "detections": [
                    {
                        "bbox": dict(zip(("left", "top", "right", "bottom"), box, strict=True)),
                        "confidence": confidence,
                    }
                    for *box, confidence in boxes
                ],
            }
            for number, boxes in frames
        ],
    }


def written(file, content):
    text = content if isinstance(content, str) else json.dumps(content)
    data = text.encode()
    file.write_bytes(gzip.compress(data) if file.suffix == ".gz" else data)
    return file


@pytest.mark.parametrize("name", ["a.txt", "a.txt.gz"])
def test_vatic(tmp_path, name):
    boxes = read_boxes(written(tmp_path / name, VATIC), truth=True)
    assert boxes.frame.tolist() == [0, 1]
    assert boxes.identity.tolist() == [7, 8]
    assert boxes.box.tolist() == [[10, 20, 30, 60], [100, 20, 130, 90]]
    assert boxes.confidence.tolist() == [1, 1]


@pytest.mark.parametrize("name", ["a.txt", "a.csv.gz"])
def test_motchallenge(tmp_path, name):
    boxes = read_boxes(written(tmp_path / name, MOT))
    assert boxes.frame.tolist() == [1, 3]
    assert boxes.box.tolist() == [[10, 20, 30, 60], [12, 20, 32, 60]]
    assert boxes.confidence.tolist() == [0.9, 0.4]
    assert boxes.identity.tolist() == [-1, -1]


def test_motchallenge_truth_leaves_out_what_is_to_be_ignored(tmp_path):
    text = "1,4,10,20,20,40,1,-1,-1,-1\n1,5,10,20,20,40,0,-1,-1,-1\n"
    boxes = read_boxes(written(tmp_path / "gt.txt", text), truth=True)
    assert boxes.identity.tolist() == [4]
    assert boxes.confidence.tolist() == [1]


@pytest.mark.parametrize("name", ["a.json", "a.json.gz"])
def test_json(tmp_path, name):
    content = detections((0, []), (4, [(0.1, 0.2, 0.5, 0.8, 0.7), (0, 0, 1, 1, 0.3)]))
    boxes = read_boxes(written(tmp_path / name, content))
    assert boxes.frame.tolist() == [4, 4]
    np.testing.assert_allclose(boxes.box, [[20, 20, 100, 80], [0, 0, 200, 100]])
    assert boxes.confidence.tolist() == [0.7, 0.3]


@pytest.mark.parametrize("content", ["", "\n\n", detections(), detections((0, []))])
def test_nothing_seen(tmp_path, content):
    name = "a.txt" if isinstance(content, str) else "a.json"
    boxes = read_boxes(written(tmp_path / name, content))
    assert len(boxes) == 0
    assert boxes.box.shape == (0, 4)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('7 10 20 30 60 0 0 0 "PERSON"', "line 4: expected 9 numbers, got 8"),
        ('7 10 20 30 x 0 0 0 0 "PERSON"', "line 4: expected a number, got 'x'"),
        ('7 10 20 10 60 3 0 0 0 "PERSON"', "line 4: expected x1 < x2"),
        ('7 10 20 30 nan 3 0 0 0 "PERSON"', "line 4: a number is not finite"),
        ('-7 10 20 30 60 3 0 0 0 "PERSON"', "line 4: expected an identity and a frame from 0"),
        ('7 10 20 30 60 1.5 0 0 0 "PERSON"', "line 4: identity or frame is not whole"),
        ('7 10 20 30 60 0 0 0 0 "PERSON"', "line 4: this identity is in this frame already"),
    ],
)
def test_vatic_malformed(tmp_path, line, message):
    file = written(tmp_path / "a.txt", VATIC + line)
    with pytest.raises(ValueError, match=message) as caught:
        read_boxes(file)
    assert str(file) in str(caught.value)


def without(key):
    content = detections((4, [(0.1, 0.2, 0.5, 0.8, 0.7)]))
    del content["frames"][0][key]
    return content


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not readable as JSON"),
        ({"frames": []}, "video_info: 'video_info' is missing"),
        ([1, 2], "video_info"),
        (without("frame_number"), r"frames\[0\]: 'frame_number' is missing"),
        (without("detections"), r"frames\[0\]: 'detections' is missing"),
        (detections((4, [(0.1, 0.2, "wide", 0.8, 0.7)])), r"frames\[0\]: .*'wide'"),
        (detections((4, [(10, 20, 50, 80, 0.7)])), "frame_number 4: expected a box in parts"),
        (detections((4, [(0.1, 0.2, 0.1, 0.8, 0.7)])), "frame_number 4: expected left < right"),
        (detections((-1, [(0.1, 0.2, 0.3, 0.8, 0.7)])), "expected a frame number from 0"),
        (detections((1, [(0.1, 0.2, 0.3, 0.8, float("nan"))])), "a number is not finite"),
        (detections(width=0), "video_info: expected a width and a height"),
    ],
)
def test_json_malformed(tmp_path, content, message):
    file = written(tmp_path / "a.json", content)
    with pytest.raises(ValueError, match=message) as caught:
        read_boxes(file)
    assert str(file) in str(caught.value)


def test_truth_without_identities(tmp_path):
    file = written(tmp_path / "a.json", detections((4, [(0.1, 0.2, 0.5, 0.8, 0.7)])))
    with pytest.raises(ValueError, match=r"a\.json: expected a table of true boxes"):
        read_boxes(file, truth=True)


def test_no_file_and_no_text(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.txt does not exist"):
        read_boxes(tmp_path / "nowhere.txt")
    (tmp_path / "a.txt.gz").write_text("not packed")
    with pytest.raises(ValueError, match=r"a\.txt\.gz is not readable as text"):
        read_boxes(tmp_path / "a.txt.gz")
    (tmp_path / "b.txt.gz").write_bytes(gzip.compress(MOT.encode() * 50)[:-20])
    with pytest.raises(ValueError, match=r"b\.txt\.gz is not readable as text"):
        read_boxes(tmp_path / "b.txt.gz")
    (tmp_path / "c.txt").write_bytes(b"\xff\xfe\xfd")
    with pytest.raises(ValueError, match=r"c\.txt is not readable as text"):
        read_boxes(tmp_path / "c.txt")

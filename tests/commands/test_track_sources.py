"""`mixer track` on what is no folder of a sequence: files of detections, classes, cameras."""

import json
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import csv, parquet
from track_inputs import files_in, lines, seen, text_of, true_lines, write_sequence

from mixer_torch.tracking.weights import Weights


def boxes(lanes=(0, 1), frames=range(1, 6)):
    return [(f, 100.0 * lane + 10 + f, 20.0) for f in frames for lane in lanes]


def write_coco(path, videos=1):
    """The same boxes as `lines`, in each of some videos."""
    images, annotations = [], []
    for video in range(videos):
        for frame in range(1, 6):
            images.append({"id": 10 * video + frame, "video_id": video, "frame_id": frame})
        for frame, left, top in boxes():
            one = {"id": len(annotations), "image_id": 10 * video + frame, "category_id": 1}
            annotations.append(one | {"bbox": [left, top, 30, 60], "score": 0.9, "track_id": 3})
    content = {"images": images, "annotations": annotations, "categories": []}
    Path(path).write_text(json.dumps(content))


def write_table(path, **more):
    frame, left, top = (list(column) for column in zip(*boxes(), strict=True))
    columns = {"frame": frame, "x1": left, "y1": top, "x2": [x + 30 for x in left]}
    columns |= {"y2": [y + 60 for y in top], "identity": [5] * len(frame)} | more
    write = parquet.write_table if Path(path).suffix == ".parquet" else csv.write_csv
    write(pa.table(columns), path)


@pytest.mark.parametrize("name", ["walk.txt", "walk.json", "walk.csv", "walk.parquet"])
def test_a_file_will_do(track, name):
    folder = write_sequence("folder")
    if name.endswith(".txt"):
        Path(name).write_text((folder / "det" / "det.txt").read_text())
    else:
        (write_coco if name.endswith(".json") else write_table)(name)
    code, out, err = track("folder", name, "--out", "out")
    assert code == 0, err
    assert text_of("walk").count("\n") == 10
    columns = [
        [line.split(",")[:6] for line in text_of(x).splitlines()] for x in ("folder", "walk")
    ]
    assert columns[0] == columns[1]
    assert out.count("30 frames per second; see --frame_rate") == 1
    assert "identity" not in seen()[1].features
    assert seen()[1]["time"].max() == pytest.approx(5 / 30, abs=0.04)
    row = next(line for line in out.splitlines() if line.startswith("walk"))
    assert row.split()[1:4] == ["5", "10", "2"]


def test_another_detector_of_a_sequence_is_measured_with_its_truth(track):
    folder = write_sequence("walk", truth=true_lines())
    (folder / "det" / "better.txt").write_text("\n".join(lines(lanes=[0])) + "\n")
    code, out, err = track("walk/det/better.txt", "walk/det/det.txt", "--out", "out")
    assert code == 0, err
    assert files_in("out") == {"better.txt", "walk.txt", "config.yaml"}
    assert "per second" not in out
    table = [line.split() for line in out.splitlines()[1:3]]
    assert [row[0] for row in table] == ["better", "walk"]
    assert [row[8] for row in table] == [f"{100 * 2 * 5 / 15:.1f}", "100.0"]


def test_times_of_a_table_and_a_frame_rate_that_is_said(track):
    write_table("own.csv", time=[10.0 * f for f, _, _ in boxes()])
    code, out, err = track("own.csv", "--out", "out")
    assert code == 0, err
    assert "note" not in out
    assert seen()[0]["time"].max() == 50
    assert track("own.csv", "--out", "out", "--frame_rate", 5)[0] == 0
    assert seen()[1]["time"].max() == 1


def test_parts_of_a_table(track):
    write_table("own.csv", confidence=[0.1 * k for k in range(10)])
    given = ("--start", 2, "--stop", 4, "--min_confidence", 0.45)
    code, out, err = track("own.csv", "--out", "out", *given)
    assert code == 0, err
    assert seen()[0]["frame"].tolist() == [3, 4, 4]
    assert out.splitlines()[1].split()[1:3] == ["3", "3"]


@pytest.mark.parametrize(
    ("columns", "argv", "message"),
    [
        (["frame"], [], "own.csv: column 'view' or 'frame' is missing"),
        (["x1", "x2", "y1", "y2"], [], "own.csv: expected columns 'x1', 'y1', 'x2' and 'y2'"),
        ([], ["--min_confidence", "0.5"], "own.csv has no column 'confidence'"),
    ],
)
def test_tables_that_cannot_be_tracked(track, columns, argv, message):
    write_table("whole.csv")
    table = csv.read_csv("whole.csv").drop_columns(columns)
    csv.write_csv(table, "own.csv")
    code, _, err = track("own.csv", "--out", "out", *argv)
    assert code == 2
    assert message in err
    assert not Path("out").exists()


def test_cameras_that_the_format_cannot_tell_apart_are_said_before_the_work(track):
    write_coco("two.json", videos=2)
    code, _, err = track("two.json", "--out", "out")
    assert code == 2
    assert "two is of 2 cameras, which mot cannot tell apart; choose --format coco" in err
    assert not Path("out").exists()
    assert track("two.json", "--out", "out", "--format", "csv")[0] == 0


def classed(line, kind, tail):
    return ",".join([*line.split(",")[:7], str(kind), *tail])


@pytest.mark.parametrize("tail", [["1"], ["0", "0"]])
def test_classes_of_detections_are_read_and_measured_apart(track, tail):
    rows = [classed(line, 1 + k % 2, tail) for k, line in enumerate(lines())]
    truth = [classed(line, 1 + k % 2, tail) for k, line in enumerate(true_lines())]
    write_sequence("uav", rows, truth)
    code, out, err = track("uav", "--out", "out")
    assert code == 0, err
    assert seen()[0]["category"].tolist() == [1, 2] * 5
    assert out.splitlines()[1].split()[8] == "100.0"
    code, out, err = track("uav", "--out", "out", "--classes", "[9]")
    assert code == 0
    assert "classes: uav/gt/gt.txt has none of [9]; it has 1, 2" in out


def test_places_in_the_columns_after_the_score_are_no_classes(track):
    write_sequence("mot15", [line.replace("-1,-1,-1", "2.5,3,-1") for line in lines()])
    assert track("mot15", "--out", "out")[0] == 0
    write_sequence("whole", [line.replace(",-1,-1,-1", ",2,3,-1") for line in lines()])
    assert track("whole", "--out", "out")[0] == 0
    assert all("category" not in one.features for one in seen())


def test_weights_of_ones_own_and_what_they_gain(track, monkeypatch):
    import mixer_torch.tracking.own as own

    monkeypatch.setattr(own, "SCENES", 2)
    frames = range(1, 60)
    for name, lanes in (("a", (0, 1)), ("b", (0, 1, 2))):
        clutter = [f"{f},-1,{40 * (f % 7)},100,30,60,0.2,-1,-1,-1" for f in frames]
        truth = true_lines(frames, lanes)
        write_sequence(name, lines(frames, lanes) + clutter, truth, length=60)
    code, _, err = track("a", "--train", "own.safetensors")
    assert code == 2
    assert "sequences: expected at least two" in err
    assert track("a", "b", "--train", "own.bin")[0] == 2
    code, out, err = track("a", "b", "--train", "own.safetensors")
    assert code == 0, err
    table = [line.split() for line in out.splitlines()[:5]]
    assert [row[:2] for row in table[1:]] == [[n, m] for n in "ab" for m in ("HOTA", "IDF1")]
    assert "mean gain on sequences held out: " in out
    assert Weights.load("own.safetensors").card["families"][0] == "own: a, b"
    assert files_in(".") == {"a", "b", "own.safetensors", "own_tracker.py", "lanes.yaml"}


@pytest.mark.parametrize(("source", "out"), [("det/walk.txt", "det"), ("linked/walk.txt", "det")])
def test_what_is_read_is_not_written_over(track, source, out):
    folder = write_sequence("folder")
    Path("det").mkdir()
    text = (folder / "det" / "det.txt").read_text()
    Path("det/walk.txt").write_text(text)
    Path("linked").symlink_to("det")
    code, _, err = track(source, "--out", out)
    assert code == 2
    assert "out: det/walk.txt is read, and would be written over" in err
    assert Path("det/walk.txt").read_text() == text
    assert files_in("det") == {"walk.txt"}


def test_boxes_that_no_picture_has_room_for_have_no_video(track):
    frame = [f for f, _, _ in boxes()]
    write_table("far.csv", x2=[1e7 + f for f in frame])
    code, out, err = track("far.csv", "--out", "out", "--video")
    assert code == 0, err
    assert "far: no video, as boxes reach further than any picture does" in out
    assert files_in("out") == {"far.txt", "config.yaml"}


def test_the_class_of_a_detection_does_not_depend_on_the_frames_chosen(track):
    rows = [classed(line, 0 if k < 4 else 2, ["0", "0"]) for k, line in enumerate(lines())]
    write_sequence("uav", rows)
    assert track("uav", "--out", "out", "--stop", 2)[0] == 0
    assert seen()[0]["category"].tolist() == [0] * 4


@pytest.mark.parametrize(
    ("sources", "message"),
    [
        (["a", "own.csv"], "train: expected sequences with gt/gt.txt beside them, got own.csv"),
        (["a", "blind"], "blind/gt/gt.txt does not exist"),
    ],
)
def test_weights_are_learned_from_what_has_truth(track, sources, message):
    write_sequence("a", truth=true_lines())
    write_sequence("blind")
    write_table("own.csv")
    code, _, err = track(*sources, "--train", "own.safetensors")
    assert code == 2
    assert message in err
    assert not Path("own.safetensors").exists()

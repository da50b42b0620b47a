"""Tables: each column becomes what the documentation says, and bad cells are named."""

import cv2
import numpy as np
import pyarrow as pa
import pytest
import torch
from pyarrow import parquet

from mixer_torch.datasets.table import Table

FULL = """\
frame,time,x1,y1,x2,y2,x,y,confidence,identity,embedding_0,embedding_1,speed,note
0,0.0,10,20,30,60,1.5,2.5,0.9,4,0.1,0.2,3,fast
0,0.0,50,20,70,60,,2.5,0.8,-1,,0.2,,slow
2,0.1,11,20,31,,1.6,2.6,,,0.1,0.3,4.5,
"""


@pytest.fixture
def table(tmp_path):
    def write(text, name="table.csv", **arguments):
        (tmp_path / name).write_text(text)
        return Table(tmp_path / name, **arguments)

    return write


def same(tensor, expected):
    np.testing.assert_allclose(tensor, expected, rtol=1e-6)


def test_columns(table):
    nan = np.nan
    seen = table(FULL).load()
    assert seen.view.tolist() == [0, 0, 2]
    assert seen["frame"].tolist() == [0, 0, 2]
    same(seen["time"], [0, 0, 0.1])
    same(seen["box"], [[10, 20, 30, 60], [50, 20, 70, 60], [nan] * 4])
    same(seen["position"], [[1.5, 2.5, 0], [nan] * 3, [1.6, 2.6, 0]])
    same(seen["confidence"], [0.9, 0.8, nan])
    assert seen["identity"].tolist() == [4, -1, -1]
    same(seen["embedding"], [[0.1, 0.2], [nan] * 2, [0.1, 0.3]])
    same(seen["speed"], [3, nan, 4.5])
    assert "note" not in seen.features
    assert seen["position"].dtype == seen["embedding"].dtype == torch.float32


def test_parquet_is_read_alike(table, tmp_path):
    from pyarrow import csv

    expected = table(FULL).load()
    parquet.write_table(csv.read_csv(tmp_path / "table.csv"), tmp_path / "table.parquet")
    seen = Table(tmp_path / "table.parquet").load()
    assert seen.features.keys() == expected.features.keys()
    for name, value in expected.features.items():
        same(seen[name], value)


def test_parquet_types(tmp_path):
    columns = {
        "view": pa.array(["b", "a", None]),
        "identity": pa.array(["x", "y", "x"]).dictionary_encode(),
        "embedding": pa.array([[1.0, 2.0], None, [3.0, 4.0]]),
        "shape": pa.array([[1, 2, 3]] * 3, pa.list_(pa.int32(), 3)),
        "parked": pa.array([True, False, None]),
        "x": pa.array([1.0, float("nan"), 3.0], pa.float32()),
        "y": pa.array([1, 2, 3], pa.int16()),
        "z": pa.array([7, 8, 9], pa.uint8()),
    }
    parquet.write_table(pa.table(columns), tmp_path / "t.parquet")
    seen = Table(tmp_path / "t.parquet").load()
    assert seen.view.tolist() == [1, 0, -1]
    assert seen["identity"].tolist() == [0, 1, 0]
    same(seen["embedding"], [[1, 2], [np.nan] * 2, [3, 4]])
    same(seen["shape"], [[1, 2, 3]] * 3)
    same(seen["parked"], [1, 0, np.nan])
    same(seen["position"], [[1, 1, 7], [np.nan] * 3, [3, 3, 9]])


def test_ragged_lists(tmp_path):
    columns = {"view": [0, 1], "embedding": [[1.0, 2.0], [3.0]]}
    parquet.write_table(pa.table(columns), tmp_path / "t.parquet")
    with pytest.raises(ValueError, match=r"row 2, column 'embedding': expected a list of 2"):
        Table(tmp_path / "t.parquet").load()


def test_views(table):
    assert table("view,frame\n5,1\n,1\n3,2\n").load().view.tolist() == [5, -1, 3]
    assert table("view\nb\na\nb\n").load().view.tolist() == [1, 0, 1]
    seen = table("camera,frame\nleft,7\nright,7\nleft,8\nleft,7\n").load()
    assert seen.view.tolist() == [0, 2, 1, 0]
    assert seen["camera"].tolist() == [0, 1, 0, 0]
    with pytest.raises(ValueError, match=r"column 'view' or 'frame' is missing; columns: x1, y1"):
        table("x1,y1\n1,2\n").load()


def test_identities(table):
    def read(*cells):
        text = "view,identity\n" + "".join(f"{i},{cell}\n" for i, cell in enumerate(cells))
        return table(text).load()["identity"].tolist()

    assert read("7", "007", " 3 ", "") == [7, 7, 3, -1]
    assert read("bob", "", "alice", "bob") == [1, -1, 0, 1]
    assert read("12", "a", "12") == [0, 1, 0]
    assert read("-5", "1") == [-1, 1]
    assert read("", "") == [-1, -1]
    assert read("9007199254740993", "9007199254740992") == [9007199254740993, 9007199254740992]
    with pytest.raises(ValueError, match="row 2, column 'identity': expected a whole number"):
        read("1", "1.5")


def test_frames(table):
    text = "frame\n" + "".join(f"{k}\n" for k in range(10))
    assert table(text, start=1, stop=7, step=3).load().view.tolist() == [1, 4, 7]
    assert table(text, step=4).load().view.tolist() == [0, 4, 8]
    assert table(text, stop=2).load().view.tolist() == [0, 1, 2]
    assert table(text, start=20).load().view.tolist() == []
    with pytest.raises(ValueError, match="column 'frame' is missing"):
        table("view\n1\n", start=1).load()


def test_time_from_frames(table):
    same(table("frame\n0\n5\n", frame_rate=10.0).load()["time"], [0, 0.5])
    same(table("frame,time\n0,3\n5,4\n", frame_rate=10.0).load()["time"], [3, 4])


def test_tabs_and_spaces(table):
    seen = table("frame\t x \ty\n1\t 2 \t3\n", "t.tsv").load()
    same(seen["position"], [[2, 3, 0]])


@pytest.mark.parametrize("name", ["t.csv", "t.parquet"])
def test_header_only(tmp_path, name):
    columns = {key: [] for key in FULL.splitlines()[0].split(",")}
    if name == "t.csv":
        (tmp_path / name).write_text(",".join(columns) + "\n")
    else:
        parquet.write_table(pa.table(columns), tmp_path / name)
    seen = Table(tmp_path / name).load()
    assert len(seen) == 0
    assert seen["box"].shape == (0, 4)
    assert seen["embedding"].shape == (0, 2)
    assert seen["identity"].dtype == torch.int64


def test_a_file_of_no_bytes_is_said_to_be_empty(table):
    with pytest.raises(ValueError, match=r"table\.csv is empty: expected a header with 'view' or"):
        table("").load()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("view,x,y\n1,2,3\n2,two,3\n", r"row 2, column 'x': expected a number, got 'two'"),
        ("view,x,y\n1,2,inf\n", r"row 1, column 'y': expected a finite number, got inf"),
        ("view,x\n1,2\n", r"column 'y' is missing; columns: view, x"),
        ("view,x1,y1,x2\n1,2,3,4\n", r"column 'y2' is missing"),
        ("view,x1,y1,x2,y2\n1,2,3,2,5\n", r"row 1, column 'x2': expected more than x1, got 2"),
        ("frame\n1\n\n", None),
        ("frame\n1\n1.5\n", r"row 2, column 'frame': expected a whole number, got 1.5"),
        ("frame,x,y\n1,2,3\n,2,3\n", r"row 2, column 'frame': expected a whole number, got None"),
        ("frame,camera\n1,\n", r"row 1, column 'camera': expected a number or a name"),
        ("view,speed\n1,2\n1,quick\n", r"row 2, column 'speed': expected a number, got 'quick'"),
        ("view,embedding_0,embedding_2\n1,2,3\n", r"column 'embedding_1' is missing"),
        ("view,time\n1,2020-01-01\n", r"column 'time': expected numbers, got date32"),
        ("view,view\n1,2\n", r"column 'view' appears 2 times"),
        ("view,x,y\n1,2,3\n1,2\n", r"not readable as a table: .*#3: Expected 3 columns, got 2"),
    ],
)
def test_malformed(table, text, message):
    dataset = table(text)
    if message is None:
        assert len(dataset.load()) == 1
        return
    with pytest.raises(ValueError, match=message) as caught:
        dataset.load()
    assert str(dataset.path) in str(caught.value)


def test_not_parquet(table):
    with pytest.raises(ValueError, match="not readable as a table"):
        table("view\n1\n", "t.parquet").load()
    with pytest.raises(FileNotFoundError, match=r"nowhere\.csv"):
        Table("nowhere.csv").load()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"step": 0}, "step"),
        ({"frame_rate": 0.0}, "frame_rate"),
        ({"images": "a", "video": "b"}, "expected one of them"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        Table("anywhere.csv", **arguments)


def test_images_by_pattern(table, tmp_path):
    for k in (1, 2):
        cv2.imwrite(str(tmp_path / f"{k:03d}.png"), np.full((20, 30, 3), 100 * k, np.uint8))
    text = "frame,x1,y1,x2,y2,file\n2,1,1,5,6,001.png\n1,1,1,5,6,002.png\n2,1,1,9,6,001.png\n"
    seen = table(text, images="{frame:03d}.png").load()
    assert [int(seen.images.crop(i)[0, 0, 0]) for i in range(3)] == [200, 100, 200]
    assert seen.images.crop(2).shape == (5, 8, 3)
    assert len(seen.images.frames) == 2
    seen = table(text, images="{file}", start=2).load()
    assert [int(seen.images.crop(i)[0, 0, 0]) for i in range(2)] == [100, 100]
    whole = table("view,file\n0,001.png\n", images="{file}").load()
    assert whole.images.crop(0).shape == (20, 30, 3)
    assert len(table("frame\n1.0\n2\n", images="{frame:03d}.png").load().images) == 2
    for pattern in ("{file:03d}.png", "{}.png"):
        with pytest.raises(ValueError, match=r"images: .* does not fit the columns"):
            table(text, images=pattern).load()
    with pytest.raises(FileNotFoundError, match=r"frame .*003\.png does not exist"):
        table("frame\n3\n", images="{frame:03d}.png").load()
    with pytest.raises(ValueError, match="column 'name' is missing"):
        table("frame\n3\n", images="{name}").load()


def test_images_of_a_video(table, tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 5, (64, 48))
    for k in range(4):
        writer.write(np.full((48, 64, 3), 60 * k, np.uint8))
    writer.release()
    seen = table("frame\n4\n2\n", video="v.avi", first_frame=1).load()
    assert [int(seen.images.crop(i).mean()) for i in range(2)] == pytest.approx([180, 60], abs=3)
    with pytest.raises(ValueError, match="row 2, column 'frame': expected a frame of the video"):
        table("frame\n0\n4\n", video="v.avi").load()
    assert len(table("frame\n0\n4\n", video="v.avi", stop=0).load()) == 1
    with pytest.raises(ValueError, match="more than one camera"):
        table("camera,frame\n0,0\n1,0\n", video="v.avi").load()

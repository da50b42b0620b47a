import re

import numpy as np
import pytest
import torch
from drawn_tracks import assert_same, drawn_tracks
from hypothesis import given
from hypothesis import strategies as st

from mixer_torch.datasets import Table
from mixer_torch.io.results import write_associations
from mixer_torch.io.tracks import read_table, write_table
from mixer_torch.observations import Observations
from mixer_torch.tracking import Tracks


@given(drawn_tracks(cameras=3), st.sampled_from(["csv", "tsv", "parquet", "pq", "CSV"]))
def test_what_is_written_is_read(tmp_path_factory, columns, suffix):
    path = tmp_path_factory.mktemp("table") / f"tracks.{suffix}"
    write_table(path, Tracks(**columns))
    assert_same(read_table(path), Tracks(**columns))


def test_a_table_reads_for_people_and_as_a_dataset(tmp_path):
    path = tmp_path / "tracks.csv"
    write_table(path, Tracks([2, 1], [1, 3], [[0, 1, 2.5, 3], [4, 5, 6, 7]], [np.nan, 0.5]))
    assert path.read_text() == (
        "frame,identity,x1,y1,x2,y2,confidence,camera,observation\n"
        "1,3,4,5,6,7,0.5,0,-1\n"
        "2,1,0,1,2.5,3,,0,-1\n"
    )
    observations = Table(path).load()
    assert observations["identity"].tolist() == [3, 1]
    assert observations["box"][1].tolist() == [0, 1, 2.5, 3]


def test_the_table_of_an_association_is_tracks(tmp_path):
    path = tmp_path / "associations.csv"
    box = torch.arange(16.0).reshape(4, 4)
    box[3] = torch.nan
    observations = Observations(torch.arange(4), {"frame": torch.arange(4), "box": box})
    write_associations(path, observations, torch.tensor([1, 0, 0, 0]))
    tracks = read_table(path)
    assert tracks.identity.tolist() == [2, 1, 1]
    assert tracks.observation.tolist() == [0, 1, 2]


def test_identities_and_cameras_may_be_names_or_missing(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(
        "camera,frame,identity,x1,y1,x2,y2\nwest,1,bo,0,0,1,1\neast,1,bo,0,0,1,1\neast,1,,0,0,1,1\n"
        "east,2,al,0,0,1,1\n"
    )
    tracks = read_table(path)
    assert tracks.identity.tolist() == [2, 2, 1]
    assert tracks.camera.tolist() == [0, 1, 0]
    path.write_text("frame,identity,x1,y1,x2,y2\n1,0,0,0,1,1\n1,4,0,0,1,1\n1,-1,0,0,1,1\n")
    assert read_table(path).identity.tolist() == [1, 5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty: expected a header"),
        ("frame,x1,y1,x2,y2\n1,0,0,1,1\n", "column 'identity' is missing"),
        ("identity,x1,y1,x2,y2\n1,0,0,1,1\n", "column 'frame' is missing"),
        ("frame,identity,x1,y1,x2\n1,1,0,0,1\n", "column 'y2' is missing"),
        ("frame,identity,x1,y1,x2,y2\n1,1,0,0,1,a\n", "row 1, column 'y2': expected a number"),
        ("frame,identity,x1,y1,x2,y2\n1,1,0,0,1,1\n1,1,0,0,2,2\n", "row 2, column 'identity'"),
        ("frame,identity,x1,y1,x2,y2\n1,1,0,0,1,1\n1.5,1,0,0,2,2\n", "row 2, column 'frame'"),
    ],
)
def test_mistakes_are_named(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=re.escape(str(path)) + f".*{message}"):
        read_table(path)


def test_a_header_alone_is_no_tracks(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("frame,identity,x1,y1,x2,y2\n")
    assert len(read_table(path)) == 0


def test_files_that_are_not_there_or_of_other_names(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.csv does not exist"):
        read_table(tmp_path / "none.csv")
    with pytest.raises(ValueError, match=r"expected a file name in \.csv"):
        write_table(tmp_path / "a.xls", Tracks([], [], []))

import csv
import json
import re

import pytest
import torch

from mixer_torch.affinity import Affinity
from mixer_torch.association import Association, Status
from mixer_torch.commands.text import result_table
from mixer_torch.fusion import LinearFusion
from mixer_torch.io.files import write_json
from mixer_torch.io.results import (
    COLUMNS,
    Result,
    known_identity,
    read_labels,
    staged,
    write_associations,
    write_tables,
    write_tracks,
)
from mixer_torch.observations import Observations


def seen(m=4, **features):
    box = torch.arange(4 * m, dtype=torch.float32).reshape(m, 4) * torch.tensor([1, 1, 2, 3])
    frame = torch.arange(m) // 2 + 160
    return Observations(torch.arange(m) // 2, {"box": box, "frame": frame, **features})


def found(*labels):
    return Association(torch.tensor(labels, dtype=torch.int64), -1.0, Status.CONVERGED)


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_associations_hold_each_observation_once_in_order(tmp_path):
    path = tmp_path / "associations.csv"
    write_associations(path, seen(), torch.tensor([0, 1, 1, 0]))
    table = rows(path)
    assert tuple(table[0]) == COLUMNS
    assert [row["label"] for row in table] == ["0", "1", "1", "0"]
    assert table[2] == dict(
        zip(COLUMNS, ["2", "1", "161", "8.000", "9.000", "20.000", "33.000", "1"], strict=True)
    )


def test_what_is_not_known_is_an_empty_cell(tmp_path):
    path = tmp_path / "associations.csv"
    box = torch.full((2, 4), torch.nan)
    write_associations(path, Observations(torch.tensor([0, -1]), {"box": box}), None)
    assert [list(row.values()) for row in rows(path)] == [
        ["0", "0", "", "", "", "", "", ""],
        ["1", "-1", "", "", "", "", "", ""],
    ]


def test_tracks_are_in_the_motchallenge_format_by_frame_then_identifier(tmp_path):
    confidence = torch.tensor([0.5, 1.0, torch.nan, 0.25])
    observations = seen(confidence=confidence)
    observations["box"][3] = torch.nan
    write_tracks(tmp_path / "tracks.txt", observations, torch.tensor([1, 0, 0, 2]))
    assert (tmp_path / "tracks.txt").read_text().splitlines() == [
        "160,1,4.00,5.00,8.00,16.00,1,-1,-1,-1",
        "160,2,0.00,1.00,4.00,8.00,0.5,-1,-1,-1",
        "161,1,8.00,9.00,12.00,24.00,-1,-1,-1,-1",
    ]


def test_each_camera_has_tracks_of_its_own(tmp_path):
    frame, camera = torch.full((4,), 7), torch.tensor([2, 5, 2, 5])
    observations = seen(frame=frame, camera=camera)
    write_tracks(tmp_path / "tracks.txt", observations, torch.tensor([1, 1, 0, 2]))
    lines = {path.name: path.read_text().split() for path in tmp_path.iterdir()}
    assert {name: [line[:4] for line in rows] for name, rows in lines.items()} == {
        "tracks_camera2.txt": ["7,1,", "7,2,"],
        "tracks_camera5.txt": ["7,2,", "7,3,"],
    }


def test_two_boxes_in_a_frame_are_no_track(tmp_path):
    observations = seen(frame=torch.full((4,), 7))
    write_tracks(tmp_path / "tracks.txt", observations, torch.tensor([0, 0, 1, 2]))
    assert not list(tmp_path.iterdir())
    observations["box"][1] = torch.inf
    write_tracks(tmp_path / "tracks.txt", observations, torch.tensor([0, 0, 1, 2]))
    assert len((tmp_path / "tracks.txt").read_text().split()) == 3


@pytest.mark.parametrize(
    ("identity", "known"), [(None, False), ([-1] * 4, False), ([-1, 3, 3, -1], True)]
)
def test_identities_that_are_all_missing_are_not_known(identity, known):
    features = {} if identity is None else {"identity": torch.tensor(identity)}
    assert (known_identity(seen(**features)) is not None) == known


def test_metrics_are_of_all_and_where_there_are_any_of_each_alone():
    observations = seen(identity=torch.tensor([0, 1, 0, 1]))
    pairs = torch.tensor([[0, 0, 1, 1], [2, 3, 2, 3]])
    affinity = Affinity(pairs, torch.full((1, 4), 0.5), observations.view, ("A",))
    together = Result(observations, affinity, found(0, 1, 0, 1)).metrics()
    assert list(together) == ["all"]
    assert together["all"]["f1"] == 1
    metrics = Result(observations, affinity, found(0, 1, 0, 1), {"A": found(0, 1, 1, 0)}).metrics()
    assert list(metrics) == ["all", "alone"]
    assert metrics["alone"]["A"]["f1"] == 0


def test_a_gallery_of_several_cameras_is_ranked_too():
    identity, camera = torch.tensor([0, 1, 0, 1]), torch.tensor([1, 1, 2, 2])
    observations = Observations(torch.full((4,), -1), {"identity": identity, "camera": camera})
    pairs = torch.tensor([[0, 0, 1, 1], [2, 3, 2, 3]])
    scores = torch.tensor([[0.6, 0.4, 0.4, 0.6], [0.2, 0.9, 0.9, 0.2]])
    affinity = Affinity(pairs, scores, observations.view, ("A", "B"))
    alone = {"A": found(0, 1, 0, 1), "B": found(0, 1, 1, 0)}
    weighted = LinearFusion({"B": 0.1})
    for fusion, rank1 in ((None, 0), (weighted, 1)):
        metrics = Result(observations, affinity, found(0, 1, 0, 1), alone, fusion).metrics()
        assert metrics["all"]["rank1"] == rank1
        assert [metrics["alone"][name]["rank1"] for name in "AB"] == [1, 0]
    assert metrics["all"] | {"f1": 1, "bcubed_f1": 1, "map": 1, "queries": 4} == metrics["all"]
    text = result_table(Result(observations, affinity, found(0, 1, 0, 1), alone, fusion))
    assert text.split()[:7] == ["precision", "recall", "F1", "bcubed", "f1", "rank1", "map"]


def test_links_without_labels_are_written_as_links(tmp_path):
    observations = seen()
    links = torch.tensor([[0, 1], [2, 2]])
    affinity = Affinity(links, torch.ones(1, 2), observations.view, ("A",))
    association = Association(None, -2.0, Status.INCONSISTENT, declared_links=links)
    write_tables(tmp_path, Result(observations, affinity, association))
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"associations.csv", "links.csv", "affinity.npz"}
    assert (tmp_path / "links.csv").read_text().split() == ["first,second", "0,2", "1,2"]
    assert {row["label"] for row in rows(tmp_path / "associations.csv")} == {""}


def fail_after_writing(path):
    path.write_text("new")
    raise ValueError("broken")


def test_a_failure_leaves_the_place_as_it_was(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "metrics.json").write_text("old")
    with pytest.raises(ValueError, match="broken"), staged(out) as folder:
        fail_after_writing(folder / "metrics.json")
    assert (out / "metrics.json").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_failure_makes_no_folder(tmp_path):
    with pytest.raises(ValueError, match="broken"), staged(tmp_path / "a" / "out"):
        raise ValueError("broken")
    assert not (tmp_path / "a" / "out").exists()


def test_a_new_result_replaces_the_old_one_and_leaves_other_files_alone(tmp_path):
    for name in ("metrics.json", "tracks.txt", "tracks_camera3.txt", "notes.txt"):
        (tmp_path / name).write_text("old")
    with staged(tmp_path) as folder:
        (folder / "tracks.txt").write_text("new")
    left = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert left == {"tracks.txt": "new", "notes.txt": "old"}


def test_a_file_in_the_place_of_the_folder_is_named(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(NotADirectoryError, match=re.escape(str(tmp_path / "out"))):
        staged(tmp_path / "out").__enter__()


def test_labels_are_read_back_as_they_were_written(tmp_path):
    labels = torch.tensor([0, 1, 1, 0])
    write_associations(tmp_path / "a.csv", seen(), labels)
    table = read_labels(tmp_path / "a.csv")
    assert set(table) == {"observation", "view", "label"}
    assert table["label"].equal(labels)
    assert table["observation"].equal(torch.arange(4))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "column 'label'; columns: none"),
        ("observation,view\n0,0\n", "column 'label'; columns: observation, view"),
        ("label\n0\nx\n", "line 3: expected an integer in column 'label', got 'x'"),
        ("label\n0\n1.5\n", "line 3: .*got '1.5'"),
        ("view,label\n0\n", "line 2: .*'label', got None"),
    ],
)
def test_malformed_labels_are_named(tmp_path, text, message):
    (tmp_path / "labels.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_labels(tmp_path / "labels.csv")


def test_json_is_json(tmp_path):
    write_json(tmp_path / "metrics.json", {"all": {"f1": 0.5}})
    assert json.loads((tmp_path / "metrics.json").read_text()) == {"all": {"f1": 0.5}}

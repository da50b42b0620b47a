"""The tracking benchmark: what peers are fed and give back, the oracle, and what rows become."""

import numpy as np
import pytest
import torch

from mixer_torch.benchmarks import peers, results, tracking, tracking_report
from mixer_torch.datasets import Crowd
from mixer_torch.tracking import Tracks


@pytest.fixture
def folder(tmp_path):
    """A sequence of two people who walk past each other, one false and one missed detection."""
    folder = tmp_path / "TWO"
    for name in ("det", "gt"):
        (folder / name).mkdir(parents=True)
    (folder / "seqinfo.ini").write_text("[Sequence]\nframeRate=10\nseqLength=12\n")
    truth, found = [], []
    for frame in range(1, 11):
        for person, left in ((1, 10.0 * frame), (2, 300.0 - 10 * frame)):
            truth.append(f"{frame},{person},{left},50,40,100,1,-1,-1,-1")
            if (frame, person) != (5, 2):
                found.append(f"{frame},-1,{left + 1},50,40,100,0.97,-1,-1,-1")
    truth.append("3,9,600,50,40,100,0,-1,-1,-1")  # to be ignored
    found.append("4,-1,600,50,40,100,0.6,-1,-1,-1")
    (folder / "gt" / "gt.txt").write_text("\n".join(truth) + "\n")
    (folder / "det" / "det.txt").write_text("\n".join(found) + "\n")
    return folder


def one_for_all(observations, frames):
    return Tracks.from_labels(observations, torch.arange(len(observations))), None


def test_rows(folder, monkeypatch, tmp_path):
    monkeypatch.setattr(tracking, "OURS", {})
    monkeypatch.setattr(tracking, "held_out", lambda families, out: dict.fromkeys(families))
    monkeypatch.setattr(
        tracking.peers, "installed", lambda: {"one for all": lambda *a: one_for_all(*a)[0]}
    )
    rows = tracking.run({"ours": [tracking.Scene(folder)]}, tmp_path / "out")
    assert [(row["family"], row["tracker"], row["sequence"]) for row in rows] == [
        ("ours", "one for all", "TWO"), ("ours", "one for all", "combined"),
        ("ours", "oracle", "TWO"), ("ours", "oracle", "combined"),
    ]  # fmt: skip
    apart, oracle = rows[0], rows[2]
    assert (apart["frames"], apart["detections"], apart["tracks"]) == (12, 20, 20)
    # Each of 2 people is seen in one of 20 tracks of one box: IDTP 2, IDFP 18, IDFN 18.
    assert apart["IDF1"] == pytest.approx(100 * 2 * 2 / (20 + 20))
    # The oracle misses one of 20 true boxes and drops the false one.
    assert oracle["IDF1"] == pytest.approx(100 * 2 * 19 / (20 + 19))
    assert (oracle["IDSW"], oracle["tracks"]) == (0, 2)
    assert "seconds" not in oracle
    assert apart["seconds"] > 0


def test_weights_of_a_family_are_learned_on_the_others(folder, monkeypatch, tmp_path):
    learned = []

    class Found:
        def save(self, file):
            file.write_text("")

    def train(families):
        learned.append(set(families))
        return Found()

    monkeypatch.setattr(tracking, "train", train)
    monkeypatch.setattr(tracking, "simulated", lambda count: [])
    monkeypatch.setattr(tracking.Weights, "load", lambda file: file.name)
    scenes = {name: [tracking.Scene(folder)] for name in "abc"}
    found = tracking.held_out(scenes, tmp_path)
    assert learned == [
        set("bc") | {"simulated"},
        set("ac") | {"simulated"},
        set("ab") | {"simulated"},
    ]
    assert found == {name: f"without_{name}.safetensors" for name in "abc"}
    tracking.held_out(scenes, tmp_path)
    assert len(learned) == 3


def test_peers_are_fed_every_frame():
    observations = Crowd(3, 6, seed=1).load()
    observations = observations.select(observations["frame"] != 2)
    order = torch.from_numpy(np.random.default_rng(0).permutation(len(observations)))
    boxes, confidences = peers._by_frame(observations.select(order), 8)
    boxes, confidences = list(boxes), list(confidences)
    assert len(boxes) == len(confidences) == 8
    assert [len(box) for box in boxes] == [
        int((observations["frame"] == frame).sum()) for frame in range(1, 9)
    ]
    assert len(boxes[1]) == len(boxes[7]) == 0


@pytest.mark.parametrize("name", peers.PEERS)
def test_peers_follow_one_who_walks(name):
    pytest.importorskip(peers.PEERS[name][0])
    frame = np.repeat(np.arange(1, 31), 2)
    left = np.where(np.arange(60) % 2, 600.0 - 4 * frame, 10.0 + 4 * frame)
    box = torch.from_numpy(np.stack([left, 0 * left, left + 40, 0 * left + 100], 1))
    features = {
        "frame": torch.from_numpy(frame),
        "box": box,
        "confidence": torch.full((60,), 0.9),
    }
    seen = Crowd(0, 0).load()
    observations = type(seen)(features["frame"], features)
    tracks = peers.installed()[name](observations, 30)
    assert len(np.unique(tracks.identity)) == 2
    assert tracks.frame.max() == 30
    nothing = observations.select(torch.zeros(60, dtype=torch.bool))
    assert len(peers.installed()[name](nothing, 5)) == 0


def test_report(tmp_path):
    names = ("MIXER", "MIXER online", "SORT", "oracle")
    rows = [
        {
            "family": family, "tracker": name, "sequence": sequence, "HOTA": 40 + k, "AssA": 41.0,
            "DetA": 42.0, "IDF1": 50.0 + k, "MOTA": 44.0, "IDSW": 9 - k, "Frag": 1, "tracks": 5,
            "frames": 100, "detections": 900,
            **({} if name == "oracle" else {"seconds": 2.0, "peak_mib": 3.0}),
        }
        for family in ("cars", "people")
        for k, name in enumerate(names)
        for sequence in ("A", "B", "combined")
    ]  # fmt: skip
    speed = [
        {
            "tracker": name, "people": 50, "frames": 100, "detections": 5000, "seconds": 1.0,
            "peak_mib": 400, "HOTA": 80, "IDF1": 90,
            **({"latency_median_ms": 4.0, "latency_p99_ms": 5.0} if "online" in name else {}),
        }
        for name in names[:2]
    ]  # fmt: skip
    results.write(tmp_path / "rows.csv", tracking.COLUMNS, rows)
    results.write(tmp_path / "speed.csv", tracking.SPEED_COLUMNS, speed)
    text = tracking_report.make(tmp_path)
    assert "| | cars | people |" in text
    assert "| SORT | **42.0** / **41.0** / **52.0** |" in text  # the oracle's 43 does not count
    assert "| SORT | 42.0 (7) | 42.0 (7) | 42.0 (7) | 50 |" in text
    assert "| MIXER online | 50 | 100 | 100 | 400 | 80.0 | 90.0 | 4.0 | 5.0 |" in text
    assert "Not installed, so left out: ByteTrack, OC-SORT, C-BIoU, norfair, ARC-SORT" in text
    assert (tmp_path / "tracking.png").stat().st_size > 10_000


@pytest.mark.real_data
def test_figures_of_the_peers(real_data, monkeypatch):
    for package in ("trackers", "norfair"):
        pytest.importorskip(package)
    monkeypatch.setattr(tracking, "OURS", {})
    monkeypatch.setattr(tracking, "held_out", lambda families, out: dict.fromkeys(families))
    rows = tracking.run(tracking.families_of([real_data / "mot15"]), None)
    found = {row["tracker"]: row for row in rows if row["sequence"] == "combined"}
    for name, expected in {
        "SORT": (39.2, 36.8, 51.5),
        "ByteTrack": (38.7, 35.2, 52.6),
        "norfair": (39.5, 37.9, 53.4),
        "oracle": (52.3, 56.4, 83.1),
    }.items():
        assert [found[name][key] for key in ("HOTA", "AssA", "IDF1")] == pytest.approx(
            expected, abs=0.06
        )
    assert found["norfair"]["IDSW"] == 113

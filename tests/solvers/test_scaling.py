"""benchmarks/scaling.py where there is a GPU, which is pretended."""

import pytest
import torch
from pretended_device import DEVICE, Generator, PretendedDevice

from mixer_torch.benchmarks import results, scaling


@pytest.fixture
def events(monkeypatch):
    """What is asked of torch.cuda and of the clock, in order."""
    events = []
    answers = {
        "synchronize": None,
        "reset_peak_memory_stats": None,
        "memory_allocated": 2**20,
        "max_memory_allocated": 3 * 2**20,
        "get_device_name": "Pretended",
    }
    for name, value in answers.items():
        monkeypatch.setattr(torch.cuda, name, lambda n=name, v=value: events.append(n) or v)
    clock = scaling.time.perf_counter
    monkeypatch.setattr(scaling.time, "perf_counter", lambda: events.append("clock") or clock())
    return events


def test_the_clock_stops_when_the_gpu_has_finished(events):
    _, seconds, peak = scaling.timed("cuda", lambda: events.append("solve"))
    before = ["synchronize", "reset_peak_memory_stats", "memory_allocated"]
    once = ["clock", "solve", "synchronize", "clock", "synchronize", "max_memory_allocated"]
    assert events == 2 * [*before, *once]
    assert 0 <= seconds < 1
    assert peak == 2


def test_a_gpu_has_rows_of_its_own(events, monkeypatch, tmp_path):
    monkeypatch.setattr(torch, "Generator", Generator)
    monkeypatch.setattr(scaling, "DETECTIONS", 6)
    with PretendedDevice() as device:
        rows = [
            *scaling.step("dense", 40, 0, DEVICE.type),
            *scaling.step("batch", 2, 0, DEVICE.type),
        ]
    assert device.moved["to the host"] > 0
    host = scaling.step("dense", 40, 0, "cpu")
    assert rows[0]["objective"] == pytest.approx(host[0]["objective"], rel=1e-3)
    results.write(tmp_path / "rows.csv", scaling.COLUMNS, rows + host)
    lines = scaling.main(["--out", str(tmp_path), "--from_rows"]).splitlines()
    assert [line.split("|")[2].strip() for line in lines[2:6]] == ["Pretended"] * 3 + ["cpu"]
    assert lines[2].endswith("| - | - | - | - |")
    assert "-" not in lines[5].split("|")[-3:-1]


def test_a_device_can_be_chosen(monkeypatch, tmp_path):
    asked = []
    row = dict.fromkeys(scaling.COLUMNS, 1) | {"series": "degree"}

    def run(quick, devices):
        asked.append((quick, devices))
        return [row | {"device": device} for device in devices]

    monkeypatch.setattr(scaling, "run", run)
    monkeypatch.setattr(scaling, "profile", lambda frames: "")
    monkeypatch.setattr(scaling, "plot", lambda rows, path: None)
    options = ["--quick", "--out", str(tmp_path)]
    for here, choice in ((False, []), (True, []), (False, ["--device", "cuda"])):
        monkeypatch.setattr(torch.cuda, "is_available", lambda here=here: here)
        scaling.main([*options, *choice])
    assert asked == [(True, ["cpu"]), (True, ["cpu", "cuda"]), (True, ["cuda"])]

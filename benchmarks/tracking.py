"""Tracking: ours, offline and online, beside what people use today, on the same detections.

Every tracker gets boxes and confidences of ``det/det.txt``, no pixels and no truth, one after the
other in one process: MIXER with configs/track.yaml, the same online with
benchmarks/configs/tracking/online.yaml, and SORT, ByteTrack, OC-SORT and norfair at their defaults
(peers.py). The oracle gives each detection the identity of the true box that it is assigned to at
an overlap of 0.5 or more, and drops the rest: what association could reach. Truth of flag 0 is
dropped. Combined figures are
MOTChallenge's: boxes, matches and errors are added up over sequences before ratios are taken.

Sequences are those in mot15 of the folder $MIXER_DATA, or the folders named:

    mixer bench tracking --out out/benchmarks/tracking
    python -m mixer_torch.benchmarks.tracking --sequences MOT17-02-FRCNN MOT17-04-FRCNN

Speed is measured on synthetic crowds (mixer_torch/datasets/crowd.py) of 50 detections a frame, each
run in a process of its own: is time per frame the same whatever the length of the sequence? Time
runs from detections in memory to tracks. Memory is the most that the process held meanwhile: on the
sequences over what it held before, on crowds in all, with interpreter and libraries.
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from importlib import resources
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import yaml
from jsonargparse import ArgumentParser
from tqdm import tqdm

from mixer_torch.benchmarks import comparison, peers, results, tracking_report
from mixer_torch.datasets import Crowd, MOTChallenge
from mixer_torch.io.files import find
from mixer_torch.io.mot_tracks import read_mot_truth
from mixer_torch.metrics.tracking import evaluate_sequences
from mixer_torch.plugins import everything
from mixer_torch.tracking import Tracks
from mixer_torch.tracking.base import BaseTracker

OURS = {
    "MIXER": resources.files("mixer_torch.configs") / "track.yaml",
    "MIXER online": resources.files("mixer_torch.benchmarks")
    / "configs"
    / "tracking"
    / "online.yaml",
}
ORACLE = "oracle"
METRICS = ("HOTA", "AssA", "DetA", "IDF1", "MOTA", "IDSW", "Frag", "tracks")
COST = ("frames", "detections", "seconds", "peak_mib")
LATENCY = ("latency_median_ms", "latency_p95_ms", "latency_max_ms")
COLUMNS = ("tracker", "sequence", *METRICS, *COST, *LATENCY)
SPEED_COLUMNS = ("tracker", *COST, "HOTA", "IDF1", *LATENCY)
LENGTHS = (250, 500, 1000, 2000)
SLOW = 4  # online, which solves anew with each frame, gets crowds of this fraction of the lengths
PEOPLE = 55  # on the ground: about 50 detections a frame, 3 of them clutter


def ours(config):
    """A tracker of the project as its configuration has it."""
    everything()  # makes bare class names known
    text = config.read_text()
    parser = ArgumentParser(exit_on_error=False)
    parser.add_subclass_arguments(BaseTracker, "tracker")
    chosen = {"tracker": yaml.safe_load(text)["tracker"]}
    return parser.instantiate(parser.parse_object(chosen)).tracker


def trackers():
    """All ways to track: name -> (observations, frames) -> tracks and latencies in seconds."""
    found = {}
    for name, config in OURS.items():
        found[name] = lambda observations, frames, config=config: _run(ours(config), observations)
    for name, track in peers.installed().items():
        found[name] = lambda observations, frames, track=track: (track(observations, frames), None)
    return found


def _run(tracker, observations):
    association = tracker.associate(observations)
    return tracker.finish(observations, association), association.stats.get("latency")


def measure(track, observations, frames):
    """Tracks, and what they cost."""
    with comparison.Peak() as peak:
        start = time.perf_counter()
        tracks, latency = track(observations, frames)
        seconds = time.perf_counter() - start
    cost = {"frames": frames, "detections": len(observations), "seconds": seconds}
    milliseconds = np.quantile(latency, (0.5, 0.95, 1)) * 1000 if latency else [""] * 3
    return tracks, cost | {"peak_mib": peak.mebibytes} | dict(
        zip(LATENCY, milliseconds, strict=True)
    )


def sequences(folders):
    """Name -> (observations without truth, with identities, truth, frames) of each folder."""
    found = {}
    for folder in folders:
        blind = MOTChallenge(folder, pixels=False, truth=False, repair=True)
        seen = MOTChallenge(folder, pixels=False, repair=True).load()
        truth = read_mot_truth(blind.folder / "gt" / "gt.txt")
        frames = blind.info().length or int(max(seen["frame"].max(), truth.tracks.frame.max()))
        found[blind.folder.name] = blind.load(), seen, truth, frames
    return found


def run(folders):
    """A row for each tracker and sequence, and one for all sequences together."""
    scenes = sequences(folders)
    ways = trackers() | {ORACLE: None}
    warm_up(ways)
    rows = []
    for name, track in tqdm(ways.items(), "trackers", disable=None):
        tracks, costs = {}, {}
        for sequence, (blind, seen, _, frames) in scenes.items():
            if track is None:
                tracks[sequence] = Tracks.from_labels(seen, seen["identity"])
                costs[sequence] = {"frames": frames, "detections": len(seen)}
            else:
                tracks[sequence], costs[sequence] = measure(track, blind, frames)
        truths = {key: scene[2] for key, scene in scenes.items()}
        tracks = {key: truths[key].without_distractors(value) for key, value in tracks.items()}
        scores = evaluate_sequences(tracks, {key: true.tracks for key, true in truths.items()})
        for sequence, score in (scores["sequences"] | {"combined": scores["combined"]}).items():
            cost = costs.get(sequence) or together(list(costs.values()))
            score = {key: score[key] for key in METRICS}
            rows.append({"tracker": name, "sequence": sequence, **score, **cost})
    return rows


def together(costs):
    """What several sequences cost: sums of time and work, the highest of memory and latency."""
    total = {key: sum(cost[key] for cost in costs) for key in COST[:3] if key in costs[0]}
    return total | {"peak_mib": max((cost.get("peak_mib", 0) for cost in costs), default="")}


def warm_up(ways):
    """Track something small with each: compilers and libraries start outside of the clock."""
    observations = Crowd(num_people=10, num_frames=60).load()
    for track in ways.values():
        if track is not None:
            track(observations, 60)


def speed_step(name, frames):
    """One row of the speed part; runs in a process of its own."""
    track = trackers()[name]
    warm_up({name: track})
    observations = Crowd(PEOPLE, frames).load()
    true = Crowd(PEOPLE, frames, source="gt").load()
    tracks, cost = measure(track, observations, frames)
    cost["peak_mib"] = process_peak()
    truth = Tracks.from_labels(true, true["identity"])
    score = evaluate_sequences({"": tracks}, {"": truth})["combined"]
    return {"tracker": name, **{key: score[key] for key in ("HOTA", "IDF1")}, **cost}


def process_peak():
    """The most memory that this process held since `comparison.Peak` began, MiB, if Linux tells."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.is_file() else []
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), "")


def run_speed(lengths):
    share = {name: SLOW if name == "MIXER online" else 1 for name in trackers()}
    steps = [(name, frames // share[name]) for name in share for frames in lengths]
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        return [
            pool.submit(speed_step, *step).result() for step in tqdm(steps, "speed", disable=None)
        ]


def folders_of(named):
    """The folders named, or those in $MIXER_DATA/mot15."""
    if named:
        return named
    return sorted(path.parent for path in find("mot15").glob("*/seqinfo.ini"))


def main(argv=None):
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--sequences", nargs="+", type=Path)
    named, rest = parser.parse_known_args(argv)
    quick = "two shortest sequences, crowds of 100 and 200 frames"
    arguments = results.arguments((__file__, __doc__), rest, quick)
    out = arguments.out
    if not arguments.from_rows:
        folders = folders_of(named.sequences)
        lengths = LENGTHS
        if arguments.quick:
            folders = sorted(folders, key=lambda f: len((f / "det/det.txt").read_bytes()))[:2]
            lengths = 100, 200
        results.write(out / "rows.csv", COLUMNS, run(folders))
        results.write(out / "speed.csv", SPEED_COLUMNS, run_speed(lengths))
    return tracking_report.make(out)


if __name__ == "__main__":
    print(main())

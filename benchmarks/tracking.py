"""Tracking: ours, offline and online, beside what people use today, family by family.

A family is a folder of sequences in the layout of MOTChallenge: one kind of scene and one detector.
Every tracker gets the boxes and confidences of ``det/det.txt``, no pixels and no truth, and runs at
its defaults (peers.py). What is shown of MIXER on a family is with weights that were learned on the
other families alone (leave one family out); what is shipped is learned on all. The oracle gives
each detection the identity of the true box that it is assigned to at an overlap of 0.5 or more, and
drops the rest: what association could reach. Combined figures are MOTChallenge's: boxes, matches
and errors are added up over the sequences of a family before ratios are taken.

Families are those in $MIXER_DATA, mot15 and the folders in tracking, or the folders named:

    mixer bench tracking --out out/benchmarks/tracking
    python -m mixer_torch.benchmarks.tracking --families dancetrack_val sportsmot_val

Weights that were learned without a family are kept in OUT/weights, and used again. What is shipped,
mixer_torch/tracking/tracker.safetensors, is made by

    python -m mixer_torch.benchmarks.tracking --learn_all tracker.safetensors
"""

import argparse
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from mixer_torch.benchmarks import comparison, peers, results, tracking_report
from mixer_torch.datasets import Crowd, MOTChallenge
from mixer_torch.io.files import find
from mixer_torch.io.tracks import read_mot_truth
from mixer_torch.metrics.tracking import evaluate_sequences
from mixer_torch.tracking import Tracker
from mixer_torch.tracking.examples import simulated
from mixer_torch.tracking.own import LEAST_OVERLAP, SCENES, Labelled
from mixer_torch.tracking.training import train
from mixer_torch.tracking.weights import Weights
from mixer_torch.tracks import Tracks

OURS = {"MIXER": False, "MIXER online": True}
ORACLE = "oracle"
METRICS = ("HOTA", "AssA", "DetA", "IDF1", "MOTA", "IDSW", "Frag", "tracks")
COST = ("frames", "detections", "seconds", "peak_mib")
LATENCY = ("latency_median_ms", "latency_p99_ms", "latency_max_ms")
COLUMNS = ("family", "tracker", "sequence", *METRICS, *COST, *LATENCY)
SPEED_COLUMNS = ("tracker", "people", *COST, "HOTA", "IDF1", *LATENCY)
LICENCES = {
    "mot15": "truth MASA-OA (Apache-2.0), detections of the authors of SORT (GPL-3.0)",
    "dancetrack": "truth Deep-OC-SORT (MIT), detections imm-jhse (MIT)",
    "sportsmot_oracle": "truth SportsMOT (CC BY-NC 4.0)",
    "kitti_cars": "truth AB3DMOT (non-commercial research), detections imm-jhse (MIT)",
    "mot17_frcnn": "truth and detections py-motmetrics (MIT) and MOTChallenge",
    "mot17_yolox": "truth py-motmetrics (MIT), detections yolo_tracking (none stated)",
}
"""Of the labels and detections that the shipped weights were learned on, as their sources state."""
CROWDS = ((10, 1000), (20, 500), (20, 2000), (50, 1000))
"""People and frames of the crowds that speed is measured on: does time grow with the length?"""


class Scene:
    """One sequence: what trackers see, and what is true."""

    def __init__(self, folder):
        self.folder, self.name = folder, folder.name
        self.blind = MOTChallenge(folder, pixels=False, truth=False, repair=True).load()
        self.seen = MOTChallenge(folder, pixels=False, repair=True).load()
        self.truth = read_mot_truth(folder / "gt" / "gt.txt")
        frames = MOTChallenge(folder).info().length
        self.frames = frames or int(max(self.seen["frame"].max(), self.truth.tracks.frame.max()))

    def to_learn_from(self, seed):
        dataset = MOTChallenge(self.folder, pixels=False, repair=True, min_overlap=LEAST_OVERLAP)
        return Labelled(dataset.load(), self.truth).to_learn_from(seed)


def measured(families):
    """By family: stretches of its sequences to learn from; simulated scenes are one more family."""
    found = {
        name: [one for seed, scene in enumerate(scenes) for one in scene.to_learn_from(seed)]
        for name, scenes in tqdm(families.items(), "measured", disable=None)
    }
    return found | {"simulated": simulated(SCENES)}


def held_out(families, out):
    """By family: weights that were learned on all the others, or read where they are already."""
    folder = out / "weights"
    folder.mkdir(parents=True, exist_ok=True)
    files = {name: folder / f"without_{name}.safetensors" for name in families}
    wanted = {name: file for name, file in files.items() if not file.exists()}
    data = measured(families) if wanted else {}
    for name, file in tqdm(wanted.items(), "learned", disable=None):
        train({family: value for family, value in data.items() if family != name}).save(file)
    return {name: Weights.load(file) for name, file in files.items()}


def learn_all(families, file):
    """Weights that were learned on all families: what is shipped, with its card."""
    card = {
        "families": [*families, f"{SCENES} scenes of mixer_torch.datasets.simulated"],
        "licences": {name: LICENCES.get(name, "not known") for name in families},
    }
    Weights(train(measured(families)).networks, card).save(file)
    return f"written: {file}"


def run(families, out):
    """A row for each family, tracker and sequence, and one for all sequences of the family."""
    weights = held_out(families, out)
    rows = []
    for family, scenes in families.items():
        ways = {
            name: lambda observations, frames, online=online, own=weights[family]: _run(
                Tracker(weights=own, online=online), observations
            )
            for name, online in OURS.items()
        }
        for name, track in peers.installed().items():
            ways[name] = lambda observations, frames, track=track: (
                track(observations, frames),
                None,
            )
        warm_up(ways)
        for name, track in tqdm((ways | {ORACLE: None}).items(), family, disable=None):
            rows += _rows(family, name, track, scenes)
    return rows


def _run(tracker, observations):
    association = tracker.associate(observations)
    return tracker.finish(observations, association), association.stats.get("latency")


def _rows(family, name, track, scenes):
    tracks, costs = {}, {}
    for scene in scenes:
        if track is None:
            tracks[scene.name] = Tracks.from_labels(scene.seen, scene.seen["identity"])
            costs[scene.name] = {"frames": scene.frames, "detections": len(scene.seen)}
        else:
            tracks[scene.name], costs[scene.name] = measure(track, scene.blind, scene.frames)
    truths = {scene.name: scene.truth for scene in scenes}
    tracks = {key: truths[key].without_distractors(value) for key, value in tracks.items()}
    scores = evaluate_sequences(tracks, {key: true.tracks for key, true in truths.items()})
    for sequence, score in (scores["sequences"] | {"combined": scores["combined"]}).items():
        cost = costs.get(sequence) or together(list(costs.values()))
        score = {key: score[key] for key in METRICS}
        yield {"family": family, "tracker": name, "sequence": sequence, **score, **cost}


def measure(track, observations, frames):
    """Tracks, and what they cost."""
    with comparison.Peak() as peak:
        start = time.perf_counter()
        tracks, latency = track(observations, frames)
        seconds = time.perf_counter() - start
    cost = {"frames": frames, "detections": len(observations), "seconds": seconds}
    milliseconds = np.quantile(latency, (0.5, 0.99, 1)) * 1000 if latency else [""] * 3
    return tracks, cost | {"peak_mib": peak.mebibytes} | dict(
        zip(LATENCY, milliseconds, strict=True)
    )


def together(costs):
    """What several sequences cost: sums of time and work, the highest of memory."""
    total = {key: sum(cost[key] for cost in costs) for key in COST[:3] if key in costs[0]}
    return total | {"peak_mib": max((cost.get("peak_mib", 0) for cost in costs), default="")}


def warm_up(ways):
    """Track something small with each: compilers and libraries start outside of the clock."""
    observations = Crowd(num_people=10, num_frames=60).load()
    for track in ways.values():
        track(observations, 60)


def run_speed():
    """Rows of time, memory and quality on crowds, of ours with what is shipped."""
    rows = []
    for name, online in OURS.items():

        def track(observations, frames, online=online):
            return _run(Tracker(online=online), observations)

        warm_up({name: track})
        for people, frames in tqdm(CROWDS, f"speed of {name}", disable=None):
            observations = Crowd(people, frames).load()
            true = Crowd(people, frames, source="gt").load()
            tracks, cost = measure(track, observations, frames)
            truth = Tracks.from_labels(true, true["identity"])
            score = evaluate_sequences({"": tracks}, {"": truth})["combined"]
            found = {key: score[key] for key in ("HOTA", "IDF1")}
            rows.append({"tracker": name, "people": people, **found, **cost})
    return rows


def families_of(named):
    """Scenes by family: of the folders named, or of those in $MIXER_DATA."""
    folders = named or [find("mot15"), *sorted(p for p in find("tracking").iterdir() if p.is_dir())]
    return {
        folder.name: [Scene(path.parent) for path in sorted(folder.glob("*/seqinfo.ini"))]
        for folder in folders
    }


def main(argv=None):
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--families", nargs="+", type=Path)
    parser.add_argument("--learn_all", type=Path)
    named, rest = parser.parse_known_args(argv)
    if named.learn_all:
        return learn_all(families_of(named.families), named.learn_all)
    quick = "the shortest sequence of each family"
    arguments = results.arguments((__file__, __doc__), rest, quick)
    out = arguments.out
    if not arguments.from_rows:
        families = families_of(named.families)
        if arguments.quick:
            families = {
                name: [min(scenes, key=lambda scene: len(scene.seen))]
                for name, scenes in families.items()
            }
        results.write(out / "rows.csv", COLUMNS, run(families, out))
        results.write(out / "speed.csv", SPEED_COLUMNS, run_speed())
    return tracking_report.make(out)


if __name__ == "__main__":
    print(main())

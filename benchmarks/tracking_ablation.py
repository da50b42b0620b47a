"""What each modality of the tracker, and each thing that it measures, is worth, family by family.

A modality is taken out by holding its inputs at their mean in what was learned, so that it says the
same of every pair. A measured quantity is taken out by what is usual in its place: scores that are
all alike, a camera at rest, the motion, jitter and continuity that are assumed before anything is
seen. Weights are those that were learned without the family (`mixer bench tracking` leaves them in
its folder), and nothing is learned anew, so what others could make up for is not counted.

    python -m mixer_torch.benchmarks.tracking_ablation --weights out/benchmarks/tracking/weights
"""

import argparse
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import torch
from tqdm import tqdm

from mixer_torch.benchmarks import results, tracking
from mixer_torch.metrics.tracking import evaluate_sequences
from mixer_torch.tracking import Tracker, passes
from mixer_torch.tracking.camera_steps import AT_REST
from mixer_torch.tracking.evidence import FIRST_STAGE, MODALITIES
from mixer_torch.tracking.measured import COMMON_CHANGE, COMMON_MOTION, measure
from mixer_torch.tracking.running import PRIOR_CONTINUITY
from mixer_torch.tracking.weights import Weights

METRICS = ("HOTA", "AssA", "DetA", "IDF1")
COLUMNS = ("family", "without", *METRICS)
WHOLE = "nothing"
QUANTITIES = {
    "what scores mean": None,
    "the camera's motion": None,
    "motion and jitter": {
        "motion": COMMON_MOTION,
        "change": COMMON_CHANGE,
        "jitter": COMMON_CHANGE / 2,
    },
    "continuity": {"continuity": PRIOR_CONTINUITY},
}


def held(network, names):
    """A network whose inputs of these names are held at their mean, which is 0 inside."""
    own = np.isin(network.features, names)
    return replace(
        network,
        hidden=np.where(own[:, None], 0, network.hidden),
        linear=np.where(own, 0, network.linear),
    )


def without_modality(weights, modality):
    """Weights of which one modality says the same of every pair."""
    stage = "evidence" if modality in FIRST_STAGE else "rivals"
    names = [name for name in MODALITIES[modality] if name != "evidence"]
    networks = dict(weights.networks) | {stage: held(weights[stage], names)}
    return Weights(networks, weights.card)


@contextmanager
def assumed(values):
    """Sequences measured as they are but for some values, which are taken as given."""

    def instead(sequence, camera=None):
        return replace(measure(sequence, camera), **values)

    with mock.patch.object(passes, "measure", instead):
        yield


@contextmanager
def resting():
    """Cameras taken to be at rest."""

    def instead(sequence, camera=None):
        return measure(sequence, np.tile(AT_REST, (max(len(sequence.frames), 1), 1)))

    with mock.patch.object(passes, "measure", instead):
        yield


def ways(weights):
    """What is taken out: the tracker, what it is shown, and what is assumed meanwhile."""
    yield WHOLE, weights, False, assumed({})
    for modality in MODALITIES:
        yield modality, without_modality(weights, modality), False, assumed({})
    for name, values in QUANTITIES.items():
        if name == "the camera's motion":
            yield name, weights, False, resting()
        else:
            yield name, weights, name == "what scores mean", assumed(values or {})


def run(families, folder):
    """A row for each family and each thing taken out."""
    for family, scenes in families.items():
        weights = Weights.load(folder / f"without_{family}.safetensors")
        truths = {scene.name: scene.truth.tracks for scene in scenes}
        for name, own, alike, context in tqdm([*ways(weights)], family, disable=None):
            tracks = {}
            with context:
                for scene in scenes:
                    seen = scene.blind
                    if alike:
                        seen = seen.with_features(confidence=torch.ones(len(seen)))
                    found = Tracker(weights=own).track(seen)
                    tracks[scene.name] = scene.truth.without_distractors(found)
            score = evaluate_sequences(tracks, truths)["combined"]
            yield {"family": family, "without": name} | {key: score[key] for key in METRICS}


def table(rows):
    """HOTA and IDF1 of the whole, and by how much they change without each part."""
    families = list(dict.fromkeys(row["family"] for row in rows))
    found = {(row["without"], row["family"]): row for row in rows}
    lines = [
        "| HOTA / IDF1 without | " + " | ".join(families) + " |",
        "|---|" + "---:|" * len(families),
    ]
    for name in dict.fromkeys(row["without"] for row in rows):
        cells = []
        for family in families:
            row, whole = found[name, family], found[WHOLE, family]
            change = name != WHOLE
            values = (row[key] - change * whole[key] for key in ("HOTA", "IDF1"))
            cells.append(" / ".join(f"{value:{'+' if change else ''}.1f}" for value in values))
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main(argv=None):
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--weights", type=Path, default=Path("out/benchmarks/tracking/weights"))
    named, rest = parser.parse_known_args(argv)
    quick = "the shorter half of the sequences of each family"
    arguments = results.arguments((__file__, __doc__), rest, quick)
    if not arguments.from_rows:
        families = tracking.families_of(None)
        if arguments.quick:
            families = {
                name: sorted(scenes, key=lambda scene: len(scene.seen))[: (len(scenes) + 1) // 2]
                for name, scenes in families.items()
            }
        rows = run(families, named.weights)
        results.write(arguments.out / "rows.csv", COLUMNS, rows)
    return results.tabled(arguments.out, table)


if __name__ == "__main__":
    print(main())

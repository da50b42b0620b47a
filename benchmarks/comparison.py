"""What the comparisons share: the algorithms, the scenes, and one row for each run.

Every algorithm gets the same affinity. Those that know one score a pair take the mean of the
modalities' (``Problem.score``). ``SETTINGS`` lists what was tried for each algorithm, its authors'
defaults first; ``CHOSEN``, in chosen.py, is what tuning.py found best for each dataset on a part of
it that no table shows.
"""

import os
import time
from importlib import resources
from pathlib import Path

import torch

import mixer_torch as mx
from mixer_torch.benchmarks.chosen import CHOSEN
from mixer_torch.cli import build_parsers
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.solvers.clear import Clear
from mixer_torch.solvers.hungarian import Hungarian
from mixer_torch.solvers.matchals import MatchALS
from mixer_torch.solvers.matcheig import MatchEIG
from mixer_torch.solvers.matchlift import MatchLift
from mixer_torch.solvers.quickmatch import QuickMatch
from mixer_torch.solvers.spectral import Spectral
from mixer_torch.solvers.threshold import AllPairs, Consecutive

COLUMNS = (
    "algorithm",
    "modalities",
    "dataset",
    "seed",
    "precision",
    "recall",
    "f1",
    "clusters",
    "seconds",
    "peak_memory_mb",
    "consistent",
)
MODALITIES = {"IoU": "bbox", "Proximity": "proximity", "Color": "colour", "SIFT": "SIFT"}
ALL = "+".join(MODALITIES)
REAL = ("pets", "cmu_hotel")
HELD_OUT = {  # what settings are chosen on: other seeds, other frames
    "parking_lot": ("--dataset.seed=100", "--dataset.seed=101"),
    "pets": ("--dataset.start=1 --dataset.stop=150 --dataset.step=5 --pairs.window=15",),
    "cmu_hotel": ("--dataset.start=5",),
}
SYNTHETIC = "synthetic"

EVIDENCE = [{"evidence": kind} for kind in ("match", "assignment", "attraction", "score")]
THRESHOLDS = [{"threshold": value} for value in (0.5, 0.6, 0.7)]
SETTINGS = {
    "All-pairs": (AllPairs, THRESHOLDS),
    "Consecutive": (Consecutive, THRESHOLDS),
    "Hungarian": (Hungarian, THRESHOLDS),
    "Spectral": (Spectral, EVIDENCE),
    "MatchEIG": (MatchEIG, EVIDENCE),
    "MatchALS": (MatchALS, EVIDENCE),
    "MatchLift": (
        MatchLift,
        [
            {"evidence": "match", "sparsity": None},
            {"evidence": "assignment", "sparsity": None},
            {"evidence": "attraction", "sparsity": None},
            {"evidence": "score", "sparsity": 0.5},
        ],
    ),
    "QuickMatch": (
        QuickMatch,
        [
            {"bandwidth": 0.25, "ratio": 0.67},
            {"bandwidth": 0.5, "ratio": 0.67},
            {"bandwidth": 0.25, "ratio": 0.6},
            {"bandwidth": 0.25, "ratio": 0.5},
        ],
    ),
    "CLEAR": (Clear, EVIDENCE),
    "MIXER (published)": (mx.Mixer, [{"refine": False}]),
    "MIXER": (mx.Mixer, [{}]),
}


def algorithms(dataset):
    """A solver for each algorithm, with the setting chosen for it on a dataset."""
    chosen = CHOSEN.get(dataset, {})
    return {
        name: kind(**chosen.get(name, settings[0])) for name, (kind, settings) in SETTINGS.items()
    }


def scene(config, *overrides):
    """Affinity and true identities of a configuration, as `mixer associate` would read it."""
    parser = build_parsers()[1]["associate"]
    path = resources.files("mixer_torch.configs") / f"{config}.yaml"
    chosen = parser.instantiate(parser.parse_args([f"--config={path}", "--out=.", *overrides]))
    observations = chosen.dataset.load()
    affinity = mx.score(observations, chosen.scorers, chosen.pairs)
    return affinity, observations["identity"]


def parking_lots(seeds, num_frames=100):
    """(dataset, seed, affinity, identity) of rendered parking lots."""
    for seed in seeds:
        overrides = f"--dataset.seed={seed}", f"--dataset.num_frames={num_frames}"
        yield "parking_lot", seed, *scene("parking_lot", *overrides)


def real_scenes():
    """(dataset, seed, affinity, identity) of the real data, if MIXER_DATA says where it is."""
    for config in REAL if os.environ.get("MIXER_DATA") else ():
        yield config, 0, *scene(config)


def held_out(num_frames=100):
    """(dataset, seed, affinity, identity) of scenes that no table shows, to choose settings on."""
    for config, parts in HELD_OUT.items():
        if config in REAL and not os.environ.get("MIXER_DATA"):
            continue
        short = () if config in REAL else (f"--dataset.num_frames={num_frames}",)
        for k, overrides in enumerate(parts):
            yield config, k, *scene(config, *overrides.split(), *short)
    for seed in range(100, 110):
        yield (
            SYNTHETIC,
            seed,
            *synthetic(8, 6, modalities=4, wrong=0.2, inconclusive=0.6, seed=seed),
        )


def measure(algorithm, solver, affinity, identity, dataset, seed, modalities=None):
    """Solve once: its row, and what went wrong in it."""
    if modalities is not None:
        affinity = affinity.select(modalities)
    with Peak() as peak:
        start = time.perf_counter()
        association = mx.solve(affinity, solver)
        seconds = time.perf_counter() - start
    metrics = evaluate(association, identity, affinity.view)
    row = {
        "algorithm": algorithm,
        "modalities": "+".join(affinity.modalities),
        "dataset": dataset,
        "seed": seed,
        **{key: metrics[key] for key in ("precision", "recall", "f1")},
        "clusters": "" if association.labels is None else association.num_clusters,
        "seconds": seconds,
        "peak_memory_mb": peak.mebibytes,
        "consistent": association.labels is not None,
    }
    return row, failures(association, metrics, identity, affinity.view) | {
        key: row[key] for key in ("algorithm", "modalities", "dataset", "seed")
    }


FAILURES = (
    "algorithm",
    "modalities",
    "dataset",
    "seed",
    "wrong_links",
    "missed_links",
    "parts_of_an_object",
    "mixed_clusters",
    "open_cycles",
    "within_view_links",
)


def failures(association, metrics, identity, view):
    """How a result goes wrong: links too many and too few, splits, merges, inconsistencies."""
    correct = round(metrics["precision"] * metrics["declared_pairs"])
    found = {
        "wrong_links": metrics["declared_pairs"] - correct,
        "missed_links": metrics["true_pairs"] - correct,
        "parts_of_an_object": "",
        "mixed_clusters": "",
        "open_cycles": metrics["open_cycles"],
        "within_view_links": metrics["within_view_links"],
    }
    if association.labels is not None:
        labels, known = association.labels, identity >= 0
        both = torch.unique(torch.stack([labels[known], identity[known]]), dim=1)
        found["parts_of_an_object"] = both.shape[1] / max(len(identity[known].unique()), 1)
        size = torch.bincount(labels)
        kinds = torch.bincount(both[0], minlength=len(size))
        clutter = torch.bincount(labels[~known], minlength=len(size))
        mixed = (kinds + clutter > 1) & (size > 1)
        found["mixed_clusters"] = float(mixed.sum() / max(int((size > 1).sum()), 1))
    return found


class Peak:
    """How much more memory the process holds at its peak than before, where Linux tells."""

    def __enter__(self):
        self.mebibytes = float("nan")
        try:
            Path("/proc/self/clear_refs").write_text("5")  # resets the high-water mark
            self._before = self._read("VmRSS")
        except OSError:
            self._before = None
        return self

    def __exit__(self, *_):
        if self._before is not None:
            self.mebibytes = max(self._read("VmHWM") - self._before, 0) / 1024

    @staticmethod
    def _read(key):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith(key):
                return int(line.split()[1])
        raise OSError(f"no {key}")


def warm_up():
    """Solve something small with each: compilers and libraries start outside of the clock."""
    scores = torch.eye(6).repeat(2, 2)
    affinity = mx.Affinity.from_dense(scores, torch.arange(2).repeat_interleave(6))
    for solver in algorithms(SYNTHETIC).values():
        mx.solve(affinity, solver)

"""What all tests share: data folders, devices, and what is skipped where they are absent."""

import os
from importlib.metadata import distributions
from pathlib import Path

import pytest
import torch

torch.set_num_threads(1)  # tests run side by side, one a core

# On a machine that is borrowed for its GPU, the project may be a mere folder and packages may be
# missing: what cannot be imported there is left out, so that `pytest -m cuda` runs.
COMMANDS = (
    "commands",
    "datasets/test_datasets.py",
    "test_readme.py",
    "train/test_embedding_training.py",
    "train/test_learning.py",
    "train/test_mixer_train.py",
)
BENCHMARKS = ("solvers/test_scaling.py", "test_solver_benchmarks.py")
BENCHMARKS_BY_COMMANDS = (
    "datasets/test_multicamera.py",
    "test_campus.py",
    "test_comparison.py",
    "test_learning_motion_benchmark.py",
    "test_persons_benchmark.py",
    "test_tracking_benchmark.py",
)


def is_absent(distribution: str) -> bool:
    """Whether it is not installed; nothing is imported, as types are to be checked from then on."""
    return not any(distributions(name=distribution))


collect_ignore: list[str] = []
if is_absent("jsonargparse"):
    collect_ignore += COMMANDS + BENCHMARKS_BY_COMMANDS
if is_absent("mixer-torch"):
    collect_ignore += BENCHMARKS + BENCHMARKS_BY_COMMANDS


def pytest_report_header():
    lines = []
    if collect_ignore:
        lines.append(f"left out, as packages are missing: {', '.join(collect_ignore)}")
    if is_absent("beartype"):
        lines.append("types are not checked, as beartype is missing")
    return lines


def pytest_collection_modifyitems(items):
    no_data = pytest.mark.skip(reason="MIXER_DATA is not set")
    no_cuda = pytest.mark.skip(reason="there is no CUDA device")
    for item in items:
        if "real_data" in item.keywords and not os.environ.get("MIXER_DATA"):
            item.add_marker(no_data)
        if "cuda" in item.keywords and not torch.cuda.is_available():
            item.add_marker(no_cuda)


@pytest.fixture
def real_data() -> Path:
    """The folder of real data; tests that use it are marked real_data."""
    return Path(os.environ["MIXER_DATA"]).resolve()

"""What all tests share: data folders, devices, and what is skipped where they are absent."""

import os
from pathlib import Path

import pytest
import torch

torch.set_num_threads(1)  # tests run side by side, one a core


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

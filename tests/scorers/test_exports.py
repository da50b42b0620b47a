"""Every public class of scorers and train is imported from its package, which stays light."""

import inspect
import pkgutil
import subprocess
import sys
from importlib import import_module

import pytest
from torch import nn

from mixer_torch.plugins import KINDS, members


def public_classes(package):
    for child in pkgutil.iter_modules(package.__path__):
        module = import_module(f"{package.__name__}.{child.name}")
        for name, value in vars(module).items():
            own = inspect.isclass(value) and value.__module__ == module.__name__
            if own and issubclass(value, nn.Module) and not name.startswith("_"):
                yield name, value


@pytest.mark.parametrize("name", ["mixer_torch.scorers", "mixer_torch.train"])
def test_public_classes_are_imported_from_the_package(name):
    if name.endswith("train"):
        pytest.importorskip("lightning")
    package = import_module(name)
    for cls_name, value in public_classes(package):
        if cls_name != "PairModule":  # a base of trainings, not for users
            assert getattr(package, cls_name) is value
            assert cls_name in package.__all__


def test_importing_scorers_imports_nothing_heavy():
    heavy = ("cv2", "kornia", "lightning", "matplotlib", "numba")
    code = f"import sys, mixer_torch.scorers; print([m for m in {heavy} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_listed_calibrators_can_all_be_used():
    (kind,) = (kind for kind in KINDS if kind.name == "calibrators")
    listed = {member.class_path.rpartition(".")[2] for member in members(kind, announced=())}
    assert {"Logistic", "PiecewiseLinear", "Platt", "Isotonic", "MonotoneSpline"} <= listed
    assert "LikelihoodRatio" not in listed

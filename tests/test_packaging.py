"""What is installed is all that there is, under one name."""

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
TOP = ("mixer_torch", "scorers", "train", "configs", "benchmarks")


def test_every_folder_of_code_is_packaged():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {
        str(file.parent.relative_to(ROOT)).replace("/", ".")
        for top in TOP
        for file in (ROOT / top).rglob("__init__.py")
    }
    elsewhere = {folder: name for name, folder in settings["package-dir"].items()}
    assert set(settings["packages"]) == {elsewhere.get(folder, folder) for folder in folders}
    assert all(name.split(".")[0] == "mixer_torch" for name in settings["packages"])


def test_constraints_pin_every_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = sum(project["optional-dependencies"].values(), project["dependencies"])
    names = {line.split(">=")[0].split("[")[0].lower() for line in wanted} - {"mixer-torch"}
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.split("==")[0].lower() for line in lines if "==" in line}
    assert names <= pinned


def test_packages_that_only_some_need_are_not_imported_by_the_rest():
    some = {"highspy", "kornia", "lightning"}
    program = f"import sys, mixer_torch.scorers; print(*{some} & set(sys.modules))"
    command = [sys.executable, "-c", program]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout.strip(), found.stderr) == (0, "", "")

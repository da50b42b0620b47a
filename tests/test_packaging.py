"""What is installed is all that there is."""

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_every_folder_of_code_is_packaged():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    elsewhere = settings["package-dir"]
    folders = {
        str(file.parent.relative_to(ROOT)).replace("/", ".")
        for top in ("mixer_torch", "scorers", "train")
        for file in (ROOT / top).rglob("__init__.py")
    }
    assert {name for name in settings["packages"] if name not in elsewhere} == folders
    assert all((ROOT / folder / "__init__.py").is_file() for folder in elsewhere.values())


def test_constraints_pin_every_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["dev"]]
    names = {line.split(">=")[0].split("[")[0].lower() for line in wanted}
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.split("==")[0].lower() for line in lines if "==" in line}
    assert names <= pinned


def test_packages_that_only_some_need_are_not_imported_by_the_rest():
    some = {"highspy", "kornia", "lightning"}
    program = f"import sys, mixer_torch, scorers; print(*{some} & set(sys.modules))"
    command = [sys.executable, "-c", program]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout.strip(), found.stderr) == (0, "", "")

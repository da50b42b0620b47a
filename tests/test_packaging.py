"""What is installed: everything, under one name; and what is imported: what is needed."""

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

import mixer_torch

ROOT = Path(__file__).parents[1]
TOP = ("mixer_torch", "scorers", "train", "configs", "benchmarks")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
HEAVY = {"cv2", "highspy", "kornia", "lightning", "matplotlib", "numba", "pytorch_lightning"}
HEAVY |= {"pytorch_metric_learning", "supervision", "trackeval"}


def python(program, cwd):
    """What a program prints, run in a folder by an interpreter of its own."""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=cwd, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.strip()


def test_every_folder_of_code_is_packaged_under_one_name():
    settings = PROJECT["tool"]["setuptools"]
    folders = {
        str(file.parent.relative_to(ROOT)).replace("/", ".")
        for top in TOP
        for file in (ROOT / top).rglob("*.py")
        if not any(parent.is_symlink() for parent in file.parents)
    }
    elsewhere = {folder: name for name, folder in settings["package-dir"].items()}
    assert set(settings["packages"]) == {elsewhere.get(folder, folder) for folder in folders}
    assert all(name.split(".")[0] == "mixer_torch" for name in settings["packages"])


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The names of the files in a wheel that is built from a copy of the sources."""
    pytest.importorskip("setuptools", "77", reason="setuptools 77 builds the wheel")
    pytest.importorskip("pip", reason="pip builds the wheel")
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("the sources are not under git, which says which files they are")
    folder = tmp_path_factory.mktemp("sources")
    for name in listed.stdout.decode().split("\0"):
        source, target = ROOT / name, folder / name
        if name and source.is_file():
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(source.read_bytes())
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--no-index", "-w", "dist", "."], cwd=folder, check=True)
    (built,) = (folder / "dist").glob("*.whl")
    with zipfile.ZipFile(built) as archive:
        return set(archive.namelist())


def test_the_wheel_installs_one_name(wheel):
    assert {name.split("/")[0] for name in wheel} == {
        "mixer_torch",
        f"mixer_torch-{PROJECT['project']['version']}.dist-info",
    }


def test_the_wheel_has_the_files_of_all_folders(wheel):
    for top in TOP:
        for file in (ROOT / top).rglob("*"):
            if any(parent.is_symlink() for parent in file.parents) or "__pycache__" in file.parts:
                continue
            if file.suffix in {".py", ".yaml", ".txt", ".typed"}:
                name = str(file.relative_to(ROOT))
                assert (name if top == "mixer_torch" else f"mixer_torch/{name}") in wheel
    assert any(name.endswith("/LICENSE") for name in wheel)


def test_constraints_pin_every_dependency():
    project = PROJECT["project"]
    wanted = sum(project["optional-dependencies"].values(), project["dependencies"])
    names = {re.split(r"[\[><=]", line)[0].lower() for line in wanted} - {"mixer-torch"}
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.split("==")[0].lower() for line in lines if "==" in line}
    assert names <= pinned
    assert "opencv-python" not in names | pinned  # it overwrites opencv-python-headless


def test_the_version_is_said_once_for_all():
    version = PROJECT["project"]["version"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    assert f"\n## {version}" in (ROOT / "CHANGELOG.md").read_text()
    assert isinstance(mixer_torch.__version__, str)


@pytest.mark.parametrize("module", ["mixer_torch", "mixer_torch.scorers", "mixer_torch.cli"])
def test_importing_imports_nothing_heavy(module, tmp_path):
    program = f"import sys, {module}; print(*sorted({HEAVY} & set(sys.modules)))"
    assert python(program, tmp_path) == ""


def test_what_a_user_has_beside_a_script_shadows_nothing(tmp_path):
    for name in ("scorers", "train", "configs", "benchmarks"):
        (tmp_path / f"{name}.py").write_text(f"OWNER = 'the user, {name}'")
    program = """
import scorers, train, configs, benchmarks
import mixer_torch.scorers, mixer_torch.configs
from mixer_torch.cli import build_parsers
build_parsers()
print(scorers.OWNER, train.OWNER, mixer_torch.scorers.IoU.__module__, sep="; ")
"""
    said = python(program, tmp_path)
    assert said == "the user, scorers; the user, train; mixer_torch.scorers.iou"


def test_a_checkout_that_is_not_installed_works_from_its_folder():
    """The editable install is hidden: `-S` leaves out site-packages, which PYTHONPATH brings back.

    Files of the kind `.pth` and finders of editable installs work in site folders alone.
    """
    program = """
import sys
sys.path += [path for path in sys.argv[1:] if path]
sys.path.insert(0, "")
import mixer_torch.scorers, mixer_torch.configs
print(mixer_torch.__file__, mixer_torch.scorers.__file__)
"""
    folders = [path for path in sys.path if "site-packages" in path]
    done = subprocess.run(
        [sys.executable, "-S", "-c", program, *folders],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == [
        str(ROOT / "mixer_torch" / "__init__.py"),
        str(ROOT / "mixer_torch" / "scorers" / "__init__.py"),
    ]

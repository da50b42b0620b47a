"""The command, as the tests of all commands run it."""

import sys
from pathlib import Path

import pytest
from track_inputs import OWN_TRACKER, write_config

from mixer_torch.cli import main


@pytest.fixture
def mixer(tmp_path, monkeypatch, capsys):
    """Run the command in an empty folder: (exit code, standard output, standard error)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delenv("MIXER_TRACEBACK", raising=False)

    def run(*argv):
        try:
            code = main([str(word) for word in argv])
        except SystemExit as stop:
            code = stop.code
        out, err = capsys.readouterr()
        return code, out, err

    yield run
    sys.modules.pop("own_scorers", None)


@pytest.fixture
def track(mixer, monkeypatch):
    """Run `mixer track`: (exit code, standard output, standard error)."""
    monkeypatch.delenv("MIXER_DATA", raising=False)
    Path("own_tracker.py").write_text(OWN_TRACKER)
    write_config("lanes.yaml")

    def run(*argv, config="lanes.yaml"):
        return mixer("track", *argv, *(["--config", config] if config else []))

    yield run
    sys.modules.pop("own_tracker", None)

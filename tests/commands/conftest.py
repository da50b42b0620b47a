"""The command, as the tests of all commands run it."""

import sys

import pytest

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

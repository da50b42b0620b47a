"""A command that needs a package of an extra names the extra; the others work without."""

import sys
from pathlib import Path

import pytest
from command_inputs import labels_in, one, write_config, write_sequence, write_table

from mixer_torch.cli import train


@pytest.fixture
def hide(monkeypatch):
    """Make packages look as if they were not installed."""

    def hidden(*packages):
        for name in [name for name in sys.modules if name.split(".")[0] in packages]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setattr(sys, "meta_path", [Hidden(packages), *sys.meta_path])

    return hidden


class Hidden:
    def __init__(self, packages):
        self.packages = packages

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in self.packages:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def test_without_any_extra_tables_are_associated_and_pictures_left_out(mixer, hide):
    hide("cv2", "kornia", "matplotlib", "lightning", "highspy", "pytorch_metric_learning")
    write_table()
    code, out, err = mixer("associate", "--config", write_config(), "--out", "result")
    assert code == 0, err
    assert labels_in("result/associations.csv") == [0, 1, 2] * 3
    assert 'no pictures: this needs the package matplotlib: pip install "mixer-torch[plots]"' in out
    assert mixer("list")[0] == 0
    assert "does not load" not in mixer("list")[1]


def test_images_need_vision(mixer, hide):
    config = write_config(scorers=["Color"], dataset=write_sequence("tiny", [(1, 4), (2, 5)]))
    hide("cv2")
    code, _, err = mixer("associate", "--config", config, "--out", "result")
    assert code == 2
    assert 'pip install "mixer-torch[vision]"' in err
    assert not Path("result").exists()


def test_the_exact_solver_needs_exact(mixer, hide):
    rows = [(f, -1, 10 * k + f / 10) for f in range(3) for k in range(3)]
    write_table(rows=rows)
    config = write_config(scorers=["own_scorers.Depth"], solver=one("Exact"))
    hide("highspy", "matplotlib")
    code, out, err = mixer("associate", "--config", config, "--out", "result")
    # Problems that are proven without a linear program need no HiGHS.
    assert code == 0 or 'pip install "mixer-torch[exact]"' in err, (out, err)


@pytest.mark.parametrize("package", ["lightning", "pytorch_metric_learning"])
def test_training_needs_train(hide, capsys, package):
    hide(package)
    assert train(["fit"]) == 2
    assert capsys.readouterr().err == (
        f'mixer-train: error: this needs the package {package}: pip install "mixer-torch[train]"\n'
    )

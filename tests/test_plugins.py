from importlib.metadata import EntryPoint, EntryPoints

import pytest

from mixer_torch.plugins import KINDS, members, near
from mixer_torch.scoring import Scorer

BY_NAME = {kind.name: kind for kind in KINDS}


def paths(name, announced=()):
    return [member.class_path for member in members(BY_NAME[name], announced)]


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (
            "scorers",
            {"mixer_torch.scorers.IoU", "mixer_torch.scorers.SIFT", "mixer_torch.FunctionScorer"},
        ),
        ("solvers", {"mixer_torch.Mixer"}),
        ("datasets", {"mixer_torch.datasets.MOTChallenge", "mixer_torch.datasets.Table"}),
        ("calibrators", {"mixer_torch.Calibrator"}),
        ("fusions", {"mixer_torch.LinearFusion", "mixer_torch.LogOddsFusion"}),
        ("pairs", {"mixer_torch.Every", "mixer_torch.Within", "mixer_torch.Nearest"}),
    ],
)
def test_the_projects_own_are_found_by_themselves(kind, expected):
    found = members(BY_NAME[kind], ())
    assert expected <= {member.class_path for member in found}
    assert all(member.cls is not None and member.summary for member in found), found
    assert not {f"mixer_torch.{base}" for base in ("Scorer", "Solver", "Fusion")} & set(paths(kind))


def test_a_class_is_listed_once_by_its_shortest_path():
    found = [member.cls for member in members(BY_NAME["scorers"], ())]
    assert len(set(found)) == len(found)
    assert "mixer_torch.scorers.iou.IoU" not in paths("scorers")


@pytest.fixture
def announced(tmp_path, monkeypatch):
    """A module beside the project with a scorer, and entry points into it."""
    (tmp_path / "announced_scorers.py").write_text(
        "from mixer_torch import Scorer\n\n"
        "class Depth(Scorer):\n"
        '    """Alike in ``depth``, not :class:`~torch.Tensor`.\n\n    More.\n    """\n'
    )
    monkeypatch.syspath_prepend(tmp_path)

    def point(value):
        return EntryPoint(name="any", value=value, group="mixer_torch.scorers")

    return point


def test_what_other_packages_announce_is_listed(announced):
    found = {
        m.class_path: m for m in members(BY_NAME["scorers"], [announced("announced_scorers:Depth")])
    }
    depth = found["announced_scorers.Depth"]
    assert depth.summary == "Alike in depth, not torch.Tensor."
    assert depth.cls is not None
    assert issubclass(depth.cls, Scorer)


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("no_such_module:Depth", "No module named 'no_such_module'"),
        ("announced_scorers:Height", "Height"),
        ("pathlib:Path", "expected a concrete subclass of Scorer"),
    ],
)
def test_what_does_not_load_is_listed_with_its_error(announced, value, reason):
    found = {m.class_path: m for m in members(BY_NAME["scorers"], [announced(value)])}
    broken = found[value.replace(":", ".")]
    assert broken.cls is None
    assert "does not load" in broken.summary
    assert reason in broken.summary
    assert "mixer_torch.scorers.IoU" in found


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Mixr", "did you mean Mixer?"),
        ("mixer_torch.scorers.Proximty", "did you mean Proximity?"),
        ("iou", "did you mean IoU?"),
        ("Proximity", "mixer_torch.scorers.Proximity is one of the scorers"),
        ("Xyzzy", "`mixer list` shows all"),
    ],
)
def test_what_is_near_to_a_name_that_will_not_do(name, said):
    assert near(name).startswith(f"'{name}' is not the name of a class that may stand here")
    assert said in near(name)


def test_an_announced_class_that_does_not_load_says_why(announced, monkeypatch):
    points = EntryPoints([announced("no_such_module:Depth")])
    monkeypatch.setattr("mixer_torch.plugins.entry_points", lambda: points)
    assert near("Depth").startswith("'Depth' does not load: ModuleNotFoundError: No module named")

"""A package that is missing ends in a message that names the extra which brings it."""

import sys

import pytest

from mixer_torch.extras import require


def test_what_is_installed_is_imported():
    assert require("torch.nn", extra="vision").Module.__name__ == "Module"


@pytest.mark.parametrize("module", ["no_such_package", "no_such_package.inside"])
def test_what_is_missing_names_its_extra(module):
    with pytest.raises(ImportError) as caught:
        require(module, extra="vision")
    assert str(caught.value) == (
        'this needs the package no_such_package: pip install "mixer-torch[vision]"'
    )


def test_an_installed_package_that_lacks_something_raises_its_own_error(tmp_path, monkeypatch):
    (tmp_path / "halfway.py").write_text("import no_such_package")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError, match="No module named 'no_such_package'"):
        require("halfway", extra="vision")
    assert "halfway" not in sys.modules

# Two commands do everything on a fresh machine: `make demo` and `make test`.
# Each makes .venv first if it is not there, with the versions in constraints.txt.

PYTHON ?= python3
BIN := .venv/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
# Tests compare our metrics of tracking with those of trackeval. It asks for opencv-python, which would
# overwrite opencv-python-headless, and uses neither; so it is installed without what it asks for.
TRACKEVAL := $(INSTALL) --no-deps trackeval pycocotools

.PHONY: demo test lint gpu peers clean

demo: .venv/installed
	$(BIN)/mixer demo

test: .venv/installed-dev
	$(BIN)/python -m pytest

lint: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# What needs a GPU: the tests marked so, and the rows of benchmarks/scaling.py. Nothing is downloaded.
# With another Python than that of `make test`: make gpu BIN=FOLDER_OF_THAT_PYTHON.
gpu:
	$(BIN)/python -c 'import mixer_torch.benchmarks' 2>/dev/null \
		|| $(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e ".[all]"
	$(BIN)/python -m pytest -n0 -m cuda
	$(BIN)/python -m mixer_torch.benchmarks.scaling --device cuda --out out/benchmarks/scaling_gpu

# The trackers that benchmarks/tracking.py compares with; some of them ask for opencv-python, too.
peers: .venv/installed
	$(INSTALL) --no-deps -r benchmarks/peers.txt

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed, this is " + sys.version.split()[0] + "; name another: make PYTHON=python3.11")'
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml constraints.txt | .venv/bin/python
	$(INSTALL) -e ".[all]"
	@touch $@

.venv/installed-dev: pyproject.toml constraints.txt | .venv/bin/python
	$(INSTALL) -e ".[dev]"
	$(TRACKEVAL)
	@touch $@ .venv/installed

clean:
	rm -rf .venv out build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

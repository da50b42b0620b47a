# Two commands do everything on a fresh machine: `make demo` and `make test`.
# Each makes .venv first if it is not there, with the versions in constraints.txt.

PYTHON ?= python3
BIN := .venv/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
# trackeval asks for the OpenCV with windows, which would overwrite the one without: it uses neither.
TRACKEVAL := $(INSTALL) --no-deps trackeval pycocotools tabulate

.PHONY: demo test lint gpu peers clean

demo: .venv/installed
	$(BIN)/mixer demo

test: .venv/installed-dev
	$(BIN)/python -m pytest

lint: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# What needs a GPU: the tests marked so, and the rows of benchmarks/scaling.py. It fetches nothing;
# with another Python than that of `make test`: make gpu BIN=FOLDER_OF_THAT_PYTHON.
gpu:
	$(BIN)/python -c 'import mixer_torch.benchmarks' 2>/dev/null \
		|| $(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e ".[all]"
	$(BIN)/python -m pytest -n0 -m cuda
	$(BIN)/python -m mixer_torch.benchmarks.scaling --device cuda --out out/benchmarks/scaling_gpu

# The trackers that benchmarks/tracking.py compares with; they, too, ask for the other OpenCV.
peers: .venv/installed
	$(INSTALL) --no-deps -r benchmarks/peers.txt

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed, this is " + sys.version.split()[0] + "; name another: make PYTHON=python3.11")'
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml constraints.txt | .venv/bin/python
	$(INSTALL) -e ".[all]"
	$(TRACKEVAL)
	@touch $@

.venv/installed-dev: pyproject.toml constraints.txt | .venv/bin/python
	$(INSTALL) -e ".[dev]"
	$(TRACKEVAL)
	@touch $@ .venv/installed

clean:
	rm -rf .venv out build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

# `make demo` in a fresh clone sets up .venv once and runs the demonstration.
#
#   PYTHON    interpreter for the environment (3.11 or later)
#   PIP_ARGS  further arguments for pip, e.g. an index with CPU-only builds of torch
#   WORKERS   test processes; each uses one thread
#   ARGS      passed on, e.g. make demo ARGS="source=published path=FOLDER"

PYTHON ?= python3
PIP_ARGS ?=
WORKERS ?= 2
ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.tactorch-installed
# One thread per process: the workers already share the cores.
ONE_THREAD := OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 NUMBA_NUM_THREADS=1
# Quick tests check the shapes of some calls, see tests/shape_checks.py; these of all.
ALL_CHECKED := TACTORCH_MAX_CHECKS=0
# Tests start processes: each would compile the package anew where bytecode is not kept.
KEEP_BYTECODE := PYTHONDONTWRITEBYTECODE=
# "worksteal" evens out files of very different length.
PARALLEL := -n $(WORKERS) --dist worksteal

export PIP_DISABLE_PIP_VERSION_CHECK := 1

.DEFAULT_GOAL := help
.PHONY: help setup demo test slow external docs dist lint format typecheck clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  %-10s %s\n", $$1, $$2}'

setup: $(STAMP)  ## make .venv and install the project with its tools

$(STAMP): pyproject.toml setup.py constraints.txt
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "Installing into $(VENV) (about two minutes the first time)"
	@$(BIN)/python -m pip install --quiet --progress-bar off $(PIP_ARGS) -c constraints.txt -e ".[test,dev,docs]"
	@touch $@

demo: $(STAMP)  ## simulate a soft cube with a stiff inclusion and find it again
	@$(BIN)/tactorch demo $(ARGS)

test: $(STAMP)  ## quick tests
	$(KEEP_BYTECODE) $(ONE_THREAD) $(BIN)/pytest -q $(PARALLEL) $(ARGS)

slow: $(STAMP)  ## tests that take long
	$(KEEP_BYTECODE) $(ALL_CHECKED) $(BIN)/pytest -q -m slow $(ARGS)

external: $(STAMP)  ## tests on the shared data (TACTORCH_SHARED, or ../shared)
	$(KEEP_BYTECODE) $(ALL_CHECKED) $(BIN)/pytest -q -m external $(ARGS)

docs: $(STAMP)  ## build the documentation into site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict $(ARGS)
	@echo "Open site/index.html"

dist: $(STAMP)  ## wheel and source archive into dist/, checked
	@$(BIN)/python -m pip install --quiet --progress-bar off $(PIP_ARGS) -c constraints.txt -e ".[dist]"
	rm -rf dist build
	$(BIN)/python -m build --no-isolation
	$(BIN)/twine check --strict dist/*

lint: $(STAMP)  ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(STAMP)  ## ruff: repair what it can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

typecheck: $(STAMP)  ## mypy
	$(BIN)/mypy

clean:  ## remove the environment, builds and caches; runs in outputs/ stay
	rm -rf $(VENV) build dist site *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# robustopt. `make demo` and `make test` do all the set-up they need: a virtual environment in .venv with pinned versions.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUN := $(BIN)/robustopt
# One thread for linear algebra, as in the command line: the matrices are small.
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow lint format type docs bench bench-execution bench-learners reproduce-tables reproduce-all clean

help:  ## what each target does
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 20

$(VENV)/.run: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "robustopt needs Python 3.11 or newer: make PYTHON=python3.12 ..."; exit 1; }
	$(PYTHON) -m venv $(VENV) || { echo "on Debian and Ubuntu: apt-get install python3-venv"; exit 1; }
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	$(BIN)/python -m compileall -q robustopt
	@touch $@

$(VENV)/.test: $(VENV)/.run
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test,robots]'
	@touch $@

demo: $(VENV)/.run  ## install, then plan the two-block waiter task; the run is left in results/demo
	rm -rf results/demo
	$(RUN) plan configs/waiter_two_blocks.yaml --out results/demo

test: $(VENV)/.test  ## install, then run the tests
	$(BIN)/pytest -n 2

test-slow: $(VENV)/.test  ## the tests that take minutes
	$(BIN)/pytest -m slow

lint: $(VENV)/.test  ## ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/.test  ## rewrite the code in the project's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

type: $(VENV)/.test  ## mypy --strict
	$(BIN)/mypy

docs: $(VENV)/.run  ## the reference of the configuration and its JSON Schema
	$(BIN)/python -m robustopt.config.schema

bench: $(VENV)/.test  ## time the solvers side by side; writes results/benchmarks
	$(BIN)/python experiments/bench_planning.py

bench-execution: $(VENV)/.test  ## executor against a bare MuJoCo rollout, and its memory; writes results/benchmarks
	$(BIN)/python experiments/bench_execution.py

bench-learners: $(VENV)/.test  ## learners of several parameters, on synthetic problems and in MuJoCo; writes results/benchmarks
	$(BIN)/python experiments/bench_learners.py
	$(BIN)/python experiments/bench_learners_real.py

reproduce-tables: $(VENV)/.run  ## the paper's tables and figure, beside the paper's numbers; writes results/tables
	$(BIN)/python experiments/reproduce.py

reproduce-all: $(VENV)/.run  ## everything beyond the paper too, over an hour; goes on where it was interrupted
	$(BIN)/python experiments/reproduce.py --all

clean:  ## remove the environment and what the tools left
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

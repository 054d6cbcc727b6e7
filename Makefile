# `make demo` and `make test` set up all they need: a virtual environment in .venv with the versions of constraints.txt.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUN := $(BIN)/robustopt
# One thread for linear algebra, as in the command line: the matrices are small.
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow lint format type hooks docs bench bench-execution bench-learners reproduce-tables reproduce-all clean

help:  ## list the targets
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

demo: $(VENV)/.run  ## install, then plan the two-block waiter task into results/demo
	rm -rf results/demo
	$(RUN) plan configs/waiter_two_blocks.yaml --out results/demo

test: $(VENV)/.test  ## install, then run the tests
	$(BIN)/pytest -n 2

test-slow: $(VENV)/.test  ## run the tests that take minutes
	$(BIN)/pytest -m slow

lint: $(VENV)/.test  ## check style and format with ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/.test  ## rewrite the code in the format of ruff
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

type: $(VENV)/.test  ## check the types with mypy --strict
	$(BIN)/mypy

hooks: $(VENV)/.test  ## install the checks that run before each commit
	$(BIN)/pip install --quiet --disable-pip-version-check pre-commit
	$(BIN)/pre-commit install

docs: $(VENV)/.run  ## write the reference of the configuration and its JSON Schema
	$(BIN)/python -m robustopt.config.schema

bench: $(VENV)/.test  ## time the solvers side by side, into results/benchmarks
	$(BIN)/python experiments/bench_planning.py
	$(BIN)/python experiments/bench_splines.py
	$(BIN)/python experiments/quintics.py

bench-execution: $(VENV)/.test  ## time executions beside a bare MuJoCo rollout, into results/benchmarks
	$(BIN)/python experiments/bench_execution.py

bench-learners: $(VENV)/.test  ## compare the learners of several parameters, into results/benchmarks
	$(BIN)/python experiments/bench_learners.py
	$(BIN)/python experiments/bench_learners_real.py

reproduce-tables: $(VENV)/.run  ## write the paper's tables and figures beside ours, into results/tables
	$(BIN)/python experiments/reproduce.py

reproduce-all: $(VENV)/.run  ## write all tables, over an hour; resumes after an interruption
	$(BIN)/python experiments/reproduce.py --all

clean:  ## remove the environment and the caches of the tools
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Everything runs in .venv, which the first command makes. Needs Python 3.11 or later, git and make.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin

.PHONY: study test lint types check measure bench paper conservatism pareto docs clean

study: .venv/run  ## install, and run the main job: how much unmodelled lag does a DSSC loop survive?
	$(BIN)/dssc-jax sweep studies/mu_robustness.toml

test: .venv/test  ## install, and run the tests, in two processes: most of the time is compilation, on one core each
	$(BIN)/python -m pytest -n 2 --dist worksteal

lint: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/test
	$(BIN)/pyright --pythonpath $(BIN)/python

check: lint types test  ## what CI runs

measure: .venv/run  ## regenerate docs/measurements.md and the figures of the documentation
	$(BIN)/python benchmarks/measure.py

bench: .venv/bench .venv/simulators/done  ## regenerate docs/performance.md: beside C, Numba, NumPy; growth; other simulators
	$(BIN)/python -m benchmarks.speed --simulators .venv/simulators/bin/python

paper: .venv/run  ## regenerate docs/paper.md: the article's figures and a table of its claims
	$(BIN)/python -m benchmarks.paper

conservatism: .venv/run  ## regenerate docs/conservatism.md: certified against simulated
	$(BIN)/python benchmarks/conservatism.py

docs: .venv/docs  ## build the documentation site into site/; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict

pareto: .venv/test  ## regenerate docs/tuning.md: gains tuned, failures hunted, controllers on the same budget
	$(BIN)/python benchmarks/pareto.py

.venv/run: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

.venv/test: .venv/run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[test]"
	touch $@

.venv/docs: .venv/run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	touch $@

.venv/bench: .venv/run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[bench]"
	touch $@

# Other people's simulators, which want their own versions of what we use; the page tells where they do not install.
.venv/simulators/done:
	$(PYTHON) -m venv .venv/simulators
	for name in crazyflow "rotorpy torch"; do \
		.venv/simulators/bin/python -m pip install --quiet --disable-pip-version-check $$name || echo "no $$name here"; done
	touch $@

clean:
	rm -rf .venv build dist site .pytest_cache .ruff_cache

# Everything runs in .venv, which the first command makes. Needs Python 3.11 or later, git and make.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
PARALLEL := -n logical --maxprocesses 6 --dist worksteal
QUICK := $(addprefix tests/,engine/test_batching.py lanes closed_loop/test_settled.py test_protocols.py cli/test_commands.py)

# Each command and many tests are processes of their own: they read the modules' bytecode instead of compiling them again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: study test quick lint types check measure bench ratios proofs fuzz paper conservatism noise laws library fmu formulas notebooks pages screenshots exploring pareto wind docs clean hover vehicle answers

study: $(VENV)/run  ## install, and run the main job: how much unmodelled lag does a DSSC loop survive?
	$(BIN)/dssc-jax sweep studies/mu_robustness.toml

test: $(VENV)/test  ## install, and run the tests, in a process for each core, at most six: each needs some 2 GB
	$(BIN)/python -m pytest $(PARALLEL)

quick: $(VENV)/test  ## the tests that tell whether another Python or JAX will do: make quick VENV=.venv-next PYTHON=python3.13
	$(BIN)/python tests/newest_jax.py
	$(BIN)/python -m pytest $(PARALLEL) $(QUICK)

lint: $(VENV)/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/test
	$(BIN)/pyright --pythonpath $(BIN)/python

check: lint types test  ## what CI runs

measure: $(VENV)/run  ## regenerate docs/measurements.md and the figures of the documentation
	$(BIN)/python benchmarks/measure.py

bench: $(VENV)/bench $(VENV)/test $(VENV)/simulators/done  ## regenerate docs/performance.md: beside C, Numba, NumPy; growth; commands; other simulators
	$(BIN)/python -m benchmarks.speed
	$(BIN)/python -m benchmarks.speed.waiting
	$(BIN)/python -m benchmarks.speed.others $(VENV)/simulators/bin/python $(wildcard $(VENV)/simulators-newest/bin/python)

paper: $(VENV)/run  ## regenerate docs/paper.md: the article's figures and a table of its claims
	$(BIN)/python -m benchmarks.paper

conservatism: $(VENV)/run  ## regenerate docs/conservatism.md: certified against simulated
	$(BIN)/python -m benchmarks.conservatism

docs: $(VENV)/docs  ## build the documentation site into site/; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict

noise: $(VENV)/run  ## regenerate docs/noise.md: measurement noise in DSSC, other controllers and differentiators
	$(BIN)/python -m benchmarks.noise

ratios: $(VENV)/test  ## fail if the loop became slower than plain XLA and C allow; on a quiet machine
	$(BIN)/python -m pytest benchmarks/speed/test_ratios.py

proofs: $(VENV)/test  ## regenerate the measured part of docs/proofs.md: what is proved, and who tried to break it
	$(BIN)/python -m benchmarks.proofs

vehicle: $(VENV)/test  ## regenerate the measured part of docs/vehicle_proofs.md: the same for the whole vehicle
	$(BIN)/python -m benchmarks.vehicle_proofs

fuzz: $(VENV)/test  ## regenerate a part of docs/lanes.md: 100,000 random programs of jax.lax as machine code, half an hour
	$(BIN)/python -m benchmarks.fuzz --page

library: $(VENV)/run  ## regenerate the measured part of docs/library.md: bits and rates of controllers in C
	$(BIN)/python -m benchmarks.library

fmu: $(VENV)/test  ## regenerate the measured part of docs/fmu.md: rates of loops with an FMU
	$(BIN)/python -m benchmarks.fmu

laws: $(VENV)/run  ## regenerate the measured parts of docs/laws.md: the vehicle, and how often the bounds hold
	$(BIN)/python -m benchmarks.laws

formulas: $(VENV)/test $(VENV)/rtamt/done  ## regenerate a part of docs/formulas.md: 1,000 random formulas against NumPy and rtamt
	$(BIN)/python -m benchmarks.formulas $(VENV)/rtamt/bin/python

notebooks: $(VENV)/test  ## run the notebooks anew; a test tells where their stored output is old
	$(BIN)/python -m benchmarks.notebooks

pages: $(VENV)/run  ## regenerate docs/study-file.md and docs/commands.md
	$(BIN)/python -m benchmarks.pages

screenshots: $(VENV)/test  ## regenerate the pictures of docs/explore.md
	$(BIN)/python -m benchmarks.screenshots

exploring: $(VENV)/test  ## regenerate the measured part of docs/explore.md
	$(BIN)/python -m benchmarks.exploring

pareto: $(VENV)/test  ## regenerate docs/tuning.md: gains tuned, failures hunted, controllers on the same budget
	$(BIN)/python benchmarks/pareto.py

answers: $(VENV)/run $(VENV)/peers/done  ## regenerate the table of docs/which_method.md: simulations and seconds, beside other tools
	$(BIN)/python -m benchmarks.answers $(VENV)/peers/bin/python

hover: $(VENV)/test  ## regenerate docs/figures/hover_wind.png and a part of docs/vehicle_proofs.md: hover in bounded wind
	$(BIN)/python -m benchmarks.hover

wind: $(VENV)/test  ## regenerate the measured part of docs/wind.md: the worst winds found
	$(BIN)/python -m benchmarks.wind

$(VENV)/run: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[proofs]"
	touch $@

$(VENV)/test: $(VENV)/run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[test]"
	touch $@

$(VENV)/docs: $(VENV)/run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	touch $@

$(VENV)/bench: $(VENV)/run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[bench]"
	touch $@

# Other people's simulators, which want their own versions of what we use; the page tells where they do not install.
# Elodin wants a newer Python.
$(VENV)/simulators/done:
	$(PYTHON) -m venv $(VENV)/simulators
	if python3.13 --version; then python3.13 -m venv $(VENV)/simulators-newest && \
		$(VENV)/simulators-newest/bin/python -m pip install --quiet --disable-pip-version-check elodin; fi
	for name in crazyflow "rotorpy torch torchdiffeq roma"; do \
		$(VENV)/simulators/bin/python -m pip install --quiet --disable-pip-version-check $$name || echo "no $$name here"; done
	touch $@

$(VENV)/rtamt/done:
	$(PYTHON) -m venv $(VENV)/rtamt
	$(VENV)/rtamt/bin/python -m pip install --quiet --disable-pip-version-check rtamt==0.4.10
	touch $@

# Other tools for uncertainty, which want an older numpy than we do.
$(VENV)/peers/done: benchmarks/answers/peers.txt
	$(PYTHON) -m venv $(VENV)/peers
	$(VENV)/peers/bin/python -m pip install --quiet --disable-pip-version-check --requirement benchmarks/answers/peers.txt
	touch $@

clean:
	rm -rf $(VENV) build dist site .pytest_cache .ruff_cache

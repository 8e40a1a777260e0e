# `make fly`, `make test` and `make quick` make their own virtual environment in .venv.
PYTHON ?= python3
VENV := .venv
# or each of the hundreds of processes of the tests would compile the sources anew
unexport PYTHONDONTWRITEBYTECODE
BIN := $(VENV)/bin
# not compiled: Python does that by itself with what is imported, a tenth of what is installed
PIP := $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt

.PHONY: fly view test quick bench docs clean

fly: $(VENV)/.fly
	$(BIN)/flightstack sitl --scenario paper_moving_1 --filter robust

# the same flight with a live view in 3-D
view: $(VENV)/.fly
	$(PIP) --editable '.[sim,report,view]'
	$(BIN)/flightstack sitl --scenario paper_moving_1 --filter robust --view native

# the project's own files: a user's scratch code in the checkout is not linted
SOURCES := (git ls-files '*.py' 2>/dev/null || echo .)

# what `make test` and `make quick` have in common; the argument is done meanwhile
define CHECK
@echo ruff; $(SOURCES) | xargs $(BIN)/ruff check
@$(SOURCES) | xargs $(BIN)/ruff format --check
$(BIN)/lint-imports --no-logo --no-cache
$(1) & $(BIN)/mypy && wait $$!
endef
# the simulator's loops are compiled once, and the tests' sources, and not by each worker
WARM := $(BIN)/python -m sim.runners.landing
COLLECT := $(BIN)/python -m pytest --collect-only -q >/dev/null

# a test that ends its worker is given to the next one, which it ends, too
test: $(VENV)/.test
	$(call CHECK,($(WARM) && $(COLLECT)))
	$(BIN)/python -m pytest -n auto --dist loadgroup --max-worker-restart 1 -q

# the unit tests without those marked slow, with fewer random examples; one worker a core, as none flies in real time
quick: $(VENV)/.test
	$(call CHECK,$(WARM))
	$(BIN)/python -m pytest -n logical --dist loadgroup -q -m "not slow" --hypothesis-profile=quick tests/unit

# the documentation site, into build/site; a broken link fails
docs: | $(VENV)/bin/python
	$(PIP) --editable '.[sim,docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo build/site/index.html

bench: $(VENV)/.test
	$(BIN)/python -m tests.benchmarks

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or newer is needed; found $$($(PYTHON) --version). Try: make PYTHON=python3.12 fly"; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.fly: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) --editable '.[sim,report]'
	@touch $@

$(VENV)/.test: pyproject.toml constraints.txt tests/requirements-nodeps.txt | $(VENV)/bin/python
	$(PIP) --editable '.[all,docs]'
	$(PIP) --no-deps --requirement tests/requirements-nodeps.txt
	@touch $@ $(VENV)/.fly

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache

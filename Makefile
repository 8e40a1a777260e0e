# `make fly`, `make test` and `make quick` create a virtual environment in .venv.
PYTHON ?= python3
VENV := .venv
# if it were set, each of the hundreds of processes of the tests would compile the sources again
unexport PYTHONDONTWRITEBYTECODE
BIN := $(VENV)/bin
# pip compiles nothing: Python compiles the modules that it imports, a tenth of the installed ones
PIP := $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt

.PHONY: fly view test quick bench docs clean

fly: $(VENV)/.fly
	$(BIN)/flightstack sitl --scenario paper_moving_1 --filter robust

# the flight of `make fly` with a live 3-D view
view: $(VENV)/.fly
	$(PIP) --editable '.[sim,report,view]'
	$(BIN)/flightstack sitl --scenario paper_moving_1 --filter robust --view native

# only files of the project: other files in the checkout are not linted
SOURCES := (git ls-files '*.py' 2>/dev/null || echo .)

# checks of `make test` and `make quick`; the command $(1) runs at the same time as mypy
define CHECK
@echo ruff; $(SOURCES) | xargs $(BIN)/ruff check
@$(SOURCES) | xargs $(BIN)/ruff format --check
$(BIN)/lint-imports --no-logo --no-cache
$(1) & $(BIN)/mypy && wait $$!
endef
# these compile the simulator's loops (also for filters of users) and the sources of the tests once, so that the workers need not
LOOPS := $(BIN)/python -m sim.runners.landing
WARM := $(LOOPS) robust paper examples.own_filter:Smooth
COLLECT := $(BIN)/python -m pytest --collect-only -q >/dev/null

# one restart only: a test that ends its worker runs again in the next worker, and ends that one, too
test: $(VENV)/.test
	$(call CHECK,($(COLLECT) & $(WARM) && wait $$!))
	$(BIN)/python -m pytest -n auto --dist loadgroup --max-worker-restart 1 -q

# unit tests without those marked slow, with fewer random examples; one worker per core, as no test flies in real time
quick: $(VENV)/.test
	$(call CHECK,$(WARM))
	$(BIN)/python -m pytest -n logical --dist loadgroup -q -m "not slow" --hypothesis-profile=quick tests/unit

# builds the documentation site in build/site; a broken link is an error
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

# compiles the loops of the filter robust while pip, which uses one core, installs what they do not need
$(VENV)/.test: pyproject.toml constraints.txt tests/requirements-nodeps.txt | $(VENV)/bin/python
	$(PIP) --editable '.[sim]'
	$(LOOPS) robust & $(PIP) --editable '.[all,docs]' && wait $$!
	$(PIP) --no-deps --requirement tests/requirements-nodeps.txt
	@touch $@ $(VENV)/.fly

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache

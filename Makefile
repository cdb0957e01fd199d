# The project's chores. All they need is Python 3.11 or newer, make, and a package index that pip can reach.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

# Everything pip installs here, packages and build back-ends alike, has the version constraints.txt gives it.
export PIP_CONSTRAINT := constraints.txt
export PIP_BUILD_CONSTRAINT := constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# Modules stay compiled: the tests start a hundred processes, and each would compile them again.
export PYTHONDONTWRITEBYTECODE :=

OLD_ENOUGH := import sys; \
	sys.version_info >= (3, 11) or sys.exit("psmpc needs Python 3.11 or newer, and this is " \
	+ sys.version.split()[0] + " at " + sys.executable + "; choose another: make PYTHON=python3.11 ...")

.PHONY: help setup demo test test-slow coverage check build docs gallery docs-tables baseline calibration random-tasks pin clean

help:
	@echo 'make setup   the environment in $(VENV), from the pinned versions'
	@echo 'make demo    the transport task in closed loop, with its figures and its page'
	@echo 'make test      the tests of every edit, some minutes'
	@echo 'make test-slow  the other tests, some ten minutes'
	@echo 'make coverage  the tests of every edit with a count of the lines they pass, 95 % at least'
	@echo 'make check   format, lint, types, the import rules, and the numbers of the front pages against their sources'
	@echo 'make docs    the documentation as a site in site/, every link checked'
	@echo 'make build   the wheel, tried out in an empty environment'
	@echo 'make baseline     benchmarks/{baseline,weights}.yaml again: the tables changes are compared with (some 5 minutes)'
	@echo 'make calibration  benchmarks/calibration.jsonl completed: what the paper leaves open, at random (some 2 hours from nothing)'
	@echo 'make docs-tables  regenerates the tables of README.md and docs/, on a quiet machine; ONLY=WORD: of a page or a command'
	@echo 'make gallery      regenerates the figures of README.md and docs/ and the outputs of the tutorial (some 10 minutes)'
	@echo 'make random-tasks benchmarks/random_tasks.yaml again: one iteration of sqp a sample against fatrop (some 15 minutes)'
	@echo 'make pin     constraints.txt again, from the newest versions'
	@echo 'make clean   removes the environment, the wheel and the caches (runs/ stays)'

setup: $(READY)

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c '$(OLD_ENOUGH)'
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --editable '.[test,docs]'
	@# pip compiles on one core; templates among the packages are no Python
	-@$(BIN)/python -m compileall -qq -j 0 $(VENV)/lib
	@touch $@

demo: $(READY)
	$(BIN)/psmpc simulate transport --output runs/transport.h5 --force
	@echo 'The log and the figures:'
	@ls -1 runs/transport.h5 runs/transport/*.png
	$(BIN)/psmpc view runs/transport.h5 --force
	@echo 'Shown: the paper'"'"'s transport task. It bounds neither forces nor accelerations, so the base stops within milliseconds'
	@echo 'with forces that no thruster has; other tasks have limits (docs/mobility.md). Open the page named above in a browser.'

test: $(READY)
	$(BIN)/python -m pytest -m 'not slow' --numprocesses auto --dist loadfile

test-slow: $(READY)
	$(BIN)/python -m pytest -m slow --numprocesses auto --dist loadfile --no-loadscope-reorder

coverage: $(READY)
	$(BIN)/python -m pytest -m 'not slow' --numprocesses auto --dist loadfile --cov --cov-report=term:skip-covered

check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python benchmarks/prose_numbers.py > /dev/null

build: $(READY)
	rm -rf dist
	$(BIN)/python -m hatchling build --target wheel --directory dist
	.ci/smoke $(PYTHON) dist/*.whl

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --clean
	@echo 'site/index.html'

gallery: $(READY)
	$(BIN)/python benchmarks/pages.py gallery.py
	$(BIN)/python benchmarks/tutorial.py

baseline: $(READY)
	$(BIN)/python benchmarks/baseline.py

calibration: $(READY)
	$(BIN)/python benchmarks/calibration.py screen 1000
	$(BIN)/python benchmarks/calibration.py refine 100

random-tasks: $(READY)
	$(BIN)/python benchmarks/random_tasks.py

PEERS := benchmarks/peers

$(PEERS)/.venv-%/.ready: $(PEERS)/requirements-%.txt
	$(PYTHON) -m venv --clear $(@D)
	PIP_CONSTRAINT= $(@D)/bin/python -m pip install --quiet --requirement $<
	@touch $@

PEERS_READY := $(PEERS)/.venv-acados/.ready $(PEERS)/.venv-rockit/.ready $(PEERS)/.venv-do-mpc/.ready

docs-tables: $(READY) $(if $(ONLY),$(if $(findstring peers,$(ONLY)),$(PEERS_READY)),$(PEERS_READY))
	$(BIN)/python benchmarks/pages.py $(ONLY)

pin:
	.ci/pin $(PYTHON)

clean:
	rm -rf $(VENV) dist .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis site

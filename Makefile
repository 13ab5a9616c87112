# `make build` sets everything up and builds the published sensor; `make test` sets everything up and
# tests; `make check` is the fast lane for editing, `make test-all` also runs the longest tests (every
# example, the tutorial, the convolutional baseline); `make docs` builds the documentation into site/.
# All are idempotent. Any Python from 3.11 on: PYTHON=python3.13 make test.
PYTHON ?= $(shell command -v python3.11 || command -v python3.12 || command -v python3.13 || command -v python3.14 || echo python3)
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Exact versions where they were tested; elsewhere the ranges of pyproject.toml.
LOCKED := $(shell $(PYTHON) -c 'import sys; print("-r requirements.lock" if sys.version_info[:2] == (3, 11) else "torch==2.13.0 setuptools .[dev]")' 2>/dev/null)
# pip compiles nothing (below), so Python must keep what it compiles at the first import: otherwise
# every process compiles its libraries again, which costs a second or three each.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: benchmarks build test test-all check docs pytest everything fast lint types contracts system setup clean

build: setup
	$(BIN)/phytac build cylinder60 --out exports/cylinder60

# Types are checked while tests begin: that takes one core, and tests do not depend on it.
test: setup lint contracts
	@$(MAKE) -j2 --no-print-directory types pytest

test-all: setup lint contracts
	@$(MAKE) -j2 --no-print-directory types everything

check: setup lint contracts
	@$(MAKE) -j2 --no-print-directory types fast

docs: setup
	$(BIN)/python -m tools.build_site
	@echo "open site/index.html"

# Hours; a run that was stopped continues with the parts that it has not made.
benchmarks: setup
	$(BIN)/python -m benchmarks

pytest: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not long"

everything: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal

fast: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not long"

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

contracts: setup
	$(BIN)/lint-imports

types: setup
	$(BIN)/mypy

setup: system $(STAMP)

system:
	@PYTHON=$(PYTHON) sh tools/system-packages.sh

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "error: $(PYTHON) is not Python 3.11 or newer; set PYTHON=…" >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile $(LOCKED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $(STAMP)

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache

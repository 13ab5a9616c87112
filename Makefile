# `make build` sets everything up and builds the published sensor; `make test` sets everything up and
# tests; `make check` is the fast lane for editing, `make test-all` also runs the longest tests (every
# example, the tutorial, the convolutional baseline); `make docs` builds the documentation into site/.
# All are idempotent. Any Python from 3.11 on: PYTHON=python3.13 make test.
PYTHON ?= $(shell command -v python3.11 || command -v python3.12 || command -v python3.13 || command -v python3.14 || echo python3)
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Exact versions where they were tested; elsewhere the ranges of pyproject.toml. The lock file is
# complete, and pip mostly unpacks: two processes install half of it each. It is halved by the
# alphabet, since packages that share a folder (trame-…, mujoco-…) begin alike. A new pip takes less
# processor time than Debian's: it finds packages faster.
# PyTorch's build for GPUs needs libraries that its build for CPUs, with which the file was locked,
# does not: where an index gives the former, they are added at the end.
PARTS := $(addprefix $(VENV)/.installed-,$(shell $(PYTHON) -c 'import sys; print("a-p q-z" if sys.version_info[:2] == (3, 11) else "ranges")' 2>/dev/null))
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
# pip compiles nothing (below), so Python must keep what it compiles at the first import: otherwise
# every process compiles its libraries again, which costs a second or three each.
unexport PYTHONDONTWRITEBYTECODE
# A virtual environment half made is not one.
.DELETE_ON_ERROR:

.PHONY: benchmarks build test test-all check docs pytest everything fast lint types contracts system setup clean

build: setup
	$(BIN)/phytac build cylinder60 --out exports/cylinder60

# Types and contracts are checked while tests begin: tests do not depend on them.
test: setup lint
	@$(MAKE) -j2 --no-print-directory contracts types pytest

test-all: setup lint
	@$(MAKE) -j2 --no-print-directory contracts types everything

check: setup lint
	@$(MAKE) -j2 --no-print-directory contracts types fast

docs: setup
	$(BIN)/python -m tools.build_site
	@echo "open site/index.html"

# Hours; a run that was stopped continues with the parts that it has not made.
benchmarks: setup
	$(BIN)/python -m benchmarks

pytest: system $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not long"

everything: system $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist worksteal

fast: system $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not long"

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

contracts: $(STAMP)
	$(BIN)/lint-imports

types: $(STAMP)
	$(BIN)/mypy

# What is not Python's is installed beside what is.
setup:
	@$(MAKE) -j3 --no-print-directory system $(STAMP)

system: | $(BIN)/python
	@sh tools/system-packages.sh

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "error: $(PYTHON) is not Python 3.11 or newer; set PYTHON=…" >&2; exit 1; }
	@PYTHON=$(PYTHON) sh tools/system-packages.sh venv
	$(PYTHON) -m venv $(VENV)

$(STAMP): pyproject.toml $(PARTS) | $(BIN)/python
	PYTHONWARNINGS=ignore $(PIP) --no-deps --no-build-isolation -e .
	$(PIP) $$(grep '^torch==' requirements.lock)
	touch $@

# Before it is used twice at once.
$(VENV)/.installed-pip: requirements.lock | $(BIN)/python
	$(PIP) $$(grep '^pip==' $<)
	touch $@

$(VENV)/.installed-a-p: requirements.lock $(VENV)/.installed-pip
	$(PIP) --no-deps $$(grep -v '^pip==' $< | grep -i '^[a-p]')
	touch $@

$(VENV)/.installed-q-z: requirements.lock $(VENV)/.installed-pip
	$(PIP) --no-deps $$(grep -vi '^[a-p]' $<)
	touch $@

$(VENV)/.installed-ranges: pyproject.toml | $(BIN)/python
	$(PIP) torch==2.13.0 setuptools '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache

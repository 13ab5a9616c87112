# Two commands: `make build` sets everything up and builds the published sensor; `make test` sets
# everything up and tests. Both are idempotent.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Nothing is compiled at installation (below): what Python compiles at the first import is kept, or
# every process would compile its libraries anew, a second or three each.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: build test pytest lint types system setup clean

build: setup
	$(BIN)/phytac build cylinder60 --out exports/cylinder60

# Types are checked while tests begin: it takes one core, and tests do not need it.
test: setup lint
	@$(MAKE) -j2 --no-print-directory types pytest

pytest: setup
	$(BIN)/python -m pytest -n 2

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

setup: system $(STAMP)

system:
	@PYTHON=$(PYTHON) sh tools/system-packages.sh

# Python compiles what it imports; pip would compile all, which takes a minute.
$(STAMP): requirements.lock pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "error: $(PYTHON) is not installed; install Python 3.11 or set PYTHON=…" >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $(STAMP)

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache

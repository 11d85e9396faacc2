# Targets make their own environment in .venv; nothing installed elsewhere is used.
# PYTHON=/path/to/python3.12 chooses the interpreter (3.11 to 3.13).

unexport PYTHONPATH PYTHONHOME VIRTUAL_ENV PIP_USER PIP_TARGET PIP_PREFIX
# without byte code each interpreter that the tests start, and each worker, compiles all modules again
unexport PYTHONDONTWRITEBYTECODE
export PYTHONNOUSERSITE := 1

VENV    := .venv
BIN     := $(VENV)/bin
CORE    := $(VENV)/.core
STAMP   := $(VENV)/.installed
PIP     := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
PYTHON  ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
             $$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null \
             && echo $$p && exit; done)
ARGS    ?=
DEMO    ?= demo
DOCS_JOBS ?= auto

.PHONY: help demo test test-slow check lint kernels format bench docs clean
.DEFAULT_GOAL := help

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

# half of what tests and documentation need, in half the time
demo: $(if $(wildcard $(STAMP)),$(STAMP),$(CORE))  ## simulate the Zonguldak stereo twin, adjust it, write the report (DEMO=folder)
	$(BIN)/fg-orient simulate zonguldak --out $(DEMO)/zonguldak --overwrite
	$(BIN)/fg-orient adjust $(DEMO)/zonguldak/project.toml --backend graph --out $(DEMO)/result --overwrite
	@echo "report: $(abspath $(DEMO))/result/report.html"

# small matrices: two BLAS threads cost more than one, and every core has a worker already
test test-slow: export OPENBLAS_NUM_THREADS := 1

test: $(STAMP) kernels  ## all tests but the slow ones (ARGS=... goes to pytest)
	$(BIN)/python -m pytest -m "not slow" -n auto --dist loadscope $(ARGS)

test-slow: $(STAMP)  ## the full simulations
	$(BIN)/python -m pytest -m slow $(ARGS)

check: $(STAMP)  ## ruff, mypy, import-linter, records of constants by name, documentation
	$(MAKE) --no-print-directory --jobs=3 --output-sync docs lint kernels DOCS_JOBS=1

# each worker of the tests would compile them for itself
kernels: $(STAMP)  ## compile the numba kernels that the tests call most, or find them in the cache
	$(BIN)/python -m tests.support.kernels

lint: $(STAMP)  ## ruff, mypy, import-linter, records of constants by name
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.support.record_fields

format: $(STAMP)  ## let ruff mend and format the code
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(STAMP)  ## build the documentation into docs/_build/html, warnings are errors
	rm -rf docs/api  # made at each build; pages of modules that moved must go
	$(BIN)/sphinx-build -W --keep-going -q -j $(DOCS_JOBS) -b html docs docs/_build/html
	@echo "documentation: $(CURDIR)/docs/_build/html/index.html"

bench: $(STAMP)  ## time our backends against other software (ARGS="--full": hours), factors, RPC projection
	$(PIP) --group bench
	$(BIN)/python -m benchmarks.fast_path $(ARGS)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/graph_cost.py
	OMP_NUM_THREADS=1 GDAL_NUM_THREADS=1 $(BIN)/python benchmarks/rpc_projection.py

clean:  ## remove the environment and everything generated
	rm -rf $(VENV) demo docs/_build docs/api build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find factors fg_orient tests -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "no Python 3.11, 3.12 or 3.13 found; name one: make PYTHON=/path/to/python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(None if (3, 11) <= v[:2] <= (3, 13) else \
	  f"{sys.executable} is Python {v[0]}.{v[1]}; 3.11, 3.12 or 3.13 is needed: make PYTHON=/path/to/python3.12")'
	$(PYTHON) -m venv $(VENV)

$(CORE): pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e .
	@touch $@

# the pip of a new environment may be older than dependency groups (25.1)
$(STAMP): pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) "pip>=25.1"
	$(PIP) -e ".[all]" --group dev
	@touch $(CORE) $@

# The one list of tasks, for people and for CI. It needs Python 3.11 or newer with pip, and make.
#   make demo PYTHON=python3.12     another interpreter
#   make test VENV=/tmp/palletloc   another place for the environment

PYTHON ?= python3
VENV ?= .venv
DIST ?= dist
BIN := $(VENV)/bin

.PHONY: demo test slow check format docs bench build clean
.DEFAULT_GOAL := demo

demo: $(VENV)/installed  ## localize, track and evaluate the sample, write a page to look at
	$(BIN)/palletloc demo

test: $(VENV)/installed-test  ## the tests and the examples in the documentation
	$(BIN)/python -m pytest

slow: $(VENV)/installed-test  ## the tests that take minutes; exit code 5: there are none
	$(BIN)/python -m pytest -m slow || [ $$? -eq 5 ]

check: $(VENV)/installed-dev  ## lint, format, types, layers
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/installed-dev  ## rewrite what ruff can
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

docs: $(VENV)/installed-docs  ## the documentation, in docs/_build/html
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

bench: $(VENV)/installed  ## speed, as ratios within one process
	$(BIN)/python -m benchmarks

build: $(VENV)/installed-dev  ## source archive and wheel, in dist
	rm -f $(DIST)/*.whl $(DIST)/*.tar.gz
	$(BIN)/python -m build --outdir $(DIST)
	$(BIN)/python .ci/check_wheel.py $(DIST)

clean:  ## everything that the other targets made
	rm -rf $(VENV) $(DIST) docs/_build docs/gallery docs/api palletloc-demo .mypy_cache .pytest_cache .ruff_cache

# The stamps say which extras are installed, and for which pyproject.toml.
$(VENV)/installed: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(VENV)/installed-test: extras = test
$(VENV)/installed-docs: extras = docs
$(VENV)/installed-dev: extras = dev,test,docs
$(VENV)/installed-%: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[$(extras)]'
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("palletloc needs Python 3.11 or newer; name one with: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)

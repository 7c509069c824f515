# The one list of tasks, for people and for CI. It needs Python 3.11 or newer with pip, and make.
#   make demo PYTHON=python3.12     another interpreter
#   make test VENV=/tmp/palletloc   another place for the environment
#   make test CONSTRAINTS=          the newest releases of all dependencies, not those that the tests are known to pass with

PYTHON ?= python3
VENV ?= .venv
CONSTRAINTS ?= constraints.txt
PYTHONS ?= python3.11 python3.12 python3.13
DIST ?= dist
BIN := $(VENV)/bin
INSTALL = $(BIN)/python -m pip install --quiet $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS)) --editable

.PHONY: demo test smoke slow search check format docs bench build constraints clean
.DEFAULT_GOAL := demo

demo: $(VENV)/installed  ## localize, track and evaluate the sample, write a page to look at
	$(BIN)/palletloc demo

test: $(VENV)/installed-test  ## the tests and the examples in the documentation
	$(BIN)/python -m pytest

smoke: $(VENV)/installed-test  ## whether the installation works, in half a minute
	$(BIN)/python -m pytest -W default tests/test_smoke.py

slow: $(VENV)/installed-test  ## the tests that take minutes; exit code 5: there are none
	$(BIN)/python -m pytest -m slow --hypothesis-profile=many || [ $$? -eq 5 ]

search: $(VENV)/installed-test  ## random examples, very many, for what no test has found; takes hours
	$(BIN)/python -m pytest -m hypothesis --hypothesis-profile=search

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

constraints:  ## the newest releases, to test with from now on
	$(PYTHON) .ci/constraints.py $(PYTHONS) > constraints.new
	mv constraints.new constraints.txt

clean:  ## everything that the other targets made
	rm -rf $(VENV) $(DIST) docs/_build docs/gallery docs/api palletloc-demo .hypothesis .mypy_cache .pytest_cache .ruff_cache

# The stamps say which extras are installed, and for which pyproject.toml and constraints.
$(VENV)/installed: pyproject.toml $(CONSTRAINTS) | $(BIN)/python
	$(INSTALL) .
	@touch $@

$(VENV)/installed-test: extras = test
$(VENV)/installed-docs: extras = docs
$(VENV)/installed-dev: extras = dev,test,docs
$(VENV)/installed-%: pyproject.toml $(CONSTRAINTS) | $(BIN)/python
	$(INSTALL) '.[$(extras)]'
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("palletloc needs Python 3.11 or newer; name one with: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)

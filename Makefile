# Needs nothing but Python >= 3.11 and make.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin

# The tests start hundreds of processes: each would compile all modules anew.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test suite coverage check lint types docs clean

demo: $(VENV)/.installed
	$(BIN)/motionkit demo $(ARGS)

# mypy has one core for a minute, so the tests run beside it.
test: lint
	$(MAKE) --jobs 2 types suite

# Each worker has half of the folders, so that what the tests of a module share is made once; and one core.
suite: $(VENV)/.installed
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal $(ARGS)

# The suite, then the share of statements that it runs, by file and in all.
coverage: ARGS += --cov=motionkit --cov=nerm --cov=pahires --cov=peers --cov=eval --cov-report=term
coverage: suite

check: lint types

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed
	$(BIN)/mypy

# The site, in build/docs; a link that leads nowhere fails it.
docs: $(VENV)/.docs
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going docs build/docs

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev,text]'
	touch $@

$(VENV)/.docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	touch $@

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache

# Needs only Python, pip and make: everything else goes into a virtual environment of its own.
PYTHON ?= python3
VENV ?= .venv
ARGS ?=

.PHONY: train test lint clean

train: $(VENV)/installed
	$(VENV)/bin/ailsrs train hopper $(ARGS)

test: $(VENV)/installed
	$(VENV)/bin/pytest $(ARGS)

lint: $(VENV)/installed
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy

$(VENV)/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .hypothesis

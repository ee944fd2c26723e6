# You need only Python, pip and make. Everything else is installed in a virtual environment.
PYTHON ?= python3
VENV ?= .venv
ARGS ?=

.PHONY: train test test-matrix lint docs peer clean

train: $(VENV)/package
	$(VENV)/bin/ailsrs train halfcheetah --demonstrations expert:linear \
		--num-trajectories 1 --subsample 20 --iterations 14 $(ARGS)

test: $(VENV)/installed
	$(VENV)/bin/pytest $(ARGS)

# The supported Pythons that are installed, each in a fresh environment.
test-matrix:
	tests/matrix.sh

lint: $(VENV)/installed
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy

docs: $(VENV)/installed
	$(VENV)/bin/sphinx-build -W --keep-going -q -c docs . site
	-$(VENV)/bin/ailsrs render docs/gallery/hopper-ten-demonstrations.npz --play --output site/docs/play.html
	@echo site/index.html

# Optional: compare with GAIL of another package, which gets its own environment.
peer: $(VENV)/installed .venv-peer/installed
	$(VENV)/bin/python experiments/peer/compare.py $(ARGS)

# Enough to train; the tests, the linters and the documentation need more.
$(VENV)/package: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/installed: $(VENV)/package
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

.venv-peer/installed: experiments/peer/requirements.txt
	$(PYTHON) -m venv .venv-peer
	.venv-peer/bin/pip install --quiet --disable-pip-version-check --requirement $<
	.venv-peer/bin/pip install --quiet --disable-pip-version-check --no-deps imitation==1.0.1
	touch $@

clean:
	rm -rf $(VENV) .venv-peer site .mypy_cache .pytest_cache .ruff_cache .hypothesis

# make fit   train a classifier against the Moiré Attack, attack it again, write a report
# make test  lint, check types and run the tests
# make docs  build the site into site/; broken links and warnings are errors
# make clean remove .venv and site
PYTHON ?= python3
VENV := .venv/bin

.PHONY: fit test docs clean

fit: .venv/installed
	$(VENV)/python training/fit.py recipe=moire_at 'scene=[dashcam_at_led_sign,phone_at_laptop]' 'shrink=[1,3]' data.train=7000

test: .venv/installed-all
	$(VENV)/ruff check .
	$(VENV)/ruff format --check .
	$(VENV)/mypy
	OMP_NUM_THREADS=1 OMP_WAIT_POLICY=passive $(VENV)/python -m pytest -n auto --maxprocesses 8 --dist worksteal

docs: .venv/installed-docs
	NO_MKDOCS_2_WARNING=1 $(VENV)/mkdocs build --strict

.venv/bin/python:
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'moireaug needs Python 3.11 or newer, got ' + sys.version.split()[0] + '. Name one: make PYTHON=python3.12')"
	$(PYTHON) -m venv .venv

.venv/installed: .venv/bin/python pyproject.toml
	$(VENV)/python -m pip install --quiet --disable-pip-version-check --editable ".[train]"
	touch $@

.venv/installed-all: .venv/installed
	$(VENV)/python -m pip install --quiet --disable-pip-version-check --editable ".[all]"
	touch $@

.venv/installed-docs: .venv/installed
	$(VENV)/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	touch $@

clean:
	rm -rf .venv site

# make fit   train a classifier against the Moiré Attack, attack it again, write a report
# make test  lint, check types and run the tests
# make docs  build the site into site/; broken links and warnings are errors
# make clean remove the environments and site
PYTHON ?= python3
VENV := .venv/bin
DOCS_VENV := .venv-docs/bin
PIP := -m pip install --quiet --disable-pip-version-check

.PHONY: fit test docs clean

fit: .venv/installed
	$(VENV)/python training/fit.py recipe=moire_at 'scene=[dashcam_at_led_sign,phone_at_laptop]' 'shrink=[1,3]' data.train=7000

test: .venv/installed-all
	@echo "make test: 4 to 13 minutes on two cores, once everything is installed"
	$(VENV)/ruff check .
	$(VENV)/ruff format --check .
	$(VENV)/mypy
	OMP_NUM_THREADS=1 OMP_WAIT_POLICY=passive $(VENV)/python -m pytest -n auto --maxprocesses 8 --dist worksteal

# an environment of its own: torchattacks pins an older requests than mkdocs needs
docs: .venv-docs/installed
	NO_MKDOCS_2_WARNING=1 $(DOCS_VENV)/mkdocs build --strict

.venv/bin/python .venv-docs/bin/python:
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'moireaug needs Python 3.11 or newer, got ' + sys.version.split()[0] + '. Name one: make PYTHON=python3.12')"
	$(PYTHON) -m venv $(patsubst %/bin/python,%,$@)

.venv/installed: .venv/bin/python pyproject.toml
	$(VENV)/python $(PIP) --editable ".[train]"
	touch $@

.venv/installed-all: .venv/installed
	@echo "make test: installing every extra, about 2 minutes"
	$(VENV)/python $(PIP) --editable ".[all]"
	touch $@

.venv-docs/installed: .venv-docs/bin/python docs/requirements.txt
	$(DOCS_VENV)/python $(PIP) --requirement docs/requirements.txt
	touch $@

clean:
	rm -rf .venv .venv-docs site

# The commands that people and CI both run.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test lint bench evaluate config clean

$(VENV)/base.stamp: pyproject.toml
	.ci/venv $(PYTHON) $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	touch $@

$(VENV)/dev.stamp: $(VENV)/base.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev,ros]'
	touch $@

demo: $(VENV)/base.stamp
	$(BIN)/visual-compass demo

# the tests of one file share what they have simulated
test: $(VENV)/dev.stamp
	$(BIN)/python -m pytest -n auto --dist loadfile

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/dev.stamp
	set -e; for script in tests/benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script; done

evaluate: $(VENV)/base.stamp
	$(BIN)/visual-compass evaluate --seeds 20 --json out/evaluation.json

config: $(VENV)/base.stamp
	{ echo '# All parameters with their defaults, for ros2 --params-file and visual-compass --config. Made by `make config`.'; \
	$(BIN)/python -c 'from fusion.settings import *; print(dump_settings(Settings()), end="")'; } > config/visual_compass.yaml

clean:
	rm -rf $(VENV) build *.egg-info

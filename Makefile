# The commands that people and CI both run:
#   make check     while working: lint, and the tests without long simulations and without nodes; a minute on two cores
#   make test      before a change lands: all tests; 6 minutes on two cores, longer beside other programs, no less green
#   make lint      style and types alone
#   make torture   every sensor times every fault, and some at random, written to docs/faults.md; a quarter of an hour
#   make mutants   small changes made to the code on purpose, each of which its tests have to notice; ten minutes
#   make bench     speed, which no test judges, written to docs/benchmarks.md
#   make evaluate  every experiment with 20 seeds in the held-out worlds, written to docs/benchmarks.md: hours
#   make demo      a simulated drive, fused
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo check test lint torture mutants bench evaluate config clean

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

# what conftest.py does not mark as slow
check: lint
	$(BIN)/python -m pytest -n auto --dist loadfile -m 'not slow'

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

torture: $(VENV)/dev.stamp
	PYTHONPATH=tests $(BIN)/python -m torture

mutants: $(VENV)/dev.stamp
	PYTHONPATH=tests $(BIN)/python -m mutants

bench: $(VENV)/dev.stamp
	set -e; for script in tests/benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script --markdown docs/benchmarks.md; done

# the real log is not in this repository; tests/tools/photo_drive.py says where it is looked for
HUSKY := $(wildcard ../shared/data/husky.bag)

evaluate: $(VENV)/base.stamp
	mkdir -p out
	$(BIN)/visual-compass evaluate --seeds 20 --smooth --json out/evaluation.json
	$(if $(HUSKY),$(BIN)/visual-compass evaluate $(HUSKY) --smooth --json out/husky.json)
	$(BIN)/visual-compass evaluate out/evaluation.json $(if $(HUSKY),out/husky.json) --markdown docs/benchmarks.md --headline README.md

config: $(VENV)/base.stamp
	{ echo '# All parameters with their defaults, for ros2 --params-file and visual-compass --config. Made by `make config`.'; \
	$(BIN)/python -c 'from fusion.settings import *; print(dump_settings(Settings()), end="")'; } > config/visual_compass.yaml

clean:
	rm -rf $(VENV) build *.egg-info

# `make demo` and `make test` set everything up on a fresh machine; nothing else is needed before them.

PYTHON ?= python3
VENV ?= .venv
OUTPUT ?= demo-output
REPRODUCED ?= reproduced
HARDWARE ?= demo-hardware
BIN := $(VENV)/bin

.PHONY: install demo demo-hardware test check unit bench reproduce pictures packages dev clean

install: $(VENV)/.installed  ## the station in its own environment

demo: install  ## scan a face and a mould on a simulated rig, end with models, pictures and a report
	$(BIN)/fringe demo --output $(OUTPUT)

demo-hardware: packages dev  ## the real drivers, a real window and real ports on an emulated laboratory
	$(BIN)/python tools/demo_hardware.py --output $(HARDWARE)

test: packages dev check demo unit  ## everything that CI runs

check: dev  ## style, types, import contracts
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

unit: dev  ## the tests alone
	$(BIN)/python -m pytest

bench: $(VENV)/.bench  ## every figure, printed beside what it has to reach
	$(BIN)/python tests/bench/run.py

reproduce: dev  ## the registration experiments of the thesis, its tables beside ours; its face database
	$(BIN)/python tests/bench/reproduce.py --output $(REPRODUCED)
	$(BIN)/python tests/bench/bench_heads.py
	$(BIN)/python tests/bench/bench_models.py --output $(REPRODUCED)/models.png

pictures: dev  ## every picture of the documentation, drawn again
	@for script in $$(ls tools/pictures/*.py | grep -v shrink.py); do \
		echo "$$script"; $(BIN)/python "$$script" || exit 1; \
	done

packages:  ## the system packages that tests use
	@sh tools/debian-packages.sh

dev: $(VENV)/.dev

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --group dev
	touch $@

$(VENV)/.bench: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --editable '.[bench]'
	$(BIN)/python -m pip install --quiet --no-deps 'fringes>=2.1'  # its opencv-contrib would overwrite the headless OpenCV
	@ready() { ! $(BIN)/python -m pip show --quiet open3d 2>/dev/null || $(BIN)/python -c 'import open3d' >/dev/null 2>&1; }; \
	packages=$$(sed -n 's/^#bench //p' debian-packages.txt | tr '\n' ' '); \
	ready || [ "$$(id -u)" != 0 ] || { apt-get update -qq && \
		DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$packages; }; \
	ready || { $(BIN)/python -m pip uninstall --quiet --yes open3d; \
		echo "Open3D does not load and is left out: apt-get install $$packages; $(BIN)/python -m pip install open3d" >&2; }
	touch $@

clean:
	rm -rf $(VENV) $(OUTPUT) build dist

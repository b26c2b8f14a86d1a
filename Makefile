# `make demo` sets everything up and runs the main job; `make test` sets up and passes the tests.
VENV ?= .venv
PYTHON := $(VENV)/bin/python
SESSION ?=
TEST_PROCESSES ?= 3
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
export OPENBLAS_NUM_THREADS ?= 1
# without bytecode every process of a graph, and of the tests, compiles all sources and tests anew
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup setup-dev demo studio test test-all lint figures colcon clean
help:
	@echo "make demo [SESSION=folder]  set up, run the whole graph live on the built-in session (or a folder of videos)"
	@echo "make studio [SESSION=folder] set up, serve simulated GigE Vision cameras until Ctrl-C (docs/how-to/studio.md)"
	@echo "make test                   set up, run the tests in three processes;  make test-all: the slow ones too"
	@echo "make lint | figures         ruff and mypy | write the figures of docs/figures into the pages"
	@echo "make colcon | clean         colcon build in ros_ws | remove what was built"

setup:
	@VENV=$(VENV) scripts/setup.sh

setup-dev: # with what tests and checks need
	@VENV=$(VENV) scripts/setup.sh dev

demo: setup
	@$(PYTHON) -m sagoma_tools.cli demo $(if $(SESSION),--session "$(SESSION)")

studio: setup
	@$(PYTHON) -m sagoma_tools.cli studio $(if $(SESSION),--session "$(SESSION)")

test: setup-dev
	$(PYTHON) -m pytest -n $(TEST_PROCESSES)

test-all: TEST_PROCESSES = 2
test-all: setup-dev
	$(PYTHON) -m pytest -n $(TEST_PROCESSES) -m "slow or not slow" -o faulthandler_timeout=600

lint: setup-dev
	$(PYTHON) -m ruff check . && $(PYTHON) -m ruff format --check .
	@echo "mypy: the types of all packages (half a minute when nothing is cached)"
	@MYPYPATH=$(subst $() ,:,$(wildcard src/*)) $(PYTHON) -m mypy $(addprefix -p ,$(notdir $(wildcard src/*)))

figures: setup
	@$(PYTHON) scripts/figures.py

colcon: setup-dev
	cd ros_ws && COLCON_DEFAULTS_FILE=$$PWD/colcon_defaults.yaml ../$(VENV)/bin/colcon build

clean:
	rm -rf $(VENV) ros_ws/build ros_ws/install ros_ws/log output

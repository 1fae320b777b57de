# SPDX-License-Identifier: Apache-2.0
# The door to everything: `make` lists what there is. Nothing is installed outside .venv/ and build/.

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
MAKEFLAGS += --no-builtin-rules --no-print-directory
.NOTPARALLEL:
.DELETE_ON_ERROR:

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
LOG := build/setup.log
SRC := ros_ws/src
PACKAGES := microhand_node microhand_planner stage_driver_sim microhand_twin microhand_station

# A sourced ROS installation, or an active environment with ROS wheels, would put its own packages and
# libraries before ours. `make` works on the wheels of .venv alone.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH PYTHONHOME
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE VIRTUAL_ENV ROS_DISTRO
# Constraints hold everywhere, also for what pip would fetch to build something.
export PIP_CONSTRAINT := requirements/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# `py3.11`: builds of different Pythons live side by side. An existing .venv decides.
py_tag = $(shell $(1) -I -S -c 'import sys; print("py%d.%d" % sys.version_info[:2])' 2>/dev/null)
TAG := $(call py_tag,$(if $(wildcard $(BIN)/python),$(BIN)/python,$(PYTHON)))
TOOLS := build/$(TAG)/tools

# Stamps are named after the content that they stand for: a step is repeated when, and only when, it changed.
# So all prerequisites are order-only.
hash = $(shell sha256sum $(sort $(wildcard $(1))) | sha256sum | cut -c 1-12)
MSGS := $(SRC)/microhand_msgs_py
MSGS_HASH := $(call hash,$(MSGS)/*/*.msg $(MSGS)/*/*.srv $(MSGS)/*/*.action $(MSGS)/_wheel/*.* $(MSGS)/*.*)
PACKAGES_HASH := $(call hash,tools/link_into_prefix.py $(foreach p,$(PACKAGES),$(addprefix $(SRC)/$(p)/,setup.* package.xml launch/* config/* foxglove/* rviz/*)))
CORE_HASH := $(call hash,$(SRC)/microhand_planner/microhand_planner/*.py $(SRC)/microhand_planner/microhand_planner/core/*.py $(SRC)/microhand_twin/microhand_twin/*.py $(SRC)/stage_driver_sim/stage_driver_sim/model.py requirements/constraints.txt)
VENV_READY := $(VENV)/.ready/venv
REQUIREMENTS_READY := $(VENV)/.ready/requirements-$(call hash,requirements/runtime.txt requirements/dev.txt requirements/docs.txt requirements/constraints.txt)
TOOLS_READY := $(TOOLS)/.ready/build-$(call hash,requirements/build.txt requirements/constraints.txt)
COLCON_READY := $(TOOLS)/.ready/runtime-$(call hash,requirements/runtime.txt requirements/constraints.txt)
MSGS_WHEEL := build/$(TAG)/interfaces-$(MSGS_HASH)/.built
MSGS_READY := $(VENV)/.ready/interfaces-$(MSGS_HASH)
PACKAGES_READY := $(VENV)/.ready/packages-$(PACKAGES_HASH)
WARM_READY := $(VENV)/.ready/warm-$(CORE_HASH)

# $(call step,what people read,command): one line with the time taken; the log only if it fails.
define step
@mkdir -p build; printf '  %-46s' '$(1)'; start=$$SECONDS; \
if ! ( $(2) ) >$(LOG) 2>&1; then \
  printf 'failed\n\n' >&2; tail -n 40 $(LOG) >&2; printf '\nThe step "%s" failed; all of its log: %s\n' '$(1)' '$(LOG)' >&2; exit 1; \
fi; printf '%4d s\n' $$((SECONDS - start))
endef
# Only the stamp of the present content stays: going back to older content is a change, too.
done = mkdir -p $(@D) && rm -f $(@D)/$(firstword $(subst -, ,$(@F)))-* && touch $@

.PHONY: help setup run test lint format docs colcon clean python

help:  ## list the commands
	@echo 'microhand: plan and run the reorientation of a micro-object held by three fingers'
	@echo
	@sed -n 's/^\([a-z]*\):[^#]*## \(.*\)/\1|\2/p' Makefile | while IFS='|' read -r target what; do printf '  make %-8s %s\n' "$$target" "$$what"; done
	@echo
	@echo 'Everything sets up .venv first if needed. PYTHON=python3.12 make setup chooses the Python (3.10 to 3.13).'

setup: | $(WARM_READY)  ## make .venv: pinned packages, interfaces, the five Python packages
	@echo 'Ready: $(BIN)/microhand --help'

run: setup  ## reorient the ellipsoid of examples/ on a simulated station, record it, say how it went
	$(BIN)/microhand demo examples/ellipsoid.stl --euler-zyz 80 220 100

test: setup  ## run all tests
	$(BIN)/python -m pytest -n 2

lint: setup  ## style, types, imports between modules and packages, container files
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/yamllint --strict docker .yamllint.yaml
	$(BIN)/hadolint docker/Dockerfile

format: setup  ## put all Python files into the project's format
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

docs: setup  ## build the documentation site; a dead link, or any other warning, is an error
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet docs build/docs
	@echo 'Open build/docs/index.html'

# The same six packages by colcon, in an environment of its own, so that nothing can come from .venv.
# MAKEFLAGS keeps colcon from adding a load limit, which stalls the build on a busy machine.
COLCON := build/$(TAG)/colcon
COLCON_PYTHON := $(CURDIR)/$(TOOLS)/bin/python
colcon: python $(COLCON_READY)  ## build the workspace with colcon, as on Ubuntu, and check the result
	@echo 'Building $(SRC) with colcon into $(COLCON)'
	@AMENT_PREFIX_PATH='$(CURDIR)/$(TOOLS)' CMAKE_PREFIX_PATH='$(CURDIR)/$(TOOLS)' PATH="$(CURDIR)/$(TOOLS)/bin:$$PATH" MAKEFLAGS="-j$$(nproc)" \
	colcon --log-base $(COLCON)/log build --base-paths $(SRC) \
	  --build-base $(COLCON)/build --install-base $(COLCON)/install --event-handlers console_stderr- \
	  --cmake-args -G Ninja -DBUILD_TESTING=OFF -DCMAKE_BUILD_TYPE=Release \
	    '-DPython3_EXECUTABLE=$(COLCON_PYTHON)' '-DPYTHON_EXECUTABLE=$(COLCON_PYTHON)' \
	    '-DCMAKE_PROJECT_INCLUDE=$(CURDIR)/$(MSGS)/_wheel/wheel.cmake' \
	|| { tail -n 40 $(COLCON)/log/latest_build/*/stderr.log; exit 1; }
	@set +u; export AMENT_PREFIX_PATH='$(CURDIR)/$(TOOLS)'; source $(COLCON)/install/local_setup.bash; \
	$(COLCON_PYTHON) tools/check_install.py $(COLCON)/install

clean:  ## remove .venv, builds and caches; recorded runs stay
	rm -rf $(VENV) build .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache $(SRC)/*/*.egg-info $(SRC)/*/build
	find ros_ws tests -name __pycache__ -prune -exec rm -rf {} +

# One clear line for what is missing, before anything is made.
python:
	@fail() { echo "microhand: $$1" >&2; exit 1; }; \
	if [[ -x $(BIN)/python ]]; then \
	  [[ '$(origin PYTHON)' == file || '$(TAG)' == '$(call py_tag,$(PYTHON))' ]] \
	    || fail '.venv was made with $(TAG:py%=Python %), PYTHON=$(PYTHON) is another one: run `make clean` first'; \
	  exit 0; \
	fi; \
	command -v '$(PYTHON)' >/dev/null || fail '$(PYTHON) was not found; install Python 3.10 to 3.13, or name it: make PYTHON=/path/to/python3'; \
	[[ '$(TAG)' =~ ^py3\.1[0-3]$$ ]] || fail '$(PYTHON) is $(TAG:py%=Python %), but Python 3.10 to 3.13 is needed: make PYTHON=/path/to/python3'; \
	'$(PYTHON)' -c 'import ensurepip, venv' 2>/dev/null || fail '$(PYTHON) cannot make environments; install its venv module (Debian, Ubuntu: python3-venv)'; \
	'$(PYTHON)' -c 'import os, sysconfig; os.stat(sysconfig.get_path("include") + "/Python.h")' 2>/dev/null \
	  || fail '$(PYTHON) has no header files; install them (Debian, Ubuntu: python3-dev)'; \
	for compiler in gcc g++; do command -v $$compiler >/dev/null || fail "no $$compiler; a C and a C++ compiler build the ROS interfaces (Debian, Ubuntu: build-essential)"; done

$(VENV_READY): | python
	@echo 'Setting up $(VENV) with $(TAG:py%=Python %); the first time takes about three minutes.'
	$(call step,environment,rm -rf $(VENV) && '$(PYTHON)' -m venv $(VENV) && $(BIN)/python -m pip install pip)
	@$(done)

$(REQUIREMENTS_READY): | $(VENV_READY)
	$(call step,ROS 2 Jazzy and Python packages,$(BIN)/python -m pip install -r requirements/runtime.txt -r requirements/dev.txt -r requirements/docs.txt)
	@$(done)

$(TOOLS_READY): | python
	$(call step,build tools,'$(if $(wildcard $(BIN)/python),$(BIN)/python,$(PYTHON))' -m venv $(TOOLS) \
	  && $(TOOLS)/bin/python -m pip install pip && $(TOOLS)/bin/python -m pip install -r requirements/build.txt)
	@$(done)

$(COLCON_READY): | $(TOOLS_READY)
	$(call step,build tools: what the packages need to run,$(TOOLS)/bin/python -m pip install -r requirements/runtime.txt)
	@$(done)

# --no-build-isolation: the tools environment is the isolation, and is kept for the next build.
$(MSGS_WHEEL): | $(TOOLS_READY)
	$(call step,interfaces (generates and compiles),rm -rf build/$(TAG)/interfaces-* && mkdir -p $(@D) \
	  && $(TOOLS)/bin/python -m pip wheel --no-build-isolation --no-deps --wheel-dir $(@D) ./$(MSGS))
	@$(done)

$(MSGS_READY): | $(REQUIREMENTS_READY) $(MSGS_WHEEL)
	$(call step,interfaces: install,$(BIN)/python -m pip install --no-index --no-deps --force-reinstall $(dir $(MSGS_WHEEL))*.whl)
	@$(done)

# Editable, by a plain path file (`compat`) that type checkers follow as well.
$(PACKAGES_READY): | $(MSGS_READY)
	$(call step,$(PACKAGES),$(BIN)/python -m pip install --no-build-isolation --no-deps --no-index \
	  --config-settings editable_mode=compat $(addprefix -e ./$(SRC)/,$(PACKAGES)) \
	  && $(BIN)/python tools/link_into_prefix.py $(addprefix ./$(SRC)/,$(PACKAGES)))
	@$(done)

# numba compiles searches, contacts and stages once, here, so that nobody waits for it later. It keeps code by the age of one file, and
# would not see that a function from another file has changed: so it begins from nothing.
$(WARM_READY): | $(PACKAGES_READY) python
	$(call step,compiled code,find $(SRC)/microhand_planner $(SRC)/microhand_twin $(SRC)/stage_driver_sim -name '*.nb[ci]' -delete \
	  && $(BIN)/python -m microhand_planner.warm_up && $(BIN)/python -m microhand_twin.warm_up && $(BIN)/python -m stage_driver_sim.warm_up)
	@$(done)

# `make help` lists the targets.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
MAKEFLAGS += --no-builtin-rules --no-print-directory
.DELETE_ON_ERROR:
.DEFAULT_GOAL := all

PYTHON ?= python3
SEED ?= 1
# Two more than there are cores: nodes, browsers and processes that end are waited for a third of the time.
WORKERS ?= $(shell expr $$(nproc) + 2)
# The fast tests wait for little, and a worker takes four seconds to begin.
FEWER_WORKERS ?= $(shell expr $$(nproc) + 1)
MINUTES ?= 5

BIN := .venv/bin
# One file a step that is done; a step is done again when what it was made from is newer.
DONE := .venv/.done
# Errors alone: the warnings of pip are about the indexes and caches of the machine.
PIP := $(BIN)/python -m pip -qq --disable-pip-version-check --no-input
# uv takes half of the time of pip, but reads none of its settings: pip installs where an index or a proxy is set, and where
# uv fails, and reports what fails then.
LOCKED = $(PIP) install --require-hashes --no-deps --requirement
say = @printf '%s\n' '$(1)'
# What begins each step that installs: two at a time would write into each other, and pip refuses to replace what it was
# killed before it listed.
alone = [ -w Makefile ] || { echo 'this checkout belongs to another user: make one that you can write to' >&2; exit 1; }; \
    exec 9>>Makefile; flock -n 9 || \
    { echo 'another make installs into .venv, or what is left of an interrupted one: wait for its end' >&2; exit 1; }; \
    for own in .venv/lib/python*/site-packages/gyrowheel*.dist-info; do [ -e "$$own/RECORD" ] || rm -rf "$$own"; done

MSGS := src/gyrowheel_msgs
PACKAGES := $(addprefix src/gyrowheel,_core _sim _air _control _recording _analysis _bringup) src/gyrowheel
MSGS_FILES := $(addprefix $(MSGS)/,package.xml CMakeLists.txt pyproject.toml) $(wildcard $(MSGS)/*/*.*)
# Python modules are used where they stand; these are what an installation copies.
PACKAGE_FILES := $(foreach p,$(PACKAGES),$(wildcard \
    $(p)/pyproject.toml $(p)/package.xml $(p)/resource/* $(p)/scripts/* $(p)/launch/* $(p)/config/* $(p)/urdf/*))

export CMAKE_BUILD_PARALLEL_LEVEL ?= 2
# The nodes talk to this machine alone, unless told otherwise.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# .venv is a ROS installation of its own: nothing of another one that the shell may have sourced mixes in.
export AMENT_PREFIX_PATH := $(CURDIR)/.venv
unexport PYTHONPATH
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
endif

.PHONY: all demo test quick studies workspace wheels oldest fuzz bench lint docs notebooks site lock clean help

all: $(DONE)/packages ## create .venv and install the nine packages into it (also: just `make`)
	$(call say,ready: .venv/bin/gyrowheel ("make demo" shows what it does))

# An environment belongs to the folder in which it was made, and is made again from nothing in a checkout that was moved or
# copied, and where the installation of packages was interrupted, which pip takes for installed when half of them are there.
ifneq ($(file <$(DONE)/venv),$(CURDIR))
.PHONY: $(DONE)/venv $(DONE)/requirements
endif

$(DONE)/venv:
	$(call say,creating .venv)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12)))' || \
	    { echo 'Python 3.11 or 3.12 is needed; name it by: make PYTHON=/path/to/python3.11' >&2; exit 1; }
	@$(PYTHON) -c 'import os, sysconfig as s; sys_h = s.get_path("include") + "/Python.h"; assert os.path.exists(sys_h)' \
	    2>/dev/null || { echo 'the headers of Python are needed (Debian, Ubuntu: python3-dev)' >&2; exit 1; }
	@command -v "$${CXX:-c++}" >/dev/null || { echo 'a C and C++ compiler is needed (Debian, Ubuntu: g++)' >&2; exit 1; }
	@$(alone); $(PYTHON) -m venv --clear .venv; mkdir $(DONE); pwd -P > $@

$(DONE)/requirements: requirements.lock | $(DONE)/venv
	$(call say,installing the packages of requirements.lock (about a minute))
	@$(alone); rm -f $(DONE)/venv; awk '!/^ / {uv = /^uv==/} uv' $< > $(DONE)/uv; $(LOCKED) $(DONE)/uv; \
	    if $(PIP) config list | grep -Eq '\.(index-url|no-index|proxy)=' || \
	        ! $(BIN)/uv pip --quiet --no-config --system-certs install --python $(BIN)/python --compile-bytecode \
	        --require-hashes --no-deps --requirement $< 2>/dev/null; then $(LOCKED) $<; fi; \
	    touch $@; pwd -P > $(DONE)/venv

$(DONE)/msgs: $(MSGS_FILES) $(DONE)/requirements
	$(call say,building gyrowheel_msgs (about half a minute))
	@$(alone); $(PIP) install --no-deps --no-build-isolation --force-reinstall ./$(MSGS); touch $@

$(DONE)/packages: $(PACKAGE_FILES) $(DONE)/requirements | $(DONE)/msgs
	$(call say,installing $(notdir $(PACKAGES)))
	@$(alone); $(PIP) install --no-deps --no-build-isolation $(addprefix --editable ,$(PACKAGES)); \
	    $(BIN)/python -m tools.ros_setup; touch $@

demo: $(DONE)/packages ## find a hidden effect, from the running graph to the report (SEED=1 draws which)
	@$(BIN)/gyrowheel demo --seed $(SEED)

test: $(DONE)/packages ## run the tests (ARGS="-k plans" picks some)
ifdef ARGS
	@$(BIN)/python -m pytest $(ARGS)
else
	@$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal
endif

quick: lint ## lint, and the tests that are neither slow nor start nodes: for every commit
	@$(BIN)/python -m pytest -n $(FEWER_WORKERS) --dist worksteal -m 'not slow and not graph'

studies: $(DONE)/packages ## run further cases of what the tests show, before a release (ARGS="-k events" picks some)
	@$(BIN)/python -m pytest --studies -n $(WORKERS) --dist worksteal $(ARGS)

fuzz: $(DONE)/packages ## try damaged input of every kind for MINUTES=5; what goes wrong is kept in fuzz_findings
	@$(BIN)/python -m tests.fuzz --minutes $(MINUTES) $(ARGS)

workspace: $(DONE)/packages ## build and test the packages by colcon (ARGS="-k units" picks some)
	@$(BIN)/python -m tools.workspace $(ARGS)

wheels: $(DONE)/packages ## build the packages as wheels, check them and try them in an empty environment (ARGS=--lowest)
	@$(BIN)/python -m tools.wheels $(ARGS)

oldest: $(DONE)/packages ## run the fast tests with the lowest versions that the packages state (ARGS="-k units" picks some)
	@$(BIN)/python -m tools.wheels --lowest --tests $(ARGS)

bench: $(DONE)/packages ## measure speed and accuracy beside other tools; figures in bench.json (ARGS=simulation)
	@$(BIN)/python -m benchmarks $(ARGS)

lint: $(DONE)/packages ## check style and types
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/mypy

docs: $(DONE)/packages ## write the pages of docs that come from the code
	@$(BIN)/python -m tools.docs

notebooks: $(DONE)/packages ## run the notebooks of examples/ and write their pages (ARGS=loop runs one)
	@$(BIN)/python -m tools.notebooks $(ARGS)

site: $(DONE)/packages ## build the pages as a site with search: build/site/index.html, which opens from disk
	@$(BIN)/python -m sphinx --quiet --fail-on-warning --conf-dir tools/site --doctree-dir build/site-cache . build/site
	$(call say,site: build/site/index.html)

lock: $(DONE)/venv ## write requirements.lock with the newest versions
	@$(PIP) install uv
	@$(BIN)/python tools/lock.py

clean: ## remove .venv and all caches
	@rm -rf .venv .mypy_cache .pytest_cache .ruff_cache .hypothesis
	@find src $(wildcard tests) -name __pycache__ -prune -exec rm -rf {} +

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-9s %s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))

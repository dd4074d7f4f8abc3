# Every target works as the first command after cloning: it makes .venv and installs what it needs.
PYTHON ?= python3
BIN := .venv/bin
C_FILES := $(shell find graspforce/csrc tests/csrc -name '*.[ch]' -o -name '*.inc')

.PHONY: run demo test check format bench clean

run: .venv/installed-sim        ## a hand in MuJoCo holds a ball and moves it, its controller a service: a film, plots and a summary
	$(BIN)/graspforce simulate --serve --video out/closed_loop.mp4 --plots out

demo: .venv/installed           ## serve, carry a box with the four-finger hand, show the forces
	$(BIN)/graspforce demo

test: .venv/installed-dev       ## the test suite, on all cores
	$(BIN)/python -m pytest -n auto --dist worksteal

check: .venv/installed-dev      ## lint, format of Python and C, types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run --Werror $(C_FILES)
	@# service/ and problems/ are installed inside graspforce: the type checker sees the tree as it is installed.
	@rm -rf build/types && mkdir -p build/types/graspforce
	@ln -s $(CURDIR)/graspforce/* $(CURDIR)/service $(CURDIR)/problems build/types/graspforce/
	cd build/types && ../../$(BIN)/python -m mypy --config-file ../../pyproject.toml -p graspforce

format: .venv/installed-dev     ## format Python and C in place
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(C_FILES)

bench: .venv/installed-bench    ## a short form of the solver benchmarks
	$(BIN)/python -m benchmarks

.venv/bin/python:
	$(PYTHON) -m venv .venv

COMPILED := $(shell find graspforce/csrc -type f)

.venv/installed: .venv/bin/python pyproject.toml $(COMPILED)
	@echo "Installing graspforce and what it needs into .venv; the first time this takes about a minute."
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

.venv/installed-sim: .venv/installed
	@echo "Installing the physics engine."
	$(BIN)/python -m pip install --quiet --editable ".[sim]"
	@touch $@

.venv/installed-dev: .venv/installed
	@echo "Installing what tests and checks need."
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	@touch $@

.venv/installed-bench: .venv/installed
	@echo "Installing the solvers to compare with."
	$(BIN)/python -m pip install --quiet --editable ".[bench]"
	@touch $@

clean: ## forget what was installed and built
	rm -rf .venv build dist *.egg-info graspforce/core/*.so graspforce/force/backends/*.so

# Every target works as the first command after cloning: it makes .venv and installs what it needs.
PYTHON ?= python3
BIN := .venv/bin
C_FILES := $(shell find graspforce/csrc tests/csrc -name '*.[ch]' -o -name '*.inc')
# A ball moves and turns, and is pushed; every period divides the duration, so that the film loops.
FILM := --hand allegro_right --object sphere:0.033 --mass 0.06 --seed 7 \
  --reference reach --travel=-0.004,0.008,-0.003 --period 3 --turn 0.2,0,0.4 --turn-period 2 --duration 6 \
  --push 0,1.5,0,4.2,0.3
SMALL := --force --film-size 480x272 --fps 10
KERNELS := Haswell $(shell grep -qs avx512f /proc/cpuinfo && echo SkylakeX)

.PHONY: help run media demo test check format bench soak docs clean

help:                           ## show the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/\1\t\2/p' $(MAKEFILE_LIST)

run: .venv/installed-sim        ## simulate an Allegro hand that moves a ball: film, plots and a summary in out/
	$(BIN)/graspforce simulate $(FILM) --force --serve --video out/closed_loop.mp4 --plots out

media: .venv/installed-sim .venv/installed-dev  ## make the films of README and guides anew
	$(BIN)/graspforce simulate $(FILM) --force --video docs/media/allegro.webp
	$(BIN)/graspforce learn synergies benchmarks/results/records/learning/postures_leap_right.csv --hand leap_right \
		--duration 2.4 --fps 10 --film-size 480x272 --force --video docs/media/synergies.webp
	$(BIN)/graspforce simulate $(SMALL) --hand dlr_hit2 --reference still --push 0.6,0.6,0,0.8,0.4 --duration 2 --video docs/media/hold.webp
	$(BIN)/graspforce plan $(SMALL) --hand leap_right --to=-0.004,0,0.004 --execute --video docs/media/plan.webp

demo: .venv/installed           ## start a service, carry a box with a four-finger hand, show the forces
	$(BIN)/graspforce demo

test: .venv/installed-dev       ## run the test suite on all cores
	$(BIN)/python -m pytest -n auto --dist worksteal

check: .venv/installed-dev      ## check style, format, types, the Dockerfile, and the solver under each OpenBLAS kernel
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run --Werror $(C_FILES)
	$(BIN)/hadolint packaging/docker/Dockerfile
	cd build/editable && ../../$(BIN)/python -m mypy --config-file ../../pyproject.toml -p graspforce
	@# Rounding depends on OpenBLAS's kernel, which depends on the machine.
	for kernel in $(KERNELS); do \
	  OPENBLAS_CORETYPE=$$kernel $(BIN)/python -m pytest -q -n auto tests/force/test_solver.py || exit 1; done

format: .venv/installed-dev     ## format Python and C in place
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(C_FILES)

bench: .venv/installed-bench    ## run a short form of the solver benchmarks
	$(BIN)/python -m benchmarks

soak: .venv/installed           ## run the service under load for ten minutes; one table
	$(BIN)/python -m benchmarks.soak

docs: .venv/installed-dev      ## build the documentation into site/
	$(BIN)/python docs/figures.py
	$(BIN)/python -m mkdocs build --strict

# Python 3.10 brings pip 23.0, which searches versions for hours.
.venv/bin/python:
	$(PYTHON) -m venv --upgrade-deps .venv

COMPILED := $(shell find graspforce/csrc -type f)

.venv/installed: .venv/bin/python pyproject.toml setup.py $(COMPILED)
	@echo "Installing graspforce and what it needs into .venv; the first time this takes about a minute."
	$(BIN)/python -m pip install --quiet --editable ".[plot,serve]"
	@touch $@

.venv/installed-sim: .venv/installed
	@echo "Installing MuJoCo and the model of the Allegro hand (150 MB)."
	$(BIN)/python -m pip install --quiet --editable ".[sim,view,record,robots]"
	@touch $@

.venv/installed-dev: .venv/installed
	@echo "Installing what tests and checks need."
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	@touch $@

.venv/installed-bench: .venv/installed
	@echo "Installing the solvers to compare with."
	$(BIN)/python -m pip install --quiet --editable ".[bench]"
	@touch $@

clean:                          ## delete what was installed and built
	rm -rf .venv build dist site *.egg-info graspforce/core/*.so graspforce/force/backends/*.so

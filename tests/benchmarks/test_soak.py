"""The growth of the server's memory in a soak: leaks are measured, single steps are not."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
PAGE = 4096 / 2**20  # MiB
TIMES = np.arange(600.0)  # s


@pytest.fixture
def memory_slope(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT), *sys.path])
    return importlib.import_module("benchmarks.soak").memory_slope


@pytest.mark.parametrize("leak", [0.0, 2.0, 10.0, 100.0])
@pytest.mark.parametrize("step", [32, 1])
def test_slope_is_that_of_a_leak_in_whole_pages(memory_slope, leak, step):
    """Memory is resident in pages, and heaps may grow by several pages at once."""
    size = step * PAGE
    memory = 200.0 + size * np.floor(leak / 3600.0 * TIMES / size)
    assert memory_slope(TIMES, memory) == pytest.approx(leak, abs=0.35 * leak + 1e-9)


def test_steps_and_warm_up_are_no_leak(memory_slope):
    warm = 200.0 + 5.0 * (1.0 - np.exp(-TIMES / 40.0))
    stepped = warm + 1.0 * (TIMES > 150.0) + 1.0 * (TIMES > 420.0)
    assert memory_slope(TIMES, stepped) < 1.0
    assert memory_slope(TIMES, stepped + 3.0 / 3600.0 * TIMES) > 2.0


def test_short_runs_have_no_slope(memory_slope):
    assert memory_slope([0.0, 1.0], [1.0, 2.0]) == 0.0

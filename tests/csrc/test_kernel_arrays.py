"""The type Kernel: arrays that it accepts, stacked problems, and threads."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("graspforce.force.backends._structured", reason="the kernel was not built: no C compiler at installation")

from support.incremental_cases import feasible_problem
from support.kernel_cases import random_case
from support.kernel_runs import FAILED, bind_kernel, solve

from graspforce.force.backends import compiled_kernel


def test_stacked_problems_equal_single_ones_in_any_threads() -> None:
    """Solutions are equal bit for bit. One invalid problem does not affect the others."""
    rng = np.random.default_rng(51)
    case = random_case(rng, 4)
    w = case.w * rng.uniform(0.8, 1.0, size=(64, 1))
    w[17] = np.nan
    kernel, outputs = bind_kernel(case, count=64, w=w)
    assert kernel.solve(0, 64, 1e-9, 60, False) == FAILED
    np.testing.assert_array_equal(np.flatnonzero(outputs["report"]["status"] == FAILED), [17])
    shared = {name: np.zeros_like(outputs[name]) for name in ("f", "y", "z", "nu_lower", "nu_upper", "report")}
    limits = {name: np.zeros_like(outputs[name]) for name in ("lambda_lower", "lambda_upper", "tau")}
    workers = [bind_kernel(case, w=w, **shared, **limits)[0] for _ in range(2)]
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda i: workers[i].solve(32 * i, 32 * i + 32, 1e-9, 60, False), range(2)))
    for name in ("f", "y", "z", "nu_lower", "nu_upper"):
        np.testing.assert_array_equal(shared[name], outputs[name])
    np.testing.assert_array_equal(solve(replace(case, w=w[5])).f, outputs["f"][5])


def test_kernel_reads_the_current_content_of_its_arrays() -> None:
    case = random_case(np.random.default_rng(62), 4)
    w = case.w.copy()
    kernel, outputs = bind_kernel(case, w=w)
    kernel.solve(0, 1, 1e-9, 60, False)
    w *= 0.9
    kernel.solve(0, 1, 1e-9, 60, False)
    np.testing.assert_array_equal(outputs["f"][0], solve(replace(case, w=0.9 * case.w)).f)


def test_kernel_rejects_arrays_of_wrong_size_or_type() -> None:
    case = random_case(np.random.default_rng(61), 3)
    with pytest.raises(ValueError, match="w must hold 6 numbers for each problem, not 5 in all"):
        bind_kernel(case, w=np.zeros(5))
    with pytest.raises(ValueError, match="z must hold 9 numbers for each problem, not 27 in all"):
        bind_kernel(case, count=2, z=np.zeros((3, 9)))
    with pytest.raises(TypeError, match="mu must hold float64"):
        bind_kernel(case, mu=np.ones(3, dtype=np.float32))
    with pytest.raises(TypeError, match="components must hold C integers"):
        bind_kernel(case, components=np.full(3, 3, dtype=np.int64))
    with pytest.raises(ValueError, match="contact_block must be as long as components"):
        bind_kernel(case, contact_block=np.zeros(2, dtype=np.intc))
    with pytest.raises(ValueError, match="describe no hand"):
        bind_kernel(case, components=np.full(3, 2, dtype=np.intc))
    with pytest.raises(ValueError, match="describe no hand"):
        bind_kernel(case, contact_block=np.full(3, -1, dtype=np.intc))
    for report in (np.zeros((1, 8)), bind_kernel(case)[1]["report"][:0]):
        with pytest.raises(TypeError, match="report must be a non-empty array"):
            bind_kernel(case, report=report)


def test_kernel_needs_exactly_its_keyword_arguments() -> None:
    case = random_case(np.random.default_rng(61), 3)
    _, arrays = bind_kernel(case)
    with pytest.raises(TypeError, match="needs the keyword argument p"):
        compiled_kernel.Kernel(R=None, **arrays)
    with pytest.raises(TypeError, match="takes exactly 33 keyword arguments"):
        compiled_kernel.Kernel(p=None, R=None, extra=None, **arrays)
    with pytest.raises(TypeError, match="takes exactly 33 keyword arguments"):
        compiled_kernel.Kernel(1, p=None, R=None, **arrays)
    with pytest.raises(TypeError, match="needs the keyword argument components"):
        compiled_kernel.Kernel()


def test_solve_rejects_invalid_ranges_and_options() -> None:
    case = random_case(np.random.default_rng(61), 3)
    kernel, arrays = bind_kernel(case)
    for first, last in ((0, 2), (-1, 1), (1, 0)):
        with pytest.raises(ValueError, match=rf"first = {first}, last = {last}: 0 <= first <= last <= 1"):
            kernel.solve(first, last, 1e-9, 60, False)
    for tolerance in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match=f"tolerance = {tolerance}: must be greater than 0"):
            kernel.solve(0, 1, tolerance, 60, False)
    for iterations in (0, 1001):
        with pytest.raises(ValueError, match=f"max_iterations = {iterations}: must be from 1 to 1000"):
            kernel.solve(0, 1, 1e-9, iterations, False)
    with pytest.raises(TypeError):
        kernel.solve(0, 1)  # type: ignore[call-arg]
    with pytest.raises(RuntimeError, match="already has its arrays"):
        kernel.__init__(p=None, R=None, **arrays)  # type: ignore[misc]


def test_kernel_without_arrays_raises() -> None:
    """Neither a new Kernel nor one whose arrays were rejected solves or certifies."""
    arrays = compiled_kernel.kernel_arrays(feasible_problem(np.random.default_rng(60)))
    bad = {
        "w must hold 6 numbers": {"w": np.zeros(5)},
        "either G must be given, or p and R": {"p": None},
        "p must hold": {"p": np.zeros((1, 3))},
        "finite G": {"p": 1.5e308 * np.sign(arrays["p"])},
    }
    for message, changes in bad.items():
        kernel = compiled_kernel.Kernel.__new__(compiled_kernel.Kernel)
        with pytest.raises(ValueError, match=message):
            kernel.__init__(**{**arrays, **changes})
        with pytest.raises(RuntimeError, match="has no arrays"):
            kernel.solve(0, 1, 1e-9, 60, False)
        with pytest.raises(RuntimeError, match="has no arrays"):
            kernel.certify(0, 1)

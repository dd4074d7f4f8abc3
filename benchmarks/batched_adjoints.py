"""Gradients of stacked problems a second, and their errors: `python -m benchmarks.batched_adjoints`.

Each problem has point contacts with a finger of three joints each, the cost of the motor torques, and random loads, motors and
Jacobians around a random feasible grasp. The function of the optimum has random derivatives with respect to forces, torques and
objective. Every problem is solved, certified and differentiated with respect to all data.

"Processor time" is that of all threads in whole calls of `solve_stack`, with the arrays of the results, divided by the number
of problems: the least of several repeats with two threads. Other programs on the machine change it little. "Two cores" is the
rate that follows if both cores do nothing else, "elapsed" the rate that was measured. "Without gradients" is the processor time
of the same call without `adjoint`. "Degenerate" are problems that are flagged, because a limit may be active or not, or because
the optimum is not unique.

Errors are the largest difference from the adjoint products of `graspforce.sensitivities`, relative to the largest entry of each
block of data. "Other flags" are problems that only one of the two computations flags as degenerate.
"""

from __future__ import annotations

import math
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import graspforce as gf
from benchmarks import report_page
from graspforce.core.arrays import Array
from graspforce.force.problem_data import change_problem

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.random_problems import feasible_problem

BLOCKS = ("w", "mu", "p", "rotation", "tau_u", "torque_lower", "torque_upper", "J")
HEAD = (
    "contacts",
    "problems",
    "processor time (µs)",
    "without gradients (µs)",
    "a second, two cores",
    "a second, elapsed",
    "degenerate",
)
ERROR_HEAD = ("data", "largest error")
GRASPS = 50  # for the errors
EACH = 10  # problems of a grasp


@dataclass(frozen=True)
class Stack:
    """A stack of problems and a function of their optima.

    Args:
        problem: the common values.
        data: stacked arrays by name.
        seeds: derivatives of the function.
    """

    problem: gf.ForceProblem
    data: dict[str, Any]
    seeds: dict[str, Array]


def random_stack(contacts: int, count: int, seed: int) -> Stack:
    """Return problems around a random grasp.

    Args:
        contacts: number of contacts.
        count: number of problems.
        seed: random seed of the grasp and of the problems.
    """
    problem, rng = feasible_problem(seed, contacts), np.random.default_rng([contacts, seed])
    a = problem.actuation
    assert a is not None  # feasible_problem gives it one
    data = {
        "w": problem.w * (1.0 + 0.05 * rng.uniform(-1.0, 1.0, (count, 6))),
        "J": a.J * (1.0 + 0.05 * rng.uniform(-1.0, 1.0, (count, *a.J.shape))),
        "tau_u": a.tau_u * (1.0 + 0.05 * rng.uniform(-1.0, 1.0, (count, len(a.tau_u)))),
    }
    sizes = {"f": (problem.size,), "tau": (len(a.tau_u),), "objective": ()}
    return Stack(problem, data, {name: rng.normal(size=(count, *size)) for name, size in sizes.items()})


def rate(contacts: int, count: int, repeats: int) -> tuple[str, ...]:
    """Return the row of a number of contacts.

    Args:
        contacts: number of contacts.
        count: number of problems.
        repeats: number of repeats, of which the best counts.
    """
    stack = random_stack(contacts, count, 0)
    processor, elapsed, plain, flagged = math.inf, math.inf, math.inf, 0
    for _ in range(repeats):
        own, start = time.process_time(), time.perf_counter()
        answer = gf.solve_stack(stack.problem, adjoint=stack.seeds, threads=2, **stack.data)
        processor, elapsed = min(processor, time.process_time() - own), min(elapsed, time.perf_counter() - start)
        assert answer.gradients is not None  # seeds were given
        flagged = sum(map(bool, answer.gradients.degenerate))
        own = time.process_time()
        gf.solve_stack(stack.problem, threads=2, **stack.data)
        plain = min(plain, time.process_time() - own)
    times = (f"{1e6 * seconds / count:.1f}" for seconds in (processor, plain))
    return (str(contacts), f"{count:,}", *times, f"{2 * count / processor:,.0f}", f"{count / elapsed:,.0f}", f"{flagged:,}")


def errors() -> tuple[dict[str, float], int, int, int]:
    """Return the largest relative error of each block; the numbers of compared, degenerate and differently flagged problems."""
    largest, compared, degenerate, other = dict.fromkeys(BLOCKS, 0.0), 0, 0, 0
    for seed in range(GRASPS):
        stack = random_stack(4, EACH, seed)
        answer = gf.solve_stack(stack.problem, adjoint=stack.seeds, **stack.data)
        gradients = answer.gradients
        assert gradients is not None  # seeds were given
        for i in np.flatnonzero(np.isfinite(answer.objective)):
            own = change_problem(stack.problem, {name: rows[i] for name, rows in stack.data.items()})
            exact = gf.sensitivities(gf.solve(own, explain=False))
            other += bool(exact.degenerate) != bool(gradients.degenerate[i])
            degenerate += bool(exact.degenerate)
            if exact.degenerate or gradients.degenerate[i]:
                continue
            compared += 1
            f, tau, objective = (stack.seeds[name][i] for name in ("f", "tau", "objective"))
            products = exact.adjoint(f, tau, float(objective))
            for name, value in products.items():
                size = max(float(np.abs(value).max()), 1e-300)
                largest[name] = max(largest[name], float(np.abs(getattr(gradients, name)[i] - value).max()) / size)
    return largest, compared, degenerate, other


def main() -> None:
    """Measure, print, and write the page."""
    parser = report_page.parser("batched_adjoints", __doc__)
    parser.add_argument("--count", type=int, default=20000, help="problems of each size (default: 20000)")
    parser.add_argument("--repeats", type=int, default=5, help="repeats, of which the best counts (default: 5)")
    options = parser.parse_args()
    load = os.getloadavg()[0]
    rows = [rate(contacts, options.count, options.repeats) for contacts in (3, 4, 5)]
    largest, compared, degenerate, other = errors()
    error_rows = [(name, f"{value:.1e}") for name, value in largest.items()]
    words = f"Errors: {compared} problems compared, {degenerate} degenerate ones, {other} other flags."
    report_page.show("Gradients of stacked problems", HEAD, rows, width=120)
    report_page.show(words, ERROR_HEAD, error_rows)
    if options.save:
        facts = report_page.facts(f"graspforce {gf.__version__}") + f" Load of the machine at the start: {load:.1f}."
        page = "\n\n".join([report_page.table(HEAD, rows, 0), words, report_page.table(ERROR_HEAD, error_rows)])
        report_page.save(options.save, "Gradients of stacked problems", __doc__, facts, page)


if __name__ == "__main__":
    main()

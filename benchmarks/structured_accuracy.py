"""Accuracy of the structured kernel on random problems: `python -m benchmarks.structured_accuracy --count 10000`.

The first table, on feasible problems, has the statuses, the iterations, and the largest violation over the force unit. It also
has the largest relative gap between the cost and the bound by the multipliers, and the difference from the cost of Clarabel.

The second table, on infeasible problems, has the number of proofs that pass an independent check. Its problems are wrenches
outside the range of the grasp matrix or the cones, and loads above the largest feasible load by 900 %, 1 % and 0.01 %.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.kernel_cases import KernelCase, random_case
from support.kernel_checks import (
    clarabel_objective,
    largest_load_factor,
    lower_bound,
    objective,
    proof_margin,
    violation,
)
from support.kernel_runs import INFEASIBLE, OPTIMAL, solve

SIZES = (2, 3, 4, 5, 10, 50)
EXCESSES = (9.0, 1e-2, 1e-4)


def feasible(contacts: int, count: int) -> str:
    """Return one row of the table of feasible problems.

    Args:
        contacts: number of contacts.
        count: number of problems.
    """
    rng = np.random.default_rng(contacts)
    statuses, iterations, violations, gaps, differences = np.zeros(4, int), [], [0.0], [0.0], [0.0]
    for _ in range(count):
        case = random_case(rng, contacts)
        solution = solve(case)
        statuses[solution.status] += 1
        iterations.append(solution.iterations)
        if solution.status != OPTIMAL:
            continue
        cost = objective(case, solution.f)
        violations.append(violation(case, solution.f))
        gaps.append(abs(cost - lower_bound(case, solution)) / cost)
        status, peer_cost, _ = clarabel_objective(case)
        if status == "Solved":
            differences.append((cost - peer_cost) / cost)
    work = f"{np.mean(iterations):.1f}, at most {max(iterations)}"
    peer = f"{max(differences):.1e} above, {-min(differences):.1e} below, {len(differences) - 1} compared"
    return f"| {contacts} | {' / '.join(map(str, statuses))} | {work} | {max(violations):.1e} | {max(gaps):.1e} | {peer} |"


def infeasible(name: str, cases: list[KernelCase]) -> str:
    """Return one row of the table of infeasible problems.

    Args:
        name: name of the row.
        cases: infeasible problems.
    """
    statuses, proven, iterations = np.zeros(4, int), 0, []
    for case in cases:
        solution = solve(case)
        statuses[solution.status] += 1
        iterations.append(solution.iterations)
        proven += solution.status == INFEASIBLE and proof_margin(case, solution) > 0.0
    work = f"{np.mean(iterations):.1f}, at most {max(iterations)}"
    return f"| {name} | {' / '.join(map(str, statuses))} | {proven} | {work} |"


def unreachable_wrenches(rng: np.random.Generator, count: int) -> list[KernelCase]:
    """Return infeasible problems: two point contacts with a moment about their line, and three that push up with a pull."""
    cases = []
    for i in range(count):
        case = random_case(rng, 2 + i % 2)
        if i % 2:
            G = case.G.copy()
            G[2] = np.where(case.columns % 4 == 2, np.abs(G[2]), 0.0)  # no vertical friction
            cases.append(replace(case, G=G, w=np.array([0, 0, -1.0, 0, 0, 0])))
        else:
            null = np.linalg.svd(case.G)[0][:, -1]  # two point contacts: rank 5
            cases.append(replace(case, w=case.w + (1e-3 + rng.random()) * case.force * null))
    return cases


def overloaded_cases(rng: np.random.Generator, excess: float, count: int) -> list[KernelCase]:
    """Return problems whose load exceeds the largest feasible load.

    Args:
        rng: random generator.
        excess: excess over the largest feasible load, relative.
        count: number of problems.
    """
    cases: list[KernelCase] = []
    while len(cases) < count:
        case = random_case(rng, int(rng.integers(3, 7)))
        load = largest_load_factor(case)
        if 1.0 <= load < 1e3:
            cases.append(replace(case, w=(1 + excess) * load * case.w))
    return cases


def main() -> None:
    """Measure and print both tables."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.structured_accuracy", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--count", type=int, default=1000, help="problems of each size")
    parser.add_argument("--sizes", type=int, nargs="*", default=SIZES)
    options = parser.parse_args()
    statuses = "optimal / inaccurate / infeasible / failed"
    print(f"| contacts | {statuses} | iterations | largest violation | largest proven gap | cost compared with Clarabel |")
    print("|---|---|---|---|---|---|")
    for contacts in options.sizes:
        print(feasible(contacts, options.count), flush=True)
    rng = np.random.default_rng(0)
    each = max(options.count // 10, 10)
    print(f"\n| infeasible | {statuses} | proof verified | iterations |\n|---|---|---|---|")
    print(infeasible("unreachable wrench", unreachable_wrenches(rng, each)), flush=True)
    for excess in EXCESSES:
        print(infeasible(f"{100 * excess:g} % over the largest load", overloaded_cases(rng, excess, each)), flush=True)


if __name__ == "__main__":
    main()

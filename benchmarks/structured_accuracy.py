"""How right the structured kernel is, over many random problems: `python -m benchmarks.structured_accuracy --count 10000`.

Feasible problems: statuses, iterations, the largest violation over the force unit, the largest relative gap between the cost
and the bound that the multipliers prove, and how far the cost is above and below Clarabel's. Infeasible ones (a wrench that the
contacts cannot make, and loads beyond the largest by 900 %, 1 % and 0.01 %): how many carry a proof that holds when it is
checked by itself.
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
    """One row of the table of feasible problems."""
    rng = np.random.default_rng(contacts)
    statuses, iterations, violations, gaps, differences = np.zeros(4, int), [], [0.0], [0.0], [0.0]
    for _ in range(count):
        case = random_case(rng, contacts)
        answer = solve(case)
        statuses[answer.status] += 1
        iterations.append(answer.iterations)
        if answer.status != OPTIMAL:
            continue
        cost = objective(case, answer.f)
        violations.append(violation(case, answer.f))
        gaps.append(abs(cost - lower_bound(case, answer)) / cost)
        status, least, _ = clarabel_objective(case)
        if status == "Solved":
            differences.append((cost - least) / cost)
    work = f"{np.mean(iterations):.1f}, at most {max(iterations)}"
    beside = f"{max(differences):.1e} above, {-min(differences):.1e} below, {len(differences) - 1} compared"
    return f"| {contacts} | {' / '.join(map(str, statuses))} | {work} | {max(violations):.1e} | {max(gaps):.1e} | {beside} |"


def infeasible(name: str, cases: list[KernelCase]) -> str:
    """One row of the table of infeasible problems."""
    statuses, proven, iterations = np.zeros(4, int), 0, []
    for case in cases:
        answer = solve(case)
        statuses[answer.status] += 1
        iterations.append(answer.iterations)
        proven += answer.status == INFEASIBLE and proof_margin(case, answer) > 0.0
    work = f"{np.mean(iterations):.1f}, at most {max(iterations)}"
    return f"| {name} | {' / '.join(map(str, statuses))} | {proven} | {work} |"


def unreachable_wrenches(rng: np.random.Generator, count: int) -> list[KernelCase]:
    """Two point contacts asked for a moment about their line, and three contacts that can only push upwards asked to pull."""
    cases = []
    for i in range(count):
        case = random_case(rng, 2 + i % 2)
        if i % 2:
            G = case.G.copy()
            G[2] = np.where(case.columns % 4 == 2, np.abs(G[2]), 0.0)  # friction bears nothing vertical
            cases.append(replace(case, G=G, w=np.array([0, 0, -1.0, 0, 0, 0])))
        else:
            null = np.linalg.svd(case.G)[0][:, -1]  # two point contacts: rank 5
            cases.append(replace(case, w=case.w + (1e-3 + rng.random()) * case.force * null))
    return cases


def overloaded_cases(rng: np.random.Generator, excess: float, count: int) -> list[KernelCase]:
    cases: list[KernelCase] = []
    while len(cases) < count:
        case = random_case(rng, int(rng.integers(3, 7)))
        load = largest_load_factor(case)
        if 1.0 <= load < 1e3:
            cases.append(replace(case, w=(1 + excess) * load * case.w))
    return cases


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.structured_accuracy", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--count", type=int, default=1000, help="problems of each size")
    parser.add_argument("--sizes", type=int, nargs="*", default=SIZES)
    options = parser.parse_args()
    statuses = "optimal / inaccurate / infeasible / failed"
    print(f"| contacts | {statuses} | iterations | largest violation | largest proven gap | beside Clarabel |")
    print("|---|---|---|---|---|---|")
    for contacts in options.sizes:
        print(feasible(contacts, options.count), flush=True)
    rng = np.random.default_rng(0)
    each = max(options.count // 10, 10)
    print(f"\n| infeasible | {statuses} | proof verified | iterations |\n|---|---|---|---|")
    print(infeasible("wrench out of reach", unreachable_wrenches(rng, each)), flush=True)
    for excess in EXCESSES:
        print(infeasible(f"{100 * excess:g} % over the largest load", overloaded_cases(rng, excess, each)), flush=True)


if __name__ == "__main__":
    main()

"""The structured kernel alone on every case of the library: `python -m benchmarks.structured_library --save FILE`.

No fallback helps: the kernel's answer is certified, and counts only if its verdict is that of the library. With "8 facets
instead", each exact cone becomes an inner pyramid. These problems differ from the library's, so that every certified verdict
counts; cases with more than 20 contacts are left out.
"""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np

import graspforce as gf
from benchmarks import report_page
from graspforce import problems
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.backends.structured import KernelBackend
from graspforce.force.certificate import certify, certify_infeasibility
from graspforce.problems.case import ExpectedInfeasibility

FACETS, LARGEST = 8, 20  # facets, contacts
HEAD = ("cones", "objective", "cases", "certified optimal", "infeasible", "inaccurate", "wrong", "failed", "refused")


def verdict(problem: gf.ForceProblem) -> str:
    """Return the verdict of the kernel that its certificate proves, or "failed" or "refused".

    Args:
        problem: the force problem.
    """
    try:
        solution = KernelBackend().solve(problem, SolverSettings())
    except UnsupportedProblem:
        return "refused"
    if solution.multipliers is None:
        return "failed"
    if solution.status is gf.Status.INFEASIBLE:
        return "infeasible" if certify_infeasibility(problem, solution.multipliers).certificate.verified else "failed"
    if not len(solution.f):
        return "failed"
    certificate = certify(problem, solution.f, solution.multipliers)
    return "optimal" if certificate.is_tight else "inaccurate" if certificate.verified else "failed"


def count() -> dict[tuple[str, str], Counter[str]]:
    """Return the numbers of outcomes by cones and objective."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for name in problems.names():
        case = problems.load(name)
        problem, expected = case.problem, "infeasible" if isinstance(case.expected, ExpectedInfeasibility) else "optimal"
        found = verdict(problem)
        if found in ("optimal", "infeasible") and found != expected:
            found = "wrong"
        counts.setdefault((problem.cone.type, problem.objective.type), Counter())[found] += 1
        if problem.cone.type == "exact" and len(problem.contacts) <= LARGEST:
            inner = dataclasses.replace(problem, cone=gf.Cone("pyramid", FACETS, "inner"))
            counts.setdefault((f"{FACETS} facets instead", problem.objective.type), Counter())[verdict(inner)] += 1
    return counts


def main() -> None:
    """Count, print the table and write the page."""
    options = report_page.parser("structured_library", __doc__).parse_args()
    with np.errstate(all="ignore"):  # numbers that overflow in extreme units
        counts = count()
    kinds = ("optimal", "infeasible", "inaccurate", "wrong", "failed", "refused")
    rows = [
        (cones, objective, str(found.total()), *(str(found[kind]) for kind in kinds))
        for (cones, objective), found in sorted(counts.items())
    ]
    report_page.show("The structured kernel on the library", HEAD, rows, width=160)
    if options.save:
        facts = report_page.facts(f"graspforce {gf.__version__}", f"data {problems.DATA_VERSION}")
        report_page.save(options.save, "The structured kernel on the library", __doc__, facts, report_page.table(HEAD, rows, 2))


if __name__ == "__main__":
    main()

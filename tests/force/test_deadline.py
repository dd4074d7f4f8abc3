"""A solver with a deadline: the last certified forces once the time is over, and no other changes."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("graspforce.force.backends._structured", reason="the kernel was not built: no C compiler at installation")

from support.random_problems import feasible_problem

from graspforce import InvalidInput, Solution, Solver, SolverSettings, Status, solve
from graspforce.force.backends.structured import KernelSession


def test_deadline_returns_the_last_certified_forces():
    """Without time for a second iteration a changed load has no answer: the last certified one is returned, marked as late."""
    problem = feasible_problem(2)
    solver = Solver(problem, deadline=60.0)
    first = solver.solve()
    assert (first.status, first.timed_out) == (Status.OPTIMAL, False)
    assert solver.solve(w=0.9 * problem.w).found
    last = solver.solve(w=0.95 * problem.w)
    solver._deadline = 1e-12
    solver._session._kernel.limit_time(1e-12)
    late = solver.solve(w=np.roll(problem.w, 1))
    assert late.timed_out
    assert late.status is Status.OPTIMAL
    assert late.f == pytest.approx(last.f)
    assert late.certificate == last.certificate
    assert late.problem.w == pytest.approx(0.95 * problem.w)
    assert late.to_dict()["timed_out"] is True
    assert Solution.from_dict(late.to_dict()).timed_out


def test_deadline_without_earlier_forces_fails():
    late = Solver(feasible_problem(2), deadline=1e-12).solve()
    assert (late.status, late.timed_out, late.found) == (Status.FAILED, True, False)
    assert len(late.f) == 0


def test_deadline_leaves_other_verdicts_alone():
    problem = feasible_problem(2)
    solver = Solver(problem, deadline=60.0)
    assert solver.solve().found
    overload = solver.solve(w=1e4 * problem.w)
    assert (overload.status, overload.timed_out) == (Status.INFEASIBLE, False)
    for wrong in (0.0, -1.0, np.nan):
        with pytest.raises(InvalidInput, match="deadline"):
            Solver(problem, deadline=wrong)


def test_time_limit_ends_the_kernel():
    """The kernel makes one iteration at least; its best iterate is no solution then, and the fallback has no time either."""
    problem = feasible_problem(2)
    assert KernelSession(problem, SolverSettings(time_limit=1e-12)).solve().iterations == 1
    free = KernelSession(problem, SolverSettings(time_limit=60.0)).solve()
    assert (free.status, free.iterations) == (Status.OPTIMAL, solve(problem, "structured").iterations)

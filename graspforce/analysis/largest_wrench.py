"""The largest wrench along a direction that contacts supply within friction cones, normal-force and torque limits.

    maximise t   subject to   G f = base + t d,   f in its friction cones,   all limits of the force problem

Friction cones are those of the problem: exact cones give the exact largest wrench.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.force.backends import registry
from graspforce.force.cone_program import ConicProgram, ConicResult, ConicSolver, conic_program
from graspforce.force.extreme_optima import recession_problem
from graspforce.force.infeasibility import solver_with_deadline
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective

_TOLERANCE = 1e-7  # of rows broken by an optimum, relative to the force unit


@dataclass(frozen=True, eq=False, slots=True)
class LargestWrench:
    """The largest wrench base + t d.

    Args:
        amount: the largest t, in units of the direction; inf if no limit bounds it.
        wrench: (6,) base + t d about O, in O, N and N·m; not finite without a bound.
        f: (k,) contact forces that supply it, N and N·m; empty without a bound.
    """

    amount: float
    wrench: Array
    f: Array

    def to_dict(self) -> JsonRecord:
        """Return the record; null for an amount without bound."""
        finite = bool(np.isfinite(self.amount))
        return {"amount": self.amount if finite else None, "wrench": self.wrench.tolist() if finite else None}


def largest_wrench(
    problem: ForceProblem,
    direction: npt.ArrayLike,
    base: npt.ArrayLike | None = None,
    *,
    deadline: float = np.inf,
) -> LargestWrench | None:
    """Return the largest wrench base + t d that the contacts supply.

    Args:
        problem: the contacts, cones, motors and limits; its objective is not used.
        direction: (6,) d about O, in O, N and N·m; not zero.
        base: (6,) wrench that the contacts supply in any case; by default that of the problem.
        deadline: time of the clock `time.perf_counter` at which the solver stops, s.

    Returns:
        The largest wrench; None if no t is feasible.

    Raises:
        InvalidInput: a direction of zero, a wrong shape, or numbers that are not finite.
        DeadlinePassed: the deadline passed first.
    """
    d = arrays.check_array(direction, "direction", (6,))
    if not np.abs(d).max() > 0.0:
        raise InvalidInput("direction", d, "not zero")
    start = problem.w if base is None else arrays.check_array(base, "base", (6,))
    unit = d / float(np.linalg.norm(d))
    size = max(float(np.linalg.norm(start)), _limit_size(problem)) or 1.0
    program = _wrench_program(problem, start, unit * size)
    solve_program = solver_with_deadline(registry.general_backend().solve_program, deadline)
    result = solve_program(program)
    if result.converged and _is_feasible(program, result):
        amount = float(result.x[-1]) * size / float(np.linalg.norm(d))
        forces = program.forces(result.x[:-1])
        return LargestWrench(amount, arrays.freeze(start + amount * d), arrays.freeze(forces))
    return _unbounded_wrench(problem, start, unit, solve_program)


def _limit_size(problem: ForceProblem) -> float:
    """Return the largest finite limit of the normal forces, or 0: a size for wrenches where the base is zero."""
    finite = problem.contacts.max_normal[np.isfinite(problem.contacts.max_normal)]
    return float(finite.max(initial=0.0))


def _wrench_program(problem: ForceProblem, base: Array, direction: Array) -> ConicProgram:
    """Return the program min −t over (x, t).

    Its units are those of the wrench base + direction.
    """
    plain = ForceProblem(problem.contacts, base + direction, problem.actuation, problem.cone, Objective("force"))
    program = conic_program(plain)
    along = plain.w_centred / program.wrench_units
    origin = plain.replace(w=base).w_centred / program.wrench_units
    column = along - origin
    m = len(program.q)
    A = np.pad(program.A, ((0, 0), (0, 1)))
    A[:6, m] = -column
    b = program.b.copy()
    b[:6] = origin
    q = np.zeros(m + 1)
    q[m] = -1.0
    pad = ((0, 0), (0, 1))
    changes = {"A": A, "b": b, "C": np.pad(program.C, pad), "S": np.pad(program.S, pad), "P": np.zeros((m + 1, m + 1)), "q": q}
    return dataclasses.replace(program, **changes)


def _is_feasible(program: ConicProgram, result: ConicResult) -> bool:
    """Return whether an optimum keeps all rows to `_TOLERANCE` of its own size."""
    size = max(1.0, float(np.abs(result.x).max()))
    slack = np.split(program.r - program.S @ result.x, np.cumsum(program.cones)[:-1]) if program.cones else []
    missed = [float(np.linalg.norm(part[1:]) - part[0]) for part in slack]
    missed.append(float(np.abs(program.A @ result.x - program.b).max()))
    missed.append(float((program.C @ result.x - program.d).max(initial=0.0)))
    return max(missed) <= _TOLERANCE * size


def _unbounded_wrench(problem: ForceProblem, base: Array, direction: Array, solve_program: ConicSolver) -> LargestWrench | None:
    """Return the wrench without bound if forces along the direction can grow for ever, and the base is feasible."""
    ray = _wrench_program(recession_problem(problem, Objective("force")), np.zeros(6), direction)
    bound = np.zeros((1, len(ray.q)))
    bound[0, -1] = 1.0
    ray = dataclasses.replace(ray, C=np.vstack([ray.C, bound]), d=np.append(ray.d, 1.0))
    grown = solve_program(ray)
    if not (grown.converged and grown.x[-1] > 0.5 and _is_feasible(ray, grown)):
        return None
    start = conic_program(ForceProblem(problem.contacts, base, problem.actuation, problem.cone, Objective("force")))
    if not (result := solve_program(start)).converged or not _is_feasible(start, result):
        return None
    return LargestWrench(np.inf, arrays.freeze(np.full(6, np.inf)), arrays.freeze([]))

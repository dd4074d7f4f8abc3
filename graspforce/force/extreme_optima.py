"""Optima far from the units of their problem, and margins that grow without bound.

The wrench of nearly opposed contacts can be a small difference of large forces. In units of the wrench, such forces are lost in
a solver's tolerance. In units of the forces, with the rows of equilibrium replaced by an orthonormal basis, they are ordinary
numbers. In the same way, an optimal cost far below the unit of cost is lost unless that cost is the unit.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.force.cone_program import ConicProgram, ConicSolver, conic_program
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.scale import scale
from graspforce.force.status import Status
from graspforce.hand.actuation import Actuation

_RANK_TOLERANCE = 1e-13  # of the largest singular value of the equality rows
_UNBOUNDED_MARGIN = 0.5  # of the bound 1 that the search for a ray adds


def find_distant_optimum(problem: ForceProblem, force: float, solve_conic: ConicSolver) -> tuple[Array, Multipliers] | None:
    """Return the optimum, solved in units of large forces; None if the solver fails.

    Args:
        problem: the force problem.
        force: the expected size of the contact forces, N.
        solve_conic: solves a cone program.

    Returns:
        (k,) forces, N and N·m, and the multipliers, not verified.
    """
    program = conic_program(problem)
    ratio = force / float(scale(problem).force)
    if not (np.isfinite(program.A).all() and np.isfinite(ratio)):
        return None
    U, sigma, rows = np.linalg.svd(ratio * program.A, full_matrices=False)
    kept = sigma > _RANK_TOLERANCE * sigma[0]
    U, sigma, rows = U[:, kept], sigma[kept], rows[kept]
    P, q = ratio * ratio * program.P, ratio * program.q
    cost = float(np.trace(P)) / len(q) or float(np.abs(q).max(initial=0.0)) or 1.0
    scaled = dataclasses.replace(program, P=P / cost, q=q / cost, A=rows, b=U.T @ program.b / sigma, d=program.d / ratio)
    result = solve_conic(scaled)
    if result.status is not Status.OPTIMAL:
        return None
    x = result.x + rows.T @ (scaled.b - rows @ result.x)  # the nearest point that satisfies the equations to rounding
    return program.forces(ratio * x), program.multipliers(cost * (U @ (result.y / sigma)), cost * result.z / ratio)


def find_small_optimum(problem: ForceProblem, cost: float, solve_conic: ConicSolver) -> tuple[Array, Multipliers] | None:
    """Return the optimum, solved in units of its own cost; None if the solver fails.

    Args:
        problem: the force problem.
        cost: the expected optimal cost, > 0.
        solve_conic: solves a cone program.

    Returns:
        (k,) forces, N and N·m, and the multipliers, not verified.
    """
    program = conic_program(problem)
    ratio = cost / program.cost_unit
    scaled = dataclasses.replace(program, P=program.P / ratio, q=program.q / ratio, cost_unit=cost)
    result = solve_conic(scaled)
    if result.status is not Status.OPTIMAL:
        return None
    return scaled.forces(result.x), scaled.multipliers(result.y, result.z)


def is_margin_unbounded(problem: ForceProblem, solve_conic: ConicSolver) -> bool:
    """Return whether internal forces that load no limit increase the slip margin of all contacts without bound.

    Args:
        problem: a feasible force problem.
        solve_conic: solves a cone program.
    """
    program = _with_bounded_margin(conic_program(recession_problem(problem, Objective("margin"))))
    result = solve_conic(program)
    if not result.converged or result.x[-1] < _UNBOUNDED_MARGIN:
        return False
    slack = np.split(program.r - program.S @ result.x, np.cumsum(program.cones)[:-1]) if program.cones else []
    missed = [float(np.linalg.norm(part[1:]) - part[0]) for part in slack]
    missed += [float(np.abs(program.A @ result.x - program.b).max()), float((program.C @ result.x - program.d).max())]
    return max(missed) < 1e-8


def recession_problem(problem: ForceProblem, objective: Objective) -> ForceProblem:
    """Return the problem of the directions in which forces can grow without end: all finite limits are zero.

    Args:
        problem: the force problem.
        objective: objective of the result.
    """
    c, actuation = problem.contacts, problem.actuation
    zero = arrays.freeze(np.zeros(len(c)))
    most = arrays.freeze(np.where(np.isfinite(c.max_normal), 0.0, np.inf))
    if actuation is not None:
        lower, upper = np.where(np.isfinite([actuation.lower, actuation.upper]), 0.0, [[-np.inf], [np.inf]])
        lower, upper = [[x if np.isfinite(x) else None for x in limits] for limits in (lower.tolist(), upper.tolist())]
        actuation = Actuation(actuation.J, lower=lower, upper=upper)
    contacts = ContactSet(c.p_OC, c.R_OC, c.models, c.mu, c.gamma, zero, most)
    return ForceProblem(contacts, np.zeros(6), actuation, problem.cone, objective)


def _with_bounded_margin(program: ConicProgram) -> ConicProgram:
    """Return the program with the margin s ≤ 1 force unit."""
    bound = np.zeros((1, len(program.q)))
    bound[0, -1] = 1.0
    return dataclasses.replace(program, C=np.vstack([program.C, bound]), d=np.append(program.d, 1.0))

"""Minimum time along a path as a second-order cone program, and its solution.

The time is minimised, which is exact if a is constant between knots:

    minimise   Σ 2 Δᵢ/(√bᵢ + √bᵢ₊₁)

Between knots b' = 2a holds with a linear, from rest to rest, within the joint speeds:

    bᵢ₊₁ − bᵢ = Δᵢ (aᵢ + aᵢ₊₁),    b = 0 at both ends,    b ≤ b_max

At every knot hold the object's equations of motion, exact friction cones with margins, normal force limits and torque limits:

    G f = w₀ + w_b b + w_a a

    load ≤ μ f_n − margin,    min ≤ f_n ≤ max,    lower ≤ tau₀ + tau_b b + tau_a a + Jᵀ f ≤ upper

Accelerations of object and joints, which are linear in b and a too, stay within the task's limits.

The pseudo-inverse of G and its null space at each knot eliminate G f = w and most of the forces: f = G⁺ w + N λ. The time is
made of second-order cones, cᵢ² ≤ bᵢ and (cᵢ + cᵢ₊₁) dᵢ ≥ 1. With the discretisation "left" a is constant between knots instead,
bᵢ₊₁ − bᵢ = 2 Δᵢ aᵢ, which is of first order, as in TOPP-RA. Sources: Verscheure et al. (2009), Lobo et al. (1998).

Limits of jerk need several programs; see `graspforce.planning.path.jerk`. The path is then eased at its ends, where b is free.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from graspforce.core import fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.backends.clarabel import solve_sparse
from graspforce.force.backends.protocol import SolverSettings
from graspforce.planning.loads import wrench_scale
from graspforce.planning.path import program_rows
from graspforce.planning.path.dynamics import PathAccelerations, PathDynamics
from graspforce.planning.path.force_map import ForceMap
from graspforce.planning.path.jerk import PathJerks
from graspforce.planning.path.program_rows import Discretisation, LimitMargins, ProgramRows

_TOLERANCE = 1e-8  # of the cone solver; the plan is checked separately
_SCALE_RANGE = (0.01, 100.0)  # range of scaled b in which the program is well scaled; outside it is solved again
_MAX_SCALINGS = 4
_MAX_TANGENTS = 12  # programs with limits of jerk
_LEAST_GAIN = 1e-3  # relative: a smaller decrease of the duration ends them


@dataclass(frozen=True, eq=False, slots=True)
class PathSolution:
    """The fastest motion along a path.

    Args:
        b: (K,) ṡ² at the knots, 1/s².
        a: (K,) s̈ at the knots, 1/s².
        f: (K, k) stacked contact forces, N and N·m.
        duration: duration in the program, s.
        optimality_gap: bound on the possible reduction of the duration, relative to it, from the dual solution.
        iterations: iterations of the solver.
        seconds: time of the solver, s.
    """

    b: Array
    a: Array
    f: Array
    duration: float
    optimality_gap: float
    iterations: int
    seconds: float


class _Tangent(NamedTuple):
    """Limits of jerk with tangents at a motion.

    Args:
        jerks: the limits along the path.
        b_0: (K,) b of the motion, 1/s².
        share: (K − 1,) part of the limits that is used in each interval.
    """

    jerks: PathJerks
    b_0: Array
    share: Array


def solve_with_jerk(
    dynamics: PathDynamics, margins: LimitMargins, jerks: PathJerks, share: Array, seconds: float = np.inf
) -> PathSolution | None:
    """Return the fastest motion along an eased path with limits of jerk; a local optimum. None if the solver finds none.

    Args:
        dynamics: equations of motion at K knots.
        margins: margins of the limits.
        jerks: limits of jerk.
        share: (K − 1,) part of the limits of jerk that is used in each interval.
        seconds: time limit of each attempt of the solver, s.
    """
    best: PathSolution | None = None
    b_0, total = jerks.even_rate(), 0.0
    for _ in range(_MAX_TANGENTS):
        found = _solve_on_scales(dynamics, margins, "trapezoid", seconds, _Tangent(jerks, b_0, share))
        if found is None:
            break
        total += found.seconds
        gain = np.inf if best is None else 1.0 - found.duration / best.duration
        if gain > 0.0:
            best = replace(found, optimality_gap=np.nan)
        b_0 = found.b
        if gain < _LEAST_GAIN:
            break
    return None if best is None else replace(best, seconds=total)


def solve(
    dynamics: PathDynamics, margins: LimitMargins, discretisation: Discretisation = "trapezoid", seconds: float = np.inf
) -> PathSolution | None:
    """Return the fastest motion along a path, or None if the solver finds none. None does not prove infeasibility.

    Args:
        dynamics: equations of motion at K knots.
        margins: margins of the limits.
        discretisation: "trapezoid" (second order), or "left" (first order).
        seconds: time limit of each attempt of the solver, s.

    Raises:
        InvalidInput: nothing limits the motion.
    """
    fields.check_choice(discretisation, "discretisation", ("trapezoid", "left"))
    return _solve_on_scales(dynamics, margins, discretisation, seconds, None)


def _solve_on_scales(
    dynamics: PathDynamics, margins: LimitMargins, discretisation: Discretisation, seconds: float, tangent: _Tangent | None
) -> PathSolution | None:
    """Return the solution with scales that suit it; None if the solver does not converge."""
    forces = ForceMap.from_dynamics(dynamics)
    b_scale, force_scale = _choose_scales(dynamics)
    total = 0.0  # s
    solution: PathSolution | None = None
    for _ in range(_MAX_SCALINGS):
        rows = ProgramRows(dynamics.s, forces.null.shape[2], b_scale, force_scale, tangent is None)
        solution = _solve_scaled(rows, dynamics, margins, discretisation, forces, seconds, tangent)
        if solution is None:
            return None
        total += solution.seconds
        largest = float((solution.b / np.maximum(rows.profile, 1e-300))[1:-1].max()) / b_scale
        if _SCALE_RANGE[0] <= largest <= _SCALE_RANGE[1]:
            break
        b_scale *= largest
    return None if solution is None else replace(solution, seconds=total)


def _solve_scaled(
    rows: ProgramRows,
    dynamics: PathDynamics,
    margins: LimitMargins,
    discretisation: Discretisation,
    forces: ForceMap,
    seconds: float,
    tangent: _Tangent | None,
) -> PathSolution | None:
    """Return the solution of the program with the scales of ``rows``; None if the solver does not converge."""
    K, steps = len(dynamics.s), np.diff(dynamics.s)
    program_rows.add_motion(rows, steps, discretisation)
    if forces.unreachable is not None:
        rows.add_at_knots("equal", *forces.unreachable, None)
    program_rows.add_speed_limits(rows, dynamics, margins, steps)
    program_rows.add_torques(rows, dynamics, margins, forces)
    if dynamics.accelerations is not None:
        program_rows.add_joint_accelerations(rows, dynamics.accelerations, margins)
    cone_sizes: tuple[int, ...] = ()
    if dynamics.contacts is not None:
        program_rows.add_normal_forces(rows, dynamics.contacts, margins, forces)
        cone_sizes = program_rows.add_friction_cones(rows, dynamics.contacts, margins, forces)
    if tangent is not None:
        cone_sizes += tangent.jerks.add_to(rows, tangent.b_0, tangent.share)
    if dynamics.accelerations is not None:
        program_rows.add_object_accelerations(rows, dynamics.accelerations, margins)
    program_rows.add_time(rows)
    A, right, cones = rows.stacked(cone_sizes)
    cost = np.zeros(rows.size)
    speed = np.sqrt(rows.profile)
    cost[rows.d :] = 2.0 * steps / (speed[:-1] + speed[1:])
    quadratic = sparse.csc_matrix((rows.size, rows.size))
    start = time.perf_counter()
    settings = SolverSettings(tolerance=_TOLERANCE, time_limit=None if np.isinf(seconds) else max(seconds, 1e-3))
    answer = solve_sparse(quadratic, cost, A, right, cones, settings, refine=False)
    if not answer.converged:
        answer = solve_sparse(quadratic, cost, A, right, cones, settings)
    solver_seconds = time.perf_counter() - start
    if not answer.converged:
        return None
    duration = float(cost @ answer.x)
    residual = cost + answer.z @ A  # zero within the solver's tolerance
    gap = (abs(duration + float(right @ answer.z)) + float(np.abs(residual) @ np.abs(answer.x))) / duration
    b, a = np.maximum(answer.x[:K], 0.0) * rows.b_scales, answer.x[K : 2 * K] * rows.b_scale
    if rows.rests:
        b[[0, -1]] = 0.0
    lam = answer.x[2 * K : rows.c].reshape(K, forces.null.shape[2]) * rows.force_scale
    f = forces.forces(b, a, lam)
    return PathSolution(b, a, f, duration / np.sqrt(rows.b_scale), gap, answer.iterations, solver_seconds)


def _choose_scales(dynamics: PathDynamics) -> tuple[float, float]:
    """Return the scale of b and a, 1/s², and of forces, N: the largest b with which no single term exceeds its limit."""
    half = (dynamics.upper - dynamics.lower) / 2.0  # N·m
    terms = [np.abs(tau) / half for tau in (dynamics.tau_a, dynamics.tau_b)]  # s²
    force = 1.0  # N
    if dynamics.contacts is not None:
        limits = dynamics.contacts.max_normal[np.isfinite(dynamics.contacts.max_normal)]
        levers = np.sqrt((dynamics.J**2).mean(axis=(0, 1)))  # m, of each joint
        strengths = [*limits[limits > 0], *(half[levers > 0] / levers[levers > 0])]  # N
        if not strengths:
            raise InvalidInput("max_normal", None, "given at some contact: without a hand nothing else limits the forces")
        force = float(np.median(strengths))
        terms += [np.abs(w) / wrench_scale(dynamics.contacts) / force for w in (dynamics.w_a, dynamics.w_b)]  # s²
    if dynamics.accelerations is not None:
        terms += [np.abs(getattr(dynamics.accelerations, name)) for name in PathAccelerations.__slots__]
    terms.append(1.0 / dynamics.b_max)
    largest = max(float(term.max(initial=0.0)) for term in terms)
    if largest == 0.0:
        raise InvalidInput("path", "no motion", "a path along which something moves, with limits that bound it")
    return 1.0 / largest, force

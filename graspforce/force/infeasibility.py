"""Why a force problem has no answer: a proof where the solver gave none, plain words, and three numbers to act on.

The nearest wrench that can be held comes from the elastic program, min ‖G f − w‖ inside all limits (moments about the
contacts' centroid, over the characteristic length); whenever that distance is not zero its multipliers are themselves a
proof, and the tightest one.
The smallest factor on the torque limits comes from a program that is linear in the factor, the smallest factor on
friction from bisection, since a larger friction coefficient only ever adds forces.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.force.cone_program import ConicProgram, conic_program
from graspforce.force.problem import ForceProblem, Objective
from graspforce.force.solution import Infeasibility, InfeasibilityProof, Multipliers, Status

_NEGLIGIBLE_SHARE = 1e-6  # a constraint whose term is smaller than this beside the largest carries nothing but rounding
_LARGEST_FACTOR = 1e4  # nobody can act on a larger one
_FACTOR_ACCURACY = 1e-7  # relative
_MISS_TOLERANCE = 1e-8  # a wrench missed by less than this, relative to its size, is held


class ConicResult(Protocol):
    """What a cone solver says: see `backends.clarabel.ConicResult`."""

    @property
    def status(self) -> Status: ...
    @property
    def converged(self) -> bool: ...
    @property
    def x(self) -> Array: ...
    @property
    def y(self) -> Array: ...
    @property
    def z(self) -> Array: ...


ConicSolver = Callable[[ConicProgram], ConicResult]


def infeasibility_multipliers(problem: ForceProblem, solve_conic: ConicSolver) -> Multipliers | None:
    """Multipliers that prove a problem infeasible if it is, by its distance to the nearest wrench that can be held."""
    program = conic_program(_with_force_objective(problem))
    answer = solve_conic(_elastic_program(program))
    return None if answer.status is Status.FAILED else program.multipliers(answer.y, answer.z)


def describe_infeasibility(problem: ForceProblem, infeasibility_proof: InfeasibilityProof) -> Infeasibility:
    """A proof in plain words: which contacts, joints and wrench direction carry it.

    Args:
        problem: a problem without answer.
        refutation: its proof.
    """
    contacts, m = problem.contacts, infeasibility_proof.multipliers
    z = np.abs(contacts.pad(infeasibility_proof.z))
    # per contact, the largest weight on any component, moments over the torsional length so that all are per N
    z[:, friction.M_N] *= contacts.gamma
    weight = np.maximum.reduce([z.max(axis=1), m.normal_lower, m.normal_upper])
    carrying = np.flatnonzero(weight > _NEGLIGIBLE_SHARE * max(float(weight.max()), 1e-300))
    unit = float(np.linalg.norm(m.y))
    if unit <= _NEGLIGIBLE_SHARE * float(weight.max()):  # the limits contradict each other whatever the wrench
        unit = 0.0
    direction = m.y / unit if unit > 0 else np.zeros(6)
    torque = np.maximum(m.torque_lower, m.torque_upper)
    joints = np.flatnonzero(torque > _NEGLIGIBLE_SHARE * max(float(torque.max(initial=0.0)), 1e-300))
    return Infeasibility(
        verified=infeasibility_proof.certificate.verified,
        multipliers=m,
        contacts=tuple(int(i) for i in carrying),
        joints=tuple(int(j) for j in joints),
        wrench=arrays.freeze(direction),
        explanation=_explanation_text(problem, m, direction, unit, carrying.tolist(), joints.tolist()),
    )


def add_remedies(
    problem: ForceProblem, infeasibility: Infeasibility, solve_conic: ConicSolver, deadline: float = math.inf
) -> Infeasibility:
    """The same with the three numbers: which friction, which torque limits, which nearest wrench would give an answer.

    Args:
        problem: a problem without answer.
        infeasibility: its proof.
        run: solves a cone program.
        until: when no further program is begun, on the clock `time.perf_counter`, s; numbers not found by then stay None.
    """
    problem = _with_force_objective(problem)

    def solve_before_deadline(program: ConicProgram) -> ConicResult:
        if time.perf_counter() > deadline:
            raise _DeadlinePassed
        return solve_conic(program)

    with contextlib.suppress(_DeadlinePassed):  # what takes one program comes before what takes some forty
        infeasibility = dataclasses.replace(infeasibility, nearest_wrench=_nearest_wrench(problem, solve_before_deadline))
        infeasibility = dataclasses.replace(infeasibility, torque_factor=_torque_factor(problem, solve_before_deadline))
        infeasibility = dataclasses.replace(infeasibility, friction_factor=_friction_factor(problem, solve_before_deadline))
    return infeasibility


class _DeadlinePassed(Exception):
    """The time is over."""


def _with_force_objective(problem: ForceProblem) -> ForceProblem:
    """The same constraints, with the cost that is easiest to solve."""
    return ForceProblem(problem.contacts, problem.w, problem.actuation, problem.cone, Objective("force"))


def _elastic_program(program: ConicProgram) -> ConicProgram:
    """min t with A x − e = b in the six rows of equilibrium and ‖e‖ ≤ t: e is by how much the wrench is missed, scaled.

    The norm is not squared: its square would hide distances below the root of the solver's tolerance.
    """
    m = len(program.q)

    def widened(rows: Array) -> Array:
        return np.pad(rows, ((0, 0), (0, 7)))

    A = widened(program.A)
    A[:6, m : m + 6] = -np.eye(6)
    q = np.zeros(m + 7)
    q[-1] = 1.0
    cone = np.zeros((7, m + 7))
    cone[0, -1] = -1.0
    cone[1:, m : m + 6] = -np.eye(6)
    return dataclasses.replace(
        program,
        P=np.zeros((m + 7, m + 7)),
        q=q,
        A=A,
        C=widened(program.C),
        S=np.vstack([widened(program.S), cone]),
        r=np.append(program.r, np.zeros(7)),
        cones=(*program.cones, 7),
    )


def _feasible_optimum(program: ConicProgram, solve_conic: ConicSolver) -> Array | None:
    """The x of a program that is solved, and whose rows x keeps to `_MISS_TOLERANCE`; None otherwise."""
    answer = solve_conic(program)
    if not answer.converged:
        return None
    cones = np.split(program.r - program.S @ answer.x, np.cumsum(program.cones)[:-1])
    missed = [float(np.linalg.norm(part[1:]) - part[0]) for part in cones if len(part)]
    missed.append(float(np.abs(program.A @ answer.x - program.b).max()))
    missed.append(float((program.C @ answer.x - program.d).max(initial=0.0)))
    return answer.x if max(missed) < _MISS_TOLERANCE else None


def _nearest_wrench(problem: ForceProblem, solve_conic: ConicSolver) -> Array | None:
    program = conic_program(problem)
    x = _feasible_optimum(_elastic_program(program), solve_conic)
    if x is None:
        return None
    missed = x[-7:-1] * program.wrench_units  # about the contacts' centroid
    missed[3:] += np.cross(problem.contacts.centroid, missed[:3])
    nearest = problem.w + missed
    return arrays.freeze(nearest) if np.isfinite(nearest).all() else None


def _torque_factor(problem: ForceProblem, solve_conic: ConicSolver) -> float | None:
    """min κ subject to κ·lower ≤ tau_u + Jᵀf ≤ κ·upper and all other limits."""
    actuation = problem.actuation
    if actuation is None or not (np.isfinite(actuation.lower) | np.isfinite(actuation.upper)).any():
        return None
    program = conic_program(problem)
    m, e = len(program.q), len(program.b) - 6
    A, C = np.pad(program.A, ((0, 0), (0, 1))), np.pad(program.C, ((0, 0), (0, 1)))
    b, d = program.b.copy(), program.d.copy()
    for place, limit in enumerate(program.limits):
        if limit is None or limit.kind != "torque":
            continue
        bias = actuation.tau_u[limit.index] / limit.unit
        if limit.sign == 0:  # row = κ·limit − bias
            A[6 + place, m], b[6 + place] = -actuation.lower[limit.index] / limit.unit, -bias
        else:  # lower: −row ≤ bias − κ·lower; upper: row ≤ κ·upper − bias
            bound = actuation.lower[limit.index] if limit.sign > 0 else -actuation.upper[limit.index]
            C[place - e, m], d[place - e] = bound / limit.unit, limit.sign * bias
    C, d = np.vstack([C, np.eye(1, m + 1, m) * -1.0]), np.append(d, 0.0)  # κ ≥ 0
    q = np.zeros(m + 1)
    q[m] = 1.0
    S = np.pad(program.S, ((0, 0), (0, 1)))
    x = _feasible_optimum(dataclasses.replace(program, P=np.zeros((m + 1, m + 1)), q=q, A=A, b=b, C=C, d=d, S=S), solve_conic)
    return None if x is None else float(x[m])


def _friction_factor(problem: ForceProblem, solve_conic: ConicSolver) -> float | None:
    """The smallest κ ≥ 1 with an answer for friction κμ, κγ, by bisection on its logarithm."""
    contacts = problem.contacts
    if not ((contacts.mu > 0) | (contacts.gamma > 0)).any():
        return None

    def is_feasible(factor: float) -> bool:
        rougher = ContactSet(
            contacts.p_OC,
            contacts.R_OC,
            contacts.models,
            arrays.freeze(contacts.mu * factor),
            arrays.freeze(contacts.gamma * factor),
            contacts.min_normal,
            contacts.max_normal,
        )
        program = conic_program(ForceProblem(rougher, problem.w, problem.actuation, problem.cone, problem.objective))
        x = _feasible_optimum(_elastic_program(program), solve_conic)
        return x is not None and bool(x[-1] < _MISS_TOLERANCE)

    low, high = 1.0, 2.0
    while not is_feasible(high):
        low, high = high, high * high
        if high > _LARGEST_FACTOR**2:
            return None
    while high > low * (1.0 + _FACTOR_ACCURACY):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if is_feasible(middle) else (middle, high)
    return high if high <= _LARGEST_FACTOR else None


def _explanation_text(
    problem: ForceProblem, m: Multipliers, direction: Array, unit: float, contacts: list[int], joints: list[int]
) -> str:
    """The proof as sentences."""
    actuation = problem.actuation
    rest = m.normal_lower @ problem.contacts.min_normal - _finite_product(m.normal_upper, problem.contacts.max_normal)
    if actuation is not None:
        rest += _finite_product(m.torque_lower, actuation.lower - actuation.tau_u) - _finite_product(
            m.torque_upper, actuation.upper - actuation.tau_u
        )
    limits = []
    if contacts:
        limits.append(f"the friction and normal-force limits of contact{_format_indices(contacts)}")
    if joints:
        sides = ", ".join(f"{j} ({'upper' if m.torque_upper[j] >= m.torque_lower[j] else 'lower'})" for j in joints)
        limits.append(f"the torque limits of joint{'s' if len(joints) > 1 else ''} {sides}")
    carried = " and ".join(limits)
    if unit == 0.0:
        return f"Whatever the wrench, {carried} contradict each other."
    force, moment = direction[:3], direction[3:]
    parts = []
    if np.linalg.norm(force) > _NEGLIGIBLE_SHARE:
        parts.append(f"force along ({_format_vector(force)})")
    if np.linalg.norm(moment) > _NEGLIGIBLE_SHARE:
        parts.append(f"moment about ({_format_vector(moment)})")
    required, available = float(direction @ problem.w), -float(rest) / unit
    if abs(available) < _NEGLIGIBLE_SHARE * abs(required):
        available = 0.0
    return (
        f"In the wrench direction with {' and '.join(parts)}, {required:.6g} is wanted and at most {available:.6g} can be "
        f"supplied within {carried}."
    )


def _finite_product(multiplier: Array, limit: Array) -> float:
    """multiplier · limit, where a limit that does not exist has no multiplier."""
    return float(multiplier @ np.where(np.isfinite(limit), limit, 0.0))


def _format_indices(items: list[int]) -> str:
    return f" {items[0]}" if len(items) == 1 else "s " + ", ".join(map(str, items))


def _format_vector(vector: Array) -> str:
    return ", ".join(f"{x:.3g}" for x in np.where(np.abs(vector) < _NEGLIGIBLE_SHARE, 0.0, vector))

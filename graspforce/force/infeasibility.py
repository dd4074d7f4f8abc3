"""Explain why a force problem is infeasible: a proof, a text, and three numbers that would make it feasible.

The nearest feasible wrench comes from the elastic program, min ‖G f − w‖ within all limits, with moments about the contacts'
centroid and divided by the characteristic length. If that distance is not zero, its multipliers are the tightest proof.
The smallest factor on the torque limits comes from a program that is linear in the factor. The smallest factor on friction
comes from bisection, since a larger friction coefficient only adds feasible forces.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from dataclasses import dataclass

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord
from graspforce.force.certificate import InfeasibilityProof
from graspforce.force.cone_program import ConicProgram, ConicResult, ConicSolver, conic_program
from graspforce.force.infeasibility_text import NEGLIGIBLE_SHARE, explanation_text, reach_text
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.status import Status

_LARGEST_FACTOR = 1e4  # larger factors on friction are of no use
_SMALLEST_FACTOR = 1e-6  # smaller factors count as no friction
_FACTOR_ACCURACY = 1e-7  # relative
_MISS_TOLERANCE = 1e-8  # relative distance up to which a wrench counts as supplied


@dataclass(frozen=True, eq=False, slots=True)
class Infeasibility:
    """Why a force problem is infeasible.

    Args:
        verified: the multipliers prove that no feasible forces exist.
        multipliers: the proof.
        contacts: indices of the contacts whose limits the proof uses.
        joints: indices of the joints whose torque limits the proof uses.
        wrench: (6,) unit direction of the wrench that cannot be supplied, in O, N and N·m; zeros if the limits contradict
            each other for every wrench.
        explanation: the proof as text.
        friction_factor: smallest factor on all friction coefficients that makes the problem feasible; None if not
            computed, or if no factor does.
        torque_factor: likewise for all torque limits.
        nearest_wrench: (6,) nearest feasible wrench, in O, N and N·m; None if not computed, or if no wrench is feasible.
        reach: sum of the normal forces at contacts without max_normal up to which the proof holds, N; None if it holds for all
            forces.
    """

    verified: bool
    multipliers: Multipliers
    contacts: tuple[int, ...]
    joints: tuple[int, ...]
    wrench: Array
    explanation: str
    friction_factor: float | None = None
    torque_factor: float | None = None
    nearest_wrench: Array | None = None
    reach: float | None = None

    def to_dict(self) -> JsonRecord:
        """Return the ``infeasibility`` record of a solution."""
        return {
            "verified": self.verified,
            "explanation": self.explanation,
            "contacts": list(self.contacts),
            "joints": list(self.joints),
            "wrench": self.wrench.tolist(),
            "multipliers": self.multipliers.to_dict(),
            "friction_factor": self.friction_factor,
            "torque_factor": self.torque_factor,
            "nearest_wrench": None if self.nearest_wrench is None else self.nearest_wrench.tolist(),
            "reach": self.reach,
        }

    @classmethod
    def from_dict(cls, record: object, field: str = "infeasibility") -> Infeasibility:
        """Return the infeasibility of an ``infeasibility`` record.

        Args:
            record: as `to_dict` returns it.
            field: its path, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or of the wrong type.
        """
        names = [name.name for name in dataclasses.fields(cls) if name.name != "reach"]
        values = fields.check_record(record, field, required=names, optional=["reach"])
        nearest = values["nearest_wrench"]
        return cls(
            verified=bool(values["verified"]),
            multipliers=Multipliers.from_dict(values["multipliers"], f"{field}.multipliers"),
            contacts=tuple(values["contacts"]),
            joints=tuple(values["joints"]),
            wrench=arrays.check_array(values["wrench"], f"{field}.wrench", (6,)),
            explanation=values["explanation"],
            friction_factor=values["friction_factor"],
            torque_factor=values["torque_factor"],
            nearest_wrench=None if nearest is None else arrays.check_array(nearest, f"{field}.nearest_wrench", (6,)),
            reach=values.get("reach"),
        )


def infeasibility_multipliers(problem: ForceProblem, solve_conic: ConicSolver) -> Multipliers | None:
    """Return the tightest candidate for a proof of infeasibility: the multipliers of the elastic program.

    Args:
        problem: the force problem.
        solve_conic: solves a cone program.

    Returns:
        The multipliers, not verified; None if the solver fails.
    """
    program = conic_program(_with_force_objective(problem))
    result = solve_conic(_elastic_program(program))
    return None if result.status is Status.FAILED else program.multipliers(result.y, result.z)


def describe_infeasibility(problem: ForceProblem, infeasibility_proof: InfeasibilityProof) -> Infeasibility:
    """Return the contacts, joints and wrench direction that a proof uses, and its text.

    Args:
        problem: an infeasible problem.
        infeasibility_proof: its proof.
    """
    contacts, m = problem.contacts, infeasibility_proof.multipliers
    y = m.about(np.zeros(3)).y
    z = np.abs(contacts.pad(infeasibility_proof.z))
    # largest weight of each contact; moments times the torsional length, so that all weights are per N
    z[:, friction.M_N] *= contacts.gamma
    weight = np.maximum.reduce([z.max(axis=1), m.normal_lower, m.normal_upper])
    carrying = np.flatnonzero(weight > NEGLIGIBLE_SHARE * max(float(weight.max()), 1e-300))
    unit = float(np.linalg.norm(y))
    if unit <= NEGLIGIBLE_SHARE * float(weight.max()):  # the limits contradict each other for every wrench
        unit = 0.0
    direction = y / unit if unit > 0 else np.zeros(6)
    torque = np.maximum(m.torque_lower, m.torque_upper)
    joints = np.flatnonzero(torque > NEGLIGIBLE_SHARE * max(float(torque.max(initial=0.0)), 1e-300))
    reach = infeasibility_proof.reach if np.isfinite(infeasibility_proof.reach) else None
    return Infeasibility(
        verified=infeasibility_proof.certificate.verified,
        multipliers=m,
        contacts=tuple(int(i) for i in carrying),
        joints=tuple(int(j) for j in joints),
        wrench=arrays.freeze(direction),
        explanation=explanation_text(problem, m, direction, unit, carrying.tolist(), joints.tolist()) + reach_text(reach),
        reach=reach,
    )


def add_remedies(
    problem: ForceProblem, infeasibility: Infeasibility, solve_conic: ConicSolver, deadline: float = math.inf
) -> Infeasibility:
    """Return the infeasibility with the nearest feasible wrench and the factors on torque limits and friction.

    Args:
        problem: an infeasible problem.
        infeasibility: its explanation.
        solve_conic: solves a cone program.
        deadline: no program starts after this time of the clock `time.perf_counter`, s. The numbers that are missing then
            stay None.
    """
    problem = _with_force_objective(problem)
    solve_before_deadline = solver_with_deadline(solve_conic, deadline)
    with contextlib.suppress(DeadlinePassed):  # friction last: it takes about forty programs, the others one each
        infeasibility = dataclasses.replace(infeasibility, nearest_wrench=_nearest_wrench(problem, solve_before_deadline))
        torque_factor = smallest_torque_factor(problem, solve_before_deadline)
        infeasibility = dataclasses.replace(infeasibility, torque_factor=torque_factor)
        friction_factor = smallest_friction_factor(problem, solve_before_deadline)
        infeasibility = dataclasses.replace(infeasibility, friction_factor=friction_factor)
    return infeasibility


class DeadlinePassed(Exception):
    """The deadline of an explanation has passed."""


def solver_with_deadline(solve_conic: ConicSolver, deadline: float) -> ConicSolver:
    """Return a solver that stops at a deadline, and then raises `DeadlinePassed`.

    Args:
        solve_conic: solves a cone program within a time limit, s.
        deadline: time of the clock `time.perf_counter`, s.
    """

    def solve_before_deadline(program: ConicProgram, time_limit: float | None = None) -> ConicResult:
        remaining = min(deadline - time.perf_counter(), math.inf if time_limit is None else time_limit)
        if remaining <= 0.0:
            raise DeadlinePassed
        result = solve_conic(program, remaining) if remaining < math.inf else solve_conic(program)
        if not result.converged and time.perf_counter() >= deadline:
            raise DeadlinePassed
        return result

    return solve_before_deadline


def _with_force_objective(problem: ForceProblem) -> ForceProblem:
    """Return the problem with the cost ½‖f‖², which is the easiest to solve."""
    return ForceProblem(problem.contacts, problem.w, problem.actuation, problem.cone, Objective("force"))


def _elastic_program(program: ConicProgram) -> ConicProgram:
    """Return min t subject to A x − e = b in the six rows of equilibrium, ‖e‖ ≤ t, and all other rows.

    The scaled distance to the wrench is t. It is not squared: a square would hide distances below the square root of the
    solver's tolerance.
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
    """Return the optimum of a program; None if the solver fails or the optimum breaks a row by `_MISS_TOLERANCE`."""
    result = solve_conic(program)
    if not result.converged:
        return None
    cones = np.split(program.r - program.S @ result.x, np.cumsum(program.cones)[:-1])
    missed = [float(np.linalg.norm(part[1:]) - part[0]) for part in cones if len(part)]
    missed.append(float(np.abs(program.A @ result.x - program.b).max()))
    missed.append(float((program.C @ result.x - program.d).max(initial=0.0)))
    return result.x if max(missed) < _MISS_TOLERANCE else None


def nearest_forces(problem: ForceProblem, solve_conic: ConicSolver) -> Array | None:
    """Return (k,) forces whose wrench is nearest to w, N and N·m; None if the solver fails or no forces are allowed.

    Args:
        problem: the force problem; its objective is not used.
        solve_conic: solves a cone program.
    """
    program = conic_program(_with_force_objective(problem))
    x = _feasible_optimum(_elastic_program(program), solve_conic)
    return None if x is None else program.forces(x)


def _nearest_wrench(problem: ForceProblem, solve_conic: ConicSolver) -> Array | None:
    """Return (6,) the feasible wrench nearest to w, N and N·m."""
    program = conic_program(problem)
    x = _feasible_optimum(_elastic_program(program), solve_conic)
    if x is None:
        return None
    missed = x[-7:-1] * program.wrench_units  # about the contacts' centroid
    missed[3:] += np.cross(problem.contacts.centroid, missed[:3])
    nearest = problem.w + missed
    return arrays.freeze(nearest) if np.isfinite(nearest).all() else None


def smallest_torque_factor(problem: ForceProblem, solve_conic: ConicSolver) -> float | None:
    """Return min κ subject to κ·lower ≤ tau_u + Jᵀf ≤ κ·upper and all other limits; None without torque limits.

    Args:
        problem: the force problem; its objective is not used.
        solve_conic: solves a cone program.
    """
    problem = _with_force_objective(problem)
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


def smallest_friction_factor(problem: ForceProblem, solve_conic: ConicSolver) -> float | None:
    """Return the smallest κ with which forces exist for friction κμ, κγ, by bisection on its logarithm.

    Args:
        problem: the force problem; its objective is not used.
        solve_conic: solves a cone program.

    Returns:
        κ; 0 if forces exist without friction, None if no factor up to 10⁴ suffices or no contact has friction.
    """
    problem = _with_force_objective(problem)
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
    if is_feasible(1.0):
        low, high = _SMALLEST_FACTOR, 1.0
        if is_feasible(low):
            return 0.0
    while not is_feasible(high):
        low, high = high, high * high
        if high > _LARGEST_FACTOR**2:
            return None
    while high > low * (1.0 + _FACTOR_ACCURACY):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if is_feasible(middle) else (middle, high)
    return high if high <= _LARGEST_FACTOR else None

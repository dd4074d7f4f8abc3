"""A reference solver for force problems: an independent formulation in SI units for HiGHS and quadprog.

Pyramids are linear limits. Exact cones are approximated from outside by cutting planes (Kelley 1960). With b = (f_t1, f_t2,
μ m_n/γ), the first approximation is the box |b_i| ≤ μ f_n − s. Where a solution violates ‖b‖ ≤ μ f_n − s, the half-space
u·b ≤ μ f_n − s with u = b/‖b‖ is added, which contains the cone. Each solution is a lower bound, and the first one without
violation is the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import quadprog
from scipy import optimize

from graspforce import Contact, ForceProblem
from graspforce.core.arrays import Array

_COMPONENTS = {"frictionless": (2,), "point": (0, 1, 2), "soft": (0, 1, 2, 3)}  # of (f_t1, f_t2, f_n, m_n)
_CONE_TOLERANCE = 1e-9  # of the largest force: violation of a cone at the end
_MAX_CUT_ROUNDS = 200


class InfeasibleProblem(Exception):
    """The solver reports contradictory limits."""


class SolverFailure(Exception):
    """The solver found no optimum and proved no infeasibility."""


@dataclass(frozen=True)
class FrictionRows:
    """Rows of one contact's friction: b = (f_t1, f_t2, μ m_n/γ) and the available friction μ f_n − s as functions of x."""

    b: Array
    available: Array


@dataclass(frozen=True)
class Program:
    """min ½ xᵀPx + qᵀx + c subject to A x = w, C x ≤ d and ‖b x‖ ≤ available x at every contact of ``exact``."""

    P: Array
    q: Array
    c: float
    A: Array
    w: Array
    C: Array
    d: Array
    exact: tuple[FrictionRows, ...]


def optimum(problem: ForceProblem) -> tuple[float, Array]:
    """Return the objective's optimum (for "margin", s), and (k,) forces that reach it, N and N·m.

    Raises:
        InfeasibleProblem: no forces satisfy the constraints.
        SolverFailure: the solver found no optimum and proved no infeasibility.
    """
    program = formulate(problem)
    boxes = [
        sign * row - friction_rows.available for friction_rows in program.exact for row in friction_rows.b for sign in (1, -1)
    ]
    C, d = np.vstack([program.C, *boxes]), np.concatenate([program.d, np.zeros(len(boxes))])
    for _ in range(_MAX_CUT_ROUNDS):
        x = _minimum(program, C, d)
        cuts = []
        for friction_rows in program.exact:
            b = friction_rows.b @ x
            if np.linalg.norm(b) - friction_rows.available @ x > _CONE_TOLERANCE * np.abs(x).max():
                cuts.append(b / np.linalg.norm(b) @ friction_rows.b - friction_rows.available)
        if not cuts:
            value = float(0.5 * x @ program.P @ x + program.q @ x + program.c)
            return (-value if problem.objective.type == "margin" else value), x[: problem.size]
        C, d = np.vstack([C, *cuts]), np.concatenate([d, np.zeros(len(cuts))])
    raise SolverFailure(f"no optimum after {_MAX_CUT_ROUNDS} rounds of cuts")


def formulate(problem: ForceProblem) -> Program:
    """Return the program in SI units. x holds the stacked forces and, for "max_normal" and "margin", the level."""
    contacts, kind = problem.contacts.contacts, problem.objective.type
    places, size = [], 0
    for contact in contacts:
        names = _COMPONENTS[contact.model.value]
        places.append({name: size + i for i, name in enumerate(names)})
        size += len(names)
    size += int(kind in ("max_normal", "margin"))
    unit = np.eye(size)

    A = np.zeros((6, size))
    limits: list[tuple[Array, float]] = []  # row · x ≤ bound
    exact = []
    for contact, place in zip(contacts, places, strict=True):
        for component, column in place.items():
            A[:, column] = _wrench(contact, component)
        normal = unit[place[2]]
        limits.append((-normal, -contact.min_normal))
        if contact.max_normal is not None:
            limits.append((normal, contact.max_normal))
        if kind == "max_normal":
            limits.append((normal - unit[-1], 0.0))
        if 0 in place:
            level = unit[-1] if kind == "margin" else np.zeros(size)
            lever = contact.friction / contact.torsional_friction if 3 in place else 0.0  # 1/m
            b = np.array([unit[place[0]], unit[place[1]], lever * unit[place.get(3, 0)]])
            if problem.cone.type == "exact":
                exact.append(FrictionRows(b, contact.friction * normal - level))
            else:
                limits += [(row, 0.0) for row in _facets(problem, contact, b, normal, level)]
    if kind == "margin":
        limits.append((-unit[-1], 0.0))
    actuation = problem.actuation
    for j in range(0 if actuation is None else len(actuation.tau_u)):
        row = np.pad(actuation.J[:, j], (0, size - len(actuation.J)))
        limits += [(row, actuation.upper[j] - actuation.tau_u[j])] if np.isfinite(actuation.upper[j]) else []
        limits += [(-row, actuation.tau_u[j] - actuation.lower[j])] if np.isfinite(actuation.lower[j]) else []
    P, q, c = _cost(problem, places, size)
    return Program(
        P, q, c, A, np.array(problem.w), np.array([r for r, _ in limits]), np.array([b for _, b in limits]), tuple(exact)
    )


def _wrench(contact: Contact, component: int) -> Array:
    """Return (6,) the wrench on the object of one unit of a force component."""
    n, t = contact.normal, contact.tangent
    if component == 3:
        return np.concatenate([np.zeros(3), n])
    force = (t, np.cross(n, t), n)[component]
    return np.concatenate([force, np.cross(contact.position, force)])


def _facets(problem: ForceProblem, contact: Contact, b: Array, normal: Array, level: Array) -> list[Array]:
    """Return the rows ≤ 0 of a pyramid. Inner: ‖f_t‖/μ' + |m_n|/γ ≤ f_n; outer: the two apart; on facets at 2πk/m."""
    m, inner = problem.cone.facets, problem.cone.side == "inner"
    shrink = np.cos(np.pi / m) if inner else 1.0
    available = contact.friction * shrink * normal - level
    ring = [np.cos(angle) * b[0] + np.sin(angle) * b[1] for angle in 2 * np.pi * np.arange(m) / m]
    if contact.model.value != "soft":
        return [side - available for side in ring]
    moment = shrink * b[2]
    if inner:
        return [side + sign * moment - available for side in ring for sign in (1, -1)]
    return [side - available for side in [*ring, moment, -moment]]


def _cost(problem: ForceProblem, places: list[dict[int, int]], size: int) -> tuple[Array, Array, float]:
    """Return P, q and c of the cost to minimise (for "margin", −s)."""
    kind, actuation = problem.objective.type, problem.actuation
    P, q = np.zeros((size, size)), np.zeros(size)
    if kind == "force":
        return np.eye(size), q, 0.0
    if kind == "torque":
        W = np.diag(actuation.weight)
        P = actuation.J @ W @ actuation.J.T + problem.objective.force_weight * np.eye(size)
        return P, actuation.J @ W @ actuation.tau_u, 0.5 * float(actuation.tau_u @ W @ actuation.tau_u)
    if kind == "sum_normal":
        q[[place[2] for place in places]] = 1.0
        return P, q, 0.0
    q[-1] = 1.0 if kind == "max_normal" else -1.0
    return P, q, 0.0


def _minimum(program: Program, C: Array, d: Array) -> Array:
    """Return the optimum x with the linear limits only."""
    if not program.P.any():
        tight = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
        answer = optimize.linprog(program.q, C, d, program.A, program.w, bounds=(None, None), method="highs", options=tight)
        if answer.status == 2:
            raise InfeasibleProblem(answer.message)
        if answer.status != 0:
            raise SolverFailure(answer.message)
        return np.asarray(answer.x)
    # quadprog requires P > 0 and independent equality rows: add a ridge, and replace A by an orthonormal basis of its rows
    U, s, V = np.linalg.svd(program.A, full_matrices=False)
    kept = s > 1e-10 * s[0]
    beyond = program.w - U[:, kept] @ (U[:, kept].T @ program.w)
    if np.linalg.norm(beyond) > 1e-10 * np.linalg.norm(program.w):
        raise InfeasibleProblem("no forces at all, whatever their cones, make this wrench")
    ridge = 1e-12 * np.trace(program.P) / len(program.P) * np.eye(len(program.P))
    rows, right = V[kept], (U.T @ program.w)[kept] / s[kept]
    try:
        return quadprog.solve_qp(
            program.P + ridge, -program.q, np.vstack([rows, -C]).T, np.concatenate([right, -d]), len(rows)
        )[0]
    except ValueError as error:  # quadprog has one exception for both outcomes
        outcome = InfeasibleProblem if "constraints are inconsistent" in str(error) else SolverFailure
        raise outcome(str(error)) from None

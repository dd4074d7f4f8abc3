"""A case as a cone program with its proven answer: primal and dual optimum, or a ray that proves infeasibility.

minimise   ½ xᵀ P x + qᵀ x
subject to A x = b,   C x ≤ d,   r − S x in second-order cones {(t, v): ‖v‖ ≤ t}, one after another

optimum    P x + q = Aᵀ y − Cᵀ z − Sᵀ u,   z ≥ 0,   u in the cones,   cost of the forces = scale · value + offset
ray        Aᵀ y = Cᵀ z + Sᵀ u,             z ≥ 0,   u in the cones,   bᵀ y − dᵀ z − rᵀ u = 1
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import optimize, sparse

from graspforce.bench.case_program import case_program
from graspforce.core.arrays import Array
from graspforce.core.errors import BackendError
from graspforce.force.backends.clarabel import ConeSizes, solve_sparse
from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.cone_program import ConicProgram
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.problems.case import Case, ExpectedOptimum

DIGITS = (9, 11, 13, 15, 17)  # of numbers: the fewest with which the answer still holds
_TINY = 1e-11  # multipliers below this share of the largest one are rounding errors of the solver, and become zero
_ANSWER_ERROR = 1e-6  # largest relative error of an optimum against the proven one, and of a ray; loose for badly scaled cases


@dataclass(frozen=True, eq=False, slots=True)
class StandardForm:
    """A program and its answer; the module states the equations.

    Args:
        name: name of the case.
        feasible: whether the program is feasible.
        P: (m, m) Hessian of the cost.
        F: (h, m) factor of the Hessian, P = Fᵀ F.
        q: (m,) gradient of the cost at zero.
        A, b: (e, m) and (e,) equations.
        C, d: (i, m) and (i,) inequalities.
        S, r: (c, m) and (c,) rows of the second-order cones.
        cones: dimension of each second-order cone.
        scale: cost of the forces per unit of the program's value; −1 times it for a maximum.
        offset: cost of the forces at the value 0.
        objective: proven cost of the forces; None if infeasible.
        tolerance: relative accuracy of ``objective``.
        x: (m,) optimal variables; None if infeasible.
        y, z, u: (e,), (i,) and (c,) optimal multipliers, or the ray.
    """

    name: str
    feasible: bool
    P: sparse.csc_matrix
    F: sparse.csr_matrix
    q: Array
    A: sparse.csr_matrix
    b: Array
    C: sparse.csr_matrix
    d: Array
    S: sparse.csr_matrix
    r: Array
    cones: tuple[int, ...]
    scale: float
    offset: float
    objective: float | None
    tolerance: float
    x: Array | None
    y: Array
    z: Array
    u: Array


def standard_form(case: Case) -> StandardForm:
    """Return a case as a program with its answer, computed by Clarabel and checked against the proven answer.

    Numbers are rounded to the fewest of `DIGITS` with which the answer still satisfies the equations.

    Args:
        case: the case.

    Raises:
        BackendError: Clarabel's answer differs from the proven one.
    """
    program = case_program(case.problem)
    P, rows = sparse.csc_matrix(program.P), sparse.csc_matrix(np.vstack([program.A, program.C, program.S]))
    e, i = len(program.b), len(program.d)
    right = np.concatenate([program.b, program.d, program.r])
    feasible, x = isinstance(case.expected, ExpectedOptimum), None
    if isinstance(case.expected, ExpectedOptimum):
        cones = ConeSizes(e, i, program.cones)
        result = solve_sparse(sparse.csc_matrix(sparse.triu(P)), program.q, rows, right, cones, SolverSettings())
        x, y, z, u = result.x, -result.z[:e], np.maximum(result.z[e : e + i], 0.0), result.z[e + i :]
    else:
        y, z, u = proof_ray(program, case.expected.proof)
    scale, offset = _cost_units(program)
    form = StandardForm(
        case.name,
        feasible,
        P,
        sparse.csr_matrix(_cost_factor(program)),
        program.q,
        sparse.csr_matrix(program.A),
        program.b,
        sparse.csr_matrix(program.C),
        program.d,
        sparse.csr_matrix(program.S),
        program.r,
        program.cones,
        scale,
        offset,
        case.expected.objective if isinstance(case.expected, ExpectedOptimum) else None,
        case.expected.tolerance,
        x,
        y,
        z,
        u,
    )
    rounded = (_rounded(form, digits) for digits in DIGITS)
    found = next((one for one in rounded if not _answer_errors(one)), form)
    if error := _answer_errors(found):
        raise BackendError(error)
    return found


def _rounded(form: StandardForm, digits: int) -> StandardForm:
    """Return the program and its answer with rounded numbers."""
    matrices: dict[str, Any] = {}
    for name in ("P", "F", "A", "C", "S"):
        matrices[name] = getattr(form, name).copy()
        matrices[name].data = _round_digits(matrices[name].data, digits)
    vectors = {name: getattr(form, name) for name in ("q", "b", "d", "r", "x", "y", "z", "u")}
    rounded: dict[str, Any] = {
        name: None if values is None else _round_digits(values, digits) for name, values in vectors.items()
    }
    for name in ("y", "z", "u"):
        sizes = np.abs(rounded[name])
        rounded[name] = np.where(sizes > _TINY * sizes.max(initial=0.0), rounded[name], 0.0)
    return dataclasses.replace(form, **matrices, **rounded)


def _round_digits(values: Array, digits: int) -> Array:
    return np.array([float(f"{value:.{digits}g}") for value in values.tolist()], dtype=np.float64)


def _cost_units(program: ConicProgram) -> tuple[float, float]:
    """Return scale and offset: cost of the forces = scale · value of the program + offset."""
    problem, kind = program.problem, program.problem.objective.type
    if kind == "margin":
        return -program.cost_unit, 0.0
    if kind != "torque" or problem.actuation is None:
        return program.cost_unit, 0.0
    bias = problem.actuation.tau_u  # N·m
    return program.cost_unit, 0.5 * float(bias @ (problem.actuation.weight * bias))


def _cost_factor(program: ConicProgram) -> Array:
    """Return (h, m) F with P = Fᵀ F: joint loads for the objective "torque", and the weighted forces."""
    problem: ForceProblem = program.problem
    kind, indices = problem.objective.type, program.component_indices
    units, size = program.units[indices], len(program.q)
    weight = {"force": 1.0, "torque": problem.objective.force_weight}.get(kind, 0.0)
    forces = np.zeros((len(indices), size))
    forces[:, : len(indices)] = np.diag(units * np.sqrt(weight * problem.force_weights[indices]))
    rows = [forces] if weight > 0.0 else []
    if kind == "torque" and problem.actuation is not None:
        loads = np.zeros((len(problem.actuation.tau_u), size))
        loads[:, : len(indices)] = (np.sqrt(problem.actuation.weight) * (problem.actuation.J[indices] * units[:, None])).T
        rows.append(loads)
    return np.asarray(np.vstack([np.zeros((0, size)), *rows]) / np.sqrt(program.cost_unit))


def proof_ray(program: ConicProgram, proof: Multipliers) -> tuple[Array, Array, Array]:
    """Return the parts y, z and u of the ray of a proof, with bᵀ y − dᵀ z = 1.

    The proof gives the multipliers of equilibrium and limits. Those of the cones follow by nonnegative least squares.

    Args:
        program: the program.
        proof: multipliers that prove that the problem of the program is infeasible, in SI units.
    """
    proof = proof.about(program.problem.contacts.centroid)
    pairs = {
        "normal": (proof.normal_lower, proof.normal_upper),
        "torque": (proof.torque_lower, proof.torque_upper),
        "level": (proof.level, proof.level),
    }
    scaled = np.zeros(len(program.limits))
    for row, limit in enumerate(program.limits):
        if limit is not None:
            lower, upper = (values[limit.index] for values in pairs[limit.kind])
            scaled[row] = (lower - upper if limit.sign == 0 else lower if limit.sign > 0 else upper) * limit.unit
    equal = len(program.b) - 6
    y, z = np.concatenate([proof.y * program.wrench_units, scaled[:equal]]), scaled[equal:]
    facets = program.d == 0.0  # of friction cones: facets, f_n ≥ 0, and f_n ≤ t
    columns = np.hstack([program.C[facets].T, program.S.T, -program.S.T])
    # SciPy's nnls corrupts memory without columns
    rest = optimize.nnls(columns, program.A.T @ y - program.C.T @ z)[0] if columns.size else np.zeros(0)
    count, c = int(facets.sum()), len(program.r)
    z[facets] += rest[:count]
    u = rest[count : count + c] - rest[count + c :]
    value = float(program.b @ y - program.d @ z)
    return y / value, z / value, u / value


def _answer_errors(form: StandardForm) -> str:
    """Return what is wrong with an answer that is not the proven one; empty if it is."""
    heads = np.cumsum([0, *form.cones])
    outside = [max(0.0, float(np.linalg.norm(form.u[i + 1 : j]) - form.u[i])) for i, j in pairwise(heads)]
    if form.x is None:
        gradient = form.A.T @ form.y - form.C.T @ form.z - form.S.T @ form.u
        error = max(float(np.abs(gradient).max()), float(-form.z.min(initial=0.0)), *outside, 0.0)
        if not error <= _ANSWER_ERROR:
            return f"{form.name}: the proof leaves a ray with the residual {error:.1e}"
        return ""
    value = 0.5 * float(form.x @ (form.P @ form.x)) + float(form.q @ form.x)
    proven = form.objective or 0.0
    error = abs(form.scale * value + form.offset - proven)
    if not error <= _ANSWER_ERROR * (abs(proven) + abs(form.scale)):
        return f"{form.name}: the optimum differs from the proven one by {error:.1e}"
    return ""

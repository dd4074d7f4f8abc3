"""The squeeze of least cost for a set of errors, as one cone program, and its certificate.

The vertices of the set shift the friction cones; limits and pyramids shrink by the largest shift. Reserves for all other errors
enter as ‖x_i‖ ≤ u_i and |tau_l| ≤ v_l. This program is exact without reserves. With them it is safe, and a second program with
some members of the set only bounds the least cost from below.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.force.backends.clarabel import ClarabelBackend, ConeSizes, SparseConicResult, solve_sparse
from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.certificate import INFEASIBILITY_TOLERANCE, Certificate
from graspforce.force.infeasibility import Infeasibility
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.robust_limits import SLIP_TOLERANCE, worst_case
from graspforce.force.robust_set import Reserve, RobustSet
from graspforce.force.solution import Solution
from graspforce.force.status import Status

STRICT = SLIP_TOLERANCE  # force units: added to the slip margin, so that rounding makes no contact slip
_ROUNDS = 3  # of the search for members of the set that bound the cost from below
_LARGEST = 1e100  # of a solver's numbers: the squares of larger ones overflow
_TOLERANCE = 1e-11  # of the solver: the residuals of the certificate are relative to rows with several terms


@dataclass(frozen=True, eq=False, slots=True)
class ConeRows:
    """A cone program min ½ xᵀP x + qᵀx subject to b − A x in cones.

    Args:
        P: (m, m) Hessian.
        q: (m,) gradient at zero.
        A: (r, m) rows.
        b: (r,) right sides.
        sizes: the cones of the slacks, in order.
    """

    P: Array
    q: Array
    A: Array
    b: Array
    sizes: ConeSizes


def solve_robust(problem: ForceProblem, settings: SolverSettings) -> Solution:
    """Return the squeeze of least cost that holds for the errors of a problem, certified.

    Args:
        problem: a force problem with an uncertainty.
        settings: tolerance and limits of the solver.

    Raises:
        InvalidInput: as `RobustSet`.
    """
    start = time.perf_counter()
    robust = RobustSet(problem)
    settings = dataclasses.replace(settings, tolerance=settings.tolerance or _TOLERANCE)
    rows = safe_rows(robust)
    result = _solve(rows, settings)
    seconds = time.perf_counter() - start
    if not robust.is_supplied:
        return _failure(
            problem, result, seconds, _unsupplied(robust), Certificate(True, 0.0, 0.0, 1.0, INFEASIBILITY_TOLERANCE)
        )
    certificate = _certify(rows, result)
    if not certificate.verified:
        proof = _certify_infeasibility(rows, result)
        if not proof.verified:
            return _failure(problem, result, seconds, None, None)
        if not robust.is_exact:  # the set may be feasible where its safe program is not: only a subset can prove otherwise
            return _refuted(robust, settings) or _failure(problem, result, seconds, None, None)
        return _failure(problem, result, seconds, _no_squeeze(robust, result), proof)
    f = robust.program.forces(result.x)
    if not _holds(robust, f, certificate.tolerance):
        return _failure(problem, result, seconds, None, None)
    bound = problem.cost(f)
    bound -= certificate.gap * (1.0 + abs(bound) / robust.program.cost_unit) * robust.program.cost_unit
    if not robust.is_exact:
        bound = _cost_below(robust, f, settings)
    e = len(robust.program.b)
    i = len(robust.program.d)
    multipliers = robust.program.multipliers(-result.z[:e], np.maximum(result.z[e : e + i], 0.0))
    solution = Solution(
        Status.OPTIMAL,
        problem,
        arrays.freeze(f),
        None,
        None,
        ClarabelBackend.name,
        result.iterations,
        time.perf_counter() - start,
        multipliers,
        cost_bound=bound,
    )
    return solution.with_certificate(certificate)


def _holds(robust: RobustSet, f: Array, tolerance: float) -> bool:
    """Return whether a squeeze keeps margins and limits for all errors, from its forces alone."""
    worst, force = worst_case(robust, f), float(robust.program.wrench_units[0])  # N
    size = max(1.0, float(robust.sizes(robust.program.variables(f)).max()))
    kept = float(worst.guaranteed.min()) >= robust.uncertainty.slip_margin - tolerance * size * force
    return kept and worst.exceeded <= tolerance * size


def safe_rows(robust: RobustSet) -> ConeRows:
    """Return the program whose squeezes hold for all errors.

    Args:
        robust: the set.
    """
    program, m = robust.program, robust.columns
    extra = len(program.q) - m  # the level of "max_normal"
    size = _Sizes(robust, m + extra)
    margin = robust.uncertainty.slip_margin / float(program.wrench_units[0]) + STRICT
    linear = robust.reserve(program.C[:, :m])
    facets = np.array([limit is None for limit in program.limits[len(program.b) - 6 :]], dtype=bool)
    level = np.array(
        [limit is not None and limit.kind == "level" for limit in program.limits[len(program.b) - 6 :]], dtype=bool
    )
    most = (program.C[:, :m] @ robust.shifts.T).max(axis=1) if len(program.C) else np.zeros(0)
    shrunk = np.where(level, 0.0, most + linear.constant)
    C = size.widened(program.C)
    C[~level] += size.reserved(linear)[~level]
    d = program.d - shrunk - np.where(facets, margin, 0.0)
    spread = [shift for shift in robust.shifts if np.abs(program.A[6:, :m] @ shift).max(initial=0.0) > STRICT]
    A = np.vstack([program.A, *[program.A[6:]] * len(spread)])  # equal limits leave no room for shifts
    b = np.concatenate([program.b, *[program.b[6:] - program.A[6:, :m] @ shift for shift in spread]])
    cone_rows, cone_sides, cones = _friction_cones(robust, size, margin)
    sizes = ConeSizes(len(b), len(d) + 2 * len(size.motors), (*cones, *size.cones))
    return ConeRows(
        P=np.pad(program.P, ((0, size.added), (0, size.added))),
        q=np.pad(program.q, (0, size.added)),
        A=np.vstack([size.widened(A), C, *size.rows, *cone_rows, *size.cone_rows]),
        b=np.concatenate([b, d, *size.sides, *cone_sides, *[np.zeros(len(rows)) for rows in size.cone_rows]]),
        sizes=sizes,
    )


class _Sizes:
    """The variables u_i ≥ ‖x_i‖ and v_l ≥ |tau_l| behind the variables of a program, and their rows."""

    def __init__(self, robust: RobustSet, width: int) -> None:
        actuation = robust.problem.actuation
        self.width = width
        self.contacts = np.flatnonzero(robust.displacement > 0.0)
        self.motors = np.flatnonzero(robust.torque_fractions > 0.0)
        self.added = len(self.contacts) + len(self.motors)
        self.rows: list[Array] = []
        self.sides: list[Array] = []
        self.cone_rows: list[Array] = []
        self.cones: list[int] = []
        for place, contact in enumerate(self.contacts):
            own = np.flatnonzero(robust.owners == contact)
            block = np.zeros((1 + len(own), width + self.added))
            block[0, width + place] = -1.0
            block[1 + np.arange(len(own)), own] = -1.0
            self.cone_rows.append(block)
            self.cones.append(len(block))
        lever, bias = robust.lever[:, self.motors], np.zeros(len(self.motors))
        if actuation is not None:
            bias = actuation.tau_u[self.motors]
        largest = np.maximum(np.abs(lever).max(axis=0, initial=0.0), np.abs(bias))
        self.torque_units = np.where(largest > 0.0, largest, 1.0)  # N·m
        for sign in (1.0, -1.0):  # ± tau ≤ v
            rows = np.zeros((len(self.motors), width + self.added))
            rows[:, : robust.columns] = sign * (lever / self.torque_units).T
            rows[:, width + len(self.contacts) :] = -np.eye(len(self.motors))
            self.rows.append(rows)
            self.sides.append(-sign * bias / self.torque_units)

    def widened(self, rows: Array) -> Array:
        """Return rows with zeros for the sizes."""
        return np.pad(rows, ((0, 0), (0, self.added)))

    def reserved(self, reserve: Reserve) -> Array:
        """Return the part of reserves that is linear in the sizes, as rows."""
        rows = np.zeros((len(reserve.constant), self.width + self.added))
        rows[:, self.width : self.width + len(self.contacts)] = reserve.by_contact[:, self.contacts]
        rows[:, self.width + len(self.contacts) :] = reserve.by_motor[:, self.motors] * self.torque_units
        return rows


def _friction_cones(robust: RobustSet, size: _Sizes, margin: float) -> tuple[list[Array], list[Array], list[int]]:
    """Return the rows, right sides and sizes of ‖T (x + β)‖ ≤ μ h·(x + β) − margin − reserve, for all vertices."""
    rows: list[Array] = []
    sides: list[Array] = []
    cones: list[int] = []
    if robust.problem.cone.type == "pyramid":
        return rows, sides, cones
    heads, tails = robust.friction_rows
    mu = robust.nominal.contacts.mu[robust.rubbing]
    reserves = robust.reserve(mu[:, None] * heads, tails)
    reserved = size.reserved(reserves)
    for i, (head, tail) in enumerate(zip(mu[:, None] * heads, tails, strict=True)):
        kept = tail[np.abs(tail).max(axis=1) > 0.0]
        block = np.zeros((1 + len(kept), size.width + size.added))
        block[0, : robust.columns], block[1:, : robust.columns] = -head, -kept
        block[0] += reserved[i]
        sides_of_vertices = np.vstack([robust.shifts @ head - margin - reserves.constant[i], kept @ robust.shifts.T]).T
        for side in np.unique(sides_of_vertices, axis=0):
            rows.append(block)
            sides.append(side)
            cones.append(len(block))
    return rows, sides, cones


def _solve(rows: ConeRows, settings: SolverSettings) -> SparseConicResult:
    """Return Clarabel's result of a program."""
    upper = sparse.csc_matrix(np.triu(rows.P))
    return solve_sparse(upper, rows.q, sparse.csc_matrix(rows.A), rows.b, rows.sizes, settings)


def _violations(sizes: ConeSizes, values: Array, free: bool) -> Array:
    """Return by how much values are outside the cones; equality rows count unless their multipliers are free."""
    e, i = sizes.zero, sizes.nonnegative
    parts = [np.zeros(e) if free else np.abs(values[:e]), np.maximum(-values[e : e + i], 0.0)]
    for part in np.split(values[e + i :], np.cumsum(sizes.second_order)[:-1]) if sizes.second_order else []:
        parts.append(np.array([max(float(np.linalg.norm(part[1:]) - part[0]), 0.0)]))
    return np.concatenate(parts)


def _certify(rows: ConeRows, result: SparseConicResult) -> Certificate:
    """Return the certificate of an optimum, from the rows and the numbers alone."""
    x, z = result.x, result.z
    if result.status is not Status.OPTIMAL or not np.abs(np.concatenate([x, z])).max() < _LARGEST:  # NaN fails, too
        return Certificate.from_residuals(1.0, 1.0, 1.0)
    Px = rows.P @ x
    primal = float(_violations(rows.sizes, rows.b - rows.A @ x, free=False).max(initial=0.0))
    cost = 0.5 * float(x @ Px) + float(rows.q @ x)
    size = max(1.0, float(np.abs(x).max()))
    stationarity = np.abs(Px + rows.q + rows.A.T @ z).max() * size
    dual = max(float(stationarity), float(_violations(rows.sizes, z, free=True).max(initial=0.0)) * size)
    gap = abs(float(x @ Px) + float(rows.q @ x) + float(rows.b @ z))
    return Certificate.from_residuals(primal, dual / (1.0 + abs(cost)), gap / (1.0 + abs(cost)))


def _unit_ray(result: SparseConicResult) -> Array:
    """Return the ray of the dual, with a largest entry of 1: only its direction has a meaning."""
    return np.asarray(result.z / (float(np.abs(result.z).max(initial=0.0)) or 1.0))


def _certify_infeasibility(rows: ConeRows, result: SparseConicResult) -> Certificate:
    """Return the certificate that a program has no feasible point, from a ray of its dual."""
    if not np.isfinite(result.z).all():
        return Certificate(False, 0.0, 0.0, 0.0, INFEASIBILITY_TOLERANCE)
    z = _unit_ray(result)
    terms = rows.b * z
    largest = float(np.abs(terms).max(initial=0.0)) or 1.0
    value = -float(terms.sum()) / largest
    residual = max(float(np.abs(rows.A.T @ z).max()), float(_violations(rows.sizes, z, free=True).max(initial=0.0))) / largest
    return Certificate(
        value > 0.0 and residual <= INFEASIBILITY_TOLERANCE * value, 0.0, residual, value, INFEASIBILITY_TOLERANCE
    )


def _failure(
    problem: ForceProblem,
    result: SparseConicResult,
    seconds: float,
    infeasibility: Infeasibility | None,
    certificate: Certificate | None,
) -> Solution:
    """Return a solution without forces: infeasible with an explanation, otherwise failed."""
    status = Status.FAILED if infeasibility is None else Status.INFEASIBLE
    f = arrays.freeze([])
    return Solution(status, problem, f, certificate, infeasibility, ClarabelBackend.name, result.iterations, seconds)


def _no_squeeze(robust: RobustSet, result: SparseConicResult) -> Infeasibility:
    """Return the explanation of an infeasible robust program."""
    program, z = robust.program, _unit_ray(result)
    e = len(program.b)
    multipliers = program.multipliers(-z[:e], np.maximum(z[e : e + len(program.d)], 0.0))
    return _explained(multipliers, robust, "No squeeze within the limits holds for all errors of the set.")


def _unsupplied(robust: RobustSet) -> Infeasibility:
    """Return the explanation of wrenches that the contacts do not transmit."""
    zero, count, n = np.zeros(0), len(robust.problem.contacts), robust.lever.shape[1]
    y = robust.unsupplied / robust.program.wrench_units  # Gᵀ y = 0, and yᵀ w > 0 for a wrench of the set
    none = Multipliers(y, np.zeros(count), np.zeros(count), np.zeros(n), np.zeros(n), zero, robust.problem.contacts.centroid)
    return _explained(none, robust, "The contacts do not transmit all wrenches of the set, whatever the forces.")


def _explained(multipliers: Multipliers, robust: RobustSet, text: str) -> Infeasibility:
    """Return an explanation with a text."""
    y = multipliers.about(np.zeros(3)).y
    size = float(np.linalg.norm(y)) or 1.0
    contacts = tuple(range(len(robust.problem.contacts)))
    return Infeasibility(True, multipliers, contacts, (), arrays.freeze(y / size), text)


def _cost_below(robust: RobustSet, f: Array, settings: SolverSettings) -> float:
    """Return a lower bound on the cost of all squeezes that hold for the set: the optimum for some of its members."""
    exact = RobustSet(_with_exact_errors(robust))
    rows = safe_rows(exact)
    bound, x = -np.inf, robust.program.variables(f)[: robust.columns]
    members: list[tuple[Array, Array]] = []
    for _ in range(_ROUNDS):
        members += robust.worst_members(x)
        cut = _with_members(exact, rows, members)
        result = _solve(cut, settings)
        certificate = _certify(cut, result)
        if not certificate.verified:
            break
        x = result.x[: robust.columns]
        cost = 0.5 * float(result.x @ cut.P @ result.x) + float(cut.q @ result.x)
        slack = (certificate.gap + certificate.dual_residual) * (1.0 + abs(cost))
        constant = robust.problem.cost(np.zeros(robust.problem.size)) if robust.problem.objective.type == "torque" else 0.0
        bound = max(bound, (cost - slack) * robust.program.cost_unit + constant)
    return bound


def _with_exact_errors(robust: RobustSet) -> ForceProblem:
    """Return the problem with its exact errors only."""
    p = robust.problem
    return ForceProblem(p.contacts, p.w, p.actuation, p.cone, p.objective, uncertainty=robust.exact_errors)


def _refuted(robust: RobustSet, settings: SolverSettings) -> Solution | None:
    """Return the proof that not even the exact errors leave a squeeze; None if they do."""
    solution = solve_robust(_with_exact_errors(robust), settings)
    return dataclasses.replace(solution, problem=robust.problem) if solution.status is Status.INFEASIBLE else None


def _with_members(exact: RobustSet, rows: ConeRows, members: list[tuple[Array, Array]]) -> ConeRows:
    """Return the program with the friction cones of further members."""
    heads, tails = exact.friction_rows
    mu = exact.nominal.contacts.mu[exact.rubbing]
    margin = exact.uncertainty.slip_margin / float(exact.program.wrench_units[0])
    blocks, sides, cones = [rows.A], [rows.b], list(rows.sizes.second_order)
    for M, b in members:
        for head, tail, friction in zip(heads, tails, mu, strict=True):
            block = np.zeros((1 + len(tail), rows.A.shape[1]))
            block[0, : exact.columns], block[1:, : exact.columns] = -friction * (head @ M), -(tail @ M)
            blocks.append(block)
            sides.append(np.concatenate([[friction * float(head @ b) - margin], tail @ b]))
            cones.append(len(block))
    sizes = dataclasses.replace(rows.sizes, second_order=tuple(cones))
    return dataclasses.replace(rows, A=np.vstack(blocks), b=np.concatenate(sides), sizes=sizes)

"""The optimum of a force problem by solvers that share no formula with the package: QOCO, and cutting planes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import qoco
from scipy import sparse

from graspforce import ForceProblem, Multipliers
from support import reference_solver
from support.independent_check import independent_check, pyramid_edges

_LENGTH_UNITS = (100.0, 1000.0, 10.0, 30.0)  # units of length per metre
_TORQUE_UNIT = 20.0  # units of torque per N·m
_MAX_VIOLATION = 1e-5  # N, N·m; QOCO also reports points as solved that break a limit by several newtons
_TOLERANCE = 1e-10


def second_optimum(problem: ForceProblem) -> float | None:
    """Return the optimal objective; None if no feasible forces exist.

    QOCO solves the problem in several units of length, until one run ends with the status ``QOCO_SOLVED``.
    About 2 % of random problems stall at QOCO's looser tolerance in all units, and infeasible problems have no status.
    `reference_solver` decides those. The QOCO run with the smallest residuals is the last resort.
    """
    runs = []
    for per_metre in _LENGTH_UNITS:
        run = _solve_by_qoco(problem, per_metre)
        if run is not None and run.is_solved:
            return run.objective
        runs.append(run)
    try:
        return reference_solver.optimum(problem)[0]
    except reference_solver.InfeasibleProblem:
        return None
    except reference_solver.SolverFailure:
        feasible = [run for run in runs if run is not None]
        return min(feasible, key=lambda run: run.residual).objective if feasible else None


@dataclass(frozen=True)
class QocoRun:
    """One run of QOCO whose forces obey the constraints.

    Args:
        is_solved: the status is ``QOCO_SOLVED``, at a tolerance of 1e-10.
        residual: largest of the primal residual, the dual residual and the gap.
        objective: value at QOCO's forces.
    """

    is_solved: bool
    residual: float
    objective: float


def _solve_by_qoco(problem: ForceProblem, per_metre: float) -> QocoRun | None:
    """Return the run with moments in N/per_metre; None if QOCO fails or its forces break a constraint."""
    program = _QocoProgram(problem)
    program.add_equilibrium(per_metre)
    program.add_torques()
    program.add_contacts()
    result = program.solve()
    f = np.asarray(result.x)[: problem.size]
    if result.status not in ("QOCO_SOLVED", "QOCO_SOLVED_INACCURATE") or not np.isfinite(f).all():
        return None
    contacts, joints = np.zeros(len(problem.contacts)), np.zeros(program.n)
    check = independent_check(problem, f, Multipliers(np.zeros(6), contacts, contacts, joints, joints, contacts))
    if max(check.equilibrium, check.cone, check.limits) > _MAX_VIOLATION:
        return None
    residual = max(float(result.pres), float(result.dres), float(result.gap))
    return QocoRun(result.status == "QOCO_SOLVED", residual, problem.cost(f))


class _QocoProgram:
    """min ½ xᵀPx + cᵀx subject to equalities, linear inequalities and cones, for x = (f, tau, level) in SI units."""

    def __init__(self, problem: ForceProblem) -> None:
        self.problem, kind, actuation = problem, problem.objective.type, problem.actuation
        self.k, self.n = problem.size, 0 if actuation is None else len(actuation.tau_u)
        self.size = self.k + self.n + 1
        self.P, self.c = np.zeros(self.size), np.zeros(self.size)
        self.equalities: list[tuple[np.ndarray, float]] = []  # row·x = value
        self.inequalities: list[tuple[np.ndarray, float]] = []  # row·x ≤ value
        self.cones: list[np.ndarray] = []  # −rows·x in a second-order cone
        if kind == "torque":
            self.P[: self.k], self.P[self.k : -1] = problem.objective.force_weight, actuation.weight
        elif kind == "force":
            self.P[: self.k] = 1.0
        elif kind != "sum_normal":
            self.c[-1] = 1.0 if kind == "max_normal" else -1.0
        if kind == "margin":
            self.inequalities.append((self.row({self.size - 1: -1.0}), 0.0))

    def row(self, entries: dict[int, float]) -> np.ndarray:
        """Return a row with the given entries by column."""
        row = np.zeros(self.size)
        for column, value in entries.items():
            row[column] = value
        return row

    def add_equilibrium(self, per_metre: float) -> None:
        """Add G f = w with moments in N/per_metre."""
        for i, (row, value) in enumerate(zip(self.problem.G, self.problem.w, strict=True)):
            unit = 1.0 if i < 3 else per_metre
            self.equalities.append((unit * np.pad(row, (0, self.n + 1)), unit * value))

    def add_torques(self) -> None:
        """Add tau = tau_u + Jᵀ f and the torque limits."""
        actuation, unit = self.problem.actuation, _TORQUE_UNIT
        for j in range(self.n):
            row = self.row({self.k + j: unit})
            row[: self.k] = -unit * actuation.J[:, j]
            self.equalities.append((row, unit * actuation.tau_u[j]))
            for side, limit in ((-1, actuation.lower[j]), (1, actuation.upper[j])):
                if math.isfinite(limit):
                    self.inequalities.append((self.row({self.k + j: side * unit}), side * unit * limit))

    def add_contacts(self) -> None:
        """Add the limits of the normal forces, the friction cones, and the linear costs."""
        first, kind, level = 0, self.problem.objective.type, self.size - 1
        for contact in self.problem.contacts.contacts:
            width = {"frictionless": 1, "point": 3, "soft": 4}[contact.model.value]
            normal = first + (0 if width == 1 else 2)
            if kind == "sum_normal":
                self.c[normal] = 1.0
            if kind == "max_normal":
                self.inequalities.append((self.row({normal: 1.0, level: -1.0}), 0.0))
            self.inequalities.append((self.row({normal: -1.0}), -contact.min_normal))
            if contact.max_normal is not None:
                self.inequalities.append((self.row({normal: 1.0}), contact.max_normal))
            if width > 1:
                self._add_cone(first, width, contact.friction, contact.torsional_friction)
            first += width

    def _add_cone(self, first: int, width: int, mu: float, torsional_friction: float) -> None:
        """Add the cone or the pyramid of a contact whose components begin at a column."""
        cone, gamma = self.problem.cone, torsional_friction if width == 4 else 0.0
        edges, facet_mu = pyramid_edges(self.problem, mu, gamma)
        level = {self.size - 1: 1.0} if self.problem.objective.type == "margin" else {}
        head = self.row({first + 2: -facet_mu, **level})
        if edges is None:
            block = [head, self.row({first: -1.0}), self.row({first + 1: -1.0})]
            self.cones.append(np.array(block + ([self.row({first + 3: -mu / gamma})] if width == 4 else [])))
            return
        moments = [self.row({first + 3: sign * facet_mu / gamma}) for sign in (1, -1)] if width == 4 else []
        for angle in (2 * math.pi * np.arange(cone.facets) / cone.facets).tolist():
            facet = self.row({first: math.cos(angle), first + 1: math.sin(angle)}) + head
            together = moments if cone.side == "inner" and width == 4 else [np.zeros(self.size)]
            self.inequalities += [(facet + moment, 0.0) for moment in together]
        if cone.side == "outer":
            self.inequalities += [(moment + head, 0.0) for moment in moments]

    def solve(self):
        """Return QOCO's result."""
        sizes = [len(block) for block in self.cones]
        G = np.vstack([np.array([row for row, _ in self.inequalities]), *self.cones])
        h = np.concatenate([[value for _, value in self.inequalities], np.zeros(sum(sizes))])
        unit = float(np.abs(self.P).max()) or 1.0
        solver = qoco.QOCO()
        solver.setup(
            self.size,
            len(h),
            len(self.equalities),
            sparse.csc_matrix(sparse.diags(self.P / unit)),
            self.c / unit,
            sparse.csc_matrix(np.array([row for row, _ in self.equalities])),
            np.array([value for _, value in self.equalities], dtype=float),
            sparse.csc_matrix(G),
            h,
            len(self.inequalities),
            len(sizes),
            np.array(sizes, dtype=np.int32),
            abstol=_TOLERANCE,
            reltol=_TOLERANCE,
            verbose=0,
            max_iters=200,
        )
        return solver.solve()

"""Second opinions that share no formula with the package: a certificate from the dual objective, and another solver.

Written for reading, contact by contact, in SI units and unscaled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import qoco
from scipy import sparse

from graspforce import ForceProblem, Multipliers
from support import reference_solver

_LENGTH_UNITS = (100.0, 1000.0, 10.0, 30.0)  # units of length per metre
_MAX_VIOLATION = 1e-5  # N, N·m; QOCO also reports points as solved that break a limit by several newtons


@dataclass(frozen=True)
class IndependentCheck:
    """An independent look at an answer: violations in SI, and the cost against the dual objective."""

    equilibrium: float  # N, N·m
    cone: float  # N
    limits: float  # N, N·m
    wrong_signs: float
    dual_cone: float
    cost: float
    bound: float


def independent_check(problem: ForceProblem, f: np.ndarray, m: Multipliers) -> IndependentCheck:
    """Primal violations by scalar loops; the lower bound on the cost by the dual objective.

    For cost ½ tauᵀW tau + ½ρ‖f‖² the dual objective at stationarity is
    ½ tau_uᵀW tau_u − ½ (Jᵀf)ᵀW(Jᵀf) − ½ρ‖f‖² + yᵀw + Σ multiplier · limit; for linear costs the first terms are absent.
    """
    contacts, actuation, kind = problem.contacts.contacts, problem.actuation, problem.objective.type
    m = m.about(np.zeros(3))
    total, at, cone, limits = np.zeros(6), 0, 0.0, 0.0
    z = -(m.y @ problem.G)
    if actuation is not None:
        z -= actuation.J @ (m.torque_lower - m.torque_upper)
    tau = None if actuation is None else actuation.tau_u + actuation.J.T @ f
    if kind == "torque":
        z += actuation.J @ (actuation.weight * tau) + problem.objective.force_weight * f
    if kind == "force":
        z += f
    wrong = -min(*(part.min(initial=0.0) for part in (m.normal_lower, m.normal_upper, m.torque_lower, m.torque_upper)), 0.0)
    bound, dual_cone, weights, normals, margins = float(m.y @ problem.w), 0.0, 0.0, [], []
    for i, contact in enumerate(contacts):
        n = {"frictionless": 1, "point": 3, "soft": 4}[contact.model.value]
        part, dual = f[at : at + n], z[at : at + n].copy()
        at += n
        t1, t2, fn, mn = (0.0, 0.0, part[0], 0.0) if n == 1 else (*part, 0.0) if n == 3 else tuple(part)
        axes = contact.R_OC
        force = axes @ np.array([t1, t2, fn])
        total[:3] += force
        total[3:] += np.cross(contact.position, force) + mn * axes[:, 2]
        mu = contact.friction if n > 1 else 0.0
        gamma = contact.torsional_friction if n == 4 else 0.0
        dual[0 if n == 1 else 2] -= m.normal_lower[i] - m.normal_upper[i]
        if kind == "sum_normal":
            dual[0 if n == 1 else 2] += 1.0
        if kind == "max_normal":
            dual[0 if n == 1 else 2] += m.level[i]
        normals.append(fn)
        z1, z2, zn, zm = (0.0, 0.0, dual[0], 0.0) if n == 1 else (*dual, 0.0) if n == 3 else tuple(dual)
        rays, facet_mu = _pyramid(problem, mu, gamma)
        if n == 1:
            cone, dual_cone = max(cone, -fn), max(dual_cone, -zn)
        elif rays is None:
            used = math.hypot(t1 / mu, t2 / mu, mn / gamma if gamma else 0.0)
            margins.append(mu * (fn - used))
            dual_cone = max(dual_cone, math.hypot(mu * z1, mu * z2, gamma * zm) - zn)
        else:
            margins.append(_facet_margin(problem, t1, t2, fn, mn, facet_mu, gamma))
            dual_cone = max(dual_cone, *(-(z1 * a + z2 * b + zn + zm * c) for a, b, c in rays))
        if n > 1:
            cone, weights = max(cone, -margins[-1]), weights + zn / facet_mu
        limits = max(limits, contact.min_normal - fn)
        bound += m.normal_lower[i] * contact.min_normal
        if contact.max_normal is not None:
            limits = max(limits, fn - contact.max_normal)
            bound -= m.normal_upper[i] * contact.max_normal
        elif m.normal_upper[i] != 0.0:
            wrong = max(wrong, abs(m.normal_upper[i]))
    if actuation is not None:
        for j in range(len(tau)):
            for side, limit, multiplier in (
                (1, actuation.lower[j], m.torque_lower[j]),
                (-1, actuation.upper[j], m.torque_upper[j]),
            ):
                if math.isinf(limit):
                    wrong = max(wrong, abs(multiplier))
                    continue
                limits = max(limits, side * (limit - tau[j]))
                bound += side * multiplier * (limit - actuation.tau_u[j])
    cost, bound, extra = _cost_and_bound(problem, f, tau, normals, margins, bound, weights, m)
    return IndependentCheck(
        equilibrium=float(np.abs(total - problem.w).max()),
        cone=cone,
        limits=limits,
        wrong_signs=max(wrong, extra),
        dual_cone=dual_cone,
        cost=cost,
        bound=bound,
    )


def _cost_and_bound(problem, f, tau, normals, margins, bound, weights, m):
    actuation, kind = problem.actuation, problem.objective.type
    if kind == "torque":
        rho, load = problem.objective.force_weight, tau - actuation.tau_u
        cost = 0.5 * sum(w * t * t for w, t in zip(actuation.weight, tau, strict=True)) + 0.5 * rho * sum(x * x for x in f)
        bound += (
            0.5 * actuation.tau_u @ (actuation.weight * actuation.tau_u)
            - 0.5 * load @ (actuation.weight * load)
            - 0.5 * rho * f @ f
        )
        return cost, float(bound), 0.0
    if kind == "force":
        return 0.5 * math.fsum(x * x for x in f), float(bound - 0.5 * f @ f), 0.0
    if kind == "max_normal":
        return max(normals), bound, max(abs(float(m.level.sum()) - 1.0), -float(m.level.min()))
    if kind == "sum_normal":
        return math.fsum(normals), bound, 0.0
    return -min(margins), bound, max(1.0 - weights, 0.0)  # s ≥ 0 has the multiplier Σ z_n/μ − 1


def _pyramid(problem: ForceProblem, mu: float, gamma: float):
    """Edges (t1, t2, m) at f_n = 1 found as corners of the facets' polygon, and the friction of the facets."""
    cone = problem.cone
    if cone.type == "exact" or mu == 0.0:
        return None, mu
    facet = mu * math.cos(math.pi / cone.facets) if cone.side == "inner" else mu
    corner_radius = facet / math.cos(math.pi / cone.facets)
    angles = [(2 * k + 1) * math.pi / cone.facets for k in range(cone.facets)]
    ring = [(corner_radius * math.cos(a), corner_radius * math.sin(a)) for a in angles]
    if gamma == 0.0:
        return [(a, b, 0.0) for a, b in ring], facet
    if cone.side == "inner":
        return [(a, b, 0.0) for a, b in ring] + [(0.0, 0.0, gamma), (0.0, 0.0, -gamma)], facet
    return [(a, b, c) for a, b in ring for c in (gamma, -gamma)], facet


def _facet_margin(problem, t1, t2, fn, mn, facet_mu, gamma) -> float:
    """Return the friction that the nearest facet leaves, N."""
    count = problem.cone.facets
    tangential = max(t1 * math.cos(2 * math.pi * k / count) + t2 * math.sin(2 * math.pi * k / count) for k in range(count))
    moment = abs(mn) * facet_mu / gamma if gamma else 0.0
    return facet_mu * fn - (tangential + moment if problem.cone.side == "inner" else max(tangential, moment))


def second_optimum(problem: ForceProblem) -> float | None:
    """Return the optimal objective by solvers that share no formula with the package; None without forces.

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
    """Return the run with moments in N/per_metre; None if QOCO fails or its forces break a constraint by more than 1e-5."""
    contacts, actuation, kind = problem.contacts.contacts, problem.actuation, problem.objective.type
    k, n = problem.size, 0 if actuation is None else len(actuation.tau_u)
    size = k + n + 1  # f, tau, level
    P, c = np.zeros(size), np.zeros(size)
    equal = [np.pad(row, (0, n + 1)) for row in problem.G * np.array([1, 1, 1, per_metre, per_metre, per_metre])[:, None]]
    values = list(problem.w * np.array([1, 1, 1, per_metre, per_metre, per_metre]))
    linear: list[tuple[np.ndarray, float]] = []  # row·x ≤ value
    cones: list[np.ndarray] = []
    if kind == "torque":
        P[:k], P[k : k + n] = problem.objective.force_weight, actuation.weight
    elif kind == "force":
        P[:k] = 1.0
    elif kind != "sum_normal":
        c[-1] = 1.0 if kind == "max_normal" else -1.0
    for j in range(n):
        row = np.zeros(size)
        row[:k], row[k + j] = -actuation.J[:, j] * 20, 20.0
        equal.append(row)
        values.append(20 * actuation.tau_u[j])
        for side, limit in ((-1, actuation.lower[j]), (1, actuation.upper[j])):
            if math.isfinite(limit):
                row = np.zeros(size)
                row[k + j] = side * 20
                linear.append((row, side * limit * 20))
    at = 0
    for contact in contacts:
        width = {"frictionless": 1, "point": 3, "soft": 4}[contact.model.value]
        normal = at + (0 if width == 1 else 2)

        def unit(place: int, value: float = 1.0) -> np.ndarray:
            row = np.zeros(size)
            row[place] = value
            return row

        if kind == "sum_normal":
            c[normal] = 1.0
        if kind == "max_normal":
            linear.append((unit(normal) - unit(size - 1), 0.0))
        linear.append((unit(normal, -1.0), -contact.min_normal))
        if contact.max_normal is not None:
            linear.append((unit(normal), contact.max_normal))
        if width > 1:
            mu, gamma = contact.friction, contact.torsional_friction if width == 4 else 0.0
            level = unit(size - 1) if kind == "margin" else np.zeros(size)
            rays, facet_mu = _pyramid(problem, mu, gamma)
            head = unit(normal, -facet_mu) + level
            if rays is None:
                block = [head, unit(at, -1.0), unit(at + 1, -1.0)]
                if width == 4:
                    block.append(unit(at + 3, -mu / gamma))
                cones.append(np.array(block))
            else:
                moments = [facet_mu / gamma, -facet_mu / gamma] if width == 4 else [0.0]
                for a in (2 * math.pi * np.arange(problem.cone.facets) / problem.cone.facets).tolist():
                    row = unit(at, math.cos(a)) + unit(at + 1, math.sin(a)) + head
                    if problem.cone.side == "outer" or width == 3:
                        linear.append((row, 0.0))
                    else:
                        linear += [(row + unit(at + 3, moment), 0.0) for moment in moments]
                if problem.cone.side == "outer" and width == 4:
                    linear += [(unit(at + 3, moment) + head, 0.0) for moment in moments]
        at += width
    if kind == "margin":
        linear.append((unit(size - 1, -1.0), 0.0))
    G = np.vstack([np.array([row for row, _ in linear]), *cones])
    h = np.concatenate([[value for _, value in linear], np.zeros(sum(len(block) for block in cones))])
    scale = float(np.abs(P).max()) or 1.0
    solver = qoco.QOCO()
    solver.setup(
        size,
        len(h),
        len(values),
        sparse.csc_matrix(sparse.diags(P / scale)),
        c / scale,
        sparse.csc_matrix(np.array(equal)),
        np.array(values, dtype=float),
        sparse.csc_matrix(G),
        h,
        len(linear),
        len(cones),
        np.array([len(block) for block in cones], dtype=np.int32) if cones else np.array([], dtype=np.int32),
        abstol=1e-10,
        reltol=1e-10,
        verbose=0,
        max_iters=200,
    )
    answer = solver.solve()
    f = np.asarray(answer.x)[:k]
    if answer.status not in ("QOCO_SOLVED", "QOCO_SOLVED_INACCURATE") or not np.isfinite(f).all():
        return None
    zero_multipliers = Multipliers(
        *(np.zeros(len(part)) for part in (problem.w, contacts, contacts, range(n), range(n), contacts))
    )
    seen = independent_check(problem, f, zero_multipliers)
    if max(seen.equilibrium, seen.cone, seen.limits) > _MAX_VIOLATION:
        return None
    residual = max(float(answer.pres), float(answer.dres), float(answer.gap))
    return QocoRun(answer.status == "QOCO_SOLVED", residual, problem.cost(f))

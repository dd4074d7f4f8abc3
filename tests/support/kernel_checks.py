"""Checks of kernel answers that share no code with the kernel: constraint violations, optimality, proofs, and Clarabel."""

from __future__ import annotations

from typing import Any

import clarabel
import numpy as np
import scipy.sparse as sp

from graspforce.contact import friction
from graspforce.core.arrays import Array
from support.kernel_cases import KernelCase
from support.kernel_runs import KernelAnswer


def objective(case: KernelCase, f: Array) -> float:
    """Return the cost ½ tauᵀ W tau + ½ ρ ‖f‖² + cᵀf."""
    tau = case.tau_u + case.J.T @ f
    return float(0.5 * case.weight @ tau**2 + 0.5 * case.force_weight[0] * f @ f + case.cost @ f)


def violation(case: KernelCase, f: Array) -> float:
    """Return the largest relative violation of a constraint.

    Forces are relative to `case.force`, moments to force × length, torques to force × norm of the row of Jᵀ.
    """
    F, tau = case.force, case.tau_u + case.J.T @ f
    rows = np.maximum(np.linalg.norm(case.J, axis=0), 1e-12 * np.linalg.norm(case.J)) + 1e-300  # m/rad
    wrench = (case.G @ f - case.w) / F / np.repeat([1.0, case.length], 3)
    fn = f[case.normals]
    cone = friction.violation(case.pad(f), case.mu, case.gamma)[case.exact]
    facets = [a @ case.pad(f)[i] / np.linalg.norm(a) for a, i in zip(case.facet, case.facet_contact, strict=True)]
    torque = np.maximum(case.lower - tau, tau - case.upper) / rows
    forces = np.concatenate([cone, np.maximum(case.min_normal, 0.0) - fn, fn - case.max_normal, torque, facets])
    return float(max(np.abs(wrench).max(), forces.max() / F, 0.0))


def dual_violation(case: KernelCase, answer: KernelAnswer) -> float:
    """Return how far z is outside the dual cones, in the unit of z. The dual of a pyramid is z·r ≥ 0 for each of its rays."""
    z = case.pad(answer.z)
    cone = friction.dual_violation(z, case.mu, case.gamma)[case.exact]
    rays = []
    for i in np.flatnonzero(~case.exact):
        facets = int((case.facet_contact == i).sum())
        rays.append(-(friction.pyramid_rays(facets, "inner", float(case.mu[i]), float(case.gamma[i])) @ z[i]).min())
    return float(max([0.0, *cone, *rays]))


def smallest_multiplier(answer: KernelAnswer) -> float:
    """Return the smallest multiplier of the limits, which must not be negative."""
    parts = (answer.nu_lower, answer.nu_upper, answer.lambda_lower, answer.lambda_upper)
    return min(float(part.min(initial=0.0)) for part in parts)


def stationarity(case: KernelCase, answer: KernelAnswer, *, proof: bool = False) -> Array:
    """Return the residual of stationarity (k,), or of an infeasibility proof, in cost per N."""
    tau = np.zeros(len(case.tau_u)) if proof else case.weight * (case.tau_u + case.J.T @ answer.f)
    force = np.zeros(case.k) if proof else case.force_weight[0] * answer.f + case.cost
    normal = np.zeros(case.k)
    normal[case.normals] = answer.nu_lower - answer.nu_upper
    sign = -1.0 if proof else 1.0
    price = case.G.T @ answer.y + answer.z + normal + case.J @ (answer.lambda_lower - answer.lambda_upper)
    return np.asarray(sign * (case.J @ tau + force - price))


def dual_value(case: KernelCase, answer: KernelAnswer) -> float:
    """Return yᵀw + nu_lᵀ f_min − nu_uᵀ f_max + lambda_lᵀ (lower − tau_u) − lambda_uᵀ (upper − tau_u)."""

    def times(multiplier: Array, limit: Array) -> float:
        return float(multiplier[multiplier != 0] @ limit[multiplier != 0])

    normal = times(answer.nu_lower, np.maximum(case.min_normal, 0.0)) - times(answer.nu_upper, case.max_normal)
    torque = times(answer.lambda_lower, case.lower - case.tau_u) - times(answer.lambda_upper, case.upper - case.tau_u)
    return float(answer.y @ case.w + normal + torque)


def lower_bound(case: KernelCase, answer: KernelAnswer) -> float:
    """Return the lower bound of the cost by weak duality (Boyd and Vandenberghe 2004, section 5.2).

    It is the dual value − ½ fᵀHf + ½ tau_uᵀ W tau_u with H = J W Jᵀ + ρ I.
    """
    curvature = 0.5 * case.weight @ (case.J.T @ answer.f) ** 2 + 0.5 * case.force_weight[0] * answer.f @ answer.f
    return float(dual_value(case, answer) - curvature + 0.5 * case.weight @ case.tau_u**2)


def proof_margin(case: KernelCase, answer: KernelAnswer) -> float:
    """Return the value of an infeasibility proof less the largest effect of its residuals. A positive margin proves it.

    Contacts without an upper normal force limit count as limited to 10⁴ force units.
    """
    bound = np.where(np.isfinite(case.max_normal), case.max_normal, 1e4 * case.force)  # N
    sizes = np.column_stack([case.mu * bound, case.mu * bound, bound, case.gamma * bound])  # largest components
    residual = (np.abs(case.pad(stationarity(case, answer, proof=True))) * sizes).sum()
    outside = (friction.dual_violation(case.pad(answer.z), case.mu, case.gamma) * bound).sum()
    return dual_value(case, answer) - float(residual + outside)


class _Rows:
    """Equalities a·x = b and inequalities a·x ≤ b, normalised, in units of force."""

    def __init__(self, force: float) -> None:
        self.force = force
        self.equal: list[tuple[Array, float]] = []
        self.below: list[tuple[Array, float]] = []

    def equals(self, row: Array, value: float) -> None:
        norm = np.linalg.norm(row)
        self.equal.append((row / norm, value / norm / self.force))

    def at_most(self, row: Array, bound: float) -> None:
        if np.isfinite(bound):
            norm = np.linalg.norm(row) or 1.0
            self.below.append((row / norm, bound / norm / self.force))


def sparse_program(case: KernelCase) -> tuple[Array, Array, list[Any]]:
    """Return A, b and the cones of A x + s = b with x = f / force. The first six rows are G x = w."""
    rows, cones = _Rows(case.force), []
    for i, n in enumerate(case.normals):
        cones += _contact_rows(case, rows, i, int(n))
    for row, i in zip(case.facet, case.facet_contact, strict=True):
        full = np.zeros(4 * len(case.mu))
        full[4 * i : 4 * i + 4] = row
        rows.at_most(full[case.columns], 0.0)
    for j in range(len(case.tau_u)):
        if case.lower[j] == case.upper[j]:
            rows.equals(case.J[:, j], case.lower[j] - case.tau_u[j])
        else:
            rows.at_most(-case.J[:, j], float(case.tau_u[j] - case.lower[j]))
            rows.at_most(case.J[:, j], float(case.upper[j] - case.tau_u[j]))
    units = np.repeat([1.0, case.length], 3)
    below = [np.array([row for row, _ in rows.below])] if rows.below else []
    A = np.vstack([case.G / units[:, None], *(row[None] for row, _ in rows.equal), *below, *cones])
    limits = [value for _, value in rows.equal + rows.below]
    b = np.concatenate([case.w / units / case.force, limits, np.zeros(sum(len(cone) for cone in cones))])
    kinds: list[Any] = [clarabel.ZeroConeT(6 + len(rows.equal))]
    kinds += [clarabel.NonnegativeConeT(len(rows.below))] if rows.below else []
    return A, b, kinds + [clarabel.SecondOrderConeT(len(cone)) for cone in cones]


def _contact_rows(case: KernelCase, rows: _Rows, i: int, n: int) -> list[Array]:
    """Add the normal force limits and zero components of contact i. Return its exact cone, if it has one."""
    eye = np.eye(case.k)
    largest = {0: case.mu[i], 1: case.mu[i], 3: case.gamma[i]}  # component per normal force, by padded component
    others = [(r, largest[int(case.columns[r]) % 4]) for r in np.flatnonzero(case.columns // 4 == i) if r != n]
    for r, ratio in others:
        if ratio == 0:
            rows.equals(eye[r], 0.0)
    if case.min_normal[i] == case.max_normal[i]:
        rows.equals(eye[n], case.min_normal[i])
    else:
        rows.at_most(-eye[n], -max(case.min_normal[i], 0.0))
        rows.at_most(eye[n], float(case.max_normal[i]))
    free = [eye[r] / ratio for r, ratio in others if ratio > 0]
    return [-np.vstack([eye[n], *free])] if case.exact[i] and free else []


def run_clarabel(
    cost: tuple[Array, Array], constraints: tuple[Array, Array, list[Any]], tolerance: float
) -> tuple[str, Array, float]:
    """Return Clarabel's status, x and relative duality gap for the cost ½ xᵀHx + cᵀx, given as (H, c)."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 400
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    (H, c), (A, b, kinds) = cost, constraints
    solution = clarabel.DefaultSolver(sp.csc_matrix(np.triu(H)), c, sp.csc_matrix(A), b, kinds, settings).solve()
    gap = abs(solution.obj_val - solution.obj_val_dual) / max(abs(solution.obj_val), 1e-300)
    return str(solution.status), np.array(solution.x), float(gap)


def clarabel_objective(case: KernelCase) -> tuple[str, float, Array]:
    """Return Clarabel's status, objective and forces.

    Its tolerance on the gap is absolute, in units of the cost of a stiff finger. Costs are often a thousandth of that. With
    1e-12 it often ends with ``AlmostSolved``, which promises four digits only. The status here is ``Solved`` if Clarabel
    converged at 1e-12, or if the gap of a run is at most 1e-9 of the objective.
    """
    F, k = case.force, case.k
    root = np.sqrt(case.weight) * case.J if len(case.tau_u) else np.zeros((k, 0))
    H = root @ root.T + case.force_weight[0] * np.eye(k)
    c = root @ (np.sqrt(case.weight) * case.tau_u) + case.cost
    unit = np.trace(H) / k or np.abs(c).max() / F or 1.0
    program = sparse_program(case)
    for tolerance in (1e-12, 3e-12, 1e-11):
        status, x, gap = run_clarabel((H / unit, c / unit / F), program, tolerance)
        is_accurate = gap <= 1e-9 or (status == "Solved" and tolerance == 1e-12)
        if status in ("Solved", "AlmostSolved") and is_accurate:
            return "Solved", objective(case, F * x), F * x
    return "AlmostSolved" if status == "Solved" else status, objective(case, F * x), F * x


def clarabel_optimum(case: KernelCase) -> float:
    """Return the optimal objective by Clarabel, which must have converged."""
    status, optimum, _ = clarabel_objective(case)
    assert status == "Solved"
    return optimum


def largest_load_factor(case: KernelCase) -> float:
    """Return the largest multiple of w that the contacts can supply, or NaN if Clarabel finds none."""
    A, b, kinds = sparse_program(case)
    load = np.zeros(len(b))
    load[:6], b = -b[:6], np.concatenate([np.zeros(6), b[6:]])
    H, c = np.zeros((case.k + 1, case.k + 1)), -np.eye(case.k + 1)[-1]
    status, x, _ = run_clarabel((H, c), (np.column_stack([A, load]), b, kinds), 1e-10)
    return float(x[-1]) if status == "Solved" else float("nan")

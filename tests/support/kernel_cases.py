"""Random force problems as plain arrays for the structured kernel, and a second way to solve them.

A `KernelCase` holds what structured.h asks for. `random_case` makes one that a known force obeys strictly; `clarabel_objective`
solves it as one sparse cone program, which shares nothing with the kernel; `violation`, `stationarity` and `proof_margin`
measure an answer by the laws themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import clarabel
import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from graspforce import ForceProblem
from graspforce.contact import friction
from graspforce.force.backends._structured import Kernel
from graspforce.force.certificate import scale

Array = npt.NDArray[np.float64]
OPTIMAL, INACCURATE, INFEASIBLE, FAILED = range(4)
COLUMNS = {1: (2,), 3: (0, 1, 2), 4: (0, 1, 2, 3)}  # of (f_t1, f_t2, f_n, m_n)
REPORT_WIDTH = 8


@dataclass(frozen=True)
class KernelCase:
    """One problem; the fields are those of structured.h, in the kernel's order."""

    components: npt.NDArray[np.intc]
    contact_block: npt.NDArray[np.intc]
    joint_block: npt.NDArray[np.intc]
    facet_contact: npt.NDArray[np.intc]
    G: Array
    w: Array
    mu: Array
    gamma: Array
    min_normal: Array
    max_normal: Array
    J: Array
    tau_u: Array
    lower: Array
    upper: Array
    weight: Array
    facet: Array
    cost: Array
    force_weight: Array
    units: Array = field(default_factory=lambda: np.zeros(0))  # F, L, the cost's and each T, for `certify`; none: all 1

    @property
    def k(self) -> int:
        return int(self.G.shape[1])

    @property
    def sizes(self) -> tuple[int, int]:
        """Contacts and joints."""
        return len(self.mu), len(self.tau_u)

    @property
    def columns(self) -> npt.NDArray[np.intp]:
        """Where each stacked component stands among the 4 N padded ones."""
        return np.array([4 * i + c for i, m in enumerate(self.components) for c in COLUMNS[int(m)]], dtype=np.intp)

    @property
    def normals(self) -> npt.NDArray[np.intp]:
        return np.flatnonzero(self.columns % 4 == 2)

    @property
    def exact(self) -> npt.NDArray[np.bool_]:
        """Which contacts have the exact cone."""
        return ~np.isin(np.arange(len(self.mu)), self.facet_contact)

    def pad(self, f: Array) -> Array:
        padded = np.zeros(4 * len(self.mu))
        padded[self.columns] = f
        return padded.reshape(-1, 4)

    @property
    def length(self) -> float:
        """Root mean square of the contacts' distances from the origin, m."""
        forces = self.columns % 4 < 3
        return float(np.sqrt(1.5 * (self.G[3:, forces] ** 2).sum() / (self.G[:3, forces] ** 2).sum())) or 1.0

    @property
    def force(self) -> float:
        """The scale of violations, N."""
        scale = max(np.linalg.norm(self.w[:3]), np.linalg.norm(self.w[3:]) / self.length, self.min_normal.max())
        return float(scale) if scale > 0 else 1.0


@dataclass(frozen=True)
class KernelAnswer:
    """What the kernel wrote."""

    status: int
    iterations: int
    f: Array
    y: Array
    z: Array
    nu_lower: Array
    nu_upper: Array
    lambda_lower: Array
    lambda_upper: Array
    tau: Array  # by `certify`


def bind_kernel(case: KernelCase, count: int = 1, **arrays: Array) -> tuple[Kernel, Array, Array]:
    """A kernel bound to a case, its answers and its reports. `arrays` replace the case's own, or these two."""
    N, n = case.sizes
    answer, report = np.zeros((count, 2 * case.k + 6 + 2 * N + 3 * n)), np.zeros((count, REPORT_WIDTH))
    units = case.units if len(case.units) else np.ones(3 + n)
    bound = {"answer": answer, "report": report, **vars(case), "units": units, **arrays}
    bound = {name: np.ascontiguousarray(value) for name, value in bound.items()}
    return Kernel(p=None, R=None, **bound), bound["answer"], bound["report"]


def unpack_answer(case: KernelCase, answer: Array, report: Array) -> KernelAnswer:
    N, n = case.sizes
    parts = np.split(answer.copy(), np.cumsum([case.k, 6, case.k, N, N, n, n]))
    return KernelAnswer(int(report[0]), int(report[1]), *parts)


def solve(case: KernelCase, tolerance: float = 1e-9, most: int = 60) -> KernelAnswer:
    kernel, answer, report = bind_kernel(case)
    kernel.solve(0, 1, tolerance, most, False)
    return unpack_answer(case, answer[0], report[0])


def objective(case: KernelCase, f: Array) -> float:
    """½ tauᵀ W tau + ½ ρ fᵀf + cᵀf"""
    tau = case.tau_u + case.J.T @ f
    return float(0.5 * case.weight @ tau**2 + 0.5 * case.force_weight[0] * f @ f + case.cost @ f)


def violation(case: KernelCase, f: Array) -> float:
    """The largest violation of any law, relative: forces to `force`, moments to force × length, torques to force × row norm."""
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
    """How far z is from the dual cones, in its own units. The dual of a pyramid is what its rays ask: z·r ≥ 0 for each."""
    z = case.pad(answer.z)
    cone = friction.dual_violation(z, case.mu, case.gamma)[case.exact]
    rays = []
    for i in np.flatnonzero(~case.exact):
        facets = int((case.facet_contact == i).sum())
        rays.append(-(friction.pyramid_rays(facets, "inner", float(case.mu[i]), float(case.gamma[i])) @ z[i]).min())
    return float(max([0.0, *cone, *rays]))


def least_multiplier(answer: KernelAnswer) -> float:
    """The smallest of the multipliers that must not be negative."""
    parts = (answer.nu_lower, answer.nu_upper, answer.lambda_lower, answer.lambda_upper)
    return min(float(part.min(initial=0.0)) for part in parts)


def stationarity(case: KernelCase, answer: KernelAnswer, *, proof: bool = False) -> Array:
    """What is left of the law of stationarity, or of a proof's balance, component by component."""
    tau = np.zeros(len(case.tau_u)) if proof else case.weight * (case.tau_u + case.J.T @ answer.f)
    force = np.zeros(case.k) if proof else case.force_weight[0] * answer.f + case.cost
    normal = np.zeros(case.k)
    normal[case.normals] = answer.nu_lower - answer.nu_upper
    sign = -1.0 if proof else 1.0
    pull = case.G.T @ answer.y + answer.z + normal + case.J @ (answer.lambda_lower - answer.lambda_upper)
    return np.asarray(sign * (case.J @ tau + force - pull))


def dual_value(case: KernelCase, answer: KernelAnswer) -> float:
    """yᵀw + nu_lᵀ f_min − nu_uᵀ f_max + lambda_lᵀ (lower − tau_u) − lambda_uᵀ (upper − tau_u)"""

    def times(multiplier: Array, limit: Array) -> float:
        return float(multiplier[multiplier != 0] @ limit[multiplier != 0])

    value = (
        answer.y @ case.w + times(answer.nu_lower, np.maximum(case.min_normal, 0.0)) - times(answer.nu_upper, case.max_normal)
    )
    return float(
        value + times(answer.lambda_lower, case.lower - case.tau_u) - times(answer.lambda_upper, case.upper - case.tau_u)
    )


def lower_bound(case: KernelCase, answer: KernelAnswer) -> float:
    """Weak duality: no cost is below dual value − ½ fᵀHf + ½ tau_uᵀ W tau_u, H = J W Jᵀ + ρ I. Boyd and Vandenberghe 5.2."""
    bend = 0.5 * case.weight @ (case.J.T @ answer.f) ** 2 + 0.5 * case.force_weight[0] * answer.f @ answer.f
    return float(dual_value(case, answer) - bend + 0.5 * case.weight @ case.tau_u**2)


def proof_margin(case: KernelCase, answer: KernelAnswer) -> float:
    """A proof's value, which any force inside all limits makes ≤ 0, less what its rounding could hide; > 0: there is none.

    Contacts without a limit of their own count as limited to 10⁴ force units.
    """
    reach = np.where(np.isfinite(case.max_normal), case.max_normal, 1e4 * case.force)  # N
    sizes = np.column_stack([case.mu * reach, case.mu * reach, reach, case.gamma * reach])  # largest components
    slip = (np.abs(case.pad(stationarity(case, answer, proof=True))) * sizes).sum()
    outside = (friction.dual_violation(case.pad(answer.z), case.mu, case.gamma) * reach).sum()
    return dual_value(case, answer) - float(slip + outside)


def sparse_program(case: KernelCase) -> tuple[Array, Array, list[Any]]:
    """A, b and cones of A x + s = b, the first six rows G x = w, in units of `force` and `length`."""
    F, L = case.force, case.length
    eye = np.eye(case.k)
    equal, limit = [case.G / np.repeat([1.0, L], 3)[:, None]], [case.w / np.repeat([1.0, L], 3) / F]
    below, high, cones, heads = [], [], [], []

    def exactly(row: Array, value: float) -> None:
        equal.append(row[None] / np.linalg.norm(row))
        limit.append(np.array([value / np.linalg.norm(row) / F]))

    def at_most(row: Array, bound: float) -> None:
        if np.isfinite(bound):
            norm = np.linalg.norm(row) or 1.0
            below.append(row / norm)
            high.append(bound / norm / F)

    for i, n in enumerate(case.normals):
        reach = {0: case.mu[i], 1: case.mu[i], 3: case.gamma[i]}  # what a unit of normal force bears, by padded component
        rest = [(r, reach[int(case.columns[r]) % 4]) for r in np.flatnonzero(case.columns // 4 == i) if r != n]
        for r, share in rest:
            if share == 0:
                exactly(eye[r], 0.0)
        free = [eye[r] / share for r, share in rest if share > 0]
        if case.exact[i] and free:
            heads.append(1 + len(free))
            cones.append(-np.vstack([eye[n], *free]))
        if case.min_normal[i] == case.max_normal[i]:
            exactly(eye[n], case.min_normal[i])
        else:
            at_most(-eye[n], -max(case.min_normal[i], 0.0))
            at_most(eye[n], float(case.max_normal[i]))
    for row, i in zip(case.facet, case.facet_contact, strict=True):
        full = np.zeros(4 * len(case.mu))
        full[4 * i : 4 * i + 4] = row
        at_most(full[case.columns], 0.0)
    for j in range(len(case.tau_u)):
        if case.lower[j] == case.upper[j]:
            exactly(case.J[:, j], case.lower[j] - case.tau_u[j])
        else:
            at_most(-case.J[:, j], float(case.tau_u[j] - case.lower[j]))
            at_most(case.J[:, j], float(case.upper[j] - case.tau_u[j]))
    A = np.vstack([*equal, *([np.array(below)] if below else []), *cones])
    b = np.concatenate([*limit, np.array(high), np.zeros(sum(heads))])
    kinds: list[Any] = [clarabel.ZeroConeT(sum(len(e) for e in limit))]
    kinds += [clarabel.NonnegativeConeT(len(high))] if high else []
    return A, b, kinds + [clarabel.SecondOrderConeT(h) for h in heads]


def run_clarabel(H: Array, c: Array, A: Array, b: Array, kinds: list[Any], tolerance: float) -> tuple[str, Array, float]:
    """Return Clarabel's status, x, and the duality gap relative to the objective."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 400
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    solution = clarabel.DefaultSolver(sp.csc_matrix(np.triu(H)), c, sp.csc_matrix(A), b, kinds, settings).solve()
    gap = abs(solution.obj_val - solution.obj_val_dual) / max(abs(solution.obj_val), 1e-300)
    return str(solution.status), np.array(solution.x), float(gap)


def clarabel_objective(case: KernelCase) -> tuple[str, float, Array]:
    """Return Clarabel's status, objective and forces.

    Clarabel's tolerance on the gap is absolute, in units of a stiff finger's cost, and costs are often a thousandth of that.
    At 1e-12 it often ends with ``AlmostSolved``, which promises four digits only.
    The status here is ``Solved`` only if Clarabel converged at 1e-12, or if the gap of a run is at most 1e-9 of the objective.
    """
    F, k = case.force, case.k
    spread = np.sqrt(case.weight) * case.J if len(case.tau_u) else np.zeros((k, 0))
    H = spread @ spread.T + case.force_weight[0] * np.eye(k)
    c = spread @ (np.sqrt(case.weight) * case.tau_u) + case.cost
    unit = np.trace(H) / k or np.abs(c).max() / F or 1.0
    program = sparse_program(case)
    for tolerance in (1e-12, 3e-12, 1e-11):
        status, x, gap = run_clarabel(H / unit, c / unit / F, *program, tolerance)
        is_accurate = gap <= 1e-9 or (status == "Solved" and tolerance == 1e-12)
        if status in ("Solved", "AlmostSolved") and is_accurate:
            return "Solved", objective(case, F * x), F * x
    return "AlmostSolved" if status == "Solved" else status, objective(case, F * x), F * x


def clarabel_optimum(case: KernelCase) -> float:
    """Return the optimal objective by Clarabel, which must have converged."""
    status, value, _ = clarabel_objective(case)
    assert status == "Solved"
    return value


def largest_load_factor(case: KernelCase) -> float:
    """The largest multiple of w that the contacts can supply; NaN where Clarabel finds none."""
    A, b, kinds = sparse_program(case)
    load = np.zeros(len(b))
    load[:6], b = -b[:6], np.concatenate([np.zeros(6), b[6:]])
    H = np.zeros((case.k + 1, case.k + 1))
    status, x, _ = run_clarabel(H, np.eye(case.k + 1)[-1] * -1.0, np.column_stack([A, load]), b, kinds, 1e-10)
    return float(x[-1]) if status == "Solved" else float("nan")


def contact_frame(normal: Array) -> Array:
    """Columns t₁, t₂ = n × t₁, n."""
    t1 = np.cross(normal, [0.0, 1.0, 0.0] if abs(normal[0]) >= 0.9 else [1.0, 0.0, 0.0])
    t1 /= np.linalg.norm(t1)
    return np.column_stack([t1, np.cross(normal, t1), normal])


def wrench_map(positions: Array, normals: Array, components: npt.NDArray[np.intc]) -> Array:
    """G, 6 × k"""
    blocks = []
    for p, n, m in zip(positions, normals, components, strict=True):
        R = contact_frame(n)
        padded = np.zeros((6, 4))
        padded[:3, :3], padded[3:, :3], padded[3:, 3] = R, np.cross(p, R.T).T, n
        blocks.append(padded[:, COLUMNS[int(m)]])
    return np.hstack(blocks)


def random_case(
    rng: np.random.Generator,
    fingers: int,
    *,
    models: tuple[int, ...] = (3,),
    contacts: tuple[int, ...] = (1,),
    joints: tuple[int, ...] = (3,),
    unlimited: float = 0.0,
    frictionless: float = 0.0,
    pinned: float = 0.0,
    clamped: float = 0.0,
    force_weight: float = 0.0,
    facets: int = 0,
) -> KernelCase:
    """A case that a known force obeys strictly, fingers and joints in shuffled order.

    Args:
        fingers: how many.
        models: components of a contact, drawn for each.
        contacts: contacts of a finger, drawn for each.
        joints: joints of a finger, likewise.
        unlimited: chance that a limit is missing.
        frictionless: chance that μ, and that γ, is zero.
        pinned: chance that min_normal = max_normal.
        clamped: chance that a finger has one torque with lower = upper.
        force_weight: ρ.
        facets: facets of inner pyramids that replace the cones; 0 for cones.
    """
    block = np.repeat(np.arange(fingers), rng.choice(contacts, size=fingers)).astype(np.intc)
    N = len(block)
    joint_block = np.repeat(np.arange(fingers), rng.choice(joints, size=fingers)).astype(np.intc)
    n = len(joint_block)
    rng.shuffle(block)
    rng.shuffle(joint_block)
    components = rng.choice(models, size=N).astype(np.intc)
    k = int(components.sum())
    normals = rng.normal(size=(N, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    positions = -rng.uniform(0.02, 0.08) * normals + 0.005 * rng.normal(size=(N, 3))  # m
    owner = np.repeat(block, components)
    J = np.where(owner[:, None] == joint_block, 0.05 * rng.normal(size=(k, n)), 0.0)  # m/rad
    mu = np.where(rng.random(N) < frictionless, 0.0, rng.uniform(0.2, 1.0, size=N))
    gamma = np.where(components == 4, np.where(rng.random(N) < frictionless, 0.0, rng.uniform(0.002, 0.02, size=N)), 0.0)  # m
    lower_normal, most = rng.choice([0.0, 0.1], size=N), np.full(N, rng.choice([20.0, 50.0]))  # N

    fn = np.minimum(lower_normal + rng.exponential(3.0, size=N) + 0.05, 0.95 * most)  # N
    inside = rng.normal(size=(N, 3))
    inside *= (rng.uniform(0, 0.98 if not facets else 0.6, size=N) / np.linalg.norm(inside, axis=1))[:, None]
    padded = np.column_stack([mu * fn * inside[:, 0], mu * fn * inside[:, 1], fn, gamma * fn * inside[:, 2]])
    f = np.concatenate([padded[i, COLUMNS[int(m)]] for i, m in enumerate(components)])
    tau_u = 0.02 * rng.normal(size=n)  # N·m
    tau = tau_u + J.T @ f
    tight = np.abs(tau) * rng.uniform(1.001, 1.5, size=n) + 0.02
    limit = tight if rng.random() < 0.5 else np.maximum(0.7, 1.01 * np.abs(tau))
    lower, upper = np.where(rng.random(n) < unlimited, -np.inf, -limit), np.where(rng.random(n) < unlimited, np.inf, limit)
    if n:
        one = [rng.choice(np.flatnonzero(joint_block == b)) for b in np.unique(joint_block) if rng.random() < clamped]
        lower[one] = upper[one] = tau[one]
    is_pinned = rng.random(N) < pinned
    lower_normal, most = (
        np.where(is_pinned, fn, lower_normal),
        np.where(is_pinned, fn, np.where(rng.random(N) < unlimited, np.inf, most)),
    )
    facet_contact, facet = np.zeros(0, np.intc), np.zeros((0, 4))
    if facets:
        angle = 2 * np.pi * np.arange(facets) / facets
        rough = [i for i in range(N) if components[i] == 3 and mu[i] > 0]
        facet_contact = np.repeat(rough, facets).astype(np.intc)
        reach = np.cos(np.pi / facets) * mu
        rows = [np.column_stack([np.cos(angle), np.sin(angle), np.full(facets, -reach[i]), 0 * angle]) for i in rough]
        facet = np.vstack(rows) if rows else facet
    G = wrench_map(positions, normals, components)
    return KernelCase(
        components=components,
        contact_block=block,
        joint_block=joint_block,
        facet_contact=facet_contact,
        G=G,
        w=G @ f,
        mu=mu,
        gamma=gamma,
        min_normal=lower_normal,
        max_normal=most,
        J=J,
        tau_u=tau_u,
        lower=lower,
        upper=upper,
        weight=rng.uniform(0.5, 2.0, size=n),
        facet=facet,
        cost=np.zeros(k),
        force_weight=np.full(1, force_weight),
    )


def in_units(case: KernelCase, force: float, length: float) -> KernelCase:
    """The same problem in other units: `force` old newtons make a new one, `length` old metres a new one."""
    moment = force * length
    rows = np.repeat([1.0, length], 3)
    components = np.where(case.columns % 4 == 3, length, 1.0)  # a moment component is force × length
    return replace(
        case,
        G=case.G / rows[:, None] * components,
        w=case.w / force / rows,
        gamma=case.gamma / length,
        min_normal=case.min_normal / force,
        max_normal=case.max_normal / force,
        J=case.J / length * components[:, None],
        tau_u=case.tau_u / moment,
        lower=case.lower / moment,
        upper=case.upper / moment,
    )


def case_from_problem(problem: ForceProblem) -> KernelCase:
    """A force problem with exact cones as the kernel takes it; contacts that share a motor make one finger."""
    contacts, actuation, kind = problem.contacts, problem.actuation, problem.objective.type
    assert problem.cone.type == "exact"
    N, n, k = len(contacts), 0 if actuation is None else actuation.J.shape[1], contacts.size
    linked = np.zeros((N + n, N + n))
    if actuation is not None:
        for row, column in zip(*np.nonzero(actuation.J), strict=True):
            linked[contacts.columns[row] // 4, N + column] = 1.0
    _, finger = connected_components(sp.csr_matrix(linked), directed=False)
    cost, none = np.zeros(k), np.zeros(n)
    if kind == "sum_normal":
        cost[contacts.normal_rows] = 1.0
    unit = scale(problem)
    return KernelCase(
        components=np.array([len(model.columns) for model in contacts.models], np.intc),
        contact_block=finger[:N].astype(np.intc),
        joint_block=finger[N:].astype(np.intc),
        facet_contact=np.zeros(0, np.intc),
        G=problem.G_centred,
        w=problem.w_centred,
        mu=contacts.mu,
        gamma=contacts.gamma,
        min_normal=contacts.min_normal,
        max_normal=contacts.max_normal,
        J=np.zeros((k, 0)) if actuation is None else actuation.J,
        tau_u=none if actuation is None else actuation.tau_u,
        lower=none if actuation is None else actuation.lower,
        upper=none if actuation is None else actuation.upper,
        weight=none if actuation is None or kind != "torque" else actuation.weight,
        facet=np.zeros((0, 4)),
        cost=cost,
        force_weight=np.full(1, {"torque": problem.objective.force_weight, "force": 1.0, "sum_normal": 0.0}[kind]),
        units=np.array([unit.force, unit.length, unit.cost, *unit.torque]),
    )


def case_without_hand(
    positions: Any, normals: Any, mu: float, w: Any, *, components: int = 3, limit: float = np.inf
) -> KernelCase:
    """Contacts without a hand, least ½ fᵀf."""
    N = len(positions)
    sizes = np.full(N, components, np.intc)
    k, gamma = components * N, 0.01 if components == 4 else 0.0
    return KernelCase(
        components=sizes,
        contact_block=np.arange(N, dtype=np.intc),
        joint_block=np.zeros(0, np.intc),
        facet_contact=np.zeros(0, np.intc),
        G=wrench_map(np.asarray(positions, float), np.asarray(normals, float), sizes),
        w=np.asarray(w, float),
        mu=np.full(N, mu if components > 1 else 0.0),
        gamma=np.full(N, gamma),
        min_normal=np.zeros(N),
        max_normal=np.full(N, limit),
        J=np.zeros((k, 0)),
        tau_u=np.zeros(0),
        lower=np.zeros(0),
        upper=np.zeros(0),
        weight=np.zeros(0),
        facet=np.zeros((0, 4)),
        cost=np.zeros(k),
        force_weight=np.ones(1),
    )

"""Force problems as plain arrays for the compiled kernel: random, converted from a `ForceProblem`, or in other units."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from graspforce import ForceProblem
from graspforce.core.arrays import Array
from graspforce.force.scale import scale

COLUMNS = {1: (2,), 3: (0, 1, 2), 4: (0, 1, 2, 3)}  # components of each contact model among (f_t1, f_t2, f_n, m_n)


@dataclass(frozen=True)
class KernelCase:
    """One problem. The fields are those of graspforce/problem.h; units are SI."""

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
    units: dict[str, Array] = field(default_factory=dict)  # natural units for certify(); by default all 1

    @property
    def k(self) -> int:
        """Return the number of force components."""
        return int(self.G.shape[1])

    @property
    def sizes(self) -> tuple[int, int]:
        """Return the numbers of contacts and joints."""
        return len(self.mu), len(self.tau_u)

    @property
    def columns(self) -> npt.NDArray[np.intp]:
        """Return the place of each force component among the 4 N padded ones."""
        return np.array([4 * i + c for i, m in enumerate(self.components) for c in COLUMNS[int(m)]], dtype=np.intp)

    @property
    def normals(self) -> npt.NDArray[np.intp]:
        """Return the indices of the normal forces in f."""
        return np.flatnonzero(self.columns % 4 == 2)

    @property
    def exact(self) -> npt.NDArray[np.bool_]:
        """Return which contacts have the exact cone."""
        return ~np.isin(np.arange(len(self.mu)), self.facet_contact)

    @property
    def length(self) -> float:
        """Return the root mean square distance of the contacts from the origin, m."""
        forces = self.columns % 4 < 3
        return float(np.sqrt(1.5 * (self.G[3:, forces] ** 2).sum() / (self.G[:3, forces] ** 2).sum())) or 1.0

    @property
    def force(self) -> float:
        """Return the force unit to which violations are relative, N."""
        unit = max(np.linalg.norm(self.w[:3]), np.linalg.norm(self.w[3:]) / self.length, self.min_normal.max())
        return float(unit) if unit > 0 else 1.0

    def pad(self, f: Array) -> Array:
        """Return f as (N, 4), with zeros for the components that a contact model lacks."""
        padded = np.zeros(4 * len(self.mu))
        padded[self.columns] = f
        return padded.reshape(-1, 4)


@dataclass(frozen=True)
class CaseOptions:
    """Options of a random case. Tuples are drawn from, separately for each contact or finger.

    Args:
        models: force components of a contact.
        contacts: contacts of a finger.
        joints: joints of a finger.
        unlimited: probability that a limit is missing.
        frictionless: probability that μ is zero, and that γ is zero.
        pinned: probability that min_normal equals max_normal.
        clamped: probability that a finger has one torque with equal limits.
        force_weight: ρ.
        facets: facets of inner pyramids that replace the cones; 0 for cones.
    """

    models: tuple[int, ...] = (3,)
    contacts: tuple[int, ...] = (1,)
    joints: tuple[int, ...] = (3,)
    unlimited: float = 0.0
    frictionless: float = 0.0
    pinned: float = 0.0
    clamped: float = 0.0
    force_weight: float = 0.0
    facets: int = 0


def contact_frame(normal: Array) -> Array:
    """Return the frame with the columns t₁, t₂ = n × t₁ and n."""
    t1 = np.cross(normal, [0.0, 1.0, 0.0] if abs(normal[0]) >= 0.9 else [1.0, 0.0, 0.0])
    t1 /= np.linalg.norm(t1)
    return np.column_stack([t1, np.cross(normal, t1), normal])


def wrench_map(positions: Array, normals: Array, components: npt.NDArray[np.intc]) -> Array:
    """Return the grasp matrix G (6, k)."""
    blocks = []
    for p, n, m in zip(positions, normals, components, strict=True):
        R = contact_frame(n)
        padded = np.zeros((6, 4))
        padded[:3, :3], padded[3:, :3], padded[3:, 3] = R, np.cross(p, R.T).T, n
        blocks.append(padded[:, COLUMNS[int(m)]])
    return np.hstack(blocks)


def random_case(rng: np.random.Generator, fingers: int, options: CaseOptions | None = None) -> KernelCase:
    """Return a case that known forces satisfy strictly, with contacts and joints in random order."""
    options = options or CaseOptions()
    block = np.repeat(np.arange(fingers), rng.choice(options.contacts, size=fingers)).astype(np.intc)
    joint_block = np.repeat(np.arange(fingers), rng.choice(options.joints, size=fingers)).astype(np.intc)
    N, n = len(block), len(joint_block)
    rng.shuffle(block)
    rng.shuffle(joint_block)
    components = rng.choice(options.models, size=N).astype(np.intc)
    k = int(components.sum())
    normals = rng.normal(size=(N, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    positions = -rng.uniform(0.02, 0.08) * normals + 0.005 * rng.normal(size=(N, 3))  # m
    owner = np.repeat(block, components)
    J = np.where(owner[:, None] == joint_block, 0.05 * rng.normal(size=(k, n)), 0.0)  # m/rad
    mu = np.where(rng.random(N) < options.frictionless, 0.0, rng.uniform(0.2, 1.0, size=N))
    gamma = np.where(rng.random(N) < options.frictionless, 0.0, rng.uniform(0.002, 0.02, size=N))  # m
    gamma[components < 4] = 0.0
    min_normal, max_normal = rng.choice([0.0, 0.1], size=N), np.full(N, rng.choice([20.0, 50.0]))  # N

    padded = _strictly_inside(rng, mu, gamma, (min_normal, max_normal), options.facets)
    f = np.concatenate([padded[i, COLUMNS[int(m)]] for i, m in enumerate(components)])
    tau_u = 0.02 * rng.normal(size=n)  # N·m
    lower, upper = _torque_limits(rng, tau_u + J.T @ f, joint_block, options)
    is_pinned = rng.random(N) < options.pinned
    max_normal = np.where(is_pinned, padded[:, 2], np.where(rng.random(N) < options.unlimited, np.inf, max_normal))
    facet, facet_contact = _inner_facets(components, mu, options.facets)
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
        min_normal=np.where(is_pinned, padded[:, 2], min_normal),
        max_normal=max_normal,
        J=J,
        tau_u=tau_u,
        lower=lower,
        upper=upper,
        weight=rng.uniform(0.5, 2.0, size=n),
        facet=facet,
        cost=np.zeros(k),
        force_weight=np.full(1, options.force_weight),
    )


def _strictly_inside(rng: np.random.Generator, mu: Array, gamma: Array, limits: tuple[Array, Array], facets: int) -> Array:
    """Return padded forces (N, 4) strictly inside cones or inner pyramids and inside the normal force limits, N and N·m."""
    N, (min_normal, max_normal) = len(mu), limits
    fn = np.minimum(min_normal + rng.exponential(3.0, size=N) + 0.05, 0.95 * max_normal)  # N
    inside = rng.normal(size=(N, 3))
    inside *= (rng.uniform(0, 0.6 if facets else 0.98, size=N) / np.linalg.norm(inside, axis=1))[:, None]
    return np.column_stack([mu * fn * inside[:, 0], mu * fn * inside[:, 1], fn, gamma * fn * inside[:, 2]])


def _torque_limits(
    rng: np.random.Generator, tau: Array, joint_block: npt.NDArray[np.intc], options: CaseOptions
) -> tuple[Array, Array]:
    """Return torque limits, N·m, that the torques tau satisfy: tight, wide, missing, or equal."""
    n = len(tau)
    tight = np.abs(tau) * rng.uniform(1.001, 1.5, size=n) + 0.02
    limit = tight if rng.random() < 0.5 else np.maximum(0.7, 1.01 * np.abs(tau))
    lower = np.where(rng.random(n) < options.unlimited, -np.inf, -limit)
    upper = np.where(rng.random(n) < options.unlimited, np.inf, limit)
    if n:
        blocks = np.unique(joint_block)
        clamped = [rng.choice(np.flatnonzero(joint_block == b)) for b in blocks if rng.random() < options.clamped]
        lower[clamped] = upper[clamped] = tau[clamped]
    return lower, upper


def _inner_facets(components: npt.NDArray[np.intc], mu: Array, facets: int) -> tuple[Array, npt.NDArray[np.intc]]:
    """Return the facets (m, 4) of the inner pyramids of all point contacts with friction, and their contacts (m)."""
    rough = [i for i, count in enumerate(components) if count == 3 and mu[i] > 0]
    if not facets or not rough:
        return np.zeros((0, 4)), np.zeros(0, np.intc)
    angle = 2 * np.pi * np.arange(facets) / facets
    reduced = np.cos(np.pi / facets) * mu
    rows = [np.column_stack([np.cos(angle), np.sin(angle), np.full(facets, -reduced[i]), 0 * angle]) for i in rough]
    return np.vstack(rows), np.repeat(rough, facets).astype(np.intc)


def in_units(case: KernelCase, force: float, length: float) -> KernelCase:
    """Return the same case with other units of force (in N) and length (in m)."""
    moment = force * length
    rows = np.repeat([1.0, length], 3)
    components = np.where(case.columns % 4 == 3, length, 1.0)  # a moment component has the unit force × length
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
    """Return a force problem with exact cones as a case. Contacts that share a joint belong to one finger."""
    contacts, actuation, kind = problem.contacts, problem.actuation, problem.objective.type
    assert problem.cone.type == "exact"
    N, n, k = len(contacts), 0 if actuation is None else actuation.J.shape[1], contacts.size
    linked = np.zeros((N + n, N + n))
    if actuation is not None:
        for row, column in zip(*np.nonzero(actuation.J), strict=True):
            linked[contacts.columns[row] // 4, N + column] = 1.0
    _, finger = connected_components(sp.csr_matrix(linked), directed=False)
    cost, zeros = np.zeros(k), np.zeros(n)
    if kind == "sum_normal":
        cost[contacts.normal_rows] = 1.0
    unit = scale(problem)
    units = {"force_unit": unit.force, "length_unit": unit.length, "cost_unit": unit.cost, "torque_unit": unit.torque}
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
        tau_u=zeros if actuation is None else actuation.tau_u,
        lower=zeros if actuation is None else actuation.lower,
        upper=zeros if actuation is None else actuation.upper,
        weight=zeros if actuation is None or kind != "torque" else actuation.weight,
        facet=np.zeros((0, 4)),
        cost=cost,
        force_weight=np.full(1, {"torque": problem.objective.force_weight, "force": 1.0, "sum_normal": 0.0}[kind]),
        units={name: np.atleast_1d(value) for name, value in units.items()},
    )


def case_without_hand(
    positions: npt.ArrayLike, normals: npt.ArrayLike, mu: float, w: npt.ArrayLike, limit: float = np.inf
) -> KernelCase:
    """Return point contacts without a hand, with the objective ½ ‖f‖². `limit` is max_normal, N."""
    p, normal = np.asarray(positions, dtype=np.float64), np.asarray(normals, dtype=np.float64)
    N = len(p)
    components = np.full(N, 3, np.intc)
    return KernelCase(
        components=components,
        contact_block=np.arange(N, dtype=np.intc),
        joint_block=np.zeros(0, np.intc),
        facet_contact=np.zeros(0, np.intc),
        G=wrench_map(p, normal, components),
        w=np.asarray(w, dtype=np.float64),
        mu=np.full(N, mu),
        gamma=np.zeros(N),
        min_normal=np.zeros(N),
        max_normal=np.full(N, limit),
        J=np.zeros((3 * N, 0)),
        tau_u=np.zeros(0),
        lower=np.zeros(0),
        upper=np.zeros(0),
        weight=np.zeros(0),
        facet=np.zeros((0, 4)),
        cost=np.zeros(3 * N),
        force_weight=np.ones(1),
    )

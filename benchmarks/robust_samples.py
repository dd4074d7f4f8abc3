"""Random members of a set of errors, and the true contact forces of a squeeze in them, by plain linear algebra."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graspforce import ForceProblem
from graspforce.contact import friction
from graspforce.core.arrays import Array

_CHUNK = 20_000


class Samples(NamedTuple):
    """Outcome of random members.

    Attributes:
        margin: (N,) least true slip margin of each contact, N; inf without friction.
        exceeded: largest amount by which a normal force or torque exceeds its limit, N and N·m.
        count: number of members.
    """

    margin: Array
    exceeded: float
    count: int


def sample(problem: ForceProblem, f: Array, count: int, rng: np.random.Generator) -> Samples:
    """Return the outcome of random members of the set, half of them at its corners.

    Args:
        problem: a problem with an uncertainty.
        f: (k,) the squeeze, N and N·m.
        count: number of members.
        rng: random numbers.
    """
    margin, exceeded = np.full(len(problem.contacts), np.inf), -np.inf
    for first in range(0, count, _CHUNK):
        size = min(_CHUNK, count - first)
        forces, normals, mu, gamma = _members(problem, f, size, rng)
        margin = np.minimum(margin, _margins(problem, forces, normals, mu, gamma).min(axis=0))
        exceeded = max(exceeded, _exceeded(problem, forces, normals))
    return Samples(margin, exceeded, count)


def _members(problem: ForceProblem, f: Array, size: int, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return (M, k) forces in the modelled frames, (M, N, 3) true normals, and (M, N) true friction and lengths."""
    u, contacts = problem.uncertainty, problem.contacts
    assert u is not None  # the caller's duty
    count = len(contacts)
    share = 1.0 + u.friction_error * _corners(rng, (size, count))
    normals = _tilted(contacts.R_OC[:, :, 2], np.broadcast_to(u.normal_error, count), rng, size)
    displaced = _in_balls(rng, size, np.broadcast_to(u.position_error, count))
    w = _wrenches(problem, size, rng)
    fingers = np.tile(f, (size, 1))
    if problem.actuation is not None and u.torque_error.any():
        J, tau = problem.actuation.J, problem.torques(f)
        unit = problem.component_units
        errors = u.torque_error * tau * _corners(rng, (size, len(tau)))
        fingers = fingers + errors @ np.linalg.pinv((J * unit[:, None]).T, 1e-9).T * unit
    c, L = contacts.centroid, problem.length
    w[:, 3:] -= np.cross(c, w[:, :3])
    rows, columns = np.repeat([1.0, L], 3), problem.component_units
    kept = contacts.transmissible
    if not displaced.any() and (np.array_equal(normals[0], contacts.R_OC[:, :, 2]) or problem.size == 3 * count):
        G = (problem.G_centred * columns / rows[:, None])[:, kept]
        change = (w / rows - (fingers / columns)[:, kept] @ G.T) @ np.linalg.pinv(G, 1e-9).T
    else:
        G = (_true_matrices(problem, displaced, normals) * columns / rows[:, None])[:, :, kept]
        missing = w / rows - np.einsum("mij,mj->mi", G, (fingers / columns)[:, kept])
        change = np.einsum("mji,mi->mj", np.linalg.pinv(G, 1e-9), missing)
    forces = fingers.copy()
    forces[:, kept] += change * columns[kept]
    return forces, normals, contacts.mu * share, contacts.gamma * share


def _wrenches(problem: ForceProblem, size: int, rng: np.random.Generator) -> Array:
    """Return (M, 6) true wrenches about O."""
    u = problem.uncertainty
    assert u is not None  # the caller's duty
    w = problem.w * (1.0 + u.mass_error * _corners(rng, (size, 1)))
    w[:, 3:] += np.cross(u.centre_of_mass_error * _corners(rng, (size, 3)), w[:, :3])
    if len(u.wrenches):
        weights = rng.dirichlet(np.full(len(u.wrenches) + 1, 0.1), size)
        w += weights[:, 1:] @ u.wrenches
    if u.wrench_ellipsoid.size:
        w += _in_balls(rng, size, np.ones(1), u.wrench_ellipsoid.shape[1])[:, 0] @ u.wrench_ellipsoid.T
    return w


def _true_matrices(problem: ForceProblem, displaced: Array, normals: Array) -> Array:
    """Return (M, 6, k) grasp matrices about the modelled centroid, of displaced contacts with tilted normals."""
    contacts = problem.contacts
    arms = contacts.p_OC - contacts.centroid + displaced  # (M, N, 3)
    G = np.tile(problem.G_centred, (len(arms), 1, 1))
    for row, column in enumerate(contacts.columns.tolist()):
        contact, component = divmod(column, 4)
        if component == friction.M_N:
            G[:, 3:, row] = normals[:, contact]
        else:
            axis = contacts.R_OC[contact, :, component]
            G[:, 3:, row] = np.cross(arms[:, contact], axis)
    return G


def _margins(problem: ForceProblem, forces: Array, normals: Array, mu: Array, gamma: Array) -> Array:
    """Return (M, N) true slip margins, N; inf without friction."""
    contacts = problem.contacts
    padded = np.zeros((len(forces), 4 * len(contacts)))
    padded[:, contacts.columns] = forces
    each = padded.reshape(len(forces), -1, 4)
    F = np.einsum("nij,mnj->mni", contacts.R_OC, each[:, :, :3])  # in O
    along = (F * normals).sum(axis=2)
    across = np.linalg.norm(F - along[:, :, None] * normals, axis=2)
    lever = np.divide(mu, gamma, out=np.zeros_like(mu), where=gamma > 0.0)
    margin = mu * along - np.hypot(across, lever * each[:, :, 3])
    return np.where(contacts.mu > 0.0, margin, np.inf)


def _exceeded(problem: ForceProblem, forces: Array, normals: Array) -> float:
    """Return the largest amount beyond a limit of normal forces or torques."""
    contacts = problem.contacts
    padded = np.zeros((len(forces), 4 * len(contacts)))
    padded[:, contacts.columns] = forces
    F = np.einsum("nij,mnj->mni", contacts.R_OC, padded.reshape(len(forces), -1, 4)[:, :, :3])
    along = (F * normals).sum(axis=2)
    worst = max(float((contacts.min_normal - along).max()), float((along - contacts.max_normal).max()))
    if problem.actuation is not None:
        tau = problem.actuation.tau_u + forces @ problem.actuation.J
        worst = max(worst, float((problem.actuation.lower - tau).max()), float((tau - problem.actuation.upper).max()))
    return worst


def _corners(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Return numbers in [−1, 1], half of the rows at its ends."""
    values = rng.uniform(-1.0, 1.0, shape)
    ends = rng.random(shape[0]) < 0.5
    values[ends] = np.sign(values[ends])
    return values


def _in_balls(rng: np.random.Generator, size: int, radii: Array, dimension: int = 3) -> Array:
    """Return (M, N, d) points in balls, half of the rows on their surfaces."""
    points = rng.normal(size=(size, len(radii), dimension))
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    length = rng.random((size, len(radii), 1)) ** (1.0 / dimension)
    length[rng.random(size) < 0.5] = 1.0
    return points * length * radii[:, None]


def _tilted(normals: Array, angles: Array, rng: np.random.Generator, size: int) -> Array:
    """Return (M, N, 3) normals within angles of the modelled ones."""
    if not angles.any():
        return np.broadcast_to(normals, (size, *normals.shape))
    across = np.cross(rng.normal(size=(size, *normals.shape)), normals)
    across /= np.linalg.norm(across, axis=2, keepdims=True)
    angle = angles * np.abs(_corners(rng, (size, len(angles))))
    return np.cos(angle)[..., None] * normals + np.sin(angle)[..., None] * across

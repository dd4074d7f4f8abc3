"""Proofs that a feasible load leaves no forces strictly inside all friction cones.

Two loaded contacts whose forces f_i are on the surface of their cones may be the only ones that can supply the load. Then
some y satisfies

    −G_iᵀ y = β_i (−μ t_i, μ²),  β_i ≥ 0,  for the loaded contacts, where f_i has the tangential direction t_i,
    −G_iᵀ y in the interior of the dual cone for at least one other contact, and in the dual cone for all.

The first line is orthogonal to f_i, so that yᵀw = 0, while yᵀ G f ≤ 0 for all forces in the cones. Forces that supply w
therefore make each term zero: those of the other contacts vanish, and those of the loaded ones stay on the surface.
"""

from __future__ import annotations

import numpy as np

from graspforce.contact.contact import ContactModel
from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem

_LOADED = 1e-6  # of the largest normal force
_ON_SURFACE = 1e-6  # of the normal force
_NULL = 1e-12  # singular values of the equations that count as zero, relative
_DIRECTIONS = 3600  # tried in the plane of solutions
_ROUNDING = 1e-12  # of β and of the depth, relative
_INSIDE = 1e-3  # depth of −G_iᵀ y in the dual cone that counts as inside, relative


def find_proof(problem: ForceProblem, f: Array) -> Array | None:
    """Return (6,) y about O's origin; None if two loaded contacts on the surface do not prove it.

    Args:
        problem: a feasible problem.
        f: (k,) its forces.
    """
    contacts = problem.contacts
    exact = problem.cone.type == "exact" and all(model is ContactModel.POINT for model in contacts.models)
    if not exact or (contacts.mu <= 0.0).any():
        return None
    forces = f.reshape(-1, 3)
    loaded = np.flatnonzero(forces[:, 2] > _LOADED * forces[:, 2].max())
    tangential = np.linalg.norm(forces[:, :2], axis=1)
    if len(loaded) != 2 or (tangential < (1.0 - _ON_SURFACE) * contacts.mu * forces[:, 2])[loaded].any():
        return None
    lengths = np.array([1.0, 1.0, 1.0, *[problem.length] * 3])
    G, w = (problem.G_centred / lengths[:, None]).T.reshape(-1, 3, 6), problem.w_centred / lengths
    directions = _refined_directions(G[loaded], contacts.mu[loaded], w, forces[loaded])
    equations = np.zeros((6, 8))
    for column, i in enumerate(loaded):
        rows = slice(3 * column, 3 * column + 3)
        equations[rows, :6] = G[i]
        equations[rows, 6 + column] = [*(-contacts.mu[i] * directions[column]), contacts.mu[i] ** 2]
    _, size, right = np.linalg.svd(equations)
    basis = right[len(size) - int((size <= _NULL * size[0]).sum()) :]
    if len(basis) != 2:
        return None
    y = _deepest(G, contacts.mu, basis)
    if y is None:
        return None
    force, moment = y[:3], y[3:] / problem.length
    return np.concatenate([force + np.cross(contacts.centroid, moment), moment])


def _refined_directions(G: Array, mu: Array, w: Array, forces: Array) -> Array:
    """Return the tangential directions of forces on the surface of their cones that supply w, to rounding (Gauss–Newton)."""
    x = np.column_stack([forces[:, 2], np.arctan2(forces[:, 1], forces[:, 0])])  # normal force and angle of each contact
    for _ in range(6):
        along = np.column_stack([np.cos(x[:, 1]), np.sin(x[:, 1])])
        ray = np.column_stack([mu[:, None] * along, np.ones(len(mu))])
        turned = np.column_stack([-mu * along[:, 1], mu * along[:, 0], np.zeros(len(mu))]) * x[:, :1]
        columns = np.stack([ray, turned], axis=1)  # contact, unknown, component
        A = np.einsum("icw,iuc->wiu", G, columns).reshape(6, -1)
        residual = np.einsum("icw,ic->w", G, ray * x[:, :1]) - w
        x -= np.linalg.lstsq(A, residual, rcond=None)[0].reshape(x.shape)
    return np.column_stack([np.cos(x[:, 1]), np.sin(x[:, 1])])


def dual_depths(G: Array, mu: Array, y: Array) -> Array:
    """Return (N,) depths of −G_iᵀ y in the dual cones of point contacts; negative outside.

    Args:
        G: (N, 3, 6) transposed grasp matrices.
        mu: (N,) friction coefficients.
        y: (6,) a vector.
    """
    z = -(G @ y)
    return np.asarray(z[:, 2] - mu * np.linalg.norm(z[:, :2], axis=1))


def _deepest(G: Array, mu: Array, basis: Array) -> Array | None:
    """Return the y of a plane of solutions (y, β) with β ≥ 0 whose deepest −G_iᵀ y is deepest; None if none is inside."""
    best, found = _INSIDE, None
    without_prices = np.linalg.svd(basis[:, 6:].T)[2][-1]  # β = 0: no moment about the line through the two contacts
    angles = np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False)
    for weights in (without_prices, -without_prices, *np.column_stack([np.cos(angles), np.sin(angles)])):
        solution = weights @ basis
        y = solution[:6] / np.linalg.norm(solution[:6])
        depth = dual_depths(G, mu, y)
        if solution[6:].min() > -_ROUNDING and depth.min() > -_ROUNDING and depth.max() > best:
            best, found = float(depth.max()), y
    return found

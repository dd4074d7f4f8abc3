"""Least friction and extreme wrenches of uncertain data.

With normals up to α off and friction of at least μ (1 − e), the cones of tan(atan(μ (1 − e)) − α)
about the modelled normals are inside all true cones. For point contacts this is exact. With torsion, γ shrinks by the same
factor times cos α, since √(a² + c²) + b ≤ (1 + b/a) √(a² + c²).
"""

from __future__ import annotations

import itertools

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.force.uncertainty import Uncertainty
from graspforce.geometry.vectors import skew


def least_friction(contacts: ContactSet, uncertainty: Uncertainty) -> ContactSet:
    """Return the contacts with the friction whose cones are inside all true cones.

    Args:
        contacts: the contacts with the modelled friction.
        uncertainty: with friction_error and normal_error.
    """
    share, tilt = 1.0 - uncertainty.friction_error, uncertainty.normal_error
    mu, gamma = contacts.mu * share, contacts.gamma * share
    tilted, gamma = tilted_friction(mu, gamma, tilt)
    most = contacts.max_normal / (np.cos(tilt) + tilted * np.sin(tilt))  # a tilted normal sees more of the force
    least = np.divide(
        contacts.min_normal, np.cos(tilt) - tilted * np.sin(tilt), out=np.zeros(len(mu)), where=contacts.min_normal > 0.0
    )
    frozen = [arrays.freeze(np.broadcast_to(row, len(contacts))) for row in (tilted, gamma, least, most)]
    return ContactSet(contacts.p_OC, contacts.R_OC, contacts.models, *frozen)


def tilted_friction(mu: Array, gamma: Array, angle: Array) -> tuple[Array, Array]:
    """Return friction and torsional lengths whose cones are inside all cones with normals up to an angle off.

    Args:
        mu: (N,) friction coefficients.
        gamma: (N,) torsional friction lengths, m.
        angle: (N,) or (1,) α, rad, ≥ 0.

    Returns:
        μ' = tan(atan μ − α), or 0, and γ' = γ cos α μ'/μ.
    """
    if not angle.any():
        return mu, gamma
    tilted = np.tan(np.maximum(np.arctan(mu) - angle, 0.0))
    shrunk = gamma * np.cos(angle) * np.divide(tilted, mu, out=np.zeros(len(mu)), where=mu > 0.0)
    return tilted, np.where(angle > 0.0, shrunk, gamma)


def wrench_maps(uncertainty: Uncertainty) -> tuple[Array, Array]:
    """Return (V, 6, 6) T and (V, 6) c: T w + c are vertices of the errors of a wrench w about O but for the ellipsoid.

    Args:
        uncertainty: the errors.
    """
    e, box = uncertainty.mass_error, uncertainty.centre_of_mass_error
    axes = [(-half, half) if half else (0.0,) for half in box.tolist()]
    maps = []
    for share, moved in itertools.product((1.0 - e, 1.0 + e) if e else (1.0,), itertools.product(*axes)):
        moving = share * np.eye(6)
        moving[3:, :3] = share * skew(np.array(moved))
        maps.append(moving - np.eye(6))
    further = np.vstack([np.zeros((1, 6)), uncertainty.wrenches])
    return np.repeat(maps, len(further), axis=0), np.tile(further, (len(maps), 1))


def wrench_vertices(w: Array, uncertainty: Uncertainty) -> Array:
    """Return (V, 6) different vertices of the errors of the wrench about O but for the ellipsoid; zero is in their hull.

    Args:
        w: (6,) the modelled wrench about O, N and N·m.
        uncertainty: the errors.
    """
    maps, further = wrench_maps(uncertainty)
    return np.unique(maps @ w + further, axis=0)

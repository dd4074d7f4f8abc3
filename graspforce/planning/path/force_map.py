"""Contact forces along a path as an affine function of b = ṡ², a = s̈ and the null space of the grasp matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact.matrices import RANK_TOLERANCE
from graspforce.core.arrays import Array
from graspforce.planning.loads import wrench_scale
from graspforce.planning.path.dynamics import PathDynamics

_ZERO_TOLERANCE = 1e-9  # relative to the largest coefficient: smaller ones are rounding errors


@dataclass(frozen=True, eq=False, slots=True)
class ForceMap:
    """Contact forces f = f_0 + f_b b + f_a a + N λ, which supply the required wrench as far as the contacts can.

    Args:
        f_0: (K, k) forces at rest, N and N·m.
        f_b: (K, k) forces per unit of b.
        f_a: (K, k) forces per unit of a.
        null: N (K, k, d), a basis of the null space of G; a column is zero where G has a higher rank than elsewhere.
        unreachable: coefficients (K, r) of 1, b and a, whose sum must be zero, in wrench directions that the contacts cannot
            supply; None if they can supply every required wrench.
    """

    f_0: Array
    f_b: Array
    f_a: Array
    null: Array
    unreachable: tuple[Array, Array, Array] | None

    @classmethod
    def from_dynamics(cls, dynamics: PathDynamics) -> ForceMap:
        """Return the force map of equations of motion.

        Args:
            dynamics: equations of motion at K knots.
        """
        K, k = dynamics.J.shape[:2]
        contacts = dynamics.contacts
        if contacts is None:
            none = np.zeros((K, 0))
            return cls(none, none, none, np.zeros((K, 0, 0)), None)
        scale = wrench_scale(contacts)
        columns = np.flatnonzero(contacts.transmissible)
        u, sigma, v = np.linalg.svd(dynamics.G[:, :, columns] / scale[:, None])
        in_range = np.zeros((K, max(6, len(columns))), dtype=bool)  # singular directions in the range of G at each knot
        in_range[:, : sigma.shape[1]] = sigma > RANK_TOLERANCE * sigma[:, :1]
        most, least = int(in_range.sum(axis=1).max()), int(in_range.sum(axis=1).min())  # ranks of G
        inverse_sigma = np.where(in_range[:, :most], 1.0 / np.where(in_range[:, :most], sigma[:, :most], 1.0), 0.0)
        inverse, null = np.zeros((K, k, 6)), np.zeros((K, k, len(columns) - least))
        inverse[:, columns] = (v[:, :most].swapaxes(1, 2) * inverse_sigma[:, None]) @ u[:, :, :most].swapaxes(1, 2) / scale
        null[:, columns] = np.where(in_range[:, least : len(columns), None], 0.0, v[:, least:]).swapaxes(1, 2)
        wrenches = (dynamics.w_0, dynamics.w_b, dynamics.w_a)
        outside = np.where(in_range[:, None, least:6], 0.0, u[:, :, least:])
        f_0, f_b, f_a = ((inverse @ w[:, :, None])[:, :, 0] for w in wrenches)
        return cls(f_0, f_b, f_a, null, _unreachable_parts([w / scale for w in wrenches], outside))

    def forces(self, b: Array, a: Array, lam: Array) -> Array:
        """Return the contact forces (K, k), N and N·m.

        Args:
            b: (K,) ṡ², 1/s².
            a: (K,) s̈, 1/s².
            lam: (K, d) coefficients λ of the null space, N.
        """
        internal = (self.null @ lam[:, :, None])[:, :, 0]
        return np.asarray(self.f_0 + self.f_b * b[:, None] + self.f_a * a[:, None] + internal)


def unreachable_wrench(dynamics: PathDynamics) -> Array | None:
    """Return the wrench that accelerating at the start or braking at the goal needs, and no contact forces supply.

    Args:
        dynamics: equations of motion at K knots.

    Returns:
        (6,) of norm one in N and N·m, or None if the contacts can supply what is needed.
    """
    if dynamics.contacts is None or ForceMap.from_dynamics(dynamics).unreachable is None:
        return None
    scale = wrench_scale(dynamics.contacts)
    G = dynamics.G[[0, -1]][:, :, dynamics.contacts.transmissible] / scale[:, None]
    needed = dynamics.w_a[[0, -1]] / scale
    supplied = G @ np.linalg.pinv(G, rcond=RANK_TOLERANCE) @ needed[:, :, None]
    missing = needed - supplied[:, :, 0]
    sizes = np.linalg.norm(missing, axis=1)
    if sizes.max() <= _ZERO_TOLERANCE * np.linalg.norm(needed, axis=1).max():
        return None
    direction = missing[int(sizes.argmax())] * scale
    return np.asarray(direction / np.linalg.norm(direction))


def _unreachable_parts(wrenches: list[Array], outside: Array) -> tuple[Array, Array, Array] | None:
    """Return the parts (K, r) of scaled wrenches along directions (K, 6, r); None if all are rounding errors."""
    part_0, part_b, part_a = ((w[:, None] @ outside)[:, 0] for w in wrenches)  # N
    for part, w in zip((part_0, part_b, part_a), wrenches, strict=True):
        if float(np.abs(part).max(initial=0.0)) > _ZERO_TOLERANCE * float(np.abs(w).max()):
            return part_0, part_b, part_a
    return None

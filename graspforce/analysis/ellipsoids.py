"""Singular values of the grasp matrix, and the force and manipulability ellipsoids of fingers and object.

Sources: Yoshikawa (1985); Li and Sastry (1988); Prattichizzo and Trinkle (2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import RANK_TOLERANCE, characteristic_length, normalised_grasp_matrix
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord
from graspforce.force.problem import ForceProblem


@dataclass(frozen=True, eq=False, slots=True)
class Ellipsoid:
    """An ellipsoid about zero: the image of a unit ball.

    Args:
        axes: (d, d) directions of the semi-axes as columns, orthonormal.
        sizes: (d,) lengths of the semi-axes, descending.
    """

    axes: Array
    sizes: Array

    @property
    def volume_measure(self) -> float:
        """The product of the semi-axes: Yoshikawa's manipulability for velocities."""
        return float(np.prod(self.sizes))

    @property
    def isotropy(self) -> float:
        """The smallest semi-axis over the largest, 0 to 1."""
        return float(self.sizes[-1] / self.sizes[0]) if self.sizes[0] > 0.0 else 0.0

    def to_dict(self) -> JsonRecord:
        """Return the record."""
        return {"axes": self.axes.tolist(), "sizes": self.sizes.tolist()}


@dataclass(frozen=True, eq=False, slots=True)
class FingerEllipsoids:
    """Ellipsoids of the hand at one contact, with axes in O.

    Args:
        velocity: contact velocities for joint rates of norm 1 rad/s, m/s.
        force: contact forces that need joint torques of norm 1 N·m, N; a direction without velocity has no entry.
    """

    velocity: Ellipsoid
    force: Ellipsoid

    def to_dict(self) -> JsonRecord:
        """Return the record."""
        return {"velocity": self.velocity.to_dict(), "force": self.force.to_dict()}


def wrench_ellipsoid(contacts: ContactSet) -> Ellipsoid:
    """Return the wrenches of contact forces of norm 1 N, without friction limits: the singular values of the grasp matrix.

    Args:
        contacts: the contacts. Moments are about their centroid and divided by the characteristic length L.

    Returns:
        The ellipsoid, N; semi-axes of 0 for wrenches that the contacts do not transmit.
    """
    G = normalised_grasp_matrix(contacts)[:, contacts.columns]
    axes, sizes = np.linalg.svd(G, full_matrices=True)[:2]
    return Ellipsoid(arrays.freeze(axes), arrays.freeze(_without_rounding(np.pad(sizes, (0, 6 - len(sizes))))))


def finger_ellipsoids(problem: ForceProblem) -> tuple[FingerEllipsoids, ...]:
    """Return the ellipsoids of the hand at each contact; none without a hand.

    Args:
        problem: a force problem with an actuation; its J has contact velocities in the contact frames.
    """
    if problem.actuation is None:
        return ()
    result = []
    for rows, R, model in zip(_rows(problem.contacts), problem.contacts.R_OC, problem.contacts.models, strict=True):
        J = problem.actuation.J[rows]
        columns = [c for c in model.columns if c != friction.M_N]
        U, sizes = np.linalg.svd(R[:, columns] @ J[: len(columns)])[:2]
        sizes = _without_rounding(np.pad(sizes, (0, 3 - len(sizes))))
        moved = sizes > 0.0
        force = Ellipsoid(arrays.freeze(U[:, moved][:, ::-1]), arrays.freeze(1.0 / sizes[moved][::-1]))
        result.append(FingerEllipsoids(Ellipsoid(arrays.freeze(U), arrays.freeze(sizes)), force))
    return tuple(result)


def object_ellipsoid(problem: ForceProblem) -> Ellipsoid | None:
    """Return the twists of the object for joint rates of norm 1 rad/s, with contacts that do not slide; None without a hand.

    The twist V solves Gᵀ V = J q̇ in the least-squares sense: V = (Gᵀ)⁺ J q̇, with angular velocities times L.

    Args:
        problem: a force problem with an actuation.

    Returns:
        The ellipsoid, m/s.
    """
    if problem.actuation is None:
        return None
    contacts = problem.contacts
    G = normalised_grasp_matrix(contacts)[:, contacts.columns]
    J = (
        problem.actuation.J
        / np.where(contacts.columns % 4 == friction.M_N, 1.0 / characteristic_length(contacts), 1.0)[:, None]
    )
    axes, sizes = np.linalg.svd(np.linalg.pinv(G.T, rcond=RANK_TOLERANCE) @ J)[:2]
    return Ellipsoid(arrays.freeze(axes), arrays.freeze(_without_rounding(np.pad(sizes, (0, 6 - len(sizes))))))


def _rows(contacts: ContactSet) -> list[Array]:
    """Return the rows of each contact in stacked vectors."""
    ends = np.cumsum([len(model.columns) for model in contacts.models])
    return np.split(np.arange(contacts.size), ends[:-1])


def _without_rounding(sizes: Array) -> Array:
    """Return the sizes with those below `RANK_TOLERANCE` of the largest set to 0."""
    return np.where(sizes > RANK_TOLERANCE * sizes.max(initial=0.0), sizes, 0.0)

"""Places of the fingertips from measured contact points.

A ball of radius r at the tip touches at p, where the object's inward normal is n. Its centre is at p − r n. So a tip with the
displacement δ in its own frame F measures

    δ = R_HFᵀ (p − r n(p) − p_HF(q)).

The normal is linear in p about the contact of the grasp. δ is constant: each measurement adds its information C⁻¹ to that of
the prior, a displacement of known size in any direction. C follows from the noise of p. A wrong pose of the object turns n, and
adds an error that averages do not reduce: r times the angle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.estimation.estimate import GraspEstimate
from graspforce.estimation.measurement import Measurement
from graspforce.grasp.grasp import Grasp

_STEP = 1e-5  # m, of the differences of normals


class TipOffsetMemory(NamedTuple):
    """Information about the displacements.

    Attributes:
        information: (N, 3, 3) inverse covariances, 1/m².
        weighted: (N, 3) information times the displacements, 1/m.
    """

    information: Array
    weighted: Array


@dataclass(frozen=True, eq=False, slots=True)
class TipOffsets:
    """Displacements of N fingertips from their places in the hand's description.

    Attributes:
        fingers: names of the fingers.
        offsets: (N, 3) displacements in the tip frames, m.
        covariance: (N, 3, 3) covariances, m².
    """

    fingers: tuple[str, ...]
    offsets: Array
    covariance: Array

    @property
    def by_finger(self) -> Mapping[str, Array]:
        """Displacement of each finger by name, as `Hand.with_tip_offsets` takes it, m."""
        return dict(zip(self.fingers, self.offsets, strict=True))


class TipOffsetEstimator:
    """Estimator of the places of the fingertips of a grasp, without memory of its own.

        estimator = TipOffsetEstimator(grasp, point_noise=5e-4)
        memory = estimator.initial_memory()
        memory = estimator.step(memory, measurement, controller.estimate)  # once every period
        hand = grasp.hand.with_tip_offsets(estimator.offsets(memory).by_finger)

    Args:
        grasp: hand, object with its surface, and contacts.
        point_noise: standard deviation of each component of a measured contact point, m, > 0.
        size: standard deviation of each component of a displacement before any measurement, m, > 0.

    Raises:
        InvalidInput: a number is out of range, or the body has no shape.
    """

    def __init__(self, grasp: Grasp, point_noise: float, size: float = 3e-3) -> None:
        noise = arrays.check_number(point_noise, "point_noise", above=0.0)
        self._size = arrays.check_number(size, "size", above=0.0)
        if grasp.body.shape is None:
            raise InvalidInput("grasp.body.shape", None, "a shape: the normals at measured points follow from it")
        self._shape, self._hand, self._fingers = grasp.body.shape, grasp.hand, grasp.fingers
        self._radii = np.array([grasp.hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])[:, None]  # m
        tips = grasp.hand.tip_motion(grasp.q, np.zeros(grasp.hand.n), grasp.fingers)
        R_FO = tips.R_HF.transpose(0, 2, 1) @ grasp.R_HO
        self._p_OC, self._n_O, self._rates = grasp.contacts.p_OC, grasp.contacts.R_OC[:, :, 2], self._normal_rates(grasp)
        change = np.eye(3) - self._radii[:, :, None] * self._rates  # of the centre by p, in O
        in_F = R_FO @ change
        self._information = freeze(np.linalg.inv(noise**2 * in_F @ in_F.transpose(0, 2, 1)))

    def initial_memory(self) -> TipOffsetMemory:
        """Return the memory before the first measurement."""
        count = len(self._fingers)
        return TipOffsetMemory(np.tile(np.eye(3) / self._size**2, (count, 1, 1)), np.zeros((count, 3)))

    def step(self, memory: TipOffsetMemory, measurement: Measurement, estimate: GraspEstimate) -> TipOffsetMemory:
        """Return the memory after a period; the same if no contact points were measured.

        Args:
            memory: memory after the last period.
            measurement: the measurement of the period.
            estimate: the state that `GraspEstimator` estimated from it.

        Raises:
            InvalidInput: another number of contact points than the grasp has fingers.
        """
        if measurement.contact_points is None:
            return memory
        points = arrays.check_array(measurement.contact_points, "contact_points", (len(self._fingers), 3))
        pose, rest = estimate.object, np.zeros(self._hand.n)
        tips = self._hand.tip_motion(estimate.q, rest, self._fingers)
        p_O = (points - pose.p_HO) @ pose.R_HO
        normals = (self._n_O + np.einsum("nij,nj->ni", self._rates, p_O - self._p_OC)) @ pose.R_HO.T
        displaced = points - self._radii * normals - tips.p_HF
        offsets = np.einsum("nji,nj->ni", tips.R_HF, displaced)  # m, in F
        weighted = memory.weighted + np.einsum("nij,nj->ni", self._information, offsets)
        return TipOffsetMemory(memory.information + self._information, weighted)

    def offsets(self, memory: TipOffsetMemory) -> TipOffsets:
        """Return the displacements that follow from a memory.

        Args:
            memory: memory after some periods.
        """
        covariance = np.linalg.inv(memory.information)
        offsets = np.einsum("nij,nj->ni", covariance, memory.weighted)
        return TipOffsets(self._fingers, freeze(offsets), freeze(covariance))

    def _normal_rates(self, grasp: Grasp) -> Array:
        """Return the derivatives of the inward normals at the contacts by the position, (N, 3, 3), 1/m, in O."""

        def normals(p: Array) -> Array:
            return self._shape.inward_normal(self._shape.project_to_surface(p))

        p_OC = grasp.contacts.p_OC
        columns = [(normals(p_OC + step) - normals(p_OC - step)) / (2.0 * _STEP) for step in _STEP * np.eye(3)]
        return np.stack(columns, axis=-1)

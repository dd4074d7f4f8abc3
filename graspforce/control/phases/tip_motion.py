"""Motions of fingertips along the normals of their contacts: pre-grasp postures, and joint motions that follow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand

_SHARES = (1.0, 0.85, 0.7, 0.55, 0.4, 0.25, 0.1)  # of the distance that are tried in turn
_DAMPING = 1e-4  # m²/rad²: added to J Jᵀ; a fingertip slows down near a singular posture


def opened_posture(grasp: Grasp, distance: float) -> tuple[Array, Array]:
    """Return the posture with the fingertips off their contacts along the outward normals, and their distances.

    A finger that cannot reach the distance gets the largest of 85, 70, 55, 40, 25 and 10 % of it that it reaches.

    Args:
        grasp: the grasp.
        distance: of the tips' surfaces from the contacts, m, > 0.

    Returns:
        (n,) joint positions, rad, and (N,) distances, m.

    Raises:
        InvalidInput: a finger cannot leave its contact along the normal.
    """
    distance = arrays.check_number(distance, "distance", above=0.0)
    hand, q = grasp.hand, np.array(grasp.q)
    distances = []
    for i, name in enumerate(grasp.fingers):
        p_tip = hand.tip_pose(grasp.q, name)[0]
        n = grasp.R_HO @ grasp.contacts.R_OC[i, :, 2]
        joints = list(hand.finger(name).joints)
        for share in _SHARES:
            try:
                q[joints] = hand.tip_posture({name: p_tip - share * distance * n}, grasp.q)[joints]
            except InvalidInput:
                continue
            distances.append(share * distance)
            break
        else:
            raise InvalidInput("distance", distance, f"so small that {name} reaches a tenth of it along its normal")
    return freeze(q), freeze(distances)


class TipMotion:
    """Joint motions that move fingertips with given velocities, by resolved rates.

    Each finger follows ẋ with q̇ = Jᵀ (J Jᵀ + λ 1)⁻¹ ẋ, and stops at its joint limits.

    Args:
        hand: the hand.
        fingers: the N fingers that move.
    """

    def __init__(self, hand: Hand, fingers: Sequence[str]) -> None:
        self._hand, self._tips = hand, [hand.frame_id(name) for name in fingers]
        self._joints = [list(hand.finger(name).joints) for name in fingers]

    def positions(self, q: Array) -> Array:
        """Return the positions (N, 3) of the fingertips in H, m.

        Args:
            q: (n,) joint positions, rad.
        """
        return np.asarray(self._hand.model.frame_jacobians(q[None], self._tips)[0][0])

    def rates(self, q: Array, velocities: Array) -> Array:
        """Return the joint rates (n,), rad/s; zero for other joints.

        Args:
            q: (n,) joint positions, rad.
            velocities: (N, 3) of the fingertips in H, m/s.
        """
        J = self._hand.model.frame_jacobians(q[None], self._tips)[1][0]
        v = np.zeros(len(q))
        for i, own in enumerate(self._joints):
            J_i = J[i, :3][:, own]
            v[own] = J_i.T @ np.linalg.solve(J_i @ J_i.T + _DAMPING * np.eye(3) * float(np.square(J_i).sum()), velocities[i])
        return v

    def tip_forces(self, q: Array, tau: Array) -> Array:
        """Return the typical sizes (N,) of forces at the fingertips that balance joint torques, N.

        Root mean squares of torques and levers stand for those of single joints.

        Args:
            q: (n,) joint positions, rad.
            tau: (n,) largest torques, N·m.
        """
        J = self._hand.model.frame_jacobians(q[None], self._tips)[1][0]
        forces = []
        for i, own in enumerate(self._joints):
            J_i = J[i, :3][:, own]
            lever = float(np.sqrt(np.square(J_i).sum() / len(own)))  # m, root mean square
            forces.append(float(np.sqrt(np.square(tau[own]).mean())) / lever if lever > 0.0 else 0.0)
        return np.array(forces)

    def advance(self, q: Array, velocities: Array, dt: float) -> tuple[Array, Array]:
        """Return joint positions after a step, and the rates that lead there.

        Args:
            q: (n,) joint positions, rad.
            velocities: (N, 3) of the fingertips in H, m/s.
            dt: length of the step, s.
        """
        rates = self.rates(q, velocities)
        q_next = np.clip(q + dt * rates, self._hand.q_lower, self._hand.q_upper)
        return freeze(q_next), freeze((q_next - q) / dt)

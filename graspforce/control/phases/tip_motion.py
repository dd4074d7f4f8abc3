"""Motions of fingertips along the normals of their contacts: pre-grasp postures, and joint motions that follow."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand

_SHARES = (1.0, 0.85, 0.7, 0.55, 0.4, 0.25, 0.1)  # of the distance that are tried in turn
_SPACE = 3  # joints that a fingertip needs to move in any direction
_OUTWARD_STEPS = 40
_LEAST_PROGRESS = 0.01  # of a step: a fingertip that gets on by less has reached its end
_DAMPING = 1e-4  # m²/rad²: added to J Jᵀ; a fingertip slows down near a singular posture


def opened_posture(grasp: Grasp, distance: float) -> tuple[Array, Array]:
    """Return the posture with the fingertips off their contacts along the outward normals, and their distances.

    A finger that cannot reach the distance gets the largest of 85, 70, 55, 40, 25 and 10 % of it that it reaches. Fingers of
    one or two joints, or behind a wrist, move along the normals as far as their joints let them; see `TipMotion`.

    Args:
        grasp: the grasp.
        distance: of the tips' surfaces from the contacts, m, > 0.

    Returns:
        (n,) joint positions, rad, and (N,) distances, m.

    Raises:
        InvalidInput: a finger cannot leave its contact along the normal.
    """
    distance = arrays.check_number(distance, "distance", above=0.0)
    motion = TipMotion(grasp.hand, grasp.fingers)
    q, distances = _reached_posture(grasp, distance) if motion.reaches_any_point else _moved_outward(grasp, motion, distance)
    for name, reached in zip(grasp.fingers, distances.tolist(), strict=True):
        if reached < _SHARES[-1] * distance:
            raise InvalidInput("distance", distance, f"so small that {name} reaches a tenth of it along its normal")
    return freeze(q), freeze(distances)


def _reached_posture(grasp: Grasp, distance: float) -> tuple[Array, Array]:
    """Return the opened posture by inverse kinematics, and the distances; 0 for a finger that reaches none of the shares."""
    hand, q = grasp.hand, np.array(grasp.q)
    distances = np.zeros(len(grasp.fingers))
    for i, name in enumerate(grasp.fingers):
        p_tip = hand.tip_pose(grasp.q, name)[0]
        n = grasp.R_HO @ grasp.contacts.R_OC[i, :, 2]
        joints = list(hand.finger(name).joints)
        for share in _SHARES:
            try:
                q[joints] = hand.tip_posture({name: p_tip - share * distance * n}, grasp.q)[joints]
            except InvalidInput:
                continue
            distances[i] = share * distance
            break
    return q, distances


def _moved_outward(grasp: Grasp, motion: TipMotion, distance: float) -> tuple[Array, Array]:
    """Return the posture after small steps of the tips along the outward normals, and how far each got along its normal, m."""
    normals = grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
    start, q, reached = motion.positions(grasp.q), grasp.q, np.zeros(len(normals))
    step = distance / _OUTWARD_STEPS  # m
    for _ in range(2 * _OUTWARD_STEPS):
        is_near = reached < distance - 0.5 * step
        q, _ = motion.advance(q, -step * is_near[:, None] * normals, 1.0)
        before, reached = reached, np.einsum("ij,ij->i", start - motion.positions(q), normals)
        if (reached - before).max() < _LEAST_PROGRESS * step:
            break
    return q, reached


class TipMotion:
    """Joint motions that move fingertips with given velocities, by resolved rates.

    Each finger follows ẋ with q̇ = Jᵀ (J Jᵀ + λ 1)⁻¹ ẋ. At a joint limit the other joints of the finger take over, as far as
    they can. Joints that fingers share, such as those of a wrist, rest if each finger has three others. Otherwise the equation
    holds for all fingers at once.

    Args:
        hand: the hand.
        fingers: the N fingers that move.

    Attributes:
        reaches_any_point: whether each finger has three joints or more, and shares none.
    """

    def __init__(self, hand: Hand, fingers: Sequence[str]) -> None:
        self._hand, self._tips = hand, [hand.frame_id(name) for name in fingers]
        joints = [list(hand.finger(name).joints) for name in fingers]
        count = Counter(joint for each in joints for joint in each)
        own = [[joint for joint in each if count[joint] == 1] for each in joints]
        is_apart = min(map(len, own)) >= _SPACE or own == joints  # each finger moves by joints of its own
        self.reaches_any_point = own == joints and min(map(len, own)) >= _SPACE
        self._joints = own if is_apart else joints
        together = [(list(range(len(joints))), sorted(count))]
        self._groups = (
            [([i], each) for i, each in enumerate(own)] if is_apart else together
        )  # fingers and joints of an equation

    def positions(self, q: Array) -> Array:
        """Return the positions (N, 3) of the fingertips in H, m.

        Args:
            q: (n,) joint positions, rad.
        """
        return np.asarray(self._hand.model.frame_jacobians(q[None], self._tips)[0][0])

    def rates(self, q: Array, velocities: Array, dt: float = 0.0) -> Array:
        """Return the joint rates (n,), rad/s; zero for other joints.

        Args:
            q: (n,) joint positions, rad.
            velocities: (N, 3) of the fingertips in H, m/s.
            dt: time for which the joints move with these rates, s; joints that would pass a limit rest.
        """
        J = self._hand.model.frame_jacobians(q[None], self._tips)[1][0, :, :3]
        v = np.zeros(len(q))
        for fingers, joints in self._groups:
            free, wanted = np.array(joints), velocities[fingers].ravel()
            while len(free):
                J_i = J[fingers][:, :, free].reshape(len(wanted), -1)
                damped = J_i @ J_i.T + _DAMPING * np.eye(len(wanted)) * float(np.square(J_i).sum()) / len(fingers)
                rates = J_i.T @ np.linalg.solve(damped, wanted)
                q_next = q[free] + dt * rates
                is_free = (q_next >= self._hand.q_lower[free]) & (q_next <= self._hand.q_upper[free])
                if is_free.all():
                    v[free] = rates
                    break
                free = free[is_free]
        return v

    def velocities(self, q: Array, rates: Array) -> Array:
        """Return the velocities (N, 3) of the fingertips in H, m/s.

        Args:
            q: (n,) joint positions, rad.
            rates: (n,) joint rates, rad/s.
        """
        return np.asarray(self._hand.model.frame_jacobians(q[None], self._tips)[1][0, :, :3] @ rates)

    def tip_forces(self, q: Array, tau: Array) -> Array:
        """Return the typical sizes (N,) of forces at the fingertips that balance joint torques, N.

        Root mean squares of torques and levers stand for those of single joints.

        Args:
            q: (n,) joint positions, rad.
            tau: (n,) largest torques, N·m.
        """
        J = self._hand.model.frame_jacobians(q[None], self._tips)[1][0, :, :3]
        forces = []
        for i, own in enumerate(self._joints):
            J_i = J[i][:, own]
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
        rates = self.rates(q, velocities, dt)
        q_next = np.clip(q + dt * rates, self._hand.q_lower, self._hand.q_upper)
        return freeze(q_next), freeze((q_next - q) / dt)

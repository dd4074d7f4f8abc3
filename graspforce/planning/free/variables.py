"""Meaning of the variables of an object move: their scales, and their places in a knot's vector."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.planning.free.object_equations import VariableScales, choose_independent_joints
from graspforce.planning.interpolation import Indices
from graspforce.planning.nlp import cayley
from graspforce.planning.nlp.layout import KnotLayout
from graspforce.planning.task import GraspTask, ObjectTask
from graspforce.planning.trajectory import Trajectory

_SPIN_LENGTH = 0.03  # m: weighs spin against sliding
_FINGER_LENGTH = 0.05  # m: typical distance of a fingertip from its joints


@dataclass(frozen=True, eq=False, slots=True)
class FingerVariables:
    """Variables of a finger that holds the object.

    Args:
        independent_joints: joints of the hand that are coordinates of their own.
        independent: the same joints, by their places among the finger's joints.
        dependent_joints: joints of the hand that follow from the contact.
        coordinates: places of the independent joints in y.
        is_rolling: True if the contact rolls.
        start: place of the first dependent joint: in z, with q, q̇ and q̈ in turn; in y if the contact rolls.
        arm_start: place in z of the vector from O to the contact, if the contact rolls.
    """

    independent_joints: tuple[int, ...]
    independent: tuple[int, ...]
    dependent_joints: tuple[int, ...]
    coordinates: tuple[int, ...]
    is_rolling: bool
    start: int
    arm_start: int

    @classmethod
    def choose(cls, hand: Hand, name: str, q: Array, first_coordinate: int, spin_axis: Array | None = None) -> FingerVariables:
        """Return the variables of a finger, whose independent joints are chosen for the best-conditioned dependent ones.

        Args:
            hand: the hand.
            name: the finger.
            q: (n,) posture at the start, rad.
            first_coordinate: place of its first independent joint in y.
            spin_axis: (3,) normal in H of a soft contact that rolls, which does not spin; None for another contact.
        """
        joints = hand.finger(name).joints
        J = hand.point_jacobian(q, name, hand.tip_pose(q, name)[0])[:, list(joints)]
        J = J[:3] if spin_axis is None else np.vstack([J[:3], _SPIN_LENGTH * spin_axis @ J[3:]])
        independent = choose_independent_joints(J, len(joints) - len(J))
        dependent_joints = tuple(joint for i, joint in enumerate(joints) if i not in independent)
        coordinates = tuple(range(first_coordinate, first_coordinate + len(independent)))
        return cls(tuple(joints[i] for i in independent), independent, dependent_joints, coordinates, False, 0, 0)

    def places(self, layout: KnotLayout) -> list[tuple[Indices, Indices]]:
        """Return the places of the independent and the dependent joints in a knot's vector, for q, q̇ and q̈.

        Args:
            layout: a knot's variables.
        """
        m = len(self.dependent_joints)
        if self.is_rolling:
            dependent = [layout.part(kind)[self.start : self.start + m] for kind in "yva"]
        else:
            dependent = [layout.z(range(self.start + k * m, self.start + (k + 1) * m)) for k in range(3)]
        return [(layout.part(kind)[list(self.coordinates)], dependent[k]) for k, kind in enumerate("yva")]

    def arm(self, layout: KnotLayout) -> Indices:
        """Return the places of the vector from O to the contact in a knot's vector; none unless the contact rolls.

        Args:
            layout: a knot's variables.
        """
        return layout.z(range(self.arm_start, self.arm_start + 3 * self.is_rolling))

    def dependent_scales(self, scales: VariableScales) -> list[float]:
        """Return the scales of q, q̇ and q̈ of the dependent joints, rad, rad/s, rad/s².

        Args:
            scales: scales of the variables.
        """
        return [scales.joint / scales.time**k if k or self.is_rolling else 1.0 for k in range(3)]


@dataclass(frozen=True, eq=False, slots=True)
class MoveVariables:
    """Variables of an object move.

    Args:
        layout: a knot's variables.
        scales: their scales.
        fingers: variables of each finger; none for ideal fingers.
        forces: (3 N,) places of the contact forces, in H.
        moments: for each contact the places of M/γ, in H, and of m/γ, if it is soft, otherwise none.
        p_0: (3,) reference position of O, m.
        R_0: (3, 3) reference orientation.
        posture: (n,) posture at the start, rad, of joints that do not move.
    """

    layout: KnotLayout
    scales: VariableScales
    fingers: tuple[FingerVariables, ...]
    forces: Indices
    moments: tuple[Indices, ...]
    p_0: Array
    R_0: Array
    posture: Array

    @classmethod
    def choose(cls, task: ObjectTask, knots: Trajectory) -> MoveVariables:
        """Return the variables of the move from the first of some states to the last.

        Args:
            task: the task.
            knots: K + 1 states, evenly spaced in time.
        """
        fingers: list[FingerVariables] = []
        coordinates, algebraic = 6, 0
        if isinstance(task, GraspTask):
            spins = task.is_rolling & (task.contacts.gamma > 0.0)
            for i, name in enumerate(task.fingers):
                axis = knots.R_HO[0] @ knots.R_OC[0, i, :, 2] if spins[i] else None
                fingers.append(FingerVariables.choose(task.hand, name, knots.q[0], coordinates, axis))
                coordinates += len(fingers[-1].independent_joints)
        independent_count = coordinates
        for i, finger in enumerate(fingers):
            m = len(finger.dependent_joints)
            if task.is_rolling[i]:
                fingers[i] = replace(finger, is_rolling=True, start=coordinates, arm_start=algebraic)
                coordinates, algebraic = coordinates + m, algebraic + 3
            else:
                fingers[i] = replace(finger, start=algebraic)
                algebraic += 3 * m
        count = len(task.contacts)
        soft = task.contacts.gamma > 0.0
        first_moment = algebraic + 3 * count
        size = first_moment + 4 * int(soft.sum())
        layout = KnotLayout(coordinates, size, coordinates - independent_count)
        p_0, R_0 = (knots.p_HO[0] + knots.p_HO[-1]) / 2.0, knots.R_HO[(len(knots.times) - 1) // 2]
        scales = _choose_scales(knots, R_0, float(np.linalg.norm(task.contacts.p_OC, axis=1).max()))
        forces = layout.z(range(algebraic, algebraic + 3 * count))
        starts = first_moment + 4 * (np.cumsum(soft) - 1)
        moments = tuple(
            layout.z(range(start, start + 4 * bool(flag))) for start, flag in zip(starts.tolist(), soft, strict=True)
        )
        return cls(layout, scales, tuple(fingers), forces, moments, p_0, R_0, knots.q[0])

    @property
    def start_values(self) -> tuple[int, ...]:
        """Return the places of the variables given at the start: y, and the independent part of v."""
        coordinates = self.layout.coordinates
        return (*range(coordinates), *self._independent_rates)

    @property
    def goal_values(self) -> tuple[int, ...]:
        """Return the places of the variables given at the goal: the object's part of y, and the independent part of v."""
        return (*range(6), *self._independent_rates)

    @property
    def _independent_rates(self) -> range:
        """Return the places of the independent part of v. Where it is zero, so are the dependent rates."""
        coordinates = self.layout.coordinates
        return range(coordinates, 2 * coordinates - self.layout.dependent)


def _choose_scales(knots: Trajectory, R_0: Array, arm: float) -> VariableScales:
    """Return scales that make the variables of order one; ``arm`` is the contacts' largest distance from O, m."""
    r = cayley.parameters(knots.R_HO[[0, -1]] @ R_0.T)
    distance = float(np.linalg.norm(knots.p_HO[-1] - knots.p_HO[0]))
    size = max(distance, 2.0 * arm * float(np.linalg.norm(r[-1] - r[0])), 1e-4)  # m
    force = max(float(np.abs(knots.f).max()), 1e-6)
    return VariableScales(size, 0.5 * size / max(arm, size), float(knots.times[-1]), size / _FINGER_LENGTH, force)

"""Postures of a three-joint finger in closed form: the start values of its inverse kinematics.

The tip is at p(q) = e^(S₁ q₁) e^(S₂ q₂) e^(S₃ q₃) p₀, with rotations about the joint axes (a_i, c_i). If a₂ ∥ a₃, the last two
joints keep the tip's coordinate along a₂. The first joint must therefore give the target this coordinate, seen from its link:

    a₂ · (R(−q₁)(p* − c₁) + c₁) = a₂ · p₀,    an equation A cos q₁ + B sin q₁ = C.

The other two joints are then an arm in the plane across a₂. Source: Murray, Li and Sastry (1994), subproblems 1 and 3.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array

_PARALLEL = 1e-6  # largest sine of the angle between axes that count as parallel
_SAME_POINT = 1e-9  # m: the arm is the finger
_FREE_SHARES = (0.5, 0.2, 0.8)  # shares of its range of a first joint that does not change the tip's coordinate along a₂


@dataclass(frozen=True, eq=False, slots=True)
class ThreeJointArm:
    """The three joint axes of a finger and its tip, in H at q = 0, where q are the finger's joint positions.

    Attributes:
        a: (3, 3) unit vectors of the axes, by rows.
        c: (3, 3) a point of each axis, by rows, m.
        p0: (3,) position of the tip, m.
    """

    a: Array
    c: Array
    p0: Array

    def tip(self, q: Array) -> Array:
        """Return the position (3,) of the tip in H, m.

        Args:
            q: (3,) joint positions, rad.
        """
        p = self.p0
        for joint in (2, 1, 0):
            p = self._rotate(joint, float(q[joint]), p)
        return p

    def postures(self, p: Array, lower: Array, upper: Array) -> list[Array]:
        """Return the postures that reach a point, within the joint limits; an unreachable point gives near postures.

        Args:
            p: (3,) target of the tip in H, m.
            lower: (3,) least joint positions, rad.
            upper: (3,) largest joint positions, rad.
        """
        found = []
        for first in self._first_angles(p, lower[0], upper[0]):
            seen = self._rotate(0, -first, p)  # m, the target before the rotation of the first joint
            for third in self._third_angles(seen):
                second = self._angle_between(1, self._rotate(2, third, self.p0), seen)
                found.append(np.array([first, second, third]))
        wrapped = [lower + np.mod(q - lower, 2.0 * math.pi) for q in found]
        inside = [q for q in wrapped if (q <= upper + 1e-9).all()]
        return [np.minimum(q, upper) for q in inside]

    def _rotate(self, joint: int, angle: float, p: Array) -> Array:
        """Return a point (3,) after the rotation of a joint."""
        a, c = self.a[joint], self.c[joint]
        d = p - c
        along = (a @ d) * a
        turned: Array = c + along + math.cos(angle) * (d - along) + math.sin(angle) * np.cross(a, d)
        return turned

    def _angle_between(self, joint: int, start: Array, end: Array) -> float:
        """Return the angle of a joint that turns the direction of one point into that of another."""
        a, c = self.a[joint], self.c[joint]
        u, v = start - c, end - c
        u, v = u - (a @ u) * a, v - (a @ v) * a
        return math.atan2(float(a @ np.cross(u, v)), float(u @ v))

    def _first_angles(self, p: Array, lower: float, upper: float) -> list[float]:
        """Return the angles of the first joint that give the target the coordinate of the tip along a₂."""
        a1, a2 = self.a[0], self.a[1]
        d = p - self.c[0]
        along = (a1 @ d) * a1
        A, B = float(a2 @ (d - along)), -float(a2 @ np.cross(a1, d))
        C = float(a2 @ (self.p0 - self.c[0] - along))
        size = math.hypot(A, B)
        if size <= _PARALLEL * max(float(np.linalg.norm(d)), 1e-12):
            return [lower + share * (upper - lower) for share in _FREE_SHARES]
        middle, half = math.atan2(B, A), math.acos(min(max(C / size, -1.0), 1.0))
        return [middle + half, middle - half]

    def _third_angles(self, p: Array) -> list[float]:
        """Return the angles of the third joint that give the tip the target's distance from the second axis."""
        a, c2, c3 = self.a[2], self.c[1], self.c[2]

        def across(x: Array) -> Array:
            return np.asarray(x - (a @ x) * a)

        to_tip, to_axis, reach = across(self.p0 - c3), across(c2 - c3), across(p - c2)
        r, s = float(np.linalg.norm(to_tip)), float(np.linalg.norm(to_axis))
        if r * s == 0.0:
            return [0.0]
        cosine = (r * r + s * s - float(reach @ reach)) / (2.0 * r * s)
        angle = math.acos(min(max(cosine, -1.0), 1.0))
        base = math.atan2(float(a @ np.cross(to_tip, to_axis)), float(to_tip @ to_axis))
        return [base + angle, base - angle]


def find_three_joint_arm(tip: Callable[[Array], tuple[Array, Array]], middle: Array) -> ThreeJointArm | None:
    """Return the arm of a finger with three revolute joints of which the last two are parallel; None for another finger.

    Args:
        tip: the finger's joint positions, rad → position of its tip (3,), m, and Jacobian of its twist (6, m), linear first.
        middle: (m,) posture at which the arm is compared with the finger, rad; couplings of joints show there.
    """
    p0, J = tip(np.zeros_like(middle))
    a = J[3:].T
    if len(middle) != 3 or not np.allclose(np.linalg.norm(a, axis=1), 1.0, atol=_PARALLEL):
        return None
    arm = ThreeJointArm(a, p0 + np.cross(a, J[:3].T), p0)
    is_same = np.linalg.norm(arm.tip(middle) - tip(middle)[0]) <= _SAME_POINT
    return arm if is_same and np.linalg.norm(np.cross(a[1], a[2])) <= _PARALLEL else None

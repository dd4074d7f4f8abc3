"""Limits of jerk along a path, as cone programs that are solved one after the other.

With accelerations x_i at the knots of an interval of length Δ, its duration is 2 Δ/(√b_i + √b_{i+1}). The mean jerk is at most
‖x_{i+1} − x_i‖ √b/Δ with b = (b_i + b_{i+1})/2. The limit j/√b is a convex function of b, and above its tangent at any b₀:

    ‖x_{i+1} − x_i‖/Δ ≤ j/√b,    j/√b ≥ j/√b₀ (3/2 − b/(2 b₀))

So the right side of the tangent is a limit that is linear in b, and no motion that keeps it exceeds j. The program with the
tangent at the last solution contains this solution. Therefore the durations fall from one program to the next.
At the ends of an eased path, where the first two derivatives are zero, the jerk is the third one times ṡ³. This bounds b there.
Source: Boyd and Vandenberghe (2004), for tangents of convex functions as bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.interpolation import Indices
from graspforce.planning.path.eased_path import ease
from graspforce.planning.path.knots import PathKnots
from graspforce.planning.path.program_rows import ProgramRows, RowKind
from graspforce.planning.task import HandTask, ObjectTask, Task

_THIRD = 60.0  # h''' at both ends
_LEAST_RATE = 1e-4  # of the mean b₀: smaller ones have no tangent


@dataclass(frozen=True, eq=False, slots=True)
class PathJerks:
    """Changes of accelerations in the K − 1 intervals, divided by their lengths and by the limits; only what has a limit.

    Args:
        steps: (K − 1,) lengths Δ of the intervals.
        object_b: (K − 1, 2, c, 3) changes of the object's accelerations per unit of b at both knots.
        object_a: (K − 1, 2, c, 3) the same per unit of a.
        joints_b: (K − 1, 2, m) changes of the joints' accelerations per unit of b at both knots.
        joints_a: (K − 1, 2, m) the same per unit of a.
        b_ends: (2,) largest b at both ends, 1/s².
    """

    steps: Array
    object_b: Array
    object_a: Array
    joints_b: Array
    joints_a: Array
    b_ends: Array

    @classmethod
    def of_path(cls, task: Task, knots: PathKnots) -> PathJerks | None:
        """Return the jerks along a path; None if the task has no limits of jerk.

        Args:
            task: the task with its limits.
            knots: the path at its knots.
        """
        limits, K = task.acceleration_limits, len(knots.s)
        if not limits.has_jerk:
            return None
        steps = np.diff(knots.s)
        of_object: list[tuple[Array, Array]] = []
        if isinstance(task, ObjectTask):
            at = knots.poses
            turns = [(at.R @ x[:, :, None])[:, :, 0] for x in (at.omega, at.omega_s)]
            pairs = zip(((at.p_s, at.p_ss), (turns[0], turns[1])), limits.object_jerks, strict=True)
            of_object = [(x_a / most, x_b / most) for (x_a, x_b), most in pairs if most < np.inf]
        object_a = object_b = np.zeros((K, 0, 3))
        if of_object:
            object_a, object_b = (np.stack(x, axis=1) for x in zip(*of_object, strict=True))
        joints_a = joints_b = np.zeros((K, 0))
        if isinstance(task, HandTask) and limits.joint_jerk < np.inf:
            joints_a, joints_b = knots.joints.q_s / limits.joint_jerk, knots.joints.q_ss / limits.joint_jerk
        beside = [1, -2]  # near the ends x'' = h'' x' with the path's own x', and the third derivative is h''' x'
        objects = np.linalg.norm(object_b[beside], axis=2).max(axis=1, initial=0.0)
        joints = np.abs(joints_b[beside]).max(axis=1, initial=0.0)
        third = np.abs(_THIRD / ease(knots.s[beside])[2]) * np.maximum(objects, joints)
        b_ends = np.maximum(third, 1e-300) ** (-2.0 / 3.0)
        changes = [_changes(x, steps) for x in (object_b, object_a, joints_b, joints_a)]
        return cls(steps, changes[0], changes[1], changes[2], changes[3], b_ends)

    def even_rate(self) -> Array:
        """Return b of the fastest motion at an even rate within the limits, at the K knots, 1/s²."""
        objects = np.linalg.norm(self.object_b.sum(axis=1), axis=2).max(axis=1, initial=0.0)
        joints = np.abs(self.joints_b.sum(axis=1)).max(axis=1, initial=0.0)
        largest = float(np.maximum(objects, joints).max())
        return np.full(len(self.steps) + 1, largest ** (-2.0 / 3.0))

    def add_to(self, rows: ProgramRows, b_0: Array, share: Array) -> tuple[int, ...]:
        """Add the limits with tangents at a motion, and return the sizes of their cones.

        Args:
            rows: the program.
            b_0: (K,) b of the motion, 1/s².
            share: (K − 1,) part of the limits that is used in each interval.
        """
        b_0 = np.maximum(b_0, _LEAST_RATE * float(b_0.mean()))
        middle = (b_0[:-1] + b_0[1:]) / 2.0
        scale = np.sqrt(middle) / share
        ends, b_ends = np.array([0, rows.K - 1]), self.b_ends * share[[0, -1]] ** (2.0 / 3.0)
        rows.add("least", np.arange(2), ends, rows.b_scales[ends] / b_ends, np.ones(2))
        self._add_joints(rows, scale, middle)
        self._add_objects(rows, scale, middle)
        count: int = self.object_b.shape[2] * len(middle)
        return (4,) * count

    def _add_joints(self, rows: ProgramRows, scale: Array, middle: Array) -> None:
        """Add |x_{i+1} − x_i| √b₀/Δ ≤ 3/2 − b/(2 b₀) of each joint."""
        count, joints = self.joints_b.shape[0], self.joints_b.shape[2]
        if not joints:
            return
        row = np.arange(count * joints).reshape(count, joints)
        tangent = 0.25 / middle  # per unit of b at each knot
        for sign in (1.0, -1.0):
            per_b, per_a = (sign * scale[:, None, None] * x for x in (self.joints_b, self.joints_a))
            self._add(rows, "least", row, per_b + tangent[:, None, None], per_a, np.full(row.size, 1.5))

    def _add_objects(self, rows: ProgramRows, scale: Array, middle: Array) -> None:
        """Add ‖x_{i+1} − x_i‖ √b₀/Δ ≤ 3/2 − b/(2 b₀) of position and rotation as cones of size 4."""
        count, _, parts, _ = self.object_b.shape
        if not parts:
            return
        row = np.arange(count * parts * 4).reshape(count, parts * 4)
        shape = (count, 2, parts, 4)
        per_b, per_a = np.zeros(shape), np.zeros(shape)
        per_b[:, :, :, 0] = 0.25 / middle[:, None, None]
        per_b[:, :, :, 1:], per_a[:, :, :, 1:] = (scale[:, None, None, None] * x for x in (self.object_b, self.object_a))
        right = np.tile([1.5, 0.0, 0.0, 0.0], count * parts)
        self._add(rows, "cone", row, per_b.reshape(count, 2, -1), per_a.reshape(count, 2, -1), right)

    def _add(self, rows: ProgramRows, kind: RowKind, row: Indices, per_b: Array, per_a: Array, right: Array) -> None:
        """Add rows with entries (K − 1, 2, r) at both knots of each interval."""
        places, columns, values = [], [], []
        interval = np.arange(len(row))[:, None]
        for end in (0, 1):
            knot = np.broadcast_to(interval + end, row.shape)
            places += [row, row]
            columns += [knot, knot + rows.K]
            values += [rows.b_scales[knot] * per_b[:, end], rows.b_scale * per_a[:, end]]
        flat = [np.concatenate([np.ravel(x) for x in part]) for part in (places, columns, values)]
        nonzero = flat[2] != 0.0
        rows.add(kind, flat[0][nonzero], flat[1][nonzero], flat[2][nonzero], right)


def _changes(x: Array, steps: Array) -> Array:
    """Return the coefficients (K − 1, 2, …) of changes over intervals, from values (K, …) at the knots."""
    lengths = steps.reshape(-1, *(1,) * (x.ndim - 1))
    return np.stack([-x[:-1] / lengths, x[1:] / lengths], axis=1)

"""Paths: where the object, or the hand's joints, are at each s from 0 to 1, with derivatives to second order.

A path says where, not when. Motion along it is s(t), and then

    p̈ = p' s̈ + p'' ṡ²,    ω = Ω ṡ,    α = Ω s̈ + Ω' ṡ²,    q̈ = q' s̈ + q'' ṡ²

with Ω the angular velocity in O's axes for a unit rate of s. Derivatives must be continuous to second order, or accelerations
jump.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput

_METRES_PER_RADIAN = 0.05  # m: how far a radian counts in the distance between via points, about a hand-held object's size
_DEGREE = 5  # of splines through via points: derivatives are continuous to fourth order


@dataclass(frozen=True, eq=False, slots=True)
class PosePoints:
    """Poses at K values of s, and their derivatives with respect to s.

    Args:
        p, p_s, p_ss: (K, 3) O's origin in H, m, and its derivatives.
        R: (K, 3, 3) O's axes in H.
        omega, omega_s: (K, 3) Ω with R' = R [Ω]×, in O's axes, rad, and its derivative.
    """

    p: Array
    p_s: Array
    p_ss: Array
    R: Array
    omega: Array
    omega_s: Array


@dataclass(frozen=True, eq=False, slots=True)
class JointPoints:
    """Postures q at K values of s, and their derivatives q_s, q_ss: (K, n), rad."""

    q: Array
    q_s: Array
    q_ss: Array


@dataclass(frozen=True, eq=False, slots=True)
class ContactPoints:
    """N contacts on the object at K values of s.

    Args:
        p_OC, p_OC_s: (K, N, 3) where they are, in O, m, and its derivative.
        R_OC: (K, N, 3, 3) their frames in O.
        J: (K, k, n) the contact Jacobian, m/rad; no columns without a hand.
    """

    p_OC: Array
    p_OC_s: Array
    R_OC: Array
    J: Array


class ObjectPath(Protocol):
    """What the planner asks of an object path; anything that answers will do."""

    def points(self, s: Array) -> PosePoints:
        """Poses and derivatives at s (K,), each in [0, 1]."""
        ...


class StraightPath:
    """From pose to pose: O's origin along a straight line, the axes about one fixed direction, both at even rates.

    Args:
        p_start, p_goal: (3,) O's origin in H, m.
        R_start, R_goal: (3, 3) O's axes in H; less than half a turn apart.
    """

    def __init__(self, p_start: Any, R_start: Any, p_goal: Any, R_goal: Any) -> None:
        self._p, self._R = _pose(p_start, R_start, "start")
        p_goal, R_goal = _pose(p_goal, R_goal, "goal")
        self._displacement = p_goal - self._p  # m
        self._turn = Rotation.from_matrix(self._R.T @ R_goal).as_rotvec()  # rad, in O's axes

    def points(self, s: Array) -> PosePoints:
        """Poses and derivatives at s (K,)."""
        zero = np.zeros((len(s), 3))
        R = self._R @ Rotation.from_rotvec(s[:, None] * self._turn).as_matrix()
        return PosePoints(
            self._p + s[:, None] * self._displacement, zero + self._displacement, zero, R, zero + self._turn, zero
        )


class ScrewPath:
    """From pose to pose at one constant body twist: T(s) = T_start exp(s ξ), the straight line of SE(3).

    Args: as `StraightPath`.
    """

    def __init__(self, p_start: Any, R_start: Any, p_goal: Any, R_goal: Any) -> None:
        self._p, self._R = _pose(p_start, R_start, "start")
        p_goal, R_goal = _pose(p_goal, R_goal, "goal")
        self._turn = Rotation.from_matrix(self._R.T @ R_goal).as_rotvec()  # rad
        # p(1) − p(0) = R V v with V the integral of exp(s [turn]×), which an augmented matrix's exponential holds
        self._body_velocity = np.linalg.solve(
            _rotation_integral(self._turn, np.ones(1))[0], self._R.T @ (p_goal - self._p)
        )  # m

    def points(self, s: Array) -> PosePoints:
        """Poses and derivatives at s (K,)."""
        zero = np.zeros((len(s), 3))
        R = self._R @ Rotation.from_rotvec(s[:, None] * self._turn).as_matrix()
        p = self._p + _rotation_integral(self._turn, s) @ self._body_velocity @ self._R.T
        p_s, p_ss = R @ self._body_velocity, R @ np.cross(self._turn, self._body_velocity)
        return PosePoints(p, p_s, p_ss, R, zero + self._turn, zero)


class SplinePath:
    """Any spline: O's origin by a spline of three, its axes by a spline of unit quaternions, normalised.

    Args:
        position: SciPy spline on [0, 1] → (3,), m.
        quaternion: SciPy spline on [0, 1] → (4,) as (x, y, z, w), of any length but zero.
    """

    def __init__(self, position: BSpline, quaternion: BSpline) -> None:
        self._position, self._quaternion = position, quaternion

    @classmethod
    def through(cls, p_HO: Any, R_HO: Any) -> SplinePath:
        """Through poses without stopping, spaced by their distances, a radian counting as 5 cm.

        Args:
            p_HO: (m, 3) O's origin, start first, goal last, m.
            R_HO: (m, 3, 3) O's axes; each less than half a turn from the one before.

        Raises:
            InvalidInput: fewer than two poses, a matrix that is no rotation, the same pose twice in a row.
        """
        p = arrays.check_array(p_HO, "p_HO", (None, 3))
        R = arrays.check_array(R_HO, "R_HO", (len(p), 3, 3))
        if len(p) < 2:
            raise InvalidInput("p_HO", p, "at least two poses")
        for i, pose in enumerate(zip(p, R, strict=True)):
            _pose(*pose, f"poses[{i}]")
        turns = Rotation.from_matrix(R)
        angles = (turns[:-1].inv() * turns[1:]).magnitude()  # rad
        steps = np.hypot(np.linalg.norm(np.diff(p, axis=0), axis=1), _METRES_PER_RADIAN * angles)  # m
        if steps.min() == 0.0:
            raise InvalidInput("p_HO", p, f"poses that differ: number {int(steps.argmin())} stands twice in a row")
        at = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
        quaternions = turns.as_quat()
        flips = np.sign((quaternions[:-1] * quaternions[1:]).sum(axis=1))
        quaternions[1:] *= np.cumprod(np.where(flips == 0.0, 1.0, flips))[:, None]  # the shorter way round
        return cls(_spline_through(at, p), _spline_through(at, quaternions))

    def points(self, s: Array) -> PosePoints:
        """Poses and derivatives at s (K,)."""
        u, u_s, u_ss = (self._quaternion(s, nu) for nu in range(3))
        size = np.linalg.norm(u, axis=1)[:, None]
        x, x_s, x_ss = u / size, u_s / size, u_ss / size
        x_s = x_s - x * _dot(x, x_s)  # the derivatives of u/|u|
        x_ss = x_ss - 2.0 * x_s * _dot(x, u_s / size) - x * (_dot(x, x_ss) + _dot(x_s, x_s))
        # Ω = 2 Im(x̄ x'), and Ω' = 2 Im(x̄ x'') since x̄' x' is real
        p, p_s, p_ss = (self._position(s, nu) for nu in range(3))
        return PosePoints(
            p,
            p_s,
            p_ss,
            Rotation.from_quat(x).as_matrix(),
            2.0 * _imaginary(x, x_s),
            2.0 * _imaginary(x, x_ss),
        )


class JointPath:
    """Postures along s, by a spline.

    Args:
        spline: SciPy spline on [0, 1] → (n,), rad.
    """

    def __init__(self, spline: BSpline) -> None:
        self._spline = spline

    @classmethod
    def through(cls, postures: Any) -> JointPath:
        """Through postures without stopping, spaced by their distances.

        Args:
            postures: (m, n), start first, goal last, rad.

        Raises:
            InvalidInput: fewer than two, or the same twice in a row.
        """
        q = arrays.check_array(postures, "postures", (None, None))
        if len(q) < 2:
            raise InvalidInput("postures", q, "at least two")
        steps = np.linalg.norm(np.diff(q, axis=0), axis=1)  # rad
        if steps.min() == 0.0:
            raise InvalidInput("postures", q, f"postures that differ: number {int(steps.argmin())} stands twice in a row")
        return cls(_spline_through(np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum(), q))

    def points(self, s: Array) -> JointPoints:
        """Postures and derivatives at s (K,)."""
        return JointPoints(*(self._spline(s, nu) for nu in range(3)))


def knot_grid(intervals: int) -> Array:
    """s at the knots, denser towards both ends: even in time for a move that accelerates evenly to the middle and brakes."""
    fields.check_integer(intervals, "intervals", minimum=2, maximum=10_000)
    s = (1.0 - np.cos(np.pi * np.arange(intervals + 1) / intervals)) / 2.0
    s[-1] = 1.0
    return arrays.freeze(s)


def _spline_through(at: Array, values: Array) -> BSpline:
    """A spline through values whose second and third derivatives are zero at both ends: a straight line through two."""
    zero = np.zeros(values.shape[1])
    ends = [(2, zero), (3, zero)]
    return make_interp_spline(at, values, k=_DEGREE, bc_type=(ends, ends))


def _pose(p: Any, R: Any, name: str) -> tuple[Array, Array]:
    return arrays.check_array(p, f"p_{name}", (3,)), Rotation.from_matrix(arrays.check_rotation(R, f"R_{name}")).as_matrix()


def _rotation_integral(turn: Array, s: Array) -> Array:
    """(K, 3, 3) the integrals of exp(σ [turn]×) over σ from 0 to s: s (1 + (1 − cos θ)/θ S + (1 − sin θ/θ) S²)."""
    angle = float(np.linalg.norm(turn))
    if angle < 1e-12:
        return np.asarray(s[:, None, None] * np.eye(3))
    axis = turn / angle
    S = np.cross(np.eye(3), axis)  # rows e_i × axis: [axis]×
    theta = s * angle
    around, along = (1.0 - np.cos(theta)) / angle, s - np.sin(theta) / angle
    return np.asarray(s[:, None, None] * np.eye(3) + around[:, None, None] * S + along[:, None, None] * (S @ S))


def _dot(x: Array, y: Array) -> Array:
    return np.asarray((x * y).sum(axis=1)[:, None])


def _imaginary(x: Array, y: Array) -> Array:
    """(K, 3) Im(x̄ y) of quaternions (x, y, z, w)."""
    return np.asarray(x[:, 3:] * y[:, :3] - y[:, 3:] * x[:, :3] - np.cross(x[:, :3], y[:, :3]))

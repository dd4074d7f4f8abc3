"""Paths of the object, and of the joints: poses or postures at a path parameter s from 0 to 1, with two derivatives.

A motion along a path is s(t). With Ω the angular velocity in O's axes for a unit rate of s,

    p̈ = p' s̈ + p'' ṡ²,    ω = Ω ṡ,    α = Ω s̈ + Ω' ṡ²,    q̈ = q' s̈ + q'' ṡ²

The second derivatives must be continuous: accelerations have steps otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry.vectors import skew
from graspforce.planning.given_points import check_different, check_poses, pose_distances

_DEGREE = 5  # of splines through via points: four continuous derivatives
_MAX_INTERVALS = 40_000  # of a grid that was refined twice


@dataclass(frozen=True, eq=False, slots=True)
class PosePoints:
    """Poses at K values of s, and their derivatives with respect to s.

    Args:
        p: (K, 3) positions of O in H, m.
        p_s: (K, 3) first derivatives, m.
        p_ss: (K, 3) second derivatives, m.
        R: (K, 3, 3) orientations in H.
        omega: (K, 3) Ω with R' = R [Ω]×, in O's axes, rad.
        omega_s: (K, 3) derivatives of Ω, rad.
    """

    p: Array
    p_s: Array
    p_ss: Array
    R: Array
    omega: Array
    omega_s: Array

    def select(self, k: int) -> PosePoints:
        """Return the k-th pose alone.

        Args:
            k: index of the pose.
        """
        return PosePoints(*(getattr(self, name)[k : k + 1] for name in PosePoints.__slots__))


@dataclass(frozen=True, eq=False, slots=True)
class JointPoints:
    """Postures at K values of s, and their derivatives with respect to s.

    Args:
        q: (K, n) postures, rad.
        q_s: (K, n) first derivatives, rad.
        q_ss: (K, n) second derivatives, rad.
    """

    q: Array
    q_s: Array
    q_ss: Array


@dataclass(frozen=True, eq=False, slots=True)
class ContactPoints:
    """N contacts on the object at K values of s.

    Args:
        p_OC: (K, N, 3) positions in O, m.
        p_OC_s: (K, N, 3) derivatives of the positions, m.
        R_OC: (K, N, 3, 3) contact frames in O.
        J: (K, k, n) contact Jacobians, m/rad; no columns for ideal fingers.
    """

    p_OC: Array
    p_OC_s: Array
    R_OC: Array
    J: Array


class ObjectPath(Protocol):
    """A path of the object. Any class with this method is one."""

    def points(self, s: Array) -> PosePoints:
        """Return poses and derivatives.

        Args:
            s: (K,) path parameters, 0 to 1.
        """
        ...


class StraightPath:
    """A path from pose to pose: O on a straight line, rotation about one fixed axis, both at constant rates.

    Args:
        p_start: (3,) position of O in H at the start, m.
        R_start: (3, 3) orientation at the start.
        p_goal: (3,) position at the goal, m.
        R_goal: (3, 3) orientation at the goal, less than half a turn from the start.

    Raises:
        InvalidInput: a wrong shape, or not a rotation matrix.
    """

    def __init__(self, p_start: npt.ArrayLike, R_start: npt.ArrayLike, p_goal: npt.ArrayLike, R_goal: npt.ArrayLike) -> None:
        self._p, self._R = _check_pose(p_start, R_start, "start")
        p_goal, R_goal = _check_pose(p_goal, R_goal, "goal")
        self._displacement = p_goal - self._p  # m
        self._turn = Rotation.from_matrix(self._R.T @ R_goal).as_rotvec()  # rad, in O's axes

    def points(self, s: Array) -> PosePoints:
        """Return poses and derivatives.

        Args:
            s: (K,) path parameters, 0 to 1.
        """
        zero = np.zeros((len(s), 3))
        p, R = self._p + s[:, None] * self._displacement, self._R @ Rotation.from_rotvec(s[:, None] * self._turn).as_matrix()
        return PosePoints(p, zero + self._displacement, zero, R, zero + self._turn, zero)


class ScrewPath:
    """A path from pose to pose at a constant body twist: T(s) = T_start exp(s ξ), the geodesic of SE(3).

    Args:
        p_start: (3,) position of O in H at the start, m.
        R_start: (3, 3) orientation at the start.
        p_goal: (3,) position at the goal, m.
        R_goal: (3, 3) orientation at the goal, less than half a turn from the start.

    Raises:
        InvalidInput: a wrong shape, or not a rotation matrix.
    """

    def __init__(self, p_start: npt.ArrayLike, R_start: npt.ArrayLike, p_goal: npt.ArrayLike, R_goal: npt.ArrayLike) -> None:
        self._p, self._R = _check_pose(p_start, R_start, "start")
        p_goal, R_goal = _check_pose(p_goal, R_goal, "goal")
        self._turn = Rotation.from_matrix(self._R.T @ R_goal).as_rotvec()  # rad
        # p(1) − p(0) = R V v, V the integral of exp(s [turn]×) over s from 0 to 1
        V = _rotation_integral(self._turn, np.ones(1))[0]
        self._body_velocity = np.linalg.solve(V, self._R.T @ (p_goal - self._p))  # m

    def points(self, s: Array) -> PosePoints:
        """Return poses and derivatives.

        Args:
            s: (K,) path parameters, 0 to 1.
        """
        zero = np.zeros((len(s), 3))
        R = self._R @ Rotation.from_rotvec(s[:, None] * self._turn).as_matrix()
        p = self._p + _rotation_integral(self._turn, s) @ self._body_velocity @ self._R.T
        p_s, p_ss = R @ self._body_velocity, R @ np.cross(self._turn, self._body_velocity)
        return PosePoints(p, p_s, p_ss, R, zero + self._turn, zero)


class SplinePath:
    """A path by splines of position and orientation; the orientation is a normalised spline of quaternions.

    Args:
        position: SciPy spline on [0, 1] → (3,), m.
        quaternion: SciPy spline on [0, 1] → (4,) as (x, y, z, w), of any length except zero.
    """

    def __init__(self, position: BSpline, quaternion: BSpline) -> None:
        self._position, self._quaternion = position, quaternion

    @classmethod
    def through(cls, p_HO: npt.ArrayLike, R_HO: npt.ArrayLike) -> SplinePath:
        """Return the path through poses without stops, spaced by their distances; a radian counts as 5 cm.

        Args:
            p_HO: (m, 3) positions of O in H, start first and goal last, m.
            R_HO: (m, 3, 3) orientations, each less than half a turn from the one before.

        Raises:
            InvalidInput: fewer than two poses, a number out of range, not a rotation matrix, or two equal poses in a row.
        """
        p, R = check_poses(p_HO, R_HO)
        distances = pose_distances(p, R)  # m
        s = np.concatenate([[0.0], np.cumsum(distances)]) / distances.sum()
        quaternions = Rotation.from_matrix(R).as_quat()
        signs = np.sign((quaternions[:-1] * quaternions[1:]).sum(axis=1))
        quaternions[1:] *= np.cumprod(np.where(signs == 0.0, 1.0, signs))[:, None]  # rotate by the smaller angle
        return cls(_spline_through(s, p), _spline_through(s, quaternions))

    def points(self, s: Array) -> PosePoints:
        """Return poses and derivatives.

        Args:
            s: (K,) path parameters, 0 to 1.
        """
        u, u_s, u_ss = (self._quaternion(s, nu) for nu in range(3))
        size = np.linalg.norm(u, axis=1)[:, None]
        x, x_s, x_ss = u / size, u_s / size, u_ss / size
        x_s = x_s - x * _dot(x, x_s)  # derivatives of u/|u|
        x_ss = x_ss - 2.0 * x_s * _dot(x, u_s / size) - x * (_dot(x, x_ss) + _dot(x_s, x_s))
        omega, omega_s = 2.0 * _imaginary(x, x_s), 2.0 * _imaginary(x, x_ss)  # Ω = 2 Im(x̄ x'); x̄' x' is real
        p, p_s, p_ss = (self._position(s, nu) for nu in range(3))
        return PosePoints(p, p_s, p_ss, Rotation.from_quat(x).as_matrix(), omega, omega_s)


class JointPath:
    """A path of the joints by a spline.

    Args:
        spline: SciPy spline on [0, 1] → (n,), rad.
    """

    def __init__(self, spline: BSpline) -> None:
        self._spline = spline

    @classmethod
    def through(cls, postures: npt.ArrayLike) -> JointPath:
        """Return the path through postures without stops, spaced by their distances.

        Args:
            postures: (m, n), start first and goal last, rad.

        Raises:
            InvalidInput: fewer than two postures, or two equal ones in a row.
        """
        q = arrays.check_array(postures, "postures", (None, None))
        if len(q) < 2:
            raise InvalidInput("postures", q, "at least two postures")
        distances = np.linalg.norm(np.diff(q, axis=0), axis=1)  # rad
        check_different(distances, q, "postures")
        return cls(_spline_through(np.concatenate([[0.0], np.cumsum(distances)]) / distances.sum(), q))

    @classmethod
    def straight(cls, q_start: Array, q_goal: Array) -> JointPath:
        """Return the straight line between two postures, which may be equal.

        Args:
            q_start: (n,) posture at s = 0, rad.
            q_goal: (n,) posture at s = 1, rad.
        """
        return cls(make_interp_spline([0.0, 1.0], np.array([q_start, q_goal]), k=1))

    def points(self, s: Array) -> JointPoints:
        """Return postures and derivatives.

        Args:
            s: (K,) path parameters, 0 to 1.
        """
        return JointPoints(*(self._spline(s, nu) for nu in range(3)))


def knot_grid(intervals: int) -> Array:
    """Return path parameters (intervals + 1,) from 0 to 1, denser towards both ends.

    They are even in time for a motion that accelerates evenly up to the middle and then brakes.

    Args:
        intervals: number of intervals.
    """
    fields.check_integer(intervals, "intervals", minimum=2, maximum=_MAX_INTERVALS)
    s = (1.0 - np.cos(np.pi * np.arange(intervals + 1) / intervals)) / 2.0
    s[-1] = 1.0
    return arrays.freeze(s)


def _spline_through(s: Array, values: Array) -> BSpline:
    """Return a spline whose second and third derivatives are zero at both ends; through two values it is straight."""
    zero = np.zeros(values.shape[1])
    ends = [(2, zero), (3, zero)]
    return make_interp_spline(s, values, k=_DEGREE, bc_type=(ends, ends))


def _check_pose(p: npt.ArrayLike, R: npt.ArrayLike, name: str) -> tuple[Array, Array]:
    """Return a checked position, and a rotation matrix that is exact to rounding."""
    return arrays.check_array(p, f"p_{name}", (3,)), Rotation.from_matrix(arrays.check_rotation(R, f"R_{name}")).as_matrix()


def _rotation_integral(turn: Array, s: Array) -> Array:
    """Return the integrals of exp(σ [turn]×) over σ from 0 to s (K, 3, 3).

    They are s 1 + (1 − cos θ)/‖turn‖ S + (s − sin θ/‖turn‖) S², with θ = s ‖turn‖ and S = [turn]×/‖turn‖.
    """
    angle = float(np.linalg.norm(turn))
    if angle < 1e-12:
        return np.asarray(s[:, None, None] * np.eye(3))
    S = skew(turn / angle)
    theta = s * angle
    linear, quadratic = (1.0 - np.cos(theta)) / angle, s - np.sin(theta) / angle
    return np.asarray(s[:, None, None] * np.eye(3) + linear[:, None, None] * S + quadratic[:, None, None] * (S @ S))


def _dot(x: Array, y: Array) -> Array:
    """Return inner products (K, 1) of rows."""
    return np.asarray((x * y).sum(axis=1)[:, None])


def _imaginary(x: Array, y: Array) -> Array:
    """Return Im(x̄ y) (K, 3) of quaternions (x, y, z, w)."""
    return np.asarray(x[:, 3:] * y[:, :3] - y[:, 3:] * x[:, :3] - np.cross(x[:, :3], y[:, :3]))

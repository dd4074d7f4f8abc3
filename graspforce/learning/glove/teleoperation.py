"""Teleoperation: an operator's poses, at the rate of a glove and with errors, become a smooth desired motion.

The operator's fingertips move a virtual object: its displacement is the rigid motion that fits them best. The desired motion
follows this pose by the law of a critically damped oscillator,

    a = ω² (p* − p) − 2 ω v,

and the same for the rotation, with limits of speed, acceleration and displacement. The controller of the object chooses and
certifies the forces, as for any desired motion: the operator moves the object, and never the forces.

A hand without an object, in the approach to one, follows the operator's postures by the same law in each joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.control.joints.joint_command import JointMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.geometry.rotations import rotation_exp, rotation_log
from graspforce.hand.hand import Hand


@dataclass(frozen=True, slots=True)
class TeleoperationLimits:
    """Limits of the desired motion.

    Args:
        frequency: ω, rad/s, > 0. Lower values smooth more and follow later.
        travel: largest displacement from the start, m, > 0. Choose it by `travel_limits` of the grasp.
        turn: largest rotation from the start, rad, ≥ 0 and below π.
        speed: largest speed, m/s, > 0.
        acceleration: largest acceleration, m/s², > 0.
        turn_rate: largest rate of rotation, rad/s, > 0.
        turn_acceleration: largest angular acceleration, rad/s², > 0.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    frequency: float = 10.0
    travel: float = 0.005
    turn: float = 0.0
    speed: float = 0.05
    acceleration: float = 0.5
    turn_rate: float = 0.5
    turn_acceleration: float = 5.0

    def __post_init__(self) -> None:
        for name in ("frequency", "travel", "speed", "acceleration", "turn_rate", "turn_acceleration"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        turn = arrays.check_number(self.turn, "turn", minimum=0.0)
        if turn >= np.pi:
            raise InvalidInput("turn", turn, "below π")
        set_fields(self, turn=turn)


class TeleoperationFilter:
    """Turns an operator's poses into the desired motion of a held object.

    Args:
        start: pose of the object at the start, at rest.
        limits: limits of the desired motion.

    Attributes:
        motion: the desired motion of the last step.
    """

    def __init__(self, start: BodyMotion, limits: TeleoperationLimits | None = None) -> None:
        self._limits = TeleoperationLimits() if limits is None else limits
        self._start = self.motion = BodyMotion(start.p_HO, start.R_HO)
        self._p, self._turn = np.array(start.p_HO), np.zeros(3)

    def command(self, p_HO: npt.ArrayLike, R_HO: npt.ArrayLike | None = None) -> None:
        """Set the operator's pose of the object; it is cut to the limits of displacement and rotation.

        Args:
            p_HO: (3,) position in H, m.
            R_HO: (3, 3) axes in H; None for those of the start.

        Raises:
            InvalidInput: not a pose.
        """
        shift = arrays.check_array(p_HO, "p_HO", (3,)) - self._start.p_HO
        self._p = self._start.p_HO + _shortened(shift, self._limits.travel)
        if R_HO is None:
            self._turn = np.zeros(3)
        else:
            R = arrays.check_rotation(R_HO, "R_HO")
            self._turn = _shortened(np.array(rotation_log(R @ self._start.R_HO.T)), self._limits.turn)

    def step(self, dt: float) -> BodyMotion:
        """Return the desired motion of the next control period.

        Args:
            dt: the period, s, > 0 and below 1/ω.

        Raises:
            InvalidInput: another period.
        """
        limits, now = self._limits, self.motion
        dt = _checked_period(dt, limits.frequency)
        R_goal = rotation_exp(self._turn) @ self._start.R_HO
        errors = self._p - now.p_HO, np.array(rotation_log(R_goal @ now.R_HO.T))
        bounds = (limits.speed, limits.acceleration), (limits.turn_rate, limits.turn_acceleration)
        v, a = np.zeros(6), np.zeros(6)
        for k, (error, (fastest, strongest)) in enumerate(zip(errors, bounds, strict=True)):
            own = slice(3 * k, 3 * k + 3)
            wanted = limits.frequency**2 * error - 2.0 * limits.frequency * now.twist[own]
            v[own] = _shortened(now.twist[own] + dt * _shortened(wanted, strongest), fastest)
            a[own] = (v[own] - now.twist[own]) / dt
        R = rotation_exp(dt * v[3:]) @ now.R_HO
        self.motion = BodyMotion(now.p_HO + dt * v[:3], R, v, a)
        return self.motion


@dataclass(frozen=True, slots=True)
class ApproachLimits:
    """Limits of the desired joint motion.

    Args:
        frequency: ω, rad/s, > 0. Lower values smooth more and follow later.
        speed: largest rate of each joint, rad/s, > 0; that of the hand's description also holds.
        acceleration: largest acceleration of each joint, rad/s², > 0.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    frequency: float = 10.0
    speed: float = 2.0
    acceleration: float = 40.0

    def __post_init__(self) -> None:
        for name in ("frequency", "speed", "acceleration"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})


class PostureFilter:
    """Turns an operator's postures into the desired joint motion of a hand without an object.

    Args:
        hand: the hand.
        q_start: (n,) posture at the start, at rest, rad; neutral by default.
        limits: limits of the desired motion.

    Attributes:
        motion: the desired motion of the last step.

    Raises:
        InvalidInput: not a posture of the hand.
    """

    def __init__(self, hand: Hand, q_start: npt.ArrayLike | None = None, limits: ApproachLimits | None = None) -> None:
        self._limits = ApproachLimits() if limits is None else limits
        self._lower, self._upper = hand.q_lower, hand.q_upper
        self._fastest = np.minimum(hand.velocity_limit, self._limits.speed)
        q = hand.neutral if q_start is None else arrays.check_array(q_start, "q_start", (hand.n,))
        self._q = np.clip(q, self._lower, self._upper)
        self.motion = JointMotion(self._q)

    def command(self, q: npt.ArrayLike) -> None:
        """Set the operator's posture; it is cut to the joint limits.

        Args:
            q: (n,) joint positions, rad.

        Raises:
            InvalidInput: not a posture of the hand.
        """
        self._q = np.clip(arrays.check_array(q, "q", self._lower.shape), self._lower, self._upper)

    def step(self, dt: float) -> JointMotion:
        """Return the desired motion of the next control period.

        Args:
            dt: the period, s, > 0 and below 1/ω.

        Raises:
            InvalidInput: another period.
        """
        limits, now = self._limits, self.motion
        dt = _checked_period(dt, limits.frequency)
        wanted = limits.frequency**2 * (self._q - now.q) - 2.0 * limits.frequency * now.v
        a = np.clip(wanted, -limits.acceleration, limits.acceleration)
        v = np.clip(now.v + dt * a, -self._fastest, self._fastest)
        q = np.clip(now.q + dt * v, self._lower, self._upper)
        v = (q - now.q) / dt
        self.motion = JointMotion(freeze(q), freeze(v), freeze((v - now.v) / dt))
        return self.motion


def virtual_object(start: BodyMotion, tips_start: npt.ArrayLike, tips: npt.ArrayLike, gain: float = 1.0) -> tuple[Array, Array]:
    """Return the pose (p_HO, R_HO) of an object that moves with fingertips as a rigid body.

    Args:
        start: pose of the object at the start.
        tips_start: (F, 3) fingertips at the start in H, m, F ≥ 3, not in line.
        tips: (F, 3) fingertips now, m.
        gain: factor of the displacement, > 0; below 1 for fine motion.

    Raises:
        InvalidInput: an argument is not allowed.
    """
    from scipy.spatial.transform import Rotation  # imported here to keep the package fast to import

    a = arrays.check_array(tips_start, "tips_start", (None, 3))
    b = arrays.check_array(tips, "tips", (len(a), 3))
    gain = arrays.check_number(gain, "gain", above=0.0)
    x, y = a - a.mean(axis=0), b - b.mean(axis=0)
    if len(a) < 3 or np.linalg.svd(x, compute_uv=False)[1] < 1e-6:
        raise InvalidInput("tips_start", a, "at least three fingertips that are not in line")
    R = Rotation.align_vectors(y, x)[0].as_matrix()
    shift = b.mean(axis=0) - a.mean(axis=0) + (R - np.eye(3)) @ (start.p_HO - a.mean(axis=0))
    turned = rotation_exp(gain * np.array(rotation_log(R))) @ start.R_HO
    return freeze(start.p_HO + gain * shift), freeze(turned)


def _checked_period(dt: float, frequency: float) -> float:
    """Return a period, s, below the time constant of a frequency, rad/s."""
    dt = arrays.check_number(dt, "dt", above=0.0)
    if dt * frequency >= 1.0:
        raise InvalidInput("dt", dt, f"below {1.0 / frequency:g} s, the time constant")
    return dt


def _shortened(v: Array, longest: float) -> Array:
    """Return a vector, shortened to a length."""
    length = float(np.linalg.norm(v))
    return v if length <= longest else np.asarray(v * (longest / length))

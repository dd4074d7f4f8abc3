"""Servo of the fingers: computed torque on filtered encoders, with a bound on the force of each fingertip.

The filter of the joints gives positions q, rates v, and the acceleration d of disturbances. With the desired motion q_d, v_d,
a_d, the feedback is

    a_f = k_p (q_d − q) + k_d (v_d − v),     tau = M (a_d + s a_f) + c(q, v) + g(q) + friction(v_d).

The factor s ≤ 1 of each finger bounds its feedback as a force F at the tip, ‖F‖ ≤ F_max, where F is the force that accelerates
the tip as the feedback does, F = (J M⁻¹ Jᵀ)⁻¹ J a_f (Khatib 1987). The rest of the feedback moves the joints and not the tip.
So a finger that meets the object pushes with F_max at most, however far its desired position is inside. Fingers that share
joints, such as those of a wrist, have the same factor, the least one: other factors would change the directions of their tips.

The friction levels are those of `FrictionObserver`, which learns them while the fingers move without contact. Joints of free
fingers away from the goal get the friction of a motion towards it, too. Beside the planned motion, friction is learned from
joints that rest only: too much compensation makes a joint swing about its goal, and learning from swings would increase it.

`ForceBounds` bounds the parts of F along a direction and across it on their own. A joint that sticks by static friction leads
the tip away from its line; the force across the line that moves this joint then does not depend on the bound along it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.control.friction.disturbance_observer import FrictionObserver, ObserverTimes
from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.sensor_gains import LoopTargets, fastest_loop
from graspforce.core.arrays import Array, freeze
from graspforce.estimation.joints.joint_filter import JointFilter, JointFilterMemory
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.estimation.settings import EstimatorSettings
from graspforce.hand.drives.joint_friction import SMOOTHING_RATE
from graspforce.hand.hand import Hand

_LARGEST_FRICTION = 0.3  # of each motor's torque: bound of the observed levels
_PULL_RATE = 10.0  # 1/s, by the error beyond the band of rest: rate of the motion whose friction is compensated
_RESTING_RATE = 0.1  # rad/s: estimated rate below which static friction may hold a joint
_RANK = 1e-8  # m²/rad²: added to J Jᵀ, so that a stretched finger has a finite force
_MOBILITY_RANK = 1e-6  # of its mean diagonal: the same for J M⁻¹ Jᵀ


class ForceBounds(NamedTuple):
    """Bounds of the feedback of N fingers as a force at the tip, along a direction and across it.

    Attributes:
        normals: (N, 3) directions in H, unit vectors.
        along: (N,) largest force along them, N.
        across: (N,) largest force across them, N.
    """

    normals: Array
    along: Array
    across: Array


@dataclass(frozen=True, eq=False, slots=True)
class ServoMemory:
    """Memory of the servo between two steps.

    Attributes:
        joints: memory of the joint filter.
        acceleration: (n,) acceleration of the last command, rad/s².
        friction: (n,) observed levels of Coulomb friction, N·m.
    """

    joints: JointFilterMemory
    acceleration: Array
    friction: Array


@dataclass(frozen=True, eq=False, slots=True)
class ServoStep:
    """Result of a step of the servo.

    Attributes:
        tau: (n,) torques within the motors' limits, N·m.
        q: (n,) estimated joint positions when the torque acts, rad.
        v: (n,) estimated joint rates, rad/s.
        p_tip: (N, 3) positions of the fingertips of the grasp, in H, m; zero if the servo only observes, like the forces.
        f_disturbance: (N, 3) force on each fingertip that explains the disturbance of its joints, in H, N.
        f_feedback: (N, 3) feedback as a force of each fingertip, in H, N.
    """

    tau: Array
    q: Array
    v: Array
    p_tip: Array
    f_disturbance: Array
    f_feedback: Array


class FingerServo:
    """Servo of all joints of a hand. It has no memory of its own.

    Args:
        hand: the hand.
        fingers: fingers whose tip forces are bounded.
        sensors: noise, rate and latency of the encoders.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        largest_rate: largest rate of the double pole, rad/s.
        rest_band: error that static friction may leave in a free finger at rest, rad, or m for prismatic joints; one for each
            joint, or one for all.

    Raises:
        InvalidInput: no gains are stable with these sensors.
        UnknownName: the hand has no finger of that name.
    """

    def __init__(
        self,
        hand: Hand,
        fingers: Sequence[str],
        sensors: SensorModel,
        gravity_H: Array,
        largest_rate: float,
        rest_band: float | Array,
    ) -> None:
        sensors = sensors.with_delay(hand.drives.delay)
        self.hand, self.period = hand, 1.0 / sensors.rate
        self._rest_band = rest_band
        self._gravity, self._tips = gravity_H, [hand.frame_id(name) for name in fingers]
        self._joints = [list(hand.finger(name).joints) for name in fingers]
        self._groups = _coupled_fingers(hand, fingers)
        gains, self.margins = fastest_loop(sensors, self.period, LoopTargets(largest_rate=largest_rate))
        self._kp, self._kd = gains.kp, gains.kd
        self._filter = JointFilter(hand.n, sensors, EstimatorSettings(), self.period)
        share = hand.torque_upper / hand.torque_upper.mean()
        self._observer = FrictionObserver(share, _LARGEST_FRICTION * hand.torque_upper, ObserverTimes(), self.period)

    def initial_memory(self, measurement: Measurement) -> ServoMemory:
        """Return the memory before the first step.

        Args:
            measurement: the first measurement.
        """
        joints = self._filter.initial_memory(measurement.t, measurement.q, measurement.v)
        coulomb = np.minimum(np.nan_to_num(self.hand.friction.coulomb), self._observer.largest)
        return ServoMemory(joints, freeze(np.zeros(self.hand.n)), freeze(coulomb))

    def observe(self, memory: ServoMemory, measurement: Measurement) -> tuple[ServoStep, ServoMemory]:
        """Follow the joints while other torques act, and return the step without torques of the servo.

        Args:
            memory: memory after the last step.
            measurement: the newest measurement.

        Raises:
            InvalidInput: the measurement is earlier than the last one.
        """
        x, joints = self._filter.step(memory.joints, measurement.t, measurement.q, measurement.v, None)
        q, v, _ = x
        none = np.zeros((len(self._tips), 3))
        return ServoStep(freeze(np.zeros(len(q))), q, v, none, none, none), replace(memory, joints=joints)

    def step(
        self,
        memory: ServoMemory,
        measurement: Measurement,
        desired: JointMotion,
        largest_force: Array | ForceBounds,
        *,
        is_free: npt.ArrayLike = False,
        learns: bool = True,
        predicted: bool = True,
    ) -> tuple[ServoStep, ServoMemory]:
        """Compute the torques of a period.

        Args:
            memory: memory after the last step.
            measurement: the newest measurement.
            desired: desired motion of the joints when the torque acts.
            largest_force: (N,) bound of the feedback of each finger at its tip, N; or bounds by direction.
            is_free: whether no finger touches, or (N,) whether each one touches nothing: the friction of its joints is then
                compensated towards the desired posture, too.
            learns: whether the levels of friction of free fingers are learned. Forces of contacts would be taken for
                friction.
            predicted: whether the servo's own torques acted in the last period, so that they predict the joints.

        Raises:
            InvalidInput: the measurement is earlier than the last one.
        """
        acted = memory.acceleration if predicted else None
        x, joints = self._filter.step(memory.joints, measurement.t, measurement.q, measurement.v, acted)
        q, v, d = x
        M = self.hand.model.mass_matrix(q)
        p_tip, J = (each[0] for each in self.hand.model.frame_jacobians(q[None], self._tips))
        a_f = self._kp * (desired.q - q) + self._kd * (desired.v - v)
        torque_d = M @ d
        bounded, forces = self._bounded_feedback(M, J[:, :3], a_f, largest_force)
        disturbances = []
        for i, own in enumerate(self._joints):
            J_i = J[i, :3][:, own]
            disturbances.append(np.linalg.solve(J_i @ J_i.T + _RANK * np.eye(3), J_i @ torque_d[own]))
        a = desired.a + np.linalg.solve(M, bounded)
        free = self._free_joints(np.broadcast_to(is_free, len(self._tips)))
        pull = np.where(free, self._pull(desired.q - q), 0.0)  # rad/s
        direction = np.tanh((desired.v + pull) / SMOOTHING_RATE)
        friction = memory.friction
        tau = self.hand.model.inverse_dynamics(q, v, a, self._gravity) + friction * direction
        tau = np.clip(tau, self.hand.torque_lower, self.hand.torque_upper)
        if free.any() and learns:
            pull = np.where(np.abs(v) < _RESTING_RATE, pull, 0.0)
            learned = self._observer.step(friction, np.tanh((desired.v + pull) / SMOOTHING_RATE), np.where(free, bounded, 0.0))
            friction = freeze(np.where(free, learned, friction))
        result = ServoStep(freeze(tau), q, v, freeze(p_tip), freeze(disturbances), freeze(forces))
        return result, ServoMemory(joints, freeze(a), friction)

    def _bounded_feedback(self, M: Array, J: Array, a_f: Array, largest: Array | ForceBounds) -> tuple[Array, Array]:
        """Return the feedback torques within the bounds, (n,) N·m, and their forces at the tips, (N, 3) N.

        Bounds by direction change the part of the torques that is a force at the tip; the other part stays.

        Args:
            M: (n, n) mass matrix.
            J: (N, 3, n) Jacobians of the fingertips.
            a_f: (n,) feedback accelerations, rad/s².
            largest: the bounds, as in `step`.
        """
        u, rows = M @ a_f, J.reshape(-1, len(a_f))
        mobility = rows @ np.linalg.solve(M, rows.T)
        mobility += _MOBILITY_RANK * mobility.trace() / len(mobility) * np.eye(len(mobility))
        force: Array = np.asarray(np.linalg.solve(mobility, rows @ a_f).reshape(-1, 3))  # N
        if isinstance(largest, ForceBounds):
            along = np.asarray(np.einsum("ij,ij->i", force, largest.normals)[:, None] * largest.normals)
            kept = _shortened(along, largest.along) + _shortened(np.asarray(force - along), largest.across)
            return u + rows.T @ (kept - force).ravel(), kept
        sizes, share = np.linalg.norm(force, axis=1), np.ones(len(u))
        for fingers, joints in self._groups:
            excess = float((sizes[fingers] / largest[fingers]).max())
            if excess > 1.0:
                share[joints] = 1.0 / excess
                force[fingers] /= excess
        return M @ (share * a_f), force

    def _free_joints(self, free: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return whether each joint may move alone, (n,): all joints, or those of free fingers that no other finger shares.

        Args:
            free: (N,) whether each finger touches nothing.
        """
        joints = np.full(self.hand.n, bool(free.all()))
        for i in np.flatnonzero(free):
            joints[self._joints[i]] = True
        for i in np.flatnonzero(~free):
            joints[self._joints[i]] = False
        return joints

    def _pull(self, error: Array) -> Array:
        """Return the rates towards the desired positions of joints that are outside the band of rest, rad/s.

        Friction against these rates is compensated, too: at the end of a motion the feedback of a light finger is less than the
        static friction of its joints. Within the band nothing changes, so that the joints do not oscillate.

        Args:
            error: (n,) desired less present positions, rad.
        """
        return _PULL_RATE * np.sign(error) * np.maximum(np.abs(error) - self._rest_band, 0.0)


def _coupled_fingers(hand: Hand, fingers: Sequence[str]) -> list[tuple[list[int], list[int]]]:
    """Return the groups of fingers that share joints, directly or through other fingers: indices of fingers, and their joints.

    Args:
        hand: the hand.
        fingers: the fingers to group; other fingers of the hand connect them, too.
    """
    connected: list[set[int]] = []  # joints
    for finger in hand.fingers:
        joints = set(finger.joints)
        apart = [each for each in connected if not each & joints]
        connected = [*apart, joints.union(*(each for each in connected if each & joints))]
    own = [set(hand.finger(name).joints) for name in fingers]
    groups = [[i for i, joints in enumerate(own) if joints & each] for each in connected]
    return [(group, sorted(set.union(*(own[i] for i in group)))) for group in groups if group]


def _shortened(forces: Array, largest: Array) -> Array:
    """Return forces (N, 3) with at most the sizes (N,) largest, N."""
    sizes = np.linalg.norm(forces, axis=1)
    with np.errstate(divide="ignore"):
        share = np.where(sizes > largest, largest / sizes, 1.0)
    return np.asarray(share[:, None] * forces)

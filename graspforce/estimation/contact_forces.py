"""Contact forces from joint torques, with or without fingertip force sensors.

Without contact the motors need tau_u = M q̈ + h(q, q̇). Contacts add Aᵀ f, so torques and joint motion determine the forces:

    Aᵀ f = tau − M (a + d) − h(q, q̇).

a is the commanded joint acceleration, and d the deviation from it that the joint filter estimates from the encoders. Torque
observers with the generalised momentum (De Luca and Mattone, 2005) estimate the same quantity; here the filter of the joints is
the observer, so its gains do not depend on the posture.

Fingertip sensors measure f directly. Both sources are fused by least squares with their covariances: with the measured f_s, the
torques that f_s does not explain correct it, f = f_s + K (tau − M (a + d) − h − Aᵀ f_s). Errors are of two kinds:
noise, independent between periods, and bias, constant for seconds, such as joint friction without compensation. Averages reduce
noise only, so both covariances are reported.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.core.settings_record import SettingsRecord
from graspforce.estimation.pose.contact_pose import ARM, ContactPose
from graspforce.estimation.sensor_model import SensorModel
from graspforce.geometry.vectors import skew
from graspforce.grasp.grasp import Grasp

_REFRESH_STEPS = 64  # periods between two computations of the gains, which change with posture and forces only
_CHECK_STEPS = 8  # periods between two checks of the posture
_MAX_TURN = 0.01  # rad: change of a joint after which the gains are computed anew
_LEAST_TORQUE_NOISE = 1e-5  # N·m; a noise of zero would make the gains singular
_LEAST_TIP_NOISE = 1e-4  # N
_NO_FORCE = 1e-3  # of the expected size of a force: components that a frictionless contact does not transmit


@dataclass(frozen=True, slots=True)
class ForceModelErrors(SettingsRecord):
    """Constant errors of the quantities from which contact forces are estimated, as standard deviations.

    Args:
        torque_bias: of a joint torque, N·m, such as friction without compensation.
        torque_scale: of a joint torque relative to its value, such as from the torque constant of a motor.
        tip_bias: of a component of a fingertip force, N.
        tip_scale: of a fingertip force relative to its value.
        contact_place: of a contact's position along each tangent, m. It affects the forces from torques.
        force_size: expected size of a component of a contact force, N. It bounds components that no measurement determines.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    RECORD: ClassVar[str] = "force_errors"

    torque_bias: float = 0.0
    torque_scale: float = 0.0
    tip_bias: float = 0.0
    tip_scale: float = 0.0
    contact_place: float = 0.0
    force_size: float = 20.0

    def __post_init__(self) -> None:
        for each in dataclasses.fields(self):
            value = arrays.check_number(getattr(self, each.name), each.name, minimum=0.0)
            set_fields(self, **{each.name: value})
        if self.force_size == 0.0:
            raise InvalidInput("force_size", self.force_size, "greater than 0")


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Estimated forces of N fingers on the object.

    Attributes:
        f: (N, 3) forces (f_t1, f_t2, f_n) in the contact frames, N.
        noise: (3 N, 3 N) covariance of the errors that are independent between periods, N².
        bias: (3 N, 3 N) covariance of the constant errors, N².
        inertial: (N, 3) part of the forces from the deviation d of the joint accelerations, N. In fast motion the filter of the
            joints lags, and forces from torques have an error of this size.
        mismatch: (N, 3) forces of the fingertip sensors less those that the torques give if the joints accelerate as commanded,
            N. It shows unexpected motion before the encoders do. None without fingertip sensors.
        mismatch_noise: (N, 3, 3) covariance of the noise of `mismatch`, N².
        measured: (N, 3) forces of the fingertip sensors alone, N; None without them. Accelerations do not affect them.
        measured_variance: variances of their noise and of their constant error, in a component, N².
    """

    f: Array
    noise: Array
    bias: Array
    inertial: Array
    mismatch: Array | None
    mismatch_noise: Array
    measured: Array | None = None
    measured_variance: tuple[float, float] = (0.0, 0.0)

    @property
    def covariance(self) -> Array:
        """(3 N, 3 N) covariance of the errors in one period, N²."""
        return np.asarray(self.noise + self.bias)


class ForceGains(NamedTuple):
    """Gains of the forces, and their covariances.

    Attributes:
        from_torque: (3 N, n) fused forces per torque residual, 1/m.
        from_tips: (3 N, 3 N) fused forces per measured fingertip force.
        inertia: (3 N, n) fused forces per deviation of a joint acceleration, kg·m.
        torque_only: (3 N, n) forces from torques alone, per torque residual, 1/m.
        noise: as in `ContactForces`.
        bias: as in `ContactForces`.
        mismatch_noise: as in `ContactForces`.
    """

    from_torque: Array
    from_tips: Array
    inertia: Array
    torque_only: Array
    noise: Array
    bias: Array
    mismatch_noise: Array


class ForceMemory(NamedTuple):
    """State of the estimator between two periods. It only spares computations.

    Attributes:
        gains: the gains; None before the first period.
        has_tips: whether they include fingertip sensors.
        age: periods since the gains were computed.
        q: (n,) joint positions for which they were computed, rad; None before the first period.
    """

    gains: ForceGains | None = None
    has_tips: bool = False
    age: int = 0
    q: Array | None = None


class ContactForceEstimator:
    """Estimator of the contact forces of a grasp. Call `step` once every period, after `GraspEstimator.step`.

    Args:
        grasp: hand, object and contacts.
        sensors: noise of torques and fingertip sensors. Without measured torques, pass the commanded torques.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        errors: constant errors of the model.
        disturbance_error: standard deviation of the estimated acceleration d, rad/s²; the root of `joint_covariance[2, 2]` of
            `GraspEstimate`.

    Attributes:
        measured_variance: variances of the noise and of the constant error of a component of a fingertip force, N².
    """

    def __init__(
        self,
        grasp: Grasp,
        sensors: SensorModel,
        gravity_H: Array,
        errors: ForceModelErrors | None = None,
        disturbance_error: float = 0.0,
    ) -> None:
        hand, contacts = grasp.hand, grasp.contacts
        self._hand, self._errors = hand, ForceModelErrors() if errors is None else errors
        self._gravity_H = arrays.check_array(gravity_H, "gravity_H", (3,))
        self._count, self._rest = len(contacts), freeze(np.zeros(hand.n))
        self._tips = [hand.frame_id(name) for name in grasp.fingers]
        self._torque_noise = max(sensors.torque_noise or 0.0, _LEAST_TORQUE_NOISE)
        self._tip_noise = max(sensors.tip_force_noise or 0.0, _LEAST_TIP_NOISE)
        self.measured_variance = (self._tip_noise**2, self._errors.tip_bias**2)  # N²
        self._disturbance_error = arrays.check_number(disturbance_error, "disturbance_error", minimum=0.0)
        has_friction = contacts.mu > 0.0
        size = self._errors.force_size * np.where(has_friction[:, None], [1.0, 1.0, 1.0], [_NO_FORCE, _NO_FORCE, 1.0])
        self._prior = 1.0 / np.square(size.ravel())  # 1/N²
        self._gamma = np.array(contacts.gamma)  # m

    def step(
        self,
        memory: ForceMemory,
        contacts: ContactPose,
        joints: Sequence[Array],
        tau: Array,
        acceleration: Array | None = None,
        tip_wrench: Array | None = None,
        free_torque: Array | None = None,
    ) -> tuple[ContactForces, ForceMemory]:
        """Return the contact forces of a period, and the memory for the next one.

        Args:
            memory: memory after the last period; `ForceMemory()` before the first.
            contacts: the contacts, from the estimator's memory.
            joints: (n,) joint positions, rad, rates, rad/s, and deviations d of the accelerations, rad/s².
            tau: (n,) joint torques during the last period, N·m, without joint friction.
            acceleration: (n,) joint acceleration commanded for that period, rad/s²; None for none.
            tip_wrench: (N, 6) measured forces and moments of the fingers on the object, in H, N and N·m; None without sensors.
            free_torque: (n,) torques tau_u of the hand's own motion with that acceleration, N·m. Default: computed here.
        """
        q, deviation = joints[0], joints[2]
        tau_u = self._free_torque(joints, acceleration) if free_torque is None else free_torque
        gains, memory = self._current_gains(memory, contacts, q, tau, tip_wrench)
        f_tips = None if tip_wrench is None else _in_contact_frames(contacts, tip_wrench)
        residual = tau - tau_u  # N·m
        mismatch = None
        if f_tips is not None:  # the gains are of an earlier posture: with present contacts, they act on a small rest only
            residual = residual - f_tips.dot(contacts.A.reshape(self._count, 4, -1)[:, :3].reshape(3 * self._count, -1))
            mismatch = -gains.torque_only.dot(residual).reshape(-1, 3)
        inertial = gains.inertia.dot(deviation)
        f = gains.from_torque.dot(residual) - inertial
        if f_tips is not None:
            f += f_tips
        forces = ContactForces(
            f=f.reshape(-1, 3),
            noise=gains.noise,
            bias=gains.bias,
            inertial=inertial.reshape(-1, 3),
            mismatch=mismatch,
            mismatch_noise=gains.mismatch_noise,
            measured=None if f_tips is None else f_tips.reshape(-1, 3),
            measured_variance=self.measured_variance,
        )
        return forces, memory

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _free_torque(self, joints: Sequence[Array], acceleration: Array | None) -> Array:
        """Return the torques M a + h of the hand without contact, (n,), N·m."""
        q, v, _ = joints
        a = self._rest if acceleration is None else acceleration
        return self._hand.model.inverse_dynamics(q, v, a, self._gravity_H)

    def _current_gains(
        self, memory: ForceMemory, contacts: ContactPose, q: Array, tau: Array, tip_wrench: Array | None
    ) -> tuple[ForceGains, ForceMemory]:
        """Return the gains of a period, computed anew after a change of the posture or of the sensors, and the memory."""
        gains, last, age, has_tips = memory.gains, memory.q, memory.age + 1, tip_wrench is not None
        is_recent = gains is not None and has_tips == memory.has_tips and age < _REFRESH_STEPS
        if is_recent and last is not None and age % _CHECK_STEPS == 0:
            is_recent = max(map(abs, (q - last).tolist())) < _MAX_TURN
        if is_recent and gains is not None:
            return gains, ForceMemory(gains, has_tips, age, last)
        gains = self._gains(contacts, q, tau, tip_wrench)
        return gains, ForceMemory(gains, has_tips, 0, q)

    def _gains(self, contacts: ContactPose, q: Array, tau: Array, tip_wrench: Array | None) -> ForceGains:
        """Return the gains at the present contacts, by weighted least squares."""
        f_tips = None if tip_wrench is None else _in_contact_frames(contacts, tip_wrench)
        errors, n, rows = self._errors, len(q), 3 * self._count
        by_finger = contacts.A.reshape(self._count, 4, n)
        A = by_finger[:, :3].reshape(rows, n)
        M = self._hand.model.mass_matrix(q)
        noise = self._torque_noise**2 * np.eye(n) + self._disturbance_error**2 * M @ M  # (N·m)²
        bias: Array = np.diag(errors.torque_bias**2 + np.square(errors.torque_scale * tau))
        prior = np.diag(self._prior)
        weights = np.linalg.inv(noise + bias)
        information = A @ weights @ A.T + prior
        f = np.linalg.solve(information, A @ weights @ (tau if f_tips is None else A.T @ f_tips)).reshape(-1, 3)  # N, roughly
        bias = bias + self._place_covariance(contacts, q, f) + self._torsion_covariance(by_finger[:, 3], f)
        weights = np.linalg.inv(noise + bias)
        from_torque = A @ weights
        information = from_torque @ A.T + prior
        torque_only = np.linalg.solve(information, from_torque)
        tip_noise = self._tip_noise**2 * np.eye(rows)
        tip_bias: Array = np.zeros((rows, rows))
        from_tips: Array = np.zeros((rows, rows))
        if f_tips is not None:
            tip_bias = np.diag(errors.tip_bias**2 + np.square(errors.tip_scale * f_tips))
            from_tips = np.asarray(np.linalg.inv(tip_noise + tip_bias), np.float64)
            information = information + from_tips
        covariance = np.linalg.inv(information)
        from_torque, from_tips = covariance @ from_torque, covariance @ from_tips
        mismatch = (self._torque_noise**2 * torque_only @ torque_only.T + tip_noise).reshape(self._count, 3, self._count, 3)
        of_each = np.arange(self._count)
        return ForceGains(
            from_torque=from_torque,
            from_tips=from_tips,
            inertia=from_torque @ M,
            torque_only=torque_only,
            noise=freeze(from_torque @ noise @ from_torque.T + from_tips @ tip_noise @ from_tips.T),
            bias=freeze(
                from_torque @ bias @ from_torque.T + from_tips @ tip_bias @ from_tips.T + covariance @ prior @ covariance.T
            ),
            mismatch_noise=freeze(mismatch[of_each, :, of_each]),
        )

    def _place_covariance(self, contacts: ContactPose, q: Array, f: Array) -> Array:
        """Return the covariance (n, n) of the torques from errors of the contacts' positions, (N·m)².

        A force f at a contact that is δ further changes the torques by J_ωᵀ (δ × f).
        """
        n = len(q)
        if self._errors.contact_place == 0.0:
            return np.zeros((n, n))
        J = self._hand.model.tip_motion(q, np.zeros(n), self._tips).J
        R_HC = contacts.R_HO @ contacts.R_OC
        moments = R_HC @ skew(-f)[:, :, :2]  # (N, 3, 2): δ × f for unit displacements along t₁ and t₂, N, in H
        changes = (J[:, 3:].transpose(0, 2, 1) @ moments).transpose(1, 0, 2).reshape(n, -1)
        return np.asarray(self._errors.contact_place**2 * changes @ changes.T)

    def _torsion_covariance(self, spins: Array, f: Array) -> Array:
        """Return the covariance (n, n) of the torques from unknown moments about the normals, up to γ f_n, (N·m)²."""
        moments = self._gamma * np.maximum(f[:, 2], 0.0) / ARM  # N: `spins` are speeds at this distance from n
        rows = moments[:, None] * spins
        return np.asarray(rows.T @ rows)


def _in_contact_frames(contacts: ContactPose, tip_wrench: Array) -> Array:
    """Return measured fingertip forces (N, 6) in H as forces in the contact frames, (3 N,), N."""
    R_HC = np.matmul(contacts.R_HO, contacts.R_OC)
    return np.asarray(np.matmul(tip_wrench[:, None, :3], R_HC).ravel())


def contact_wrench(contacts: ContactPose, f: Array) -> Array:
    """Return the wrench of all contacts on the object, w = G f, (6,) about O's origin, in O, N and N·m.

    Args:
        contacts: the contacts.
        f: (N, 3) contact forces in the contact frames, N.
    """
    padded = np.zeros((len(f), 4))
    padded[:, :3] = f
    return np.asarray(padded.ravel().dot(contacts.B))


def wrench_covariances(contacts: ContactPose, forces: ContactForces) -> tuple[Array, Array]:
    """Return the covariances (6, 6) of the noise and of the constant error of `contact_wrench`, N² to (N·m)².

    Args:
        contacts: the contacts.
        forces: the contact forces.
    """
    B = contacts.B.reshape(-1, 4, 6)[:, :3].reshape(-1, 6)
    return np.asarray(B.T @ forces.noise @ B), np.asarray(B.T @ forces.bias @ B)

"""Slip of fingertips over the object, from their relative motion and from forces.

**Motion.** Rolling contact keeps three quantities of each contact constant: the accumulated slip along t₁ and t₂, and the gap
along n. Measured joint positions, and a measured pose of the object if there is one, give them with the covariance

    Σ = A Σ_q Aᵀ + B Σ_x Bᵀ.

Without a measured pose, only those changes count that no motion of the object explains. Slip of finger i changes its two
tangential rows. Its best estimate ŝ_i with the covariance P_i follows by weighted least squares, and ŝ_iᵀ P_i⁻¹ ŝ_i has a χ²
distribution with two degrees of freedom without slip (generalised likelihood ratio; Basseville and Nikiforov, 1993). Means over
several windows, less the mean over a long time, are tested: short windows find fast slip, long ones small slip. Constant errors
of pose and contacts cancel in the difference.

**Forces.** Fingertip sensors show unexpected motion at once, by forces that differ from those of the torques. While they do, a
lower threshold holds for the motion, and slip of all fingers together is tested, too: it looks like a motion of the object, so
that the test of each finger alone finds it late. A contact whose force reaches the friction limit, ‖f_t‖ ≥ c μ f_n, is reported
beside.

The thresholds follow from the wanted time between two false alarms: P(χ²₂ > x) = exp(−x/2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from graspforce.contact.compiled_kinematics import slip_displacement
from graspforce.core.arrays import Array, freeze
from graspforce.core.records import unchecked_constructor
from graspforce.estimation.contact_forces import ContactForces
from graspforce.estimation.measurement import PoseMeasurement
from graspforce.estimation.pose.contact_pose import ContactPose
from graspforce.estimation.sensor_model import CameraModel, SensorModel
from graspforce.estimation.slip.slip_forces import ForceEvidence
from graspforce.estimation.slip.slip_memory import MotionTest, SlipBlocks, SlipMemory
from graspforce.estimation.slip.slip_settings import SlipSettings
from graspforce.estimation.slip.slip_statistics import SlipTest, WindowGains, WindowMeans, make_slip_test
from graspforce.geometry.rotations import rotation_log

REFRESH_STEPS = 64  # residuals between two computations of a test, which changes with the posture
_STARTING_STEPS = {2, 4, 8, 16, 32, 64, 128, 256, 512}  # residuals from the start after which it is computed in any case
_ANCHOR_STEPS = 50  # periods after which slip is measured from new contacts; they roll by a small angle in this time
RESTART_WINDOW = 1  # index of the window whose mean is the baseline after an alarm
_FRESH_POSE_TIME = 0.005  # s: no test without the pose is needed after a pose
ALERT_TIME = 0.03  # s for which forces count as unexpected
LEAST_STICKING = 2  # fingers that determine the object's pose, with the normals of the others
_LEAST_ENCODER_NOISE = 1e-6  # rad; a noise of zero would make the tests singular
NO_STATISTICS = freeze(np.zeros(0))

Flags = npt.NDArray[np.bool_]


class SlipInputs(NamedTuple):
    """Inputs of one period of the slip detector.

    Attributes:
        t: time, s.
        contacts: the contacts, from the memory of `GraspEstimator`.
        joint_error: (n,) measured less estimated joint positions, rad.
        pose_error: (6,) measured less estimated pose of the object, from `pose_error`; None if no pose arrived.
        forces: contact forces; None if they are not estimated.
        mu: (N,) friction coefficients at which slip is expected; None if they are not known.
    """

    t: float
    contacts: ContactPose
    joint_error: Array
    pose_error: Array | None = None
    forces: ContactForces | None = None
    mu: Array | None = None


@dataclass(frozen=True, eq=False, slots=True)
class SlipEstimate:
    """Slip of N fingertips in one period.

    Attributes:
        slipping: (N,) whether a finger slips, or did so within the hold time.
        alarms: (N,) whether slip of a finger was found in this period.
        evident: (N,) whether the motion shows slip of a finger surely, now or within the hold time: above the threshold without
            unexpected forces, whatever the motion of the object, and even if any other finger slips, too. Such a finger does
            not determine the object's pose. None if fewer than two others would remain: they could not determine it either.
        at_limit: (N,) whether a contact force is at its friction limit; needs fingertip sensors.
        distance: (N, 2) slip along t₁ and t₂ at the last alarm of each finger, relative to the baseline, m.
        statistics: (K N,) statistics of the motion by window and finger; χ² with two degrees of freedom without slip. Empty in
            a period without residuals.
        threshold: statistic from which a finger counts as slipping.
        force_alert: whether forces are unexpected.
        has_alarm: whether slip of any finger was found in this period.
        is_certain: whether the fingers of the last alarm are certain: no other finger is nearly as likely.
    """

    slipping: Flags
    alarms: Flags
    evident: Flags
    at_limit: Flags
    distance: Array
    statistics: Array
    threshold: float
    force_alert: bool
    has_alarm: bool
    is_certain: bool


def pose_error(measured: PoseMeasurement, p_HO: Array, R_HO: Array) -> Array:
    """Return the measured less the estimated pose of the object as a small motion in O.

    Args:
        measured: measured pose.
        p_HO: (3,) position estimated for the time of the measurement, in H, m.
        R_HO: (3, 3) axes estimated for that time, in H.

    Returns:
        (6,) m and rad.
    """
    return pose_difference((measured.p_HO, measured.R_HO), (p_HO, R_HO))


def pose_difference(first: tuple[Array, Array], second: tuple[Array, Array]) -> Array:
    """Return one pose less another as a small motion in the axes of the second, (6,) m and rad.

    Args:
        first: position (3,), m, and axes (3, 3).
        second: the same of the second pose.
    """
    rotation = rotation_log(first[1] @ second[1].T)
    return np.asarray((np.array([first[0] - second[0], rotation]) @ second[1]).ravel())


class SlipDetector:
    """Detector of slip. Call `step` once every period.

    Args:
        count: number N of contacts.
        sensors: noise of encoders and camera.
        period: time between two steps, s.
        settings: windows, thresholds and errors of the model.
    """

    def __init__(self, count: int, sensors: SensorModel, period: float, settings: SlipSettings | None = None) -> None:
        self.settings = settings = SlipSettings() if settings is None else settings
        self._count, self._period, self._times = count, period, np.array([*settings.windows, settings.baseline])
        self._encoder_noise = max(sensors.encoder_noise, _LEAST_ENCODER_NOISE) ** 2  # rad²
        self._encoder_bias = sensors.encoder_resolution**2 / 12.0  # rad²: constant at rest
        camera = sensors.camera or CameraModel()
        self._pose_noise = np.diag(np.repeat([camera.position_noise**2, camera.angle_noise**2], 3))
        self._compliance = np.tile(np.square([settings.tangential_compliance] * 2 + [settings.compliance]), count)  # m²
        self._gains = WindowGains.for_step(self._times, period)
        test_rate = count * len(settings.windows) / period  # 1/s
        self._threshold = 2.0 * math.log(test_rate * settings.false_alarm_interval)
        self._alert_threshold = 2.0 * math.log(test_rate * settings.alert_interval)
        self._joint_threshold = float(chdtri(2 * count, math.exp(-0.5 * self._alert_threshold)))
        self._force_threshold = float(chdtri(3 * count, period / settings.false_alarm_interval))
        self._evidence = ForceEvidence(period, settings.limit_ratio, settings.limit_reserve)
        self._no_flags = np.zeros(count, bool)
        self._no_flags.setflags(write=False)

    def initial_memory(self, contacts: ContactPose) -> SlipMemory | SlipBlocks:
        """Return the memory before the first step.

        Args:
            contacts: the contacts at the start.
        """
        nothing, never = freeze(np.zeros((self._count, 2))), freeze(np.full(self._count, -np.inf))
        return SlipMemory(
            contacts.tip_contacts,
            contacts.R_OC,
            nothing,
            0,
            None,
            None,
            None,
            -math.inf,
            -math.inf,
            never,
            never,
            nothing,
            False,
            freeze(np.zeros(3 * self._count)),
            0.0,
        )

    def step(self, memory: SlipMemory | SlipBlocks, inputs: SlipInputs) -> tuple[SlipEstimate, SlipMemory | SlipBlocks]:
        """Return the slip of a period, and the memory for the next one.

        Args:
            memory: memory after the last period; `initial_memory` before the first.
            inputs: contacts, errors and forces of the period.
        """
        assert isinstance(memory, SlipMemory)  # `initial_memory` makes no other
        contacts, t = inputs.contacts, inputs.t
        tips, anchor, anchor_slip, anchor_age = contacts.tip_contacts, memory.anchor, memory.slip, memory.anchor_age + 1
        since, until = slip_displacement(anchor, tips, contacts.R_OC), slip_displacement(tips, anchor, memory.R_OC)
        slip = anchor_slip + 0.5 * (since - until)  # m
        R_OC = memory.R_OC
        if anchor_age >= _ANCHOR_STEPS:
            anchor, R_OC, anchor_slip, anchor_age = tips, contacts.R_OC, slip, 0

        y = contacts.A.dot(inputs.joint_error)
        by_contact = y.reshape(-1, 4)
        by_contact[:, :2] += slip
        by_contact[:, 2] -= contacts.gap
        residual = by_contact[:, :3].ravel()
        contact_test, pose_test, test = memory.contact_test, memory.pose_test, None
        if inputs.pose_error is not None:
            y -= contacts.B.dot(inputs.pose_error)
            test = pose_test = self._updated(pose_test, t, y, contacts, has_pose=True)
        elif pose_test is None or t - pose_test.t > _FRESH_POSE_TIME:
            test = contact_test = self._updated(contact_test, t, y, contacts, has_pose=False)

        forces, alert_until, at_limit, statistic = memory.forces, memory.alert_until, self._no_flags, 0.0
        if inputs.forces is not None and inputs.forces.mismatch is not None:
            statistic, forces = self._evidence.step(forces, inputs.forces)
            if statistic > self._force_threshold:
                alert_until = t + ALERT_TIME
            if inputs.mu is not None:
                flags = self._evidence.at_limit(forces, inputs.forces, inputs.mu)
                at_limit = np.array(flags) if True in flags else at_limit
        memory = SlipMemory(
            anchor, R_OC, anchor_slip, anchor_age, contact_test, pose_test, forces, alert_until,
            memory.last_alarm, memory.alarm, memory.evident, memory.distance, memory.is_certain, residual, statistic,
        )  # fmt: skip
        return self._judged(memory, t, at_limit, test)

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _updated(self, last: MotionTest | None, t: float, y: Array, contacts: ContactPose, *, has_pose: bool) -> MotionTest:
        """Return a test of the motion after another residual."""
        if last is None or t - last.t > self.settings.baseline:
            means, place = WindowMeans.start(y, len(self._times)), contacts.tip_contacts.p_OC
            return MotionTest(t, means, self._test(means, contacts, place, has_pose=has_pose), 0, place)
        gains, elapsed = self._gains, t - last.t
        if elapsed <= 0.0:
            return last  # the same measurement again
        if abs(elapsed - self._period) > 1e-3 * self._period:
            gains = WindowGains.for_step(self._times, elapsed)
        means, age, test, place = last.means.updated(y, gains), last.age + 1, last.test, last.place
        if age >= REFRESH_STEPS or means.updates in _STARTING_STEPS:
            place = place - math.expm1(-age * elapsed / self.settings.baseline) * (contacts.tip_contacts.p_OC - place)
            test, age = self._test(means, contacts, place, has_pose=has_pose), 0
        return MotionTest(t, means, test, age, place)

    def _test(self, means: WindowMeans, contacts: ContactPose, place: Array, *, has_pose: bool) -> SlipTest:
        """Return the test at the present contacts, for means with their present variances."""
        count = self._count
        A = contacts.A.reshape(count, 4, -1)[:, :3].reshape(3 * count, -1)
        B = contacts.B.reshape(count, 4, 6)[:, :3].reshape(-1, 6)
        joints = A @ A.T
        path = np.square(contacts.tip_contacts.p_OC - place).sum(axis=1)  # m²
        path = np.repeat(path, 3)
        bias = np.diag(self._compliance + self.settings.rolling_error**2 * path) + self._encoder_bias * joints
        noise = self._encoder_noise * joints
        if has_pose:
            noise = noise + B @ self._pose_noise @ B.T
        return make_slip_test(
            noise, bias, means.variance, B, model_error=self.settings.evident_rolling_error**2 * path, has_pose=has_pose
        )

    def _judged(
        self, memory: SlipMemory, t: float, at_limit: Flags, test: MotionTest | None
    ) -> tuple[SlipEstimate, SlipMemory]:
        """Return the slip of a period from a test, and the memory with the alarms."""
        alert = t <= memory.alert_until
        threshold = self._alert_threshold if alert else self._threshold
        statistics, has_alarm, window = NO_STATISTICS, False, 0
        if test is not None:
            statistics = test.test.statistics(test.means)
            values = statistics.tolist()
            largest = max(values)
            if largest > threshold:
                has_alarm, window = True, values.index(largest) // self._count
            elif alert:
                joint = test.test.joint_statistics(test.means).tolist()
                has_alarm, window = max(joint) > self._joint_threshold, joint.index(max(joint))
            if has_alarm:
                memory = self._with_alarm(memory, t, test, window, threshold)
        slipping = evident = self._no_flags
        if t - memory.last_alarm <= self.settings.hold_time:
            slipping, evident = (t - times <= self.settings.hold_time for times in (memory.alarm, memory.evident))
            if np.count_nonzero(evident) > self._count - LEAST_STICKING:
                evident = self._no_flags
        alarms = memory.alarm == t if has_alarm else self._no_flags
        estimate = make_estimate(
            slipping, alarms, evident, at_limit, memory.distance, statistics, threshold, alert, has_alarm, memory.is_certain
        )
        return estimate, memory

    def _with_alarm(self, memory: SlipMemory, t: float, chosen: MotionTest, window: int, threshold: float) -> SlipMemory:
        """Return the memory after an alarm: the slipping fingers, and tests that start anew from the present."""
        found = chosen.test.slipping_fingers(chosen.means, window, threshold)
        alarm, evident, distance = memory.alarm.copy(), memory.evident.copy(), memory.distance.copy()
        alarm[found.fingers], distance[found.fingers] = t, found.distances
        evident[[i for i, statistic in zip(found.fingers, found.evidence, strict=True) if statistic > self._threshold]] = t
        contact_test, pose_test = (
            None if each is None else each._replace(means=each.means.restarted(RESTART_WINDOW), age=REFRESH_STEPS)
            for each in (memory.contact_test, memory.pose_test)
        )
        return memory._replace(
            contact_test=contact_test,
            pose_test=pose_test,
            last_alarm=t,
            alarm=freeze(alarm),
            evident=freeze(evident),
            distance=freeze(distance),
            is_certain=found.is_certain,
        )


make_estimate = unchecked_constructor(SlipEstimate)

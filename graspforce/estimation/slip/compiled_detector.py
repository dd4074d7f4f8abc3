"""Slip detector in C (`csrc/include/graspforce/slip_step.h`). `detector.SlipDetector` is the reference implementation.

The C code computes means, tests and statistics of every period. The reference implementation finds the fingers of an alarm.
"""

from __future__ import annotations

import numpy as np

from graspforce.contact.compiled_kinematics import primitive_parameters
from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import Block, native, new_block
from graspforce.estimation.compiled_contact_forces import CompiledContactForces
from graspforce.estimation.pose.compiled_contact_pose import CompiledContactPose
from graspforce.estimation.pose.contact_pose import ContactPose
from graspforce.estimation.sensor_model import SensorModel
from graspforce.estimation.slip.detector import (
    ALERT_TIME,
    LEAST_STICKING,
    NO_STATISTICS,
    REFRESH_STEPS,
    RESTART_WINDOW,
    SlipDetector,
    SlipEstimate,
    SlipInputs,
    make_estimate,
)
from graspforce.estimation.slip.slip_memory import SlipBlocks, SlipMemory
from graspforce.estimation.slip.slip_settings import SlipSettings
from graspforce.estimation.slip.slip_statistics import WindowMeans, make_slip_test
from graspforce.geometry import Shape

_HAS_RESIDUALS, _NEW_TEST, _ALERT, _AT_LIMIT, _ALARM, _WINDOW = 1, 2, 4, 8, 16, 32  # bits of slip_step()


def make_detector(
    count: int, shape: Shape | None, sensors: SensorModel, period: float, settings: SlipSettings | None = None
) -> SlipDetector:
    """Return a detector of slip: compiled if possible, the reference implementation elsewhere.

    Args:
        count: number N of contacts.
        shape: the object's surface.
        sensors: noise of encoders and camera.
        period: time between two steps, s.
        settings: windows, thresholds and errors of the model.
    """
    is_compiled = native is not None and primitive_parameters(shape) is not None
    return (CompiledSlipDetector if is_compiled else SlipDetector)(count, sensors, period, settings)


class CompiledSlipDetector(SlipDetector):
    """Detector of slip by compiled code. Contacts and forces come from compiled estimators.

    Args:
        count: number N of contacts.
        sensors: noise of encoders and camera.
        period: time between two steps, s.
        settings: windows, thresholds and errors of the model.
    """

    def __init__(self, count: int, sensors: SensorModel, period: float, settings: SlipSettings | None = None) -> None:
        super().__init__(count, sensors, period, settings)
        windows = len(self.settings.windows)
        self._windows = windows
        self._numbers = new_block(np.dtype(native.slip_settings_layout(count, windows)))
        for name, value in self._compiled_settings().items():
            self._numbers[name] = value
        self._test_dtype: np.dtype[np.void] = np.dtype(native.slip_test_layout(count, windows))
        self._spare = new_block(self._test_dtype)  # for the next test; most periods compute none
        self._state_dtype: np.dtype[np.void] = np.dtype(native.slip_state_layout(count, windows))

    def initial_memory(self, contacts: ContactPose) -> SlipBlocks:
        """Return the memory before the first step.

        Args:
            contacts: the contacts at the start.
        """
        state, tips = new_block(self._state_dtype), contacts.tip_contacts
        state["p_OF"], state["R_OF"], state["p_OC"], state["R_OC"] = tips.p_OF, tips.R_OF, tips.p_OC, contacts.R_OC
        for name in ("alert_until", "alarm", "evident"):
            state[name] = -np.inf
        return SlipBlocks(state, None, None, -np.inf, freeze(np.zeros((self._count, 2))), False)

    def step(self, memory: SlipMemory | SlipBlocks, inputs: SlipInputs) -> tuple[SlipEstimate, SlipBlocks]:
        """Return the slip of a period, and the memory for the next one; see `SlipDetector.step`.

        Args:
            memory: memory after the last period; `initial_memory` before the first.
            inputs: contacts, errors and forces of the period.
        """
        assert isinstance(memory, SlipBlocks)  # `initial_memory` makes no other
        assert isinstance(inputs.contacts, CompiledContactPose)
        forces = inputs.forces
        assert forces is None or isinstance(forces, CompiledContactForces)
        if forces is not None and not forces.has_tips:
            forces = None
        state, fresh = new_block(self._state_dtype), self._spare
        contact_test, pose_test = memory.contact_test, memory.pose_test
        alarm = memory.last_alarm, memory.distance, memory.is_certain
        bits = native.slip_step(
            contact_count=self._count,
            window_count=self._windows,
            t=inputs.t,
            joint_error=inputs.joint_error,
            pose_error=inputs.pose_error,
            mu=inputs.mu,
            settings=self._numbers,
            pose=inputs.contacts.block,
            forces=None if forces is None else forces.block,
            gains=None if forces is None else forces.gains.block,
            last=memory.state,
            contact_test=contact_test,
            pose_test=pose_test,
            fresh=fresh,
            next=state,
        )
        if bits < 0:
            raise ArithmeticError("the covariance of the slip residuals is not positive definite")
        has_pose = inputs.pose_error is not None
        if bits & _NEW_TEST:
            self._spare = new_block(self._test_dtype)
            contact_test, pose_test = (contact_test, fresh) if has_pose else (fresh, pose_test)
        if bits & _ALARM:
            test = pose_test if has_pose else contact_test
            assert test is not None  # it gave the alarm
            alarm = self._write_alarm(state, test, memory.distance, inputs, bits)
        state.setflags(write=False)
        memory = SlipBlocks(state, contact_test, pose_test, *alarm)
        return self._estimate(memory, inputs.t, bits), memory

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _compiled_settings(self) -> dict[str, object]:
        """Return the settings of the compiled form by name."""
        settings, evidence = self.settings, self._evidence
        return {
            "period": self._period,
            "times": self._times,
            "encoder_noise": self._encoder_noise,
            "encoder_bias": self._encoder_bias,
            "pose_noise": np.diag(self._pose_noise),
            "compliance": self._compliance,
            "rolling_error": settings.rolling_error**2,
            "evident_error": settings.evident_rolling_error**2,
            "force_gains": evidence.gains,
            "level_gain": evidence.level_gain,
            "limit_ratio": evidence.limit_ratio,
            "planned_ratio": evidence.planned_ratio,
            "threshold": self._threshold,
            "alert_threshold": self._alert_threshold,
            "joint_threshold": self._joint_threshold,
            "force_threshold": self._force_threshold,
            "alert_time": ALERT_TIME,
            "hold_time": settings.hold_time,
        }

    def _estimate(self, memory: SlipBlocks, t: float, bits: int) -> SlipEstimate:
        """Return the result of a period from its memory."""
        state, slipping = memory.state, self._no_flags
        evident = alarms = slipping
        if t - memory.last_alarm <= self.settings.hold_time:
            slipping, evident = (t - state[name] <= self.settings.hold_time for name in ("alarm", "evident"))
            if np.count_nonzero(evident) > self._count - LEAST_STICKING:
                evident = self._no_flags
        if bits & _ALARM:
            alarms = state["alarm"] == t
        return make_estimate(
            slipping,
            alarms,
            evident,
            state["at_limit"] != 0.0 if bits & _AT_LIMIT else self._no_flags,
            memory.distance,
            state["statistics"] if bits & _HAS_RESIDUALS else NO_STATISTICS,
            self._alert_threshold if bits & _ALERT else self._threshold,
            bool(bits & _ALERT),
            bool(bits & _ALARM),
            memory.is_certain,
        )

    def _write_alarm(
        self, state: Block, block: Block, distance: Array, inputs: SlipInputs, bits: int
    ) -> tuple[float, Array, bool]:
        """Write an alarm: the slipping fingers, and means that start anew from the present.

        Args:
            state: state after the period; written.
            block: the test that gave the alarm.
            distance: (N, 2) slip of each finger at its last alarm, m.
            inputs: inputs of the period.
            bits: result of the C code, with the window of the alarm.

        Returns:
            Time of the alarm, s, slip of each finger at its last alarm, m, and whether the fingers are certain.
        """
        kind = int(inputs.pose_error is not None)
        window, threshold = bits // _WINDOW, self._alert_threshold if bits & _ALERT else self._threshold
        covariances, variance = (block["noise"], block["bias"]), block["variance"]
        test = make_slip_test(*covariances, variance, block["B"], model_error=block["model_error"], has_pose=bool(kind))
        updates = int(state["test_updates"][kind])
        means = WindowMeans(_padded(state["values"][kind]), state["variance"][kind], updates)
        found = test.slipping_fingers(means, window, threshold)
        distance = distance.copy()
        state["alarm"][found.fingers], distance[found.fingers] = inputs.t, found.distances
        is_evident = np.array(found.evidence) > self._threshold
        state["evident"][np.array(found.fingers)[is_evident]] = inputs.t
        for each in np.flatnonzero(state["test_updates"]).tolist():
            share = float(state["variance"][each, RESTART_WINDOW])
            state["values"][each] = state["values"][each, RESTART_WINDOW].copy()
            state["variance"][each] = share
            state["test_updates"][each], state["test_age"][each] = max(round(1.0 / share), 1), REFRESH_STEPS
        return inputs.t, freeze(distance), found.is_certain


def _padded(values: Array) -> Array:
    """Return means (K + 1, 3 N) with fourth rows of zeros for each contact, (K + 1, 4 N)."""
    padded = np.zeros((len(values), values.shape[1] // 3, 4))
    padded[:, :, :3] = values.reshape(len(values), -1, 3)
    return padded.reshape(len(values), -1)

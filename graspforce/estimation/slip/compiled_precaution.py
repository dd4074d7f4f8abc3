"""Test for precautions in C (`csrc/include/graspforce/precaution_step.h`). `precaution.PrecautionTest` is the reference."""

from __future__ import annotations

import numpy as np

from graspforce.contact.compiled_kinematics import primitive_parameters
from graspforce.contact.motion import BodyMotion
from graspforce.core.compiled import Block, native, new_block
from graspforce.estimation.pose.compiled_contact_pose import CompiledContactPose
from graspforce.estimation.pose.contact_pose import ContactPose
from graspforce.estimation.slip.precaution import (
    LEAST_VARIANCE,
    NOISE_LEVEL,
    REFRESH_STEPS,
    PrecautionMemory,
    PrecautionTest,
)
from graspforce.estimation.slip.slip_memory import SlipBlocks, SlipMemory
from graspforce.estimation.slip.slip_settings import SlipSettings
from graspforce.grasp.grasp import Grasp


def make_precaution_test(grasp: Grasp, encoder_variance: float, period: float, settings: SlipSettings) -> PrecautionTest:
    """Return a test for precautions: compiled if possible, the reference implementation elsewhere.

    Args:
        grasp: hand, object and contacts.
        encoder_variance: variance of the noise of a joint position, rad².
        period: time between two steps, s.
        settings: settings of the slip detector, with the time between two precautions without cause.
    """
    numbers = len(grasp.contacts), encoder_variance, period, settings.precaution_interval
    if native is None or primitive_parameters(grasp.body.shape) is None:
        return PrecautionTest(*numbers)
    return CompiledPrecautionTest(*numbers, grasp.hand.n, len(settings.windows))


class CompiledPrecautionTest(PrecautionTest):
    """Test for precautions by compiled code. Contacts and slip come from compiled estimators.

    Args:
        count: number N of contacts.
        encoder_variance: variance of the noise of a joint position, rad².
        period: time between two steps, s.
        interval: time between two precautions without cause, s, at least.
        motor_count: number n of motors.
        window_count: number of windows of the slip detector.
    """

    def __init__(
        self, count: int, encoder_variance: float, period: float, interval: float, motor_count: int, window_count: int
    ) -> None:
        super().__init__(count, encoder_variance, period, interval)
        self._numbers = new_block(np.dtype(native.precaution_settings_layout()))
        values: dict[str, object] = {"gains": self._gains, "level_gain": self._level_gain, "start": self._start}
        values |= {"refresh": REFRESH_STEPS, "encoder_variance": encoder_variance, "least_variance": LEAST_VARIANCE}
        values |= {"force_threshold": self.force_threshold, "motion_threshold": self.motion_threshold}
        values |= {"tail": self._tail, "noise_level": NOISE_LEVEL}
        for name, value in values.items():
            self._numbers[name] = value
        self._dtype: np.dtype[np.void] = np.dtype(native.precaution_state_layout(count))
        self._first = new_block(self._dtype)
        self._motors, self._slip_windows = motor_count, window_count

    def step(
        self,
        memory: PrecautionMemory | Block | None,
        slip: SlipMemory | SlipBlocks,
        contacts: ContactPose,
        desired: BodyMotion,
    ) -> tuple[bool, Block]:
        """Return whether a precaution is due in this period, and the memory for the next one; see `PrecautionTest.step`.

        Args:
            memory: memory after the last period; None before the first.
            slip: memory of a compiled slip detector after this period.
            contacts: the contacts at the estimated pose, of a compiled estimator.
            desired: desired motion of the object in this period.
        """
        assert isinstance(contacts, CompiledContactPose)
        assert isinstance(slip, SlipBlocks)
        assert not isinstance(memory, PrecautionMemory)  # this method makes no other than blocks
        state = new_block(self._dtype)
        is_due = native.precaution_step(
            contact_count=self._count,
            motor_count=self._motors,
            window_count=self._slip_windows,
            p_HO=desired.p_HO,
            R_HO=desired.R_HO,
            settings=self._numbers,
            pose=contacts.block,
            slip=slip.state,
            last=self._first if memory is None else memory,
            next=state,
        )
        return bool(is_due), state

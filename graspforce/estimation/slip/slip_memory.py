"""State of the slip detector between two periods."""

from __future__ import annotations

from typing import NamedTuple

from graspforce.contact.kinematics import TipContactState
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block
from graspforce.estimation.slip.slip_forces import ForceMeans
from graspforce.estimation.slip.slip_statistics import SlipTest, WindowMeans


class MotionTest(NamedTuple):
    """State of one test of the motion.

    Attributes:
        t: time of the last residual, s.
        means: means of the residuals.
        test: the test at the present contacts.
        age: residuals since the test was computed.
        place: (N, 3) contact points in O, mean over the baseline, m.
    """

    t: float
    means: WindowMeans
    test: SlipTest
    age: int
    place: Array


class SlipMemory(NamedTuple):
    """State of the slip detector between two periods.

    Attributes:
        anchor: contacts from which slip is measured.
        R_OC: (N, 3, 3) contact frames in O at the anchor.
        slip: (N, 2) slip up to the anchor, m.
        anchor_age: periods since the anchor.
        contact_test: test of the residuals that no motion of the object explains; None before the first period.
        pose_test: test of the residuals with the measured pose; None before the first pose.
        forces: means of the forces; None before the first.
        alert_until: time until which forces count as unexpected, s.
        last_alarm: time of the last alarm of any finger, s.
        alarm: (N,) time of the last alarm of each finger, s.
        evident: (N,) time of the last evident slip of each finger, s.
        distance: (N, 2) slip at that alarm, m.
        is_certain: whether the fingers of the last alarm are certain.
        residual: (3 N,) slip and gap of each finger for the estimated pose and the measured joint positions, m.
        force_statistic: statistic of unexpected forces, over its mean in the past; zero without forces.
    """

    anchor: TipContactState
    R_OC: Array
    slip: Array
    anchor_age: int
    contact_test: MotionTest | None
    pose_test: MotionTest | None
    forces: ForceMeans | None
    alert_until: float
    last_alarm: float
    alarm: Array
    evident: Array
    distance: Array
    is_certain: bool
    residual: Array
    force_statistic: float

    @property
    def force_level(self) -> float:
        """Mean of the force statistic, relative to that of noise; 1 before the first forces."""
        return 1.0 if self.forces is None else self.forces.level


class SlipBlocks(NamedTuple):
    """State of the compiled slip detector (`csrc/include/graspforce/slip_step.h`).

    Attributes:
        state: the state.
        contact_test: test of the residuals that no motion of the object explains; None before the first period.
        pose_test: test of the residuals with the measured pose; None before the first pose.
        last_alarm: time of the last alarm of any finger, s.
        distance: (N, 2) slip of each finger at its last alarm, m.
        is_certain: whether the fingers of the last alarm are certain.
    """

    state: Block
    contact_test: Block | None
    pose_test: Block | None
    last_alarm: float
    distance: Array
    is_certain: bool

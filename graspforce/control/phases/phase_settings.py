"""Settings of the phases of a grasp: speeds, forces, times and thresholds."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.records import set_fields
from graspforce.core.settings_record import SettingsRecord
from graspforce.hand.hand import Hand

_MOST_ATTEMPTS = 10
_SLIDE_TOLERANCE = 1e-3  # m: posture tolerance of a prismatic joint


@dataclass(frozen=True, slots=True)
class PhaseSettings(SettingsRecord):
    """Settings of the phases of a grasp.

    Args:
        standoff: distance of the fingertips from the planned contacts in the pre-grasp posture, m. Where something would touch,
            70 to 150 % of it are tried.
        close_speed: speed of the fingertips along the inward normals in the guarded close, m/s.
        open_speed: mean speed of the fastest fingertip in the release, m/s.
        touch_force: largest force with which a fingertip pushes before the squeeze, N. A finger that touches early waits with
            at most this force.
        largest_travel: distance beyond the planned contact after which a finger has missed the object, m.
        position_error: standard deviation of the object's position at the start, in each direction of the table, m.
        angle_error: standard deviation of its rotation about the vertical, rad.
        contact_error: standard deviation of a touched place, m.
        fit_tolerance: largest distance of a touched place from the object's surface at its most probable pose, m.
        squeeze_time: time in which the forces rise from the touch to the planned forces, s.
        transfer_time: time in which the weight goes from the table to the fingers, and back, s.
        settling_time: time for which the joints must be at a posture before the phase ends, s.
        posture_tolerance: largest joint error at the end of approach and retract, rad. That of a prismatic joint is 1 mm.
            Joints that have not arrived 2 s after the motion may be three times as far.
        contact_tolerance: distance of a fingertip from the surface from which its contact counts as lost, m.
        largest_shift: distance that the object may move in the squeeze, m; beyond it the fingers let go.
        loss_time: time after which a lost contact, a step without forces, or a pause of the measurements ends the cycle, s.
        largest_rate: largest rate of the double pole of the joint loop, rad/s.
        attempts: largest number of times that the fingers close on the object, 1 to 10. They open and close again if the
            close or the squeeze fails.

    Raises:
        InvalidInput: a value is not greater than 0, or `attempts` is out of range; names the field.
    """

    RECORD: ClassVar[str] = "phases"

    standoff: float = 0.02
    close_speed: float = 0.02
    open_speed: float = 0.05
    touch_force: float = 0.2
    largest_travel: float = 0.02
    position_error: float = 0.006
    angle_error: float = math.radians(6.0)
    contact_error: float = 1e-3
    fit_tolerance: float = 6e-3
    squeeze_time: float = 0.4
    transfer_time: float = 0.4
    settling_time: float = 0.1
    posture_tolerance: float = 0.03
    contact_tolerance: float = 4e-3
    largest_shift: float = 5e-3
    loss_time: float = 0.1
    largest_rate: float = 60.0
    attempts: int = 3

    def __post_init__(self) -> None:
        names = [each.name for each in dataclasses.fields(self) if each.name != "attempts"]
        numbers = {name: arrays.check_number(getattr(self, name), name, above=0.0) for name in names}
        set_fields(self, **numbers, attempts=fields.check_integer(self.attempts, "attempts", minimum=1, maximum=_MOST_ATTEMPTS))

    def posture_tolerances(self, hand: Hand) -> Array:
        """Return the largest errors (n,) of the joints at the end of approach and retract: rad, or m for prismatic joints.

        Args:
            hand: the hand.
        """
        slides = [joint.is_prismatic for joint in hand.joints]
        return np.where(slides, _SLIDE_TOLERANCE, self.posture_tolerance)

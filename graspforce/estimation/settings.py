"""Settings of the estimator of a grasp's state: process noise, initial uncertainty and gates."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.core.settings_record import SettingsRecord


@dataclass(frozen=True, slots=True)
class EstimatorSettings(SettingsRecord):
    """Settings of `GraspEstimator`. Noise is given as a standard deviation, or as the root of a spectral density.

    Args:
        acceleration_noise: white noise of the joint accelerations about the commanded ones, (rad/s²)/√Hz.
        disturbance_noise: rate of change of the joint accelerations that disturbances cause, (rad/s³)/√Hz.
        initial_rate_error: of the joint rates at the start, rad/s.
        contact_error: of each coordinate of the contacts relative to the grasp's, at the start, m.
        contact_noise: momentary error of each contact coordinate, such as from soft surfaces, m.
        position_error: of the object's position in the grasp at the start, in each coordinate, m.
        angle_error: of the object's orientation in the grasp at the start, about each axis, rad.
        position_drift: random walk of the object relative to its pose from the contacts, m/√s.
        angle_drift: the same for the orientation, rad/√s.
        slip_drift: additional random walk of each coordinate while a finger slips, m/√s.
        free_drift: random walk along motions that the contacts do not determine, as displacements at 30 mm, m/√s.
        gate: probability that a camera pose with the assumed noise is accepted, in (0, 1).
        rejection_limit: number of rejected camera poses in a row, in agreement with each other, of which the last is accepted.
        offset_time: time constant with which the desired motion follows the offset, s.
        history: length of the history of poses, s; older camera poses are ignored.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    RECORD: ClassVar[str] = "estimator"

    acceleration_noise: float = 1.0
    disturbance_noise: float = 100.0
    initial_rate_error: float = 0.05
    contact_error: float = 5e-4
    contact_noise: float = 1e-5
    position_error: float = 1e-3
    angle_error: float = 0.02
    position_drift: float = 1e-4
    angle_drift: float = 2e-3
    slip_drift: float = 5e-3
    free_drift: float = 0.03
    gate: float = 0.999
    rejection_limit: int = 5
    offset_time: float = 0.2
    history: float = 1.0

    def __post_init__(self) -> None:
        above_zero = ("acceleration_noise", "contact_noise", "offset_time", "history", "gate")
        for each in dataclasses.fields(self):
            value = getattr(self, each.name)
            if each.name == "rejection_limit":
                set_fields(self, rejection_limit=fields.check_integer(value, each.name, minimum=1, maximum=10**6))
            elif each.name in above_zero:
                set_fields(self, **{each.name: arrays.check_number(value, each.name, above=0.0)})
            else:
                set_fields(self, **{each.name: arrays.check_number(value, each.name, minimum=0.0)})
        if self.gate >= 1.0:
            raise InvalidInput("gate", self.gate, "less than 1")

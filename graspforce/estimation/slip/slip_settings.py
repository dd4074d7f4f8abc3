"""Settings of the slip detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graspforce.core import arrays
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.core.settings_record import SettingsRecord


@dataclass(frozen=True, slots=True)
class SlipSettings(SettingsRecord):
    """Settings of the slip detector.

    Args:
        windows: lengths of the means that are tested, s, ascending.
        baseline: length of the mean that they are compared with, s. Slip slower than about 0.3 mm in this time is not found.
        false_alarm_interval: time between two false alarms from motion, s, at least.
        alert_interval: the same while forces are unexpected, s.
        precaution_interval: time between two precautions without cause, s, at least; see `precaution`.
        compliance: standard deviation of the changes of a gap from deformation of the contact, m.
        tangential_compliance: the same along the tangents, m.
        rolling_error: standard deviation of the error of a contact's path, relative to its length, such as from the fingertip's
            radius or the contact's position.
        evident_rolling_error: the same for evident slip, which takes a finger out of the estimate of the object's pose.
        limit_ratio: fraction c of the friction coefficient from which a contact counts as at its friction limit.
        limit_reserve: fraction of the friction coefficient that planned forces leave unused; see `ControlSettings`.
        hold_time: time for which a finger counts as slipping after the last alarm, s.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    RECORD: ClassVar[str] = "slip"

    windows: tuple[float, ...] = (0.002, 0.004, 0.012, 0.04, 0.12)
    baseline: float = 1.0
    false_alarm_interval: float = 7200.0
    alert_interval: float = 0.1
    precaution_interval: float = 3.6e5
    compliance: float = 3e-5
    tangential_compliance: float = 1e-5
    rolling_error: float = 0.02
    evident_rolling_error: float = 0.2
    limit_ratio: float = 0.95
    limit_reserve: float = 0.1
    hold_time: float = 0.05

    def __post_init__(self) -> None:
        windows = arrays.check_array(self.windows, "windows", (None,), above=0.0)
        if len(windows) == 0 or (np.diff(windows) <= 0.0).any():
            raise InvalidInput("windows", self.windows, "at least one length, ascending")
        set_fields(self, windows=tuple(windows.tolist()))
        for name in ("baseline", "false_alarm_interval", "alert_interval", "precaution_interval", "hold_time"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        for name in (
            "compliance",
            "tangential_compliance",
            "rolling_error",
            "evident_rolling_error",
            "limit_ratio",
            "limit_reserve",
        ):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, minimum=0.0)})
        if not 1.0 - self.limit_reserve < self.limit_ratio <= 1.0:
            raise InvalidInput("limit_ratio", self.limit_ratio, "greater than 1 − limit_reserve, and at most 1")

"""What a user may choose about the control of a held object."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import GRAVITY_PALM_UP


@dataclass(frozen=True, slots=True)
class PoseGains:
    """Gains on the object's pose error: acceleration per error, per rate and per integral, for translation and rotation.

    By default a double pole at 40 rad/s, and an integral that removes an offset with a time constant of about 0.2 s.

    Args:
        kp_linear, kp_angular: 1/s², ≥ 0.
        kd_linear, kd_angular: 1/s, ≥ 0.
        ki_linear, ki_angular: 1/s³, ≥ 0; with kd·kp > ki the loop is stable (Routh).
    """

    kp_linear: float = 1600.0
    kd_linear: float = 80.0
    ki_linear: float = 8000.0
    kp_angular: float = 1600.0
    kd_angular: float = 80.0
    ki_angular: float = 8000.0

    def __post_init__(self) -> None:
        for each in dataclasses.fields(self):
            object.__setattr__(self, each.name, arrays.check_number(getattr(self, each.name), each.name, minimum=0.0))
        for part in ("linear", "angular"):
            kp, kd, ki = (getattr(self, f"{gain}_{part}") for gain in ("kp", "kd", "ki"))
            if ki > 0.0 and ki >= kp * kd:
                raise InvalidInput(f"ki_{part}", ki, f"less than kp_{part}·kd_{part} = {kp * kd:g}, or the loop is unstable")

    @classmethod
    def critically_damped(cls, linear: float, angular: float, integral: float = 0.0) -> PoseGains:
        """Double poles at the given rates, rad/s, and an integral that removes offsets at about the rate ``integral``, 1/s."""
        rates = [arrays.check_number(rate, name, minimum=0.0) for name, rate in (("linear", linear), ("angular", angular))]
        slow = arrays.check_number(integral, "integral", minimum=0.0)
        return cls(*(gain for rate in rates for gain in (rate**2, 2.0 * rate, slow * rate**2)))

    def rows(self) -> Array:
        """(3, 6) kp, kd and ki, each as it multiplies an error (linear, angular)."""
        linear = [self.kp_linear, self.kd_linear, self.ki_linear]
        angular = [self.kp_angular, self.kd_angular, self.ki_angular]
        return freeze(np.repeat(np.array([linear, angular]).T, 3, axis=1))

    def to_dict(self) -> dict[str, Any]:
        """Return a plain record with every gain by its name."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, record: object, field: str = "gains") -> PoseGains:
        """Read gains from a plain record; gains that are absent or null take their defaults.

        Args:
            record: gains by their names.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, optional=[each.name for each in dataclasses.fields(cls)])
        try:
            return cls(**{name: value for name, value in values.items() if value is not None})
        except InvalidInput as error:
            raise error.with_prefix(field) from None


@dataclass(frozen=True, eq=False, slots=True)
class ControlSettings:
    """How a held object is controlled.

    Args:
        gains: on the object's pose.
        slip_margin: s, N: the forces are planned so that ‖f_t‖ ≤ μ f_n − s at every contact with friction.
        friction_reserve: the part of μ that plans leave unused, in [0, 1): they are made with μ (1 − reserve).
        force_weight: ρ in the cost ½‖tau‖²_W + ½ρ‖f‖², (N·m/N)²: chooses where forces load no motor.
        posture_stiffness: 1/s²: fingers that do not hold, and what joints are free beside the contacts, return to the hold's
            posture, and what is told where to be (`GraspMotion`) goes there, no faster than the joints' speed limits.
        posture_damping: 1/s.
        gravity_H: (3,) the acceleration of gravity in H, m/s².
        period: the time between two steps, s.
        integral_limit_linear: the largest acceleration that the integral may ask for, m/s².
        integral_limit_angular: likewise, rad/s².
        creep_limit: how far a fingertip may slide over the object within about `creep_time` before it is called slipping, m.
        creep_time: the time constant with which past sliding is forgotten, s.
        touch_gap: how far a fingertip may be off the surface and still touch, m.
        least_lever: a direction in which the joints move a contact by less than this part of the best direction counts as one
            in which they cannot.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    gains: PoseGains = field(default_factory=PoseGains)
    slip_margin: float = 0.5
    friction_reserve: float = 0.1
    force_weight: float = 1e-6
    posture_stiffness: float = 400.0
    posture_damping: float = 40.0
    gravity_H: Array = field(default_factory=lambda: freeze(GRAVITY_PALM_UP))
    period: float = 1e-3
    integral_limit_linear: float = 5.0
    integral_limit_angular: float = 50.0
    creep_limit: float = 1e-4
    creep_time: float = 1.0
    touch_gap: float = 1e-3
    least_lever: float = 0.01

    @property
    def posture_decay_rate(self) -> float:
        """max(k_d, 2√k_p), 1/s: a joint that is Δq off comes back at k_p Δq over this, as less damping would only swing."""
        return max(self.posture_damping, 2.0 * math.sqrt(self.posture_stiffness))

    def __post_init__(self) -> None:
        for name in ("slip_margin", "friction_reserve", "force_weight", "posture_stiffness", "posture_damping"):
            object.__setattr__(self, name, arrays.check_number(getattr(self, name), name, minimum=0.0))
        for name in ("integral_limit_linear", "integral_limit_angular"):
            object.__setattr__(self, name, arrays.check_number(getattr(self, name), name, minimum=0.0))
        for name in ("period", "creep_limit", "creep_time", "touch_gap", "least_lever"):
            object.__setattr__(self, name, arrays.check_number(getattr(self, name), name, above=0.0))
        for name in ("friction_reserve", "least_lever"):
            if getattr(self, name) >= 1.0:
                raise InvalidInput(name, getattr(self, name), "less than 1")
        object.__setattr__(self, "gravity_H", arrays.check_array(self.gravity_H, "gravity_H", (3,)))

    def to_dict(self) -> dict[str, Any]:
        """Return a plain record of all settings; `gravity_H` is named `gravity` there."""
        record = {_RECORD_NAMES.get(each.name, each.name): getattr(self, each.name) for each in dataclasses.fields(self)}
        return {**record, "gravity": self.gravity_H.tolist(), "gains": self.gains.to_dict()}

    @classmethod
    def from_dict(cls, record: object, field: str = "settings") -> ControlSettings:
        """Read settings from a plain record; settings that are absent or null take their defaults.

        Args:
            record: settings by their names, `gravity` for `gravity_H`, and `gains` as in `PoseGains.to_dict`.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
        """
        names = {_RECORD_NAMES.get(each.name, each.name): each.name for each in dataclasses.fields(cls)}
        values = fields.check_record(record, field, optional=names)
        given = {names[name]: value for name, value in values.items() if value is not None}
        if "gains" in given:
            given["gains"] = PoseGains.from_dict(given["gains"], f"{field}.gains")
        try:
            return cls(**given)
        except InvalidInput as error:
            name, bracket, rest = error.field.partition("[")
            spelt = _RECORD_NAMES.get(name, name) + bracket + rest
            raise error.with_field(spelt).with_prefix(field) from None


_RECORD_NAMES = {"gravity_H": "gravity"}  # the other fields have the same name in a record

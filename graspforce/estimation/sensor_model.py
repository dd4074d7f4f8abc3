"""Rate, latency and noise of the sensors, as the estimator and the choice of gains assume them.

Noise is given as the standard deviation of each component, independent between samples.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.core.settings_record import SettingsRecord

_LONGEST_LATENCY, _LARGEST_NOISE = 1.0, 1e3  # s, and in the unit of each noise
_MOST_PERIODS = 1000  # of latency: the joint filter stores a command for each
_JOINT_RATES, _CAMERA_RATES = (0.1, 1e6), (1e-3, 1e6)  # Hz
_CAMERA_NOISES = (1e-15, _LARGEST_NOISE)  # m, rad; a noise of zero would make the gains singular


@dataclass(frozen=True, slots=True)
class CameraModel(SettingsRecord):
    """Camera, or another sensor of the object's pose in H.

    Args:
        rate: images per second, Hz, from 1e-3 to 1e6.
        latency: time from the exposure to the arrival of the pose, s, at most 1. The poses carry their time; this is used for
            gains only.
        position_noise: standard deviation of each coordinate, m, from 1e-15 to 1e3, as of the other errors from 0 to 1e3.
        angle_noise: standard deviation of the rotation about each axis, rad, from 1e-15 to 1e3.
        position_bias: standard deviation of each coordinate of the constant error, such as of the calibration, m.
        angle_bias: standard deviation of the constant error about each axis, rad.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    RECORD: ClassVar[str] = "camera"

    rate: float = 30.0
    latency: float = 0.05
    position_noise: float = 1e-3
    angle_noise: float = 0.02
    position_bias: float = 0.0
    angle_bias: float = 0.0

    def __post_init__(self) -> None:
        _check_fields(self, rate=_CAMERA_RATES, position_noise=_CAMERA_NOISES, angle_noise=_CAMERA_NOISES)


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Sensors of a hand. Noises and the resolution are from 0 to 1e3.

    Args:
        encoder_noise: standard deviation of a joint position, rad.
        encoder_resolution: step of the measured joint positions, rad; zero for continuous values.
        rate: measurements of the joints per second, Hz, from 0.1 to 1e6.
        latency: time from the measurement to the torque that follows from it, s, beyond the period of the control loop; at
            most 1 s, and at most 1000 periods.
        has_velocity: whether joint rates are measured.
        velocity_noise: standard deviation of a measured joint rate, rad/s.
        torque_noise: standard deviation of a measured joint torque, N·m; None if torques are not measured.
        current_noise: standard deviation of a measured motor current, A; None if contact forces do not follow from currents.
            Currents count if joint torques are not measured, and need torque constants in the hand's description.
        tip_force_noise: standard deviation of each component of a measured fingertip force, N; None if not measured.
        camera: sensor of the object's pose; None if there is none.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    encoder_noise: float = 0.0
    encoder_resolution: float = 0.0
    rate: float = 1000.0
    latency: float = 0.0
    has_velocity: bool = False
    velocity_noise: float = 0.0
    torque_noise: float | None = None
    tip_force_noise: float | None = None
    camera: CameraModel | None = None
    current_noise: float | None = None

    def __post_init__(self) -> None:
        fields.check_boolean(self.has_velocity, "has_velocity")
        if self.camera is not None and not isinstance(self.camera, CameraModel):
            raise InvalidInput("camera", self.camera, "a CameraModel, or None")
        _check_fields(self, rate=_JOINT_RATES)

    @property
    def encoder_variance(self) -> float:
        """Variance of a measured joint position, rad²: noise² + resolution²/12."""
        return self.encoder_noise**2 + self.encoder_resolution**2 / 12.0

    @property
    def has_force_sensors(self) -> bool:
        """Whether joint torques, motor currents or fingertip forces are measured."""
        return any(each is not None for each in (self.torque_noise, self.current_noise, self.tip_force_noise))

    def with_delay(self, delay: float) -> SensorModel:
        """Return the same sensors with a larger latency.

        Args:
            delay: time to add to the latency, such as the delay of drives, s.

        Raises:
            InvalidInput: the sum is out of the range of a latency.
        """
        try:
            return dataclasses.replace(self, latency=self.latency + delay)
        except InvalidInput:
            allowed = f"at most {_LONGEST_LATENCY:g} with the delay of the drives, {delay:g} s"
            raise InvalidInput("sensors.latency", self.latency, allowed) from None

    def latency_periods(self, period: float) -> int:
        """Return the latency in periods.

        Args:
            period: time between two measurements, s.

        Raises:
            InvalidInput: more than 1000 periods; names `sensors.latency`.
        """
        if self.latency > _MOST_PERIODS * period:
            allowed = f"at most {_MOST_PERIODS} periods, {_MOST_PERIODS * period:g} s, with the delay of the drives"
            raise InvalidInput("sensors.latency", self.latency, allowed)
        return round(self.latency / period)

    def to_dict(self) -> JsonRecord:
        """Return the record of the sensors."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, record: object, field: str = "sensors") -> SensorModel:
        """Return the sensors of a record. Fields that are absent take their defaults.

        Args:
            record: mapping with the fields by name.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, optional=[each.name for each in dataclasses.fields(cls)])
        if values.get("camera") is not None:
            values["camera"] = CameraModel.from_dict(values["camera"], f"{field}.camera")
        return fields.read_dataclass(cls, values, field)


def _check_fields(sensor: CameraModel | SensorModel, **ranges: tuple[float, float]) -> None:
    """Check the numbers of a sensor: the named ones in their ranges, the latency at most 1 s, the others at most 1e3."""
    ranges = {"latency": (0.0, _LONGEST_LATENCY), **ranges}
    for each in dataclasses.fields(sensor):
        value = getattr(sensor, each.name)
        if each.name not in ("has_velocity", "camera") and not (value is None and each.default is None):
            minimum, maximum = ranges.get(each.name, (0.0, _LARGEST_NOISE))
            set_fields(sensor, **{each.name: arrays.check_number(value, each.name, minimum=minimum, maximum=maximum)})

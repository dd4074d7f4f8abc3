"""Types of records of settings: made from the dataclasses that read them. Every setting may be absent or null."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from typing import Annotated, Any

import msgspec
import numpy as np

from graspforce.control.friction.disturbance_observer import ObserverTimes
from graspforce.control.friction.friction_compensation import FrictionSettings
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.settings import ControlSettings, PoseGains
from graspforce.core.field_meanings import field_meanings, record_summary
from graspforce.estimation.sensor_model import CameraModel, SensorModel
from graspforce.force.uncertainty import Uncertainty
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.planning.acceleration_limits import AccelerationLimits
from graspforce.service.wire.schemas.array_types import NumberOrList, Numbers, Rows, Rows6, Vector3
from graspforce.service.wire.schemas.object_types import ObstacleRecord

_PLAIN = (bool, int, float, str)


def settings_type(
    settings: type, types: Mapping[str, Any], names: Mapping[str, str] | None = None, required: tuple[str, ...] = ()
) -> type[msgspec.Struct]:
    """Return the type of the record of a dataclass of settings, with the meaning of each field.

    Args:
        settings: the dataclass.
        types: types of its fields that are not plain values, by name.
        names: names of fields in the record, where they differ.
        required: fields that must be given.
    """
    hints, meanings = typing.get_type_hints(settings), field_meanings(settings, "Args")
    made: list[Any] = []
    for each in dataclasses.fields(settings):
        kind = types.get(each.name, hints[each.name])
        name, meaning = (names or {}).get(each.name, each.name), msgspec.Meta(description=meanings[each.name])
        is_required = each.name in required
        made.append(
            (name, Annotated[kind, meaning]) if is_required else (name, Annotated[kind | None, meaning], _default(each))
        )
    summary = record_summary(settings, "Args")
    return msgspec.defstruct(settings.__name__, made, namespace={"__doc__": summary}, forbid_unknown_fields=True, kw_only=True)


def _default(field: dataclasses.Field[Any]) -> object:
    """Return the default of a field in a record, None for values that are not plain."""
    value = None if field.default is dataclasses.MISSING else field.default
    return value if isinstance(value, _PLAIN) and np.isfinite(0.0 if isinstance(value, str) else value) else None


_limits = dict.fromkeys(("linear", "angular", "joints", "linear_jerk", "angular_jerk", "joint_jerk"), float)
_by_joint = dict.fromkeys(("coulomb", "stribeck", "stribeck_velocity", "viscous"), Numbers)
_errors = ("friction_error", "position_error", "normal_error", "torque_error")

UncertaintyType = settings_type(
    Uncertainty,
    {**dict.fromkeys(_errors, NumberOrList), "centre_of_mass_error": NumberOrList, "wrenches": Rows6, "wrench_ellipsoid": Rows},
)
SensorsType = settings_type(SensorModel, {"camera": settings_type(CameraModel, {})})
PhaseSettingsType = settings_type(PhaseSettings, {})
AccelerationLimitsType = settings_type(AccelerationLimits, _limits)
FrictionType = settings_type(
    FrictionSettings,
    {
        "model": settings_type(JointFriction, {**_by_joint, "sources": list[str]}, required=("coulomb",)),
        "times": settings_type(ObserverTimes, {}),
    },
)
ControlSettingsType = settings_type(
    ControlSettings,
    {"gains": settings_type(PoseGains, {}), "gravity_H": Vector3, "friction": FrictionType, "obstacles": list[ObstacleRecord]},
    {"gravity_H": "gravity", "contact_tolerance": "touch_gap", "rank_tolerance": "least_lever"},
)

"""Measurements of a hand and its object, each with its time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.geometry.poses import pose_from_dict, pose_to_dict

LARGEST = 1e6
"""Largest magnitude of a measured number, in SI units. No hand measures more, and estimates stay finite below it."""

LARGEST_TIME = 1e10
"""Largest magnitude of a time, s. Unix time in s is smaller; in ms it is larger, and refused."""

_SYMMETRY_TOLERANCE = 1e-9  # largest |C − Cᵀ| of a covariance, relative to its largest entry

# Names in a record; the other fields have the same name there.
_RECORD_NAMES = {
    "q": "posture",
    "v": "velocity",
    "tau": "torque",
    "current": "current",
    "tip_wrench": "tip_wrenches",
    "contact_points": "contact_points",
}


@dataclass(frozen=True, eq=False, slots=True)
class PoseMeasurement:
    """Measured pose of the object in H, such as from a camera.

    The error of the measurement is δ = (p − p_true, log(R R_trueᵀ)), in H.

    Args:
        t: time at which the pose was true, such as the exposure of the image, s; on the clock of `Measurement.t`.
        p_HO: (3,) position of the object's origin in H, m.
        R_HO: (3, 3) axes of the object in H, columns.
        covariance: (6, 6) covariance of δ, m², m·rad and rad²; None if the sensor reports none.

    Raises:
        InvalidInput: a value is not finite or larger than `LARGEST`, `t` than `LARGEST_TIME`, `R_HO` is not a rotation, or
            `covariance` is not symmetric positive semidefinite.
    """

    t: float
    p_HO: Array
    R_HO: Array
    covariance: Array | None = None

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self, t: float, p_HO: npt.ArrayLike, R_HO: npt.ArrayLike, covariance: npt.ArrayLike | None = None
        ) -> None: ...

    def __post_init__(self) -> None:
        set_fields(
            self,
            t=_check_time(self.t),
            p_HO=_check_measured(self.p_HO, "p_HO", (3,)),
            R_HO=arrays.check_rotation(self.R_HO, "R_HO"),
        )
        if self.covariance is not None:
            set_fields(self, covariance=_check_covariance(self.covariance))

    def to_dict(self) -> JsonRecord:
        """Return the record: the pose, `t` in s, and `covariance` if there is one."""
        record = {"t": self.t, **pose_to_dict(self.p_HO, self.R_HO)}
        return record if self.covariance is None else {**record, "covariance": self.covariance.tolist()}

    @classmethod
    def from_dict(cls, record: object, field: str = "object") -> PoseMeasurement:
        """Return the measurement of a record.

        Args:
            record: mapping with `t` (s), `position` (m), `rotation` or `quaternion`, and optional `covariance` (6 × 6).
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        p_HO, R_HO, values = pose_from_dict(record, field, ("t", "covariance"))
        fields.check_record(values, field, required=["t"], optional=None)
        try:
            return cls(values["t"], p_HO, R_HO, values.get("covariance"))
        except InvalidInput as error:
            raise error.with_prefix(field) from None


@dataclass(frozen=True, eq=False, slots=True)
class Measurement:
    """Quantities that a hand measures in one control period. Only the joint positions are required.

    Args:
        t: time at which the joint positions were true, s.
        q: (n,) joint positions, rad.
        v: (n,) joint rates, rad/s; None if not measured.
        tau: (n,) joint torques, N·m; None if not measured.
        current: (n,) motor currents, A; None if not measured.
        tip_wrench: (N, 6) force and moment of each finger on the object at its contact point, in H, N and N·m; a row for each
            contact of the grasp. None if not measured.
        contact_points: (N, 3) contact points in H, m; None if not measured. `TipOffsetEstimator` uses them.
        object: pose of the object that arrived since the last measurement; it may be older than `t`. None if none arrived.

    Raises:
        InvalidInput: a value is not finite, is larger than `LARGEST` (`t`: `LARGEST_TIME`), or has another shape than `q` or
            other rows.
    """

    t: float
    q: Array
    v: Array | None = None
    tau: Array | None = None
    current: Array | None = None
    tip_wrench: Array | None = None
    contact_points: Array | None = None
    object: PoseMeasurement | None = None

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            t: float,
            q: npt.ArrayLike,
            v: npt.ArrayLike | None = None,
            tau: npt.ArrayLike | None = None,
            current: npt.ArrayLike | None = None,
            tip_wrench: npt.ArrayLike | None = None,
            contact_points: npt.ArrayLike | None = None,
            object: PoseMeasurement | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        q = _check_measured(self.q, "q", (None,))
        set_fields(self, t=_check_time(self.t), q=q)
        for name in ("v", "tau", "current"):
            if getattr(self, name) is not None:
                set_fields(self, **{name: _check_measured(getattr(self, name), name, q.shape)})
        count = None
        for name, width in (("tip_wrench", 6), ("contact_points", 3)):
            if getattr(self, name) is not None:
                rows = _check_measured(getattr(self, name), name, (count, width))
                set_fields(self, **{name: rows})
                count = len(rows)

    def to_dict(self) -> JsonRecord:
        """Return the record: `t`, and the measured quantities only."""
        record: JsonRecord = {"t": self.t}
        for name, record_name in _RECORD_NAMES.items():
            value = getattr(self, name)
            if value is not None:
                record[record_name] = value.tolist()
        return record if self.object is None else {**record, "object": self.object.to_dict()}

    @classmethod
    def from_dict(cls, record: JsonRecord, field: str = "measurement") -> Measurement:
        """Return the measurement of a record. Quantities that are absent or null were not measured.

        Args:
            record: mapping with `t` (s), `posture` (rad), and optional `velocity` (rad/s), `torque` (N·m), `current` (A),
                `tip_wrenches` (N × 6), `contact_points` (N × 3, m) and `object`.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        optional = [name for name in _RECORD_NAMES.values() if name != "posture"]
        values = fields.check_record(record, field, required=["t", "posture"], optional=[*optional, "object"])
        given: dict[str, Any] = {name: values.get(record_name) for name, record_name in _RECORD_NAMES.items()}
        try:
            pose = values.get("object")
            given["object"] = None if pose is None else PoseMeasurement.from_dict(pose)
            return cls(values["t"], **given)
        except InvalidInput as error:
            name, bracket, index = error.field.partition("[")
            record_name = _RECORD_NAMES.get(name, name) + bracket + index
            raise error.with_field(record_name).with_prefix(field) from None


def _check_time(value: object) -> float:
    """Return a time in s of any clock."""
    t = arrays.check_number(value, "t")
    if abs(t) > LARGEST_TIME:
        raise InvalidInput("t", t, f"a time in s, from −{LARGEST_TIME:g} to {LARGEST_TIME:g}")
    return t


def _check_measured(value: object, field: str, shape: tuple[int | None, ...]) -> Array:
    """Return an array of finite numbers that are not larger than `LARGEST`."""
    result = arrays.check_array(value, field, shape)
    if result.size and not -LARGEST <= result.min() <= result.max() <= LARGEST:
        raise InvalidInput(field, value, f"numbers from −{LARGEST:g} to {LARGEST:g}")
    return result


def _check_covariance(value: object) -> Array:
    """Return a covariance (6, 6) that is symmetric and positive semidefinite within rounding."""
    C = _check_measured(value, "covariance", (6, 6))
    tolerance = _SYMMETRY_TOLERANCE * float(np.abs(C).max())
    if np.abs(C - C.T).max() > tolerance or np.linalg.eigvalsh(C)[0] < -tolerance:
        raise InvalidInput("covariance", value, "a symmetric positive semidefinite matrix")
    return C

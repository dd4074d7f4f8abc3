"""A contact between a finger and the object, and a set of them as arrays.

A contact frame C stands at the contact with its third axis along the inward normal n, into the object. The finger's force on
the object is f = (f_t1, f_t2, f_n) in C, and a soft finger adds the moment m_n about the normal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.geometry.vectors import cross

_PARALLEL_TOLERANCE = 1e-6  # rad: a tangent closer to the normal than this gives no direction that rounding leaves meaningful


class ContactModel(str, Enum):
    """What a contact can transmit."""

    FRICTIONLESS = "frictionless"  # (f_n)
    POINT = "point"  # (f_t1, f_t2, f_n)
    SOFT = "soft"  # (f_t1, f_t2, f_n, m_n)

    @property
    def columns(self) -> tuple[int, ...]:
        """The components it has, as columns of the padded force (f_t1, f_t2, f_n, m_n)."""
        return _COLUMNS[self]


_COLUMNS = {ContactModel.FRICTIONLESS: (2,), ContactModel.POINT: (0, 1, 2), ContactModel.SOFT: (0, 1, 2, 3)}


@dataclass(frozen=True, eq=False, slots=True)
class Contact:
    """One contact. What is stored is what was validated: a unit normal, and a unit tangent orthogonal to it.

    Args:
        position: p_OC, the contact in the object's frame O, (3,) m.
        normal: inward normal in O, (3,), of any length but zero.
        friction: coefficient μ ≥ 0; needed unless the contact is frictionless.
        model: "frictionless", "point" or "soft".
        tangent: t₁ in O, (3,), made orthogonal to the normal; by default n × e_x, or n × e_y where |n_x| ≥ 0.9.
        torsional_friction: γ ≥ 0 in m, the moment about the normal that a unit of normal force bears; a soft contact needs it.
        min_normal: least normal force, N, ≥ 0.
        max_normal: largest normal force, N; None for no limit.

    Raises:
        InvalidInput: names the field, its value and what is allowed.
    """

    position: Array
    normal: Array
    friction: float | None = None
    model: ContactModel = ContactModel.POINT
    tangent: Array | None = None
    torsional_friction: float | None = None
    min_normal: float = 0.0
    max_normal: float | None = None

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            set_fields(self, **{name: value})

        put("model", ContactModel(fields.check_choice(self.model, "model", [model.value for model in ContactModel])))
        put("position", arrays.check_array(self.position, "position", (3,)))
        put("normal", _unit_vector(self.normal, "normal"))
        put("tangent", _unit_tangent(self.tangent, self.normal))
        if self.friction is not None or self.model is not ContactModel.FRICTIONLESS:
            put("friction", arrays.check_number(self.friction, "friction", minimum=0.0))
        if self.torsional_friction is not None or self.model is ContactModel.SOFT:
            put("torsional_friction", arrays.check_number(self.torsional_friction, "torsional_friction", minimum=0.0))
        put("min_normal", arrays.check_number(self.min_normal, "min_normal", minimum=0.0))
        if self.max_normal is not None:
            put("max_normal", arrays.check_number(self.max_normal, "max_normal", minimum=0.0))
            if self.min_normal > self.max_normal:
                raise InvalidInput("min_normal", self.min_normal, f"at most max_normal, which is {self.max_normal:g}")

    @property
    def R_OC(self) -> Array:
        """The contact frame in O: columns t₁, t₂ = n × t₁, n."""
        assert self.tangent is not None  # set by __post_init__, whatever the caller gave
        n, t = self.normal.tolist(), self.tangent.tolist()
        return np.asarray(np.array([t, cross(n, t), n]).T)

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], field: str = "") -> Contact:
        """A contact from the record of a problem file. ``field`` is the record's own path, for errors."""
        required = ["position", "normal"]
        optional = ["model", "friction", "tangent", "torsional_friction", "min_normal", "max_normal"]
        values = fields.check_record(record, field, required=required, optional=optional)
        try:
            return cls(**values)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> dict[str, Any]:
        """The record of a problem file, without what has its default."""
        assert self.tangent is not None
        record: dict[str, Any] = {
            "position": self.position.tolist(),
            "normal": self.normal.tolist(),
            "tangent": self.tangent.tolist(),
            "model": self.model.value,
        }
        for name in ("friction", "torsional_friction", "max_normal"):
            if getattr(self, name) is not None:
                record[name] = getattr(self, name)
        if self.min_normal:
            record["min_normal"] = self.min_normal
        return record


@dataclass(frozen=True, eq=False)
class ContactSet:
    """N contacts as arrays, in the order in which their forces are stacked.

    Args:
        p_OC: (N, 3) positions in O, m.
        R_OC: (N, 3, 3) frames in O, columns t₁, t₂, n.
        models: N contact models.
        mu: (N,) friction coefficients, zero where frictionless.
        gamma: (N,) torsional friction lengths, m, zero unless soft.
        min_normal: (N,) least normal forces, N.
        max_normal: (N,) largest normal forces, N; inf for no limit.

    `stack` makes one from validated contacts.
    """

    p_OC: Array
    R_OC: Array
    models: tuple[ContactModel, ...]
    mu: Array
    gamma: Array
    min_normal: Array
    max_normal: Array

    @classmethod
    def stack(cls, contacts: Sequence[Contact]) -> ContactSet:
        """The contacts as arrays, in order; at least one.

        Raises:
            InvalidInput: no contact.
        """
        if not contacts:
            raise InvalidInput("contacts", [], "a list of at least 1")
        return cls(
            p_OC=arrays.freeze([c.position for c in contacts]),
            R_OC=arrays.freeze([c.R_OC for c in contacts]),
            models=tuple(c.model for c in contacts),
            mu=arrays.freeze([(c.friction or 0.0) * (c.model is not ContactModel.FRICTIONLESS) for c in contacts]),
            gamma=arrays.freeze([(c.torsional_friction or 0.0) * (c.model is ContactModel.SOFT) for c in contacts]),
            min_normal=arrays.freeze([c.min_normal for c in contacts]),
            max_normal=arrays.freeze([math.inf if c.max_normal is None else c.max_normal for c in contacts]),
        )

    def __len__(self) -> int:
        return len(self.models)

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """The contacts one by one."""
        return tuple(
            Contact(
                position=self.p_OC[i],
                normal=self.R_OC[i, :, 2],
                tangent=self.R_OC[i, :, 0],
                model=model,
                friction=None if model is ContactModel.FRICTIONLESS else float(self.mu[i]),
                torsional_friction=float(self.gamma[i]) if model is ContactModel.SOFT else None,
                min_normal=float(self.min_normal[i]),
                max_normal=None if math.isinf(self.max_normal[i]) else float(self.max_normal[i]),
            )
            for i, model in enumerate(self.models)
        )

    @cached_property
    def centroid(self) -> Array:
        """(3,) the mean of the contacts' positions in O, m."""
        return arrays.freeze(self.p_OC.mean(axis=0))

    @cached_property
    def columns(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        """(k,) where each stacked force component stands among the 4 N padded ones."""
        columns = np.array([4 * i + c for i, model in enumerate(self.models) for c in model.columns], dtype=np.intp)
        columns.setflags(write=False)
        return columns

    @cached_property
    def normal_rows(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        """(N,) where each contact's normal force stands among the stacked components."""
        rows = np.flatnonzero(self.columns % 4 == 2)
        rows.setflags(write=False)
        return rows

    @cached_property
    def transmissible(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(k,) whether a stacked component can be other than zero. A normal force that may not press is held at zero."""
        contact, column = self.columns // 4, self.columns % 4
        tangential, twist = column < 2, column == 3
        dead = (tangential & (self.mu[contact] == 0)) | (twist & (self.gamma[contact] == 0))
        transmissible = ~(dead | ((tangential | twist) & (self.max_normal[contact] == 0)))
        transmissible.setflags(write=False)
        return np.asarray(transmissible)

    @cached_property
    def first_rows(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        """(N,) where each contact's components begin among the stacked ones."""
        rows = np.cumsum([0, *(len(model.columns) for model in self.models[:-1])])
        rows.setflags(write=False)
        return rows

    @property
    def size(self) -> int:
        """k, the number of stacked force components."""
        return len(self.columns)

    def pad(self, f: Array) -> Array:
        """Stacked forces (k,) → (N, 4) as (f_t1, f_t2, f_n, m_n), zeros where a model has no such component."""
        padded = np.zeros(4 * len(self))
        padded[self.columns] = f
        return padded.reshape(len(self), 4)

    def split(self, f: Array) -> tuple[Array, ...]:
        """Stacked forces (k,) → one array a contact, with its model's components."""
        ends = np.cumsum([len(model.columns) for model in self.models])
        return tuple(arrays.freeze(part) for part in np.split(f, ends[:-1]))

    def wrench_bases(self) -> Array:
        """(N, 6, 4): the wrench on the object about O's origin, in O, of each padded unit force: [R 0; S(p)R n]."""
        x, y, z = self.p_OC.T[:, :, None]  # m
        rx, ry, rz = self.R_OC.transpose(1, 0, 2)
        moments = np.stack([y * rz - z * ry, z * rx - x * rz, x * ry - y * rx], axis=1)  # S(p) R, m
        bases = np.zeros((len(self), 6, 4))
        bases[:, :3, :3] = self.R_OC
        bases[:, 3:, :3] = moments
        bases[:, 3:, 3] = self.R_OC[:, :, 2]
        return bases


def _unit_vector(value: Any, field: str) -> Array:
    """A direction of any length but zero, normalised without overflow."""
    x, y, z = arrays.check_array(value, field, (3,)).tolist()
    largest = max(abs(x), abs(y), abs(z))
    if largest == 0.0:
        raise InvalidInput(field, value, "a direction: not zero")
    x, y, z = x / largest, y / largest, z / largest
    length = math.sqrt(x * x + y * y + z * z)
    return arrays.freeze([x / length, y / length, z / length])


def _unit_tangent(value: Any, normal: Array) -> Array:
    """t₁ from what the caller gave, or by the rule of the default frame."""
    if value is None:
        axis = (0.0, 1.0, 0.0) if abs(normal[0]) >= 0.9 else (1.0, 0.0, 0.0)
        return _unit_vector(cross(normal.tolist(), axis), "tangent")
    given = _unit_vector(value, "tangent")
    across = given - (given @ normal) * normal
    if math.sqrt(across @ across) < _PARALLEL_TOLERANCE:
        raise InvalidInput("tangent", value, "not parallel to the normal")
    return _unit_vector(across - (across @ normal) * normal, "tangent")

"""Contacts between fingers and the object: `Contact`, one contact, and `ContactSet`, several contacts as arrays.

The third axis of a contact frame C is the inward normal n, which points into the object. The force of the finger on the
object is f = (f_t1, f_t2, f_n) in C; a soft finger adds the moment m_n about the normal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.core.text_table import Table
from graspforce.geometry.vectors import cross

_UNIT_ROUNDING = 1e-15  # of a squared length or an inner product of unit vectors
_PARALLEL_TOLERANCE = 1e-6  # rad; at smaller angles to the normal, rounding determines the direction of the tangent


class ContactModel(str, Enum):
    """Contact model: the force components that a contact transmits."""

    FRICTIONLESS = "frictionless"  # (f_n)
    POINT = "point"  # (f_t1, f_t2, f_n)
    SOFT = "soft"  # (f_t1, f_t2, f_n, m_n)

    @property
    def columns(self) -> tuple[int, ...]:
        """The model's components, as columns of the padded force (f_t1, f_t2, f_n, m_n)."""
        return _COLUMNS[self]


_COLUMNS = {ContactModel.FRICTIONLESS: (2,), ContactModel.POINT: (0, 1, 2), ContactModel.SOFT: (0, 1, 2, 3)}


@dataclass(frozen=True, eq=False, slots=True)
class Contact:
    """One contact. The fields hold validated values: a unit normal, and a unit tangent orthogonal to it.

    Args:
        position: (3,) p_OC, the contact in the object's frame O, m.
        normal: (3,) inward normal in O, of any length except zero.
        friction: friction coefficient μ ≥ 0; required unless the contact is frictionless.
        model: "frictionless", "point" or "soft".
        tangent: (3,) t₁ in O; its component along the normal is removed. Default: n × e_x, or n × e_y where |n_x| ≥ 0.9.
        torsional_friction: torsional friction length γ ≥ 0, m: the largest moment about the normal for each newton of normal
            force. Required for a soft contact.
        min_normal: smallest normal force, N, ≥ 0.
        max_normal: largest normal force, N, ≥ min_normal; None for no limit.

    Raises:
        InvalidInput: a value is not allowed; names the field, the value and what is allowed.
    """

    position: Array
    normal: Array
    friction: float | None = None
    model: ContactModel = ContactModel.POINT
    tangent: Array = None  # type: ignore[assignment]  # set by __post_init__
    torsional_friction: float | None = None
    min_normal: float = 0.0
    max_normal: float | None = None

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            position: npt.ArrayLike,
            normal: npt.ArrayLike,
            friction: float | None = None,
            model: ContactModel | Literal["frictionless", "point", "soft"] = ContactModel.POINT,
            tangent: npt.ArrayLike | None = None,
            torsional_friction: float | None = None,
            min_normal: float = 0.0,
            max_normal: float | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        model = ContactModel(fields.check_choice(self.model, "model", [model.value for model in ContactModel]))
        position = arrays.check_array(self.position, "position", (3,))
        normal = _unit_vector(self.normal, "normal")
        tangent = _unit_tangent(self.tangent, normal)
        mu, gamma, max_normal = self.friction, self.torsional_friction, self.max_normal
        if mu is not None or model is not ContactModel.FRICTIONLESS:
            mu = arrays.check_number(mu, "friction", minimum=0.0)
        if gamma is not None or model is ContactModel.SOFT:
            gamma = arrays.check_number(gamma, "torsional_friction", minimum=0.0)
        min_normal = arrays.check_number(self.min_normal, "min_normal", minimum=0.0)
        if max_normal is not None:
            max_normal = arrays.check_number(max_normal, "max_normal", minimum=0.0)
            if min_normal > max_normal:
                raise InvalidInput("min_normal", min_normal, f"at most max_normal, which is {max_normal:g}")
        set_fields(
            self,
            model=model,
            position=position,
            normal=normal,
            tangent=tangent,
            friction=mu,
            torsional_friction=gamma,
            min_normal=min_normal,
            max_normal=max_normal,
        )

    @property
    def R_OC(self) -> Array:
        """(3, 3) the contact frame in O: columns t₁, t₂ = n × t₁, n."""
        n, t = self.normal.tolist(), self.tangent.tolist()
        return np.asarray(np.array([t, cross(n, t), n]).T)

    @classmethod
    def from_dict(cls, record: object, field: str = "") -> Contact:
        """Return the contact of a record in a problem file.

        Args:
            record: mapping with the constructor's arguments.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        required = ["position", "normal"]
        optional = ["model", "friction", "tangent", "torsional_friction", "min_normal", "max_normal"]
        values = fields.check_record(record, field, required=required, optional=optional)
        try:
            return cls(**values)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the record of the contact, as in a problem file. Optional fields with their default value are omitted."""
        record: JsonRecord = {
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


_ARRAYS = ("p_OC", "R_OC", "mu", "gamma", "min_normal", "max_normal")  # of a contact set, by rows


@dataclass(frozen=True, eq=False)
class ContactSet:
    """N contacts as arrays, in the order in which their forces are stacked. Make one from contacts with `stack`.

    Attributes:
        p_OC: (N, 3) positions in O, m.
        R_OC: (N, 3, 3) contact frames in O, columns t₁, t₂, n.
        models: N contact models.
        mu: (N,) friction coefficients; zero for frictionless contacts.
        gamma: (N,) torsional friction lengths, m; zero unless soft.
        min_normal: (N,) smallest normal forces, N.
        max_normal: (N,) largest normal forces, N; inf for no limit.
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
        """Return contacts as arrays, in the same order.

        Args:
            contacts: at least one contact.

        Raises:
            InvalidInput: no contacts.
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

    def select(self, places: Sequence[int]) -> ContactSet:
        """Return some of the contacts.

        Args:
            places: their indices, in the order of the result.
        """
        index = list(places)
        models = tuple(self.models[i] for i in index)
        return ContactSet(models=models, **{name: arrays.freeze(getattr(self, name)[index]) for name in _ARRAYS})

    def followed_by(self, other: ContactSet) -> ContactSet:
        """Return these contacts and others after them.

        Args:
            other: the others.
        """
        rows = {name: arrays.freeze(np.concatenate([getattr(self, name), getattr(other, name)])) for name in _ARRAYS}
        return ContactSet(models=self.models + other.models, **rows)

    def __len__(self) -> int:
        return len(self.models)

    def __str__(self) -> str:
        return str(self._table())

    def _repr_html_(self) -> str:
        return self._table().to_html()

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """The contacts as single records."""
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
        """(3,) mean of the contact positions in O, m."""
        return arrays.freeze(self.p_OC.mean(axis=0))

    @cached_property
    def columns(self) -> npt.NDArray[np.intp]:
        """(k,) indices of the stacked force components among the 4 N padded ones."""
        columns = np.array([4 * i + c for i, model in enumerate(self.models) for c in model.columns], dtype=np.intp)
        columns.setflags(write=False)
        return columns

    @cached_property
    def normal_rows(self) -> npt.NDArray[np.intp]:
        """(N,) indices of the normal forces among the stacked components."""
        rows = np.flatnonzero(self.columns % 4 == 2)
        rows.setflags(write=False)
        return rows

    @cached_property
    def transmissible(self) -> npt.NDArray[np.bool_]:
        """(k,) whether a stacked component can be non-zero.

        A friction component is zero without friction, or if the largest normal force is zero. Normal forces always count.
        """
        contact, column = self.columns // 4, self.columns % 4
        tangential, torsional = column < 2, column == 3
        without = (tangential & (self.mu[contact] == 0)) | (torsional & (self.gamma[contact] == 0))
        transmissible = ~(without | ((tangential | torsional) & (self.max_normal[contact] == 0)))
        transmissible.setflags(write=False)
        return np.asarray(transmissible)

    def _table(self) -> Table:
        """Return the contacts as a table."""
        header = ("contact", "x mm", "y mm", "z mm", "n x", "n y", "n z", "model", "μ", "γ mm", "min N", "max N")
        limits = zip(self.mu, 1e3 * self.gamma, self.min_normal, self.max_normal, strict=True)
        rows = tuple(
            (str(i), *(f"{x:.2f}" for x in 1e3 * p), *(f"{x:.3f}" for x in R[:, 2]), model.value, *(f"{x:g}" for x in each))
            for i, (p, R, model, each) in enumerate(zip(self.p_OC, self.R_OC, self.models, limits, strict=True))
        )
        return Table(header, rows)

    @property
    def size(self) -> int:
        """k, the number of stacked force components."""
        return len(self.columns)

    def pad(self, f: Array) -> Array:
        """Return stacked forces as padded forces (f_t1, f_t2, f_n, m_n). Components that a model lacks are zero.

        Args:
            f: (…, k) stacked forces, N and N·m, contact frames.

        Returns:
            (…, N, 4), N and N·m.
        """
        if f.ndim == 1:
            padded = np.zeros(4 * len(self))
            padded[self.columns] = f
            return padded.reshape(len(self), 4)
        padded = np.zeros((*f.shape[:-1], 4 * len(self)))
        padded[..., self.columns] = f
        return padded.reshape(*f.shape[:-1], len(self), 4)

    def split(self, f: Array) -> tuple[Array, ...]:
        """Return stacked forces as one array for each contact, with the components of its model.

        Args:
            f: (k,) stacked forces, N and N·m, contact frames.
        """
        ends = np.cumsum([len(model.columns) for model in self.models])
        return tuple(arrays.freeze(part) for part in np.split(f, ends[:-1]))

    def wrench_bases(self) -> Array:
        """Return the wrenches on the object of padded unit forces, (N, 6, 4); see `wrench_bases`."""
        return wrench_bases(self.p_OC, self.R_OC)


def wrench_bases(p_OC: Array, R_OC: Array) -> Array:
    """Return the wrenches on the object of padded unit forces at contacts: [R 0; S(p)R n].

    Args:
        p_OC: (…, 3) contact positions in O, m.
        R_OC: (…, 3, 3) contact frames in O.

    Returns:
        (…, 6, 4): about O's origin, in O, linear rows first, 1 and m.
    """
    x, y, z = p_OC[..., 0, None], p_OC[..., 1, None], p_OC[..., 2, None]  # m
    rx, ry, rz = R_OC[..., 0, :], R_OC[..., 1, :], R_OC[..., 2, :]
    bases = np.zeros((*p_OC.shape[:-1], 6, 4))
    bases[..., :3, :3] = R_OC
    bases[..., 3, :3], bases[..., 4, :3], bases[..., 5, :3] = y * rz - z * ry, z * rx - x * rz, x * ry - y * rx  # S(p) R, m
    bases[..., 3:, 3] = R_OC[..., 2]
    return bases


def _unit_vector(value: object, field: str) -> Array:
    """Return a vector divided by its length, without overflow. Raise InvalidInput if it is zero.

    A unit vector is returned unchanged, so that a contact that was saved and loaded is the same to the last digit.
    """
    x, y, z = arrays.check_array(value, field, (3,)).tolist()
    largest = max(abs(x), abs(y), abs(z))
    if largest <= 1.0 and abs(x * x + y * y + z * z - 1.0) <= _UNIT_ROUNDING:
        return arrays.freeze([x, y, z])
    if largest == 0.0:
        raise InvalidInput(field, value, "a direction: not zero")
    x, y, z = x / largest, y / largest, z / largest
    length = math.sqrt(x * x + y * y + z * z)
    return arrays.freeze([x / length, y / length, z / length])


def _unit_tangent(value: object, normal: Array) -> Array:
    """Return t₁: the given tangent made orthogonal to the normal, or the tangent of the default frame."""
    if value is None:
        axis = (0.0, 1.0, 0.0) if abs(normal[0]) >= 0.9 else (1.0, 0.0, 0.0)
        return _unit_vector(cross(normal.tolist(), axis), "tangent")
    given = _unit_vector(value, "tangent")
    if abs(given @ normal) <= _UNIT_ROUNDING:
        return given
    across = given - (given @ normal) * normal
    if math.sqrt(across @ across) < _PARALLEL_TOLERANCE:
        raise InvalidInput("tangent", value, "not parallel to the normal")
    return _unit_vector(across - (across @ normal) * normal, "tangent")

"""Options of a plant: how the simulated hand and object differ from what the controller was given."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.records import set_fields
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import GRAVITY_PALM_UP

_NOT_NEGATIVE = ("coulomb", "stribeck", "viscous", "torque_gain", "friction", "torsional_friction", "rolling_friction")


@dataclass(frozen=True, eq=False, slots=True)
class PlantOptions:
    """How a plant differs from its grasp's hand, object and contacts. The default is a plant without any difference.

    A value for each joint or finger may be given as one number for all. The friction torque of a joint at rate v is

        (coulomb + stribeck · exp(−(v/stribeck_velocity)²)) · sign(v) + viscous · v,

    and up to coulomb + stribeck at rest (Armstrong-Hélouvry, Dupont and Canudas de Wit, 1994).

    Args:
        gravity_H: (3,) acceleration of gravity in H, m/s².
        dt: length of a step, s.
        body: the true object; the grasp's by default. The grasp's shape is used if it has none.
        friction: (N,) true coefficients of friction μ; the grasp's by default.
        torsional_friction: (N,) true torsional friction lengths, m. Default: those of the grasp's soft contacts, and none for
            its other contacts.
        rolling_friction: (N,) lengths of the moment that resists rolling, per normal force, m; none by default.
        tip_offset: (N, 3) displacements of the fingertips' centres from their places in the hand's description, in the tip
            frames, m.
        shape_offset: (3,) displacement of the object's surface from its place in O, m.
        shape_turn: (3,) rotation vector of the object's surface about O's origin, in O, rad.
        coulomb: (n,) Coulomb friction of the joints, N·m.
        stribeck: (n,) additional friction of the joints at rest, N·m.
        stribeck_velocity: (n,) rate at which the additional friction has fallen to 37 %, rad/s.
        viscous: (n,) viscous friction of the joints, N·m·s/rad.
        torque_gain: (n,) true torque of the motors per commanded torque.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    gravity_H: Array = field(default_factory=lambda: freeze(GRAVITY_PALM_UP))
    dt: float = 1e-3
    body: Body | None = None
    friction: Array | None = None
    torsional_friction: Array | None = None
    rolling_friction: Array | None = None
    tip_offset: Array | None = None
    shape_offset: Array = field(default_factory=lambda: freeze(np.zeros(3)))
    shape_turn: Array = field(default_factory=lambda: freeze(np.zeros(3)))
    coulomb: Array = field(default_factory=lambda: freeze(0.0))
    stribeck: Array = field(default_factory=lambda: freeze(0.0))
    stribeck_velocity: Array = field(default_factory=lambda: freeze(0.05))
    viscous: Array = field(default_factory=lambda: freeze(0.0))
    torque_gain: Array = field(default_factory=lambda: freeze(1.0))

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            gravity_H: npt.ArrayLike = ...,
            dt: float = ...,
            body: Body | None = None,
            friction: npt.ArrayLike | None = None,
            torsional_friction: npt.ArrayLike | None = None,
            rolling_friction: npt.ArrayLike | None = None,
            tip_offset: npt.ArrayLike | None = None,
            shape_offset: npt.ArrayLike = ...,
            shape_turn: npt.ArrayLike = ...,
            coulomb: npt.ArrayLike = ...,
            stribeck: npt.ArrayLike = ...,
            stribeck_velocity: npt.ArrayLike = ...,
            viscous: npt.ArrayLike = ...,
            torque_gain: npt.ArrayLike = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        set_fields(self, dt=arrays.check_number(self.dt, "dt", above=0.0))
        for name in ("gravity_H", "shape_offset", "shape_turn"):
            set_fields(self, **{name: arrays.check_array(getattr(self, name), name, (3,))})
        if self.tip_offset is not None:
            set_fields(self, tip_offset=arrays.check_array(self.tip_offset, "tip_offset", (None, 3)))
        for name in (*_NOT_NEGATIVE, "stribeck_velocity"):
            value = getattr(self, name)
            if value is not None:
                shape: tuple[None, ...] = () if np.ndim(value) == 0 else (None,)
                limits = {"above": 0.0} if name == "stribeck_velocity" else {"minimum": 0.0}
                set_fields(self, **{name: arrays.check_array(value, name, shape, **limits)})

    def per_joint(self, name: str, n: int) -> Array:
        """Return the values of a field for n joints.

        Args:
            name: field with a value for each joint.
            n: number of joints.

        Raises:
            InvalidInput: the field has another number of values.
        """
        return _spread(getattr(self, name), name, n)

    def contact_friction(self, grasp: Grasp) -> tuple[Array, Array, Array]:
        """Return the friction of each contact: μ, torsional and rolling friction lengths in m, each (N,).

        Args:
            grasp: the grasp, which gives what is not an option.

        Raises:
            InvalidInput: a field has another number of values than the grasp has contacts.
        """
        contacts, count = grasp.contacts, len(grasp.contacts)
        mu = contacts.mu if self.friction is None else _spread(self.friction, "friction", count)
        gamma = contacts.gamma if self.torsional_friction is None else self.torsional_friction
        rolling = np.zeros(count) if self.rolling_friction is None else self.rolling_friction
        return mu, _spread(gamma, "torsional_friction", count), _spread(rolling, "rolling_friction", count)

    def tip_offsets(self, grasp: Grasp) -> Array:
        """Return the displacements of the fingertips' centres, (N, 3) in the tip frames, m.

        Args:
            grasp: the grasp.

        Raises:
            InvalidInput: `tip_offset` has another number of rows than the grasp has contacts.
        """
        shape = (len(grasp.fingers), 3)
        return np.zeros(shape) if self.tip_offset is None else arrays.check_array(self.tip_offset, "tip_offset", shape)


def _spread(values: Array, name: str, count: int) -> Array:
    """Return one value for each of `count` parts."""
    if values.ndim == 0:
        return np.full(count, float(values))
    return arrays.check_array(values, name, (count,))

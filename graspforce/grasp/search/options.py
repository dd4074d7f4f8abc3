"""Options of the grasp search, and its progress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.geometry import Solid
from graspforce.grasp.body import Body
from graspforce.grasp.search.checks import LoadRequirements, load_cases
from graspforce.grasp.search.grasp_class import GraspClass
from graspforce.hand.hand import Hand


@dataclass(frozen=True, slots=True)
class GraspSearchProgress:
    """Progress of a grasp search.

    Attributes:
        tried: number of candidates that were refined and checked.
        largest: largest number of candidates that may be tried in this stage.
        found: number of these that meet all requirements.
        fault: what the best candidate so far lacks; empty if it lacks nothing.
        seconds: time since the search began, s.
    """

    tried: int
    largest: int
    found: int
    fault: str
    seconds: float


GraspSearchCallback = Callable[[GraspSearchProgress], bool]  # returns False to stop


@dataclass(frozen=True, eq=False, slots=True)
class GraspSearchOptions:
    """Requirements of `find_grasp` beyond friction and gravity.

    Args:
        max_normal: largest normal force of each contact, N, > 0.
        slip_margin: least slip margin μ f_n − ‖f_t‖ that all contacts can have at once under each gravity, N, ≥ 0.
        travel: distance by which the fingers can move the object both ways along each axis of H, m, ≥ 0. None for 5 mm if
            possible, otherwise for the grasp whose object can be moved furthest.
        clearance: least distance between fingers, and of the object from the palm and the links, m, ≥ 0.
        edge_ratio: least distance of a contact from the edge of its face, divided by the tip radius, ≥ 0.
        palm_normal_H: (3,) outward normal of the palm in H, of any length but zero. None for the axis of the palm nearest
            to the mean direction from the fingers' bases to their tips in the neutral posture.
        grasp_class: class of the grasp, a `GraspClass` or its name; None for any.
        approach_O: (3,) direction in O in which the palm faces, of any length but zero, to within 30°; None for any.
        up_O: (3,) direction in O away from a table on which the object stands, of any length but zero; None without a table.
            Fingers and palm keep 6 mm from it.
        pad_friction: torsional friction γ of fingertips whose description states none, m, > 0; None for point contacts there.
        budget: time after which the search ends with the best grasp so far, s, > 0; None for no limit. Results then depend on
            the speed of the machine.
        callback: called after each candidate. It returns False to end the search with the best grasp so far.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    max_normal: float = 20.0
    slip_margin: float = 0.05
    travel: float | None = None
    clearance: float = 0.002
    edge_ratio: float = 0.4
    palm_normal_H: npt.ArrayLike | None = None
    grasp_class: GraspClass | str | None = None
    approach_O: npt.ArrayLike | None = None
    up_O: npt.ArrayLike | None = None
    pad_friction: float | None = None
    budget: float | None = None
    callback: GraspSearchCallback | None = None

    def __post_init__(self) -> None:
        travel, name, gamma = self.travel, self.grasp_class, self.pad_friction
        if name is not None and not isinstance(name, GraspClass):
            name = GraspClass(fields.check_choice(name, "grasp_class", [each.value for each in GraspClass]))
        set_fields(
            self,
            max_normal=arrays.check_number(self.max_normal, "max_normal", above=0.0),
            slip_margin=arrays.check_number(self.slip_margin, "slip_margin", minimum=0.0),
            travel=None if travel is None else arrays.check_number(travel, "travel", minimum=0.0),
            clearance=arrays.check_number(self.clearance, "clearance", minimum=0.0),
            edge_ratio=arrays.check_number(self.edge_ratio, "edge_ratio", minimum=0.0),
            palm_normal_H=_unit(self.palm_normal_H, "palm_normal_H"),
            grasp_class=name,
            approach_O=_unit(self.approach_O, "approach_O"),
            up_O=_unit(self.up_O, "up_O"),
            pad_friction=None if gamma is None else arrays.check_number(gamma, "pad_friction", above=0.0),
            budget=None if self.budget is None else arrays.check_number(self.budget, "budget", above=0.0),
        )


def check_search(
    hand: Hand, body: Body, friction: float, gravity_H: npt.ArrayLike | None, options: GraspSearchOptions
) -> tuple[Solid, LoadRequirements]:
    """Return the object's surface and the loads of a search, from checked arguments.

    Args:
        hand: the hand.
        body: the object.
        friction: μ of all contacts.
        gravity_H: as in `load_cases`.
        options: of these count `max_normal`, `slip_margin` and `pad_friction`.

    Raises:
        InvalidInput: the object is no solid, or a number is out of range.
    """
    if not isinstance(body.shape, Solid):
        given = None if body.shape is None else type(body.shape).__name__
        raise InvalidInput("body.shape", given, "a sphere, cylinder, box, superquadric or mesh")
    return body.shape, LoadRequirements(
        hand=hand,
        body=body,
        friction=arrays.check_number(friction, "friction", above=0.0),
        max_normal=options.max_normal,
        gravities=load_cases(gravity_H),
        slip_margin=options.slip_margin,
        pad_friction=options.pad_friction,
    )


def _unit(value: npt.ArrayLike | None, field: str) -> Array | None:
    """Return a direction as a unit vector; None for None."""
    if value is None:
        return None
    direction = arrays.check_array(value, field, (3,))
    if not direction.any():
        raise InvalidInput(field, value, "a direction: not zero")
    return freeze(direction / np.linalg.norm(direction))

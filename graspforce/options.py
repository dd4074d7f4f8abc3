"""What options of the command line say in words and numbers: objects, and vectors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from graspforce.body import Body
from graspforce.errors import InvalidInput
from graspforce.problems import objects
from graspforce.shapes import Box, Cylinder, Solid, Sphere

_FINGERTIP = 0.7  # μ of an object that is described by its shape alone: rubber on plastic


def thing(name: str, mass: float | None, friction: float | None) -> tuple[Body, float]:
    """An object and its friction, by name or by shape.

    Args:
        name: an object of Table 1 of 004 by name, or sphere:RADIUS, cylinder:RADIUS,HEIGHT or box:X,Y,Z in m.
        mass: kg; by default the object's own, and 50 g for a shape.
        friction: μ; by default the object's own, and 0.7 for a shape.
    """
    kind, _, sizes = name.partition(":")
    makers: dict[str, tuple[int, Callable[..., Solid]]] = {
        "sphere": (1, Sphere),
        "cylinder": (2, Cylinder),
        "box": (3, lambda *edges: Box(np.array(edges))),
    }
    if kind in makers:
        count, make = makers[kind]
        numbers = _numbers(sizes, "object", count)
        return Body.solid(make(*numbers), 0.05 if mass is None else mass), _FINGERTIP if friction is None else friction
    known = {each.name: each for each in objects.ist_objects()}
    if name not in known:
        raise InvalidInput("object", name, f"sphere:RADIUS, cylinder:RADIUS,HEIGHT, box:X,Y,Z or one of {', '.join(known)}")
    found = known[name]
    return Body.solid(found.shape, found.mass if mass is None else mass), found.friction if friction is None else friction


def _numbers(text: str, field: str, count: int) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise InvalidInput(field, text, f"{count} numbers with commas between them" if count > 1 else "a number")
    return numbers


def vector(text: str, field: str, count: int = 3) -> tuple[float, ...]:
    """Numbers of the command line: 0,0,-9.81."""
    return tuple(_numbers(text, field, count))

"""What options of the command line say in words and numbers: vectors, objects, and the hold that a command begins with."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.hand.hand import Hand
from graspforce.problems import objects

_DEFAULT_FRICTION = 0.7  # μ of an object that is described by its shape alone: rubber on plastic


@dataclass(frozen=True, eq=False, slots=True)
class GraspOptions:
    """Which hand shall hold what, as options say it; read at once, so that what cannot be is refused before anything begins.

    Args:
        hand_name: a shipped hand's name, or a description file.
        thing: the object, as `thing` reads it.
        mass: kg; by default the object's own, and 50 g for a shape.
        friction: μ; by default the object's own, and 0.7 for a shape.
        fingers: names with commas between them; by default the best three or four.
        gravity: x, y, z in H with commas between them, m/s².
        seed: of the search.

    Attributes:
        hand, body, mu, gravity_H: what these say.

    Raises:
        InvalidInput: an object or a gravity that cannot be.
        UnknownName: no such hand.
    """

    hand_name: str
    thing: str
    mass: float | None
    friction: float | None
    fingers: str | None
    gravity: str
    seed: int
    hand: Hand = field(init=False, repr=False)
    body: Body = field(init=False, repr=False)
    mu: float = field(init=False, repr=False)
    gravity_H: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        put("gravity_H", arrays.check_array(parse_vector(self.gravity, "gravity"), "gravity", (3,)))
        put("hand", Hand.load(self.hand_name))
        body, mu = parse_object(self.thing, self.mass, self.friction)
        put("body", body)
        put("mu", mu)

    def search(self, console: Console) -> Grasp:
        """The hold; the search, which takes a moment, and what it found are shown.

        Raises:
            InvalidInput: no hold was found, or fingers, a mass or a friction that cannot be.
            UnknownName: a finger that the hand does not have.
        """
        who, what = self.hand.name, self.thing
        fingers = None if self.fingers is None else self.fingers.split(",")
        with console.status(f"Looking for a way to hold the {what} with {who}"):
            grasp = find_grasp(self.hand, self.body, fingers, friction=self.mu, gravity_H=self.gravity_H, seed=self.seed)
        weight = f"{1e3 * self.body.mass:.0f} g, μ = {self.mu:g}"
        console.print(f"[bold]{who}[/] holds the [bold]{what}[/] ({weight}) with {', '.join(grasp.fingers)}.")
        return grasp


def parse_object(name: str, mass: float | None, friction: float | None) -> tuple[Body, float]:
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
        try:
            shape = make(*numbers)
        except InvalidInput as error:
            raise error.with_prefix("object") from None
        return Body.solid(shape, 0.05 if mass is None else mass), _DEFAULT_FRICTION if friction is None else friction
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


def parse_vector(text: str, field: str, count: int = 3) -> tuple[float, ...]:
    """Numbers of the command line: 0,0,-9.81."""
    return tuple(_numbers(text, field, count))


def check_new_file(path: Path | None, option: str) -> None:
    """Refuse a file that cannot be written, before there is anything to write to it; None is no file."""
    if path is None:
        return
    if os.path.isdir(path):  # which, unlike Path's, is no error for a name that is too long
        raise InvalidInput(option, str(path), "a file, not a directory")
    if os.path.exists(path):
        if not os.access(path, os.W_OK):
            raise InvalidInput(option, str(path), "a file that may be written to")
        return
    _check_writable(path.parent, path, option)


def check_new_folder(path: Path | None, option: str) -> None:
    """Refuse a directory that is not there and cannot be made, or not be written to; None is no directory."""
    if path is not None:
        _check_writable(path, path, option)


def _check_writable(folder: Path, path: Path, option: str) -> None:
    """Refuse a path where nothing can be written to a folder, which may still have to be made."""
    there = next(each for each in (folder, *folder.absolute().parents) if os.path.exists(each))
    if not (os.path.isdir(there) and os.access(there, os.W_OK | os.X_OK)):
        raise InvalidInput(option, str(path), f"in a directory that may be written to, which {there} is not")

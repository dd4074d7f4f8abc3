"""Parse options of the command line: vectors, objects, files, and the grasp that a command starts with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from graspforce.cli.drive_options import parse_drive
from graspforce.cli.film_format import FilmFormat
from graspforce.cli.output_files import check_new_file, check_new_folder
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Solid, Sphere, Superquadric, TriangleMesh
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.link_grasp import LinkGrasp
from graspforce.grasp.search import GraspClass, GraspSearchOptions, find_grasp, find_link_grasp
from graspforce.grasp.search.grasp_class import ENVELOPING_CLASSES
from graspforce.hand.hand import Hand
from graspforce.problems import objects

_DEFAULT_FRICTION = 0.7  # μ of an object given by its shape alone: rubber on plastic
_DEFAULT_MASS = 0.05  # kg
_OBJECT_FORMS = "sphere:RADIUS, cylinder:RADIUS,HEIGHT, box:X,Y,Z, superquadric:A,B,C,E1,E2 (m) or mesh:FILE[,SCALE]"


@dataclass(frozen=True, eq=False, slots=True)
class GraspOptions:
    """Hand, object and search of a grasp, parsed and checked when the options are made.

    Args:
        hand_name: name of a hand that ships, or a description file.
        object_name: the object, as for `parse_object`.
        mass: kg (default: that of the named object; 0.05 for a shape).
        friction: μ (default: that of the named object; 0.7 for a shape).
        fingers: names of fingers, separated by commas (default: chosen automatically).
        gravity: x, y, z in H, separated by commas, m/s².
        seed: random seed of the grasp search.
        drive: one drive for all joints, as for `parse_drive` (default: those of the hand's description).
        requirements: class of the grasp and pads (default: any class, and the pads of the hand's description).

    Attributes:
        hand, body, mu, gravity_H: the parsed values.

    Raises:
        InvalidInput: an object or a gravity that is not allowed.
        UnknownName: no such hand.
    """

    hand_name: str
    object_name: str
    mass: float | None
    friction: float | None
    fingers: str | None
    gravity: str
    seed: int
    drive: str | None = None
    requirements: GraspSearchOptions = field(default_factory=GraspSearchOptions)
    hand: Hand = field(init=False, repr=False)
    body: Body = field(init=False, repr=False)
    mu: float = field(init=False, repr=False)
    gravity_H: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        put("gravity_H", arrays.check_array(parse_vector(self.gravity, "gravity"), "gravity", (3,)))
        hand = Hand.load(self.hand_name)
        put("hand", hand if self.drive is None else hand.with_drives(parse_drive(self.drive)))
        body, mu = parse_object(self.object_name, self.mass, self.friction)
        put("body", body)
        put("mu", mu)

    def search(self, console: Console, options: GraspSearchOptions | None = None) -> Grasp:
        """Search a grasp, and print it.

        Args:
            console: where the progress and the grasp are printed.
            options: of the search (default: `requirements`).

        Raises:
            InvalidInput: no grasp was found, or a value is not allowed.
            UnknownName: the hand has no finger of that name.
        """
        hand_name, object_name = self.hand.name, self.object_name
        fingers = None if self.fingers is None else self.fingers.split(",")
        options = self.requirements if options is None else options
        with console.status(f"Searching a grasp of the {object_name} with {hand_name}"):
            if is_enveloping(options):
                grasp = self.search_links(options, self.gravity_H).as_grasp()
            else:
                common: dict[str, Any] = {"friction": self.mu, "gravity_H": self.gravity_H, "seed": self.seed}
                grasp = find_grasp(self.hand, self.body, fingers, **common, options=options)
        weight = f"{1e3 * self.body.mass:.0f} g, μ = {self.mu:g}"
        console.print(f"[bold]{hand_name}[/] holds the [bold]{object_name}[/] ({weight}) with {', '.join(grasp.fingers)}.")
        return grasp

    def search_links(self, options: GraspSearchOptions, gravity_H: Array) -> LinkGrasp:
        """Search a grasp with contacts on inner links or the palm.

        Args:
            options: of the search, with an enveloping class.
            gravity_H: (3,) or (K, 3) accelerations of gravity in H, m/s².

        Raises:
            InvalidInput: no grasp was found, or an option is given that this search does not have.
        """
        chosen = GraspClass(options.grasp_class)
        given = (self.fingers, "--fingers"), (options.approach_O, "--approach"), (options.up_O, "--table")
        for value, option in given:
            if value is not None:
                raise InvalidInput(option, value, f"absent for the class {chosen.value}")
        common: dict[str, Any] = {"friction": self.mu, "gravity_H": gravity_H, "seed": self.seed}
        return find_link_grasp(self.hand, self.body, chosen, **common, options=options)


def is_enveloping(options: GraspSearchOptions) -> bool:
    """Return whether a search is one for contacts on inner links or the palm.

    Args:
        options: of the search.
    """
    return getattr(options.grasp_class, "value", options.grasp_class) in ENVELOPING_CLASSES


@dataclass(frozen=True, slots=True)
class RunFiles:
    """The files of a run; None for those that are not wanted.

    Args:
        video: file of the film.
        frames: directory of the film's frames.
        plots: directory of the plots.
        force: whether existing files are replaced; pictures in directories always are.
        film: size, rate and viewpoint of the film.

    Raises:
        InvalidInput: a file or a directory cannot be written.
    """

    video: Path | None = None
    frames: Path | None = None
    plots: Path | None = None
    force: bool = True
    film: FilmFormat = field(default_factory=FilmFormat)

    def __post_init__(self) -> None:
        check_new_file(self.video, "--video", self.force)
        check_new_folder(self.frames, "--frames")
        check_new_folder(self.plots, "--plots")


def parse_object(name: str, mass: float | None, friction: float | None) -> tuple[Body, float]:
    """Return an object and its friction coefficient, by name or by shape.

    Args:
        name: sphere:RADIUS, cylinder:RADIUS,HEIGHT, box:X,Y,Z or superquadric:A,B,C,E1,E2 in m; mesh:FILE or mesh:FILE,SCALE
            with metres per unit of the file; or the name of an object of the IST object set.
        mass: kg (default: that of the named object; 0.05 for a shape).
        friction: μ (default: that of the named object; 0.7 for a shape).

    Raises:
        InvalidInput: no such object, or sizes that are not allowed.
    """
    kind, _, sizes = name.partition(":")
    makers: dict[str, tuple[int, Callable[..., Solid]]] = {
        "sphere": (1, Sphere),
        "cylinder": (2, Cylinder),
        "box": (3, lambda *edges: Box(np.array(edges))),
        "superquadric": (5, lambda *sizes: Superquadric(sizes[:3], sizes[3:])),
    }
    if kind == "mesh":
        return _solid_body(_load_mesh(sizes), mass), _DEFAULT_FRICTION if friction is None else friction
    if kind in makers:
        count, make = makers[kind]
        numbers = _numbers(sizes, "object", count)
        try:
            shape = make(*numbers)
        except InvalidInput as error:
            raise error.with_prefix("object") from None
        return _solid_body(shape, mass), _DEFAULT_FRICTION if friction is None else friction
    known = {each.name: each for each in objects.ist_objects()}
    if name not in known:
        raise InvalidInput("object", name, f"{_OBJECT_FORMS}, or one of {', '.join(known)}")
    found = known[name]
    return Body.solid(found.shape, found.mass if mass is None else mass), found.friction if friction is None else friction


def _solid_body(shape: Solid, mass: float | None) -> Body:
    """Return a body of uniform density, of 50 g if there is no mass."""
    return Body.solid(shape, _DEFAULT_MASS if mass is None else mass)


def _load_mesh(text: str) -> TriangleMesh:
    """Return the mesh of FILE or FILE,SCALE."""
    file, separator, scale = text.rpartition(",")
    try:
        factor = float(scale) if separator else 1.0
    except ValueError:
        file, factor = text, 1.0  # a file name with a comma
    return TriangleMesh.load(file or text, scale=factor)


def _numbers(text: str, field: str, count: int) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise InvalidInput(field, text, f"{count} numbers separated by commas" if count > 1 else "a number")
    return numbers


def parse_vector(text: str, field: str, count: int = 3) -> tuple[float, ...]:
    """Return the numbers of an option such as 0,0,-9.81.

    Args:
        text: numbers separated by commas.
        field: name of the option in errors.
        count: how many numbers are expected.

    Raises:
        InvalidInput: another count, or not numbers.
    """
    return tuple(_numbers(text, field, count))

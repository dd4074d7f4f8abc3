"""What a URDF file says, read as it stands.

Pinocchio builds the dynamics from the same text, but drops what a hand needs to be checked: effort limits of followers, mimic
joints, which shapes a link has. This file reads those facts with the standard library and judges nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import ModelError

MOVING_TYPES = ("revolute", "continuous", "prismatic", "planar", "floating")


@dataclass(frozen=True, eq=False, slots=True)
class Inertial:
    """Mass, kg; centre of mass (3,) in the link's frame, m; inertia (3, 3) about it in the link's axes, kg·m²."""

    mass: float
    com: Array
    I: Array  # noqa: E741 - the field's own letter


@dataclass(frozen=True, eq=False, slots=True)
class UrdfMesh:
    """A mesh as the URDF names it, ``package://…`` or a path, and by how much (3,) its own coordinates grow to become m."""

    name: str
    scale: Array


@dataclass(frozen=True, eq=False, slots=True)
class UrdfShape:
    """One shape: centre p (3,) in m and axes R (3, 3) in the link's frame; full extents `size` (3,) along these axes, m.

    `size` is None for a mesh, whose file is not opened; `mesh` is None for all others.
    """

    kind: str
    p: Array
    R: Array
    size: Array | None
    mesh: UrdfMesh | None = None


@dataclass(frozen=True, eq=False, slots=True)
class UrdfLink:
    """A link: its inertia, its collision shapes (its visual ones where it has no collision shape), and its visual ones."""

    name: str
    inertial: Inertial | None
    shapes: tuple[UrdfShape, ...]
    visuals: tuple[UrdfShape, ...]


@dataclass(frozen=True, slots=True)
class Mimic:
    """q = multiplier · q_leader + offset."""

    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False, slots=True)
class UrdfJoint:
    """A joint at p (3,) m in the parent link's frame; limits are None where the file gives none.

    Positions in rad, effort in N·m, velocity in rad/s, damping in N·m·s/rad, friction in N·m (prismatic: m and N).
    """

    name: str
    type: str
    parent: str
    child: str
    p: Array
    lower: float | None
    upper: float | None
    effort: float | None
    velocity: float | None
    damping: float
    friction: float
    mimic: Mimic | None

    @property
    def is_moving(self) -> bool:
        return self.type in MOVING_TYPES


@dataclass(frozen=True, eq=False, slots=True)
class Urdf:
    """The links and joints of one file, in its order, and the link that no joint moves."""

    name: str
    links: Mapping[str, UrdfLink]
    joints: Mapping[str, UrdfJoint]
    root: str

    def chain(self, link: str) -> tuple[UrdfJoint, ...]:
        """The joints from the root to a link, in that order."""
        above = {joint.child: joint for joint in self.joints.values()}
        found: list[UrdfJoint] = []
        while link in above:
            found.append(above[link])
            link = above[link].parent
        return tuple(reversed(found))


def read(text: str, where: str) -> Urdf:
    """The facts of a URDF text. ``where`` names the file in errors.

    Raises:
        ModelError: not XML, not a URDF, numbers that are none, or links and joints that make no tree.
    """
    root = _parse(text, where)
    links = {name: _link(element, where) for name, element in _named(root, "link", where)}
    joints = {name: _joint(element, name, where) for name, element in _named(root, "joint", where)}
    for joint in joints.values():
        for end in (joint.parent, joint.child):
            if end not in links:
                raise ModelError(f"{where}: joint {joint.name} names the link {end}, which the file does not have")
    children = [joint.child for joint in joints.values()]
    for child in children:
        if children.count(child) > 1:
            raise ModelError(f"{where}: link {child} hangs on more than one joint; a hand must be a tree")
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise ModelError(f"{where}: must have exactly one link that no joint moves, not {roots or 'none'}")
    reached = {roots[0]}
    while more := {joint.child for joint in joints.values() if joint.parent in reached} - reached:
        reached |= more
    for name in links:
        if name not in reached:
            raise ModelError(
                f"{where}: link {name} hangs on a loop of joints that never meets {roots[0]}; a hand must be a tree"
            )
    return Urdf(root.get("name", ""), links, joints, roots[0])


def with_inertias(text: str, inertias: Mapping[str, Inertial], where: str) -> str:
    """The same URDF text with other inertias for the named links; every link named must exist."""
    root = _parse(text, where)
    elements = dict(_named(root, "link", where))
    for name, inertial in inertias.items():
        if name not in elements:
            raise ModelError(f"{where}: has no link {name}, for which the description gives an inertia")
        old = elements[name].find("inertial")
        if old is not None:
            elements[name].remove(old)
        new = ElementTree.SubElement(elements[name], "inertial")
        ElementTree.SubElement(new, "origin", xyz=" ".join(repr(float(x)) for x in inertial.com), rpy="0 0 0")
        ElementTree.SubElement(new, "mass", value=repr(inertial.mass))
        entries = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(inertial.I[i, j])) for i in range(3) for j in range(i, 3)}
        ElementTree.SubElement(new, "inertia", entries)
    return ElementTree.tostring(root, encoding="unicode")


def _parse(text: str, where: str) -> ElementTree.Element:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # entities can make a small file huge, and a URDF needs none
        raise ModelError(f"{where}: declares a document type or entities, which a URDF has no use for")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise ModelError(f"{where}: is not XML: {error}") from None
    if root.tag != "robot":
        raise ModelError(f"{where}: is not a URDF: its root element is <{root.tag}>, not <robot>")
    return root


def _named(root: ElementTree.Element, tag: str, where: str) -> Iterable[tuple[str, ElementTree.Element]]:
    seen: set[str] = set()
    for element in root.findall(tag):
        name = element.get("name")
        if not name or name in seen:
            raise ModelError(f"{where}: a <{tag}> has {f'the name {name} of another' if name else 'no name'}")
        seen.add(name)
        yield name, element


def _link(element: ElementTree.Element, where: str) -> UrdfLink:
    name = f"{where}: link {element.get('name')}"
    inertial = element.find("inertial")
    visuals = tuple(_shape(shape, name) for shape in element.findall("visual"))
    return UrdfLink(
        name=element.get("name", ""),
        inertial=None if inertial is None else _inertial(inertial, name),
        shapes=tuple(_shape(shape, name) for shape in element.findall("collision")) or visuals,
        visuals=visuals,
    )


def _inertial(element: ElementTree.Element, where: str) -> Inertial:
    p, R = _origin(element, where)
    mass, inertia = element.find("mass"), element.find("inertia")
    if mass is None or inertia is None:
        raise ModelError(f"{where}: its <inertial> needs a <mass> and an <inertia>")
    i = {key: _number(inertia, key, where) or 0.0 for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
    I_own = np.array([[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]])
    return Inertial(_number(mass, "value", where) or 0.0, p, freeze(R @ I_own @ R.T))


def _shape(element: ElementTree.Element, where: str) -> UrdfShape:
    p, R = _origin(element, where)
    geometry = element.find("geometry")
    if geometry is None or len(geometry) == 0:
        raise ModelError(f"{where}: a shape has no <geometry>")
    body = geometry[0]
    size: list[float] | None = None
    mesh = None
    if body.tag == "mesh":
        mesh = UrdfMesh(
            body.get("filename", ""), freeze(_vector(body, "scale", where) if "scale" in body.attrib else [1.0] * 3)
        )
    elif body.tag == "box":
        size = _vector(body, "size", where)
    elif body.tag == "sphere":
        size = [2.0 * (_number(body, "radius", where) or 0.0)] * 3
    elif body.tag in ("cylinder", "capsule"):
        radius, length = _number(body, "radius", where) or 0.0, _number(body, "length", where) or 0.0
        size = [2.0 * radius, 2.0 * radius, length + (2.0 * radius if body.tag == "capsule" else 0.0)]
    return UrdfShape(body.tag, p, R, None if size is None else freeze(size), mesh)


def _joint(element: ElementTree.Element, name: str, where: str) -> UrdfJoint:
    where = f"{where}: joint {name}"
    ends = [element.find(tag) for tag in ("parent", "child")]
    limit, dynamics, mimic = (element.find(tag) for tag in ("limit", "dynamics", "mimic"))
    return UrdfJoint(
        name=name,
        type=element.get("type", ""),
        parent="" if ends[0] is None else ends[0].get("link", ""),
        child="" if ends[1] is None else ends[1].get("link", ""),
        p=_origin(element, where)[0],
        lower=_number(limit, "lower", where),
        upper=_number(limit, "upper", where),
        effort=_number(limit, "effort", where),
        velocity=_number(limit, "velocity", where),
        damping=_number(dynamics, "damping", where) or 0.0,
        friction=_number(dynamics, "friction", where) or 0.0,
        mimic=None if mimic is None else _mimic(mimic, where),
    )


def _mimic(element: ElementTree.Element, where: str) -> Mimic:
    multiplier, offset = _number(element, "multiplier", where), _number(element, "offset", where)
    return Mimic(element.get("joint", ""), 1.0 if multiplier is None else multiplier, offset or 0.0)


def _origin(element: ElementTree.Element, where: str) -> tuple[Array, Array]:
    """p and R of an element's <origin>; roll, pitch, yaw turn about the fixed x, y, z axes in that order."""
    origin = element.find("origin")
    if origin is None:
        return freeze(np.zeros(3)), freeze(np.eye(3))
    p = _vector(origin, "xyz", where) if "xyz" in origin.attrib else [0.0] * 3
    roll, pitch, yaw = _vector(origin, "rpy", where) if "rpy" in origin.attrib else [0.0] * 3
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(x), math.sin(x)) for x in (roll, pitch, yaw))
    Rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    Rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return freeze(p), freeze(Rz @ Ry @ Rx)


def _vector(element: ElementTree.Element, key: str, where: str) -> list[float]:
    words = element.get(key, "").split()
    if len(words) != 3:
        raise ModelError(f"{where}: {key} = {element.get(key)!r} must be three numbers")
    return [_finite(word, key, where) for word in words]


def _number(element: ElementTree.Element | None, key: str, where: str) -> float | None:
    if element is None or key not in element.attrib:
        return None
    return _finite(element.attrib[key], key, where)


def _finite(word: str, key: str, where: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ModelError(f"{where}: {key} = {word!r} must be a finite number")
    return value

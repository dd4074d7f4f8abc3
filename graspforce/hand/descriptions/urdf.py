"""The links and joints of a URDF file, read without judgement.

Pinocchio builds the dynamics from the same text, but drops facts that the checks of a hand need: effort limits of followers,
mimic joints, and the shapes of the links.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import ModelError

MOVING_TYPES = ("revolute", "continuous", "prismatic", "planar", "floating")


@dataclass(frozen=True, eq=False, slots=True)
class Inertial:
    """The inertia of a link.

    Attributes:
        mass: kg.
        com: (3,) centre of mass in the link's frame, m.
        I: (3, 3) inertia about the centre of mass, in the link's axes, kg·m².
    """

    mass: float
    com: Array
    I: Array  # noqa: E741 - the field's own letter


@dataclass(frozen=True, eq=False, slots=True)
class UrdfMesh:
    """The mesh of a shape.

    Attributes:
        name: as in the URDF, ``package://…`` or a path.
        scale: (3,) factors from the file's coordinates to metres.
    """

    name: str
    scale: Array


@dataclass(frozen=True, eq=False, slots=True)
class UrdfShape:
    """A collision or visual shape of a link.

    Attributes:
        kind: the URDF's element: box, sphere, cylinder, capsule or mesh.
        p: (3,) centre in the link's frame, m.
        R: (3, 3) axes in the link's frame.
        size: (3,) full extents along these axes, m; None for a mesh, whose file is not opened.
        mesh: the mesh; None for the other kinds.
    """

    kind: str
    p: Array
    R: Array
    size: Array | None
    mesh: UrdfMesh | None = None


@dataclass(frozen=True, eq=False, slots=True)
class UrdfLink:
    """A link.

    Attributes:
        name: as in the URDF.
        inertial: its inertia; None if the file gives none.
        shapes: its collision shapes; its visual shapes if it has no collision shapes.
        visuals: its visual shapes.
    """

    name: str
    inertial: Inertial | None
    shapes: tuple[UrdfShape, ...]
    visuals: tuple[UrdfShape, ...]


@dataclass(frozen=True, slots=True)
class Mimic:
    """The coupling of a mimic joint: q = multiplier · q_leader + offset."""

    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False, slots=True)
class UrdfJoint:
    """A joint. Units for a revolute joint; a prismatic joint has m and N instead of rad and N·m.

    Attributes:
        name: as in the URDF.
        type: as in the URDF, such as "revolute".
        parent: name of the parent link.
        child: name of the child link.
        p: (3,) position in the parent link's frame, m.
        R: (3, 3) axes in the parent link's frame at position zero.
        axis: (3,) axis in the joint's frame, as in the file; not normalised.
        lower: least position, rad; None if the file gives none.
        upper: largest position, rad; None likewise.
        effort: largest torque, N·m; None likewise.
        velocity: largest rate, rad/s; None likewise.
        damping: N·m·s/rad.
        friction: Coulomb friction, N·m.
        mimic: the coupling of a mimic joint; None for other joints.
    """

    name: str
    type: str
    parent: str
    child: str
    p: Array
    R: Array
    axis: Array
    lower: float | None
    upper: float | None
    effort: float | None
    velocity: float | None
    damping: float
    friction: float
    mimic: Mimic | None

    @property
    def is_moving(self) -> bool:
        """Whether the joint has a degree of freedom."""
        return self.type in MOVING_TYPES


@dataclass(frozen=True, eq=False, slots=True)
class Urdf:
    """The links and joints of one file.

    Attributes:
        name: name of the robot.
        links: by name, in the order of the file.
        joints: by name, in the order of the file.
        root: name of the link that no joint moves.
    """

    name: str
    links: Mapping[str, UrdfLink]
    joints: Mapping[str, UrdfJoint]
    root: str

    def chain(self, link: str) -> tuple[UrdfJoint, ...]:
        """Return the joints from the root to a link, in that order.

        Args:
            link: name of the link.
        """
        above = {joint.child: joint for joint in self.joints.values()}
        found: list[UrdfJoint] = []
        while link in above:
            found.append(above[link])
            link = above[link].parent
        return tuple(reversed(found))

    def fixed_links(self, link: str) -> tuple[str, ...]:
        """Return a link and all links that fixed joints join to it, away from the root.

        Args:
            link: name of the link.
        """
        found = [link]
        for name in found:
            found += [joint.child for joint in self.joints.values() if joint.parent == name and not joint.is_moving]
        return tuple(found)

    def pose_on(self, link: str, fixed: str) -> tuple[Array, Array]:
        """Return the pose of one of the `fixed_links` of a link in that link's frame: position (3,), m, and axes (3, 3).

        Args:
            link: name of the link.
            fixed: name of the link that is fixed to it.
        """
        p, R = np.zeros(3), np.eye(3)
        chain = self.chain(fixed)
        start = next((i + 1 for i, joint in enumerate(chain) if joint.child == link), 0)
        for joint in chain[start:]:
            p, R = p + R @ joint.p, R @ joint.R
        return p, R

    def shapes_on(self, link: str) -> tuple[UrdfShape, ...]:
        """Return the shapes of a link and of all its `fixed_links`, in the link's frame.

        Args:
            link: name of the link.
        """
        shapes = []
        for name in self.fixed_links(link):
            p, R = self.pose_on(link, name)
            shapes += [replace(shape, p=p + R @ shape.p, R=R @ shape.R) for shape in self.links[name].shapes]
        return tuple(shapes)


def read(text: str, where: str) -> Urdf:
    """Read a URDF text.

    Args:
        text: the URDF.
        where: name of the file, for error messages.

    Raises:
        ModelError: not XML, not a URDF, a value is not a number, or the links and joints do not form a tree.
    """
    root = parse(text, where)
    links = {name: _link(element, where) for name, element in _named(root, "link", where)}
    joints = {name: _joint(element, name, where) for name, element in _named(root, "joint", where)}
    for joint in joints.values():
        for end in (joint.parent, joint.child):
            if end not in links:
                raise ModelError(f"{where}: joint {joint.name} names the link {end}, which is not in the file")
    children = [joint.child for joint in joints.values()]
    for child in children:
        if children.count(child) > 1:
            raise ModelError(f"{where}: link {child} is the child of more than one joint; a hand must be a tree")
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise ModelError(f"{where}: must have exactly one root link, not {roots or 'none'}")
    reached = {roots[0]}
    while more := {joint.child for joint in joints.values() if joint.parent in reached} - reached:
        reached |= more
    for name in links:
        if name not in reached:
            raise ModelError(
                f"{where}: link {name} is in a loop of joints that is not connected to {roots[0]}; a hand must be a tree"
            )
    return Urdf(root.get("name", ""), links, joints, roots[0])


def with_inertias(text: str, inertias: Mapping[str, Inertial], where: str) -> str:
    """Return the URDF text with other inertias for some links.

    Args:
        text: the URDF.
        inertias: the new inertias by the name of the link.
        where: name of the file, for error messages.

    Raises:
        ModelError: not a URDF, or it has no link of that name.
    """
    root = parse(text, where)
    elements = dict(_named(root, "link", where))
    for name, inertial in inertias.items():
        if name not in elements:
            raise ModelError(f"{where}: has no link {name}, but the description gives its inertia")
        old = elements[name].find("inertial")
        if old is not None:
            elements[name].remove(old)
        new = ElementTree.SubElement(elements[name], "inertial")
        ElementTree.SubElement(new, "origin", xyz=" ".join(repr(float(x)) for x in inertial.com), rpy="0 0 0")
        ElementTree.SubElement(new, "mass", value=repr(inertial.mass))
        entries = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(inertial.I[i, j])) for i in range(3) for j in range(i, 3)}
        ElementTree.SubElement(new, "inertia", entries)
    return ElementTree.tostring(root, encoding="unicode")


def parse(text: str, where: str) -> ElementTree.Element:
    """Return the root element of a URDF text.

    Args:
        text: the URDF.
        where: name of the file, for error messages.

    Raises:
        ModelError: not XML, not a URDF, or it declares entities.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # entities can expand a small file without bound
        raise ModelError(f"{where}: declares a document type or entities, which are not allowed in a URDF")
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
    limit, dynamics, mimic, axis = (element.find(tag) for tag in ("limit", "dynamics", "mimic", "axis"))
    p, R = _origin(element, where)
    return UrdfJoint(
        name=name,
        type=element.get("type", ""),
        parent="" if ends[0] is None else ends[0].get("link", ""),
        child="" if ends[1] is None else ends[1].get("link", ""),
        p=p,
        R=R,
        axis=freeze([1.0, 0.0, 0.0] if axis is None else _vector(axis, "xyz", where)),
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
    """Return position (3,), m, and axes (3, 3) of an element's <origin>: roll, pitch, yaw about the fixed x, y, z axes."""
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

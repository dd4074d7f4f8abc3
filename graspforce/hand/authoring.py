"""Descriptions for new hands: a first version from a URDF, in which the motors' numbers remain to be filled in."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, ModelError, UnknownName
from graspforce.core.whole_file import write_text
from graspforce.hand.descriptions import description as descriptions
from graspforce.hand.descriptions import urdf
from graspforce.hand.descriptions.urdf import Urdf, UrdfJoint, UrdfLink
from graspforce.hand.hand import Hand
from graspforce.hand.shapes.fingertips import Fingertip, find_fingertips
from graspforce.hand.shapes.meshes import Directories, find_mesh_file
from graspforce.hand.shapes.shape_geometry import diagonal_of_shapes, solid_moments

DEFAULT_DENSITY = 1500.0  # kg/m³: between plastic with air and motors of steel and copper
LARGEST_PLAUSIBLE_EFFORT = 5.0  # N·m; larger limits of a URDF are not those of a hand's motors

_FRAME_TOLERANCE = 0.5  # of the pad's radius, between an existing tip frame and the pad's centre
_TO_FILL_IN = "FILL IN: "
_TIP_DISTANCE, _TIP_SCALE = 0.045, 0.01  # m, of the tips from their mean in the neutral posture
_MIDDLE_WEIGHT = 0.5  # of a joint at the end of its range


@dataclass(frozen=True, slots=True)
class NewDescription:
    """A first description of a hand, and the changes to its URDF.

    Attributes:
        record: the description; values to fill in are null.
        urdf_text: the URDF of the hand alone, with the frames of the fingertips; None if the given URDF serves as it is.
        unfilled: paths of the values to fill in, such as ``motors[0].torque``.
        remarks: what was found, changed and assumed, one sentence each.
    """

    record: dict[str, Any]
    urdf_text: str | None
    unfilled: tuple[str, ...]
    remarks: tuple[str, ...]

    def write(self, path: str | os.PathLike[str], replace: bool = False) -> None:
        """Write the description, and beside it its URDF if there is a new one.

        Args:
            path: path of the description file.
            replace: whether existing files may be replaced.

        Raises:
            InvalidInput: one of the two files exists, and `replace` is false.
            OSError: a file cannot be written.
        """
        target = Path(path)
        model = target.parent / self.record["urdf"]
        for file in [target, *([model] if self.urdf_text is not None else [])]:
            if file.exists() and not replace:
                raise InvalidInput("path", str(file), "a new file, or given with replace to replace the existing one")
        if self.urdf_text is not None:
            write_text(model, self.urdf_text)
        write_text(target, json.dumps(self.record, indent=2, ensure_ascii=False) + "\n")


@dataclass(frozen=True, slots=True)
class AuthoringOptions:
    """Options of `describe_urdf`.

    Args:
        base: URDF link that is the hand's base; None for the root. With it, the hand of a whole robot can be described.
        density: of links without mass, kg/m³, > 0.
        directories: directories to search for meshes first.

    Raises:
        InvalidInput: the density is not a positive number.
    """

    base: str | None = None
    density: float = DEFAULT_DENSITY
    directories: Directories = ()

    def __post_init__(self) -> None:
        arrays.check_number(self.density, "density", above=0.0)


def describe_urdf(path: str | os.PathLike[str], output: str | os.PathLike[str], options: AuthoringOptions) -> NewDescription:
    """Return a first description of the hand in a URDF.

    - Fingers end at the moving links that carry no others. A tip frame is kept if it is at the centre of the pad: the centre of
      the sphere in the end of the link's shapes. Otherwise a frame is added there.
    - Mimic joints become couplings.
    - Links without mass get that of their shapes at `density`. Inertias that are impossible, or too large for the shapes, are
      replaced by those of the shapes.
    - Torques and rates come from the URDF's limits if they are plausible. Rotor inertias are to be filled in.

    Args:
        path: the URDF.
        output: path of the description to be written; names of files in it are relative to it.
        options: options.

    Raises:
        UnknownName: the URDF has no link of the name of the base.
        ModelError: the URDF cannot be read, or no finger was found.
    """
    source, target = Path(path), Path(output)
    tree = _Editor(source, options)
    tips = find_fingertips(tree.model, source, options.directories)
    if not tips:
        raise ModelError(f"{source}: no moving link with shapes or with a tip frame was found")
    fingers = [tree.finger(tip) for tip in tips]
    couplings = tree.couplings()
    inertias = tree.inertias()
    followers = {coupling["follower"] for coupling in couplings}
    locked = tree.locks(tips)
    skipped = followers | {lock["joint"] for lock in locked}
    driven = [joint for joint in tree.model.joints.values() if joint.is_moving and joint.name not in skipped]
    motors = _motors(driven)
    name = target.stem
    record: dict[str, Any] = {
        "schema": "graspforce/hand/1",
        "name": name,
        "title": f"{name}: {len(fingers)} fingers, {len(driven)} motors",
        "source": f"{source.name}; see the sources below",
        "license": "FILL IN: license of the URDF",
        "urdf": f"{name}.urdf" if tree.is_changed else os.path.relpath(source, target.parent),
        "fingers": fingers,
        "motors": motors,
        **({"couplings": couplings} if couplings else {}),
        **({"locked": locked} if locked else {}),
        **({"inertias": inertias} if inertias else {}),
    }
    try:
        record["neutral"] = _opposed_posture(_load_with_placeholders(record, source, tree))
    except ModelError as error:
        tree.remarks.append(f"No neutral posture was computed: {error}.")
    unfilled = tuple(descriptions.unfilled_numbers(record))
    return NewDescription(record, tree.text(target) if tree.is_changed else None, unfilled, tuple(tree.remarks))


def _motors(joints: Sequence[UrdfJoint]) -> list[dict[str, Any]]:
    """Return a motor entry for each pair of limits in the URDF, with null for the numbers to fill in."""
    groups: dict[tuple[float | None, float | None], list[str]] = {}
    for joint in joints:
        effort = joint.effort if joint.effort is not None and 0.0 < joint.effort <= LARGEST_PLAUSIBLE_EFFORT else None
        rate = joint.velocity if joint.velocity is not None and joint.velocity > 0.0 else None
        groups.setdefault((effort, rate), []).append(joint.name)
    entries = []
    for (effort, rate), names in groups.items():
        given = [word for word, value in (("torque", effort), ("velocity", rate)) if value is not None]
        missing = [word for word, value in (("torque (N·m)", effort), ("velocity (rad/s)", rate)) if value is None]
        missing += ["rotor_inertia (kg·m², of the rotor alone)", "gear_ratio"]
        known = f"{' and '.join(given)}: limits of the URDF, to be checked. " if given else ""
        motor = {"joints": names, "torque": effort, "velocity": rate, "rotor_inertia": None, "gear_ratio": 1.0}
        entries.append({**motor, "source": f"{known}{_TO_FILL_IN}{', '.join(missing)} from the motor's data sheet"})
    return entries


def _load_with_placeholders(record: dict[str, Any], source: Path, tree: _Editor) -> Hand:
    """Return the hand of a description whose missing numbers are 1, from a temporary folder."""
    motors = [{key: 1.0 if value is None else value for key, value in motor.items()} for motor in record["motors"]]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hand.json"
        model = Path(folder) / "hand.urdf"
        model.write_text(tree.text(path) if tree.is_changed else descriptions.text(source), encoding="utf-8")
        path.write_text(json.dumps({**record, "motors": motors, "urdf": model.name}), encoding="utf-8")
        return Hand.load(path)


def _opposed_posture(hand: Hand) -> dict[str, float]:
    """Return a posture in which the fingertips are around one point at a distance for a small object, by joint.

    It minimises Σ ((‖p_i − c‖ − r)/s)² + Σ (k (q_j − q̄_j)/h_j)², with the mean c of the tips p_i, the middle q̄ and half h of
    the joints' ranges.
    """
    from scipy.optimize import least_squares  # imported here, because it is slow to import

    tips = [finger.name for finger in hand.fingers]
    middle, half = (hand.q_lower + hand.q_upper) / 2.0, (hand.q_upper - hand.q_lower) / 2.0
    common = list(hand.common_joints)

    def residuals(x: Array) -> Array:
        p, _ = hand.tips_along((middle + half * x)[None], tips)
        away = np.linalg.norm(p[0] - p[0].mean(axis=0), axis=1)
        return np.concatenate([(away - _TIP_DISTANCE) / _TIP_SCALE, _MIDDLE_WEIGHT * x])

    x = least_squares(residuals, np.zeros(hand.n), bounds=(-0.9, 0.9)).x
    q = middle + half * x
    q[common] = np.clip(0.0, hand.q_lower[common], hand.q_upper[common])
    return {joint.name: round(float(value), 3) for joint, value in zip(hand.joints, q, strict=True)}


class _Editor:
    """A URDF that is being described: its model, its changes, and remarks on them."""

    def __init__(self, source: Path, options: AuthoringOptions) -> None:
        self._source, self._options = source, options
        text = descriptions.text(source)
        self._root = urdf.parse(text, str(source))
        self.is_changed = False
        self.remarks: list[str] = []
        whole = urdf.read(text, str(source))
        if options.base is not None:
            if options.base not in whole.links:
                raise UnknownName("link", options.base, list(whole.links))
            self._keep_branch(whole, options.base)
        self._repair_mimics()
        self.model: Urdf = urdf.read(ElementTree.tostring(self._root, encoding="unicode"), str(source))

    def text(self, target: Path) -> str:
        """Return the changed URDF; mesh files that would not be found from its folder get absolute paths.

        Args:
            target: path of the description, beside which the URDF will be.
        """
        for mesh in self._root.iter("mesh"):
            name = mesh.get("filename", "")
            try:
                file = find_mesh_file(name, self._source, self._options.directories)
            except ModelError:
                continue
            try:
                find_mesh_file(name, target)
            except ModelError:
                mesh.set("filename", str(file.absolute()))
        ElementTree.indent(self._root)
        return ElementTree.tostring(self._root, encoding="unicode") + "\n"

    def finger(self, tip: Fingertip) -> dict[str, Any]:
        """Return the record of a finger, whose tip frame is at the centre of its pad."""
        if tip.pad is None:
            self.remarks.append(
                f"Finger {tip.name}: the frame {tip.frame} is taken as it is; its link has no shapes to check it."
            )
            return {"name": tip.name, "tip": tip.frame}
        radius = round(tip.pad.radius, 5)
        if tip.frame is not None and tip.frame_offset <= _FRAME_TOLERANCE * tip.pad.radius:
            return {"name": tip.name, "tip": tip.frame, "tip_radius": radius}
        name = f"{tip.name}_pad"
        while name in self.model.links:
            name += "_centre"
        self._add_frame(name, tip.link, tip.pad.centre)
        place = ", ".join(f"{1e3 * x:.1f}" for x in tip.pad.centre)
        said = f"Finger {tip.name}: the new frame {name} is at the pad's centre, ({place}) mm in {tip.link}"
        if tip.frame is not None:
            said += f"; the frame {tip.frame} is {1e3 * tip.frame_offset:.1f} mm from it"
        self.remarks.append(f"{said}.")
        return {"name": tip.name, "tip": name, "tip_radius": radius}

    def couplings(self) -> list[dict[str, Any]]:
        """Return the couplings of the mimic joints."""
        found = []
        for joint in self.model.joints.values():
            if joint.mimic is None:
                continue
            found.append(
                {
                    "follower": joint.name,
                    "leader": joint.mimic.leader,
                    "ratio": joint.mimic.multiplier,
                    "offset": joint.mimic.offset,
                    "source": "mimic of the URDF",
                }
            )
        if found:
            self.remarks.append(f"{len(found)} mimic joints became couplings.")
        return found

    def locks(self, tips: Sequence[Fingertip]) -> list[dict[str, Any]]:
        """Return locks of the joints that move no fingertip."""
        moving = {joint.name for tip in tips for joint in self.model.chain(tip.link)}
        idle = [joint.name for joint in self.model.joints.values() if joint.is_moving and joint.name not in moving]
        if idle:
            self.remarks.append(f"Joints that move no fingertip are locked at 0: {', '.join(idle)}.")
        return [{"joint": name, "position": 0.0, "source": "moves no fingertip"} for name in idle]

    def inertias(self) -> list[dict[str, Any]]:
        """Return inertias of moving links that have none, or an impossible one."""
        found, density = [], self._options.density
        for link in self.model.links.values():
            if not link.shapes or not any(joint.is_moving for joint in self.model.chain(link.name)):
                continue
            fault = self._inertia_fault(link)
            if not fault:
                continue
            try:
                solid = solid_moments(link.shapes, self._source, self._options.directories)
            except ModelError as error:
                self.remarks.append(f"Link {link.name} {fault}, and its shapes give none: {error}.")
                continue
            known = link.inertial.mass if link.inertial is not None and link.inertial.mass > 0.0 else None
            mass = density * solid.volume if known is None else known
            I = solid.second_moments * mass / solid.volume  # noqa: E741
            how = f"shapes at {density:g} kg/m³" if known is None else "shapes at uniform density, with the mass of the URDF"
            found.append(
                {
                    "link": link.name,
                    "mass": _rounded(mass),
                    "com": [round(float(x), 7) for x in solid.centroid],
                    "inertia": [_rounded(float(x)) for x in (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])],
                    "source": how,
                }
            )
            self.remarks.append(f"Link {link.name} {fault}: {1e3 * mass:.3g} g from its {how}.")
        return found

    def _inertia_fault(self, link: UrdfLink) -> str:
        """Return why the inertia of a link with shapes cannot be used; empty if it can."""
        if link.inertial is None or link.inertial.mass <= 0.0:
            return "has no mass"
        moments = np.linalg.eigvalsh(link.inertial.I)
        if moments[0] <= 0.0 or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-6):
            return "has an impossible inertia"
        try:
            diagonal = diagonal_of_shapes(link.shapes, self._source, self._options.directories)  # m
        except ModelError:
            return ""
        radius = float(np.sqrt(moments[2] / link.inertial.mass))  # m, of gyration
        return "has an inertia that is too large for its shapes" if radius > diagonal / 2.0 > 0.0 else ""

    def _keep_branch(self, model: Urdf, base: str) -> None:
        """Remove everything that is not carried by a link."""
        links = {base}
        while more := {joint.child for joint in model.joints.values() if joint.parent in links} - links:
            links |= more
        for element in list(self._root):
            parent = element.find("parent")
            is_link = element.tag == "link" and element.get("name") in links
            is_joint = element.tag == "joint" and parent is not None and parent.get("link") in links
            if element.tag in ("link", "joint", "transmission", "gazebo") and not (is_link or is_joint):
                self._root.remove(element)
        self.is_changed = True

    def _repair_mimics(self) -> None:
        """Correct the leaders of mimic joints that lack the prefix of the joints' names."""
        joints = {joint.get("name", ""): joint for joint in self._root.findall("joint")}
        for name, joint in joints.items():
            mimic = joint.find("mimic")
            leader = "" if mimic is None else mimic.get("joint", "")
            if mimic is None or leader in joints:
                continue
            alike = [other for other in joints if leader and other.endswith(leader) and name.startswith(other[: -len(leader)])]
            if len(alike) != 1:
                raise ModelError(f"{self._source}: joint {name} mimics {leader or 'no joint'}, which is not in the file")
            mimic.set("joint", alike[0])
            self.is_changed = True
            self.remarks.append(f"Joint {name} mimics {leader}, which does not exist; {alike[0]} is taken.")

    def _add_frame(self, name: str, link: str, p: Array) -> None:
        """Add a link without mass that is fixed to another at p (3,), m."""
        ElementTree.SubElement(self._root, "link", name=name)
        joint = ElementTree.SubElement(self._root, "joint", name=f"{name}_mount", type="fixed")
        ElementTree.SubElement(joint, "parent", link=link)
        ElementTree.SubElement(joint, "child", link=name)
        ElementTree.SubElement(joint, "origin", xyz=" ".join(f"{x:.6g}" for x in np.round(p, 6) + 0.0), rpy="0 0 0")
        self.is_changed = True


def _rounded(value: float) -> float:
    """Return a number with six significant digits."""
    return float(f"{value:.6g}")

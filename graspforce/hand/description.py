"""A hand's description file: what its URDF cannot say, or says wrongly, with the source of every number.

The file is JSON and stands beside the URDF that it names. It gives the fingers with their tip frames, the motors, the
couplings between joints, joints that are locked, and better inertias where the URDF's are known to be wrong. The records below
are the file, field by field; what is not listed here is an error.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from fnmatch import fnmatchcase
from importlib import metadata
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from graspforce.core.arrays import freeze
from graspforce.core.errors import ModelError, UnknownName
from graspforce.hand import urdf
from graspforce.hand.urdf import Inertial, Urdf

MODELS_FOLDER = Path(__file__).parent / "models"
ROBOT_DATA_PREFIX = "package://example-robot-data/"

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Vector3 = tuple[float, float, float]


class FingerDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A finger: its name, the link or frame at its tip, and the radius of a round tip about that frame's origin, m."""

    name: str
    tip: str
    tip_radius: Positive | None = None


class MotorDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The motor of each joint whose name matches one of ``joints`` (shell patterns: ``*_joint_1``).

    ``torque`` is the largest torque at the joint, either way, N·m; ``velocity`` the largest joint rate, rad/s;
    ``rotor_inertia`` is the rotor's own, kg·m², which the joint feels times ``gear_ratio`` squared.
    """

    joints: tuple[str, ...]
    torque: Positive
    velocity: Positive
    rotor_inertia: NonNegative
    source: str
    gear_ratio: Positive = 1.0


def motor_matches(motor: MotorDescription, joint: str) -> bool:
    """Whether a joint's name matches one of the motor's patterns."""
    return any(fnmatchcase(joint, pattern) for pattern in motor.joints)


class Coupling(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """q_follower = ratio · q_leader + offset: the leader has the motor, the follower has none."""

    follower: str
    leader: str
    source: str
    ratio: float = 1.0
    offset: float = 0.0


class LockedJoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A joint that never moves, and where it stands, rad."""

    joint: str
    source: str
    position: float = 0.0


class InertiaOverride(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What replaces the URDF's inertia of one link.

    ``com`` is the centre of mass in the link's frame, m; ``inertia`` is (ixx, iyy, izz, ixy, ixz, iyz) about the centre of
    mass in the link's axes, kg·m².
    """

    link: str
    mass: Positive
    com: Vector3
    inertia: tuple[float, float, float, float, float, float]
    source: str

    @property
    def inertial(self) -> Inertial:
        xx, yy, zz, xy, xz, yz = self.inertia
        return Inertial(self.mass, freeze(self.com), freeze([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


class HandDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file. ``urdf`` is a path relative to the file, or ``package://example-robot-data/…``.

    ``neutral`` holds the posture from which searches start, joint by joint (rad); a joint that is not named stands at zero, or
    at the limit nearest to it. ``torque_weight`` is the default cost: ``unit`` is ½‖tau‖², ``utilisation`` weighs each torque
    by the inverse square of its motor's limit.
    """

    schema: Literal["graspforce/hand/1"]
    name: str
    title: str
    source: str
    license: str
    urdf: str
    fingers: Annotated[tuple[FingerDescription, ...], Meta(min_length=1)]
    motors: tuple[MotorDescription, ...]
    couplings: tuple[Coupling, ...] = ()
    locked: tuple[LockedJoint, ...] = ()
    inertias: tuple[InertiaOverride, ...] = ()
    neutral: dict[str, float] = {}
    torque_weight: Literal["unit", "utilisation"] = "unit"
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class HandSource:
    """A description and its URDF, read: where both lie, the URDF's text with the description's inertias, and its facts."""

    description: HandDescription
    path: Path
    urdf_path: Path
    urdf_text: str
    urdf: Urdf


def shipped_hands() -> tuple[str, ...]:
    """The names of the hands that ship, without loading any."""
    return tuple(sorted(path.stem for path in MODELS_FOLDER.glob("*.json")))


def find(name_or_path: str | os.PathLike[str]) -> Path:
    """The description file of a shipped hand, or the path itself if it is one.

    Raises:
        UnknownName: neither a shipped hand nor a file; lists the shipped hands.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    if path.suffix == "" and path.name == os.fspath(name_or_path) and path.name in shipped_hands():
        return MODELS_FOLDER / f"{path.name}.json"
    known = shipped_hands()
    raise UnknownName("hand", os.fspath(name_or_path), known, f"the path of a description file, or one of {', '.join(known)}")


def read(name_or_path: str | os.PathLike[str]) -> HandSource:
    """A description and its URDF, both read.

    Raises:
        UnknownName: neither a shipped hand nor a file.
        ModelError: a file that is no description, or whose URDF is not there or cannot be read.
    """
    path = find(name_or_path)
    description = read_description(path)
    urdf_path = locate_urdf(description.urdf, path)
    better = {inertia.link: inertia.inertial for inertia in description.inertias}
    urdf_text = urdf.with_inertias(text(urdf_path), better, str(urdf_path))
    return HandSource(description, path, urdf_path, urdf_text, urdf.read(urdf_text, str(urdf_path)))


def read_description(path: Path) -> HandDescription:
    """A description file alone: what it says of the hand, whether or not its URDF is there.

    Raises:
        ModelError: a file that is no description.
    """
    content = text(path)
    if content.lstrip().startswith("<"):
        raise ModelError(
            f"{path} is a URDF (XML); a hand is loaded from a description file (JSON) that names the URDF, its fingers' tip "
            f"frames and its motors. The files in {MODELS_FOLDER} are examples, and `graspforce hands lint` checks a URDF alone."
        )
    try:
        return msgspec.json.decode(content, type=HandDescription)
    except msgspec.DecodeError as error:  # also a ValidationError, which names the field's path
        raise ModelError(f"{path}: {error}") from None


def locate_urdf(named: str, beside: Path) -> Path:
    """Where the URDF of a description lies: beside the description, or in the package example-robot-data.

    Raises:
        ModelError: it is not there; says what to install where that would help.
    """
    if not named.startswith(ROBOT_DATA_PREFIX):
        path = beside.parent / named
        if not path.is_file():
            raise ModelError(f'{beside}: names the URDF "{named}", but there is no file {path}')
        return path
    inside = named.removeprefix(ROBOT_DATA_PREFIX)
    for share in robot_data_folders():
        if (share / inside).is_file():
            return share / inside
    raise ModelError(
        f"{beside.stem}: its URDF {named} comes with the package example-robot-data, which is not installed: "
        'pip install "graspforce[robots]"'
    )


def robot_data_folders() -> list[Path]:
    """Where the package example-robot-data keeps its files, most likely first.

    The PyPI wheel has no module to import on a plain interpreter: its files lie in share/ under cmeel.prefix, and the
    wheel's own record says where that is. Other distributions put them under the interpreter's prefix.
    """
    places = [Path(sys.prefix) / "share" / "example-robot-data"]
    try:
        files = metadata.files("example-robot-data") or []
    except metadata.PackageNotFoundError:
        return places
    for file in files:
        if file.parts[-2:] == ("example-robot-data", "package.xml"):
            places.insert(0, Path(os.fspath(file.locate())).resolve().parent)
            break
    return places


def text(path: Path) -> str:
    """A file's text; a file that cannot be read is a ModelError."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: cannot be read: {error}") from None

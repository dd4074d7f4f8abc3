"""Description files of hands: the facts that a URDF cannot state or states wrongly, each with its source.

A description is a JSON file beside its URDF. It gives the fingers with their tip frames, the motors, the couplings between
joints, the locked joints, and inertias that replace wrong ones of the URDF. The records below are the file, field by field;
any other field is an error.
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
from graspforce.core.json_text import locate_error
from graspforce.hand.descriptions import urdf
from graspforce.hand.descriptions.contact_description import AllowedContact
from graspforce.hand.descriptions.drive_description import DriveDescription
from graspforce.hand.descriptions.tendon_description import TendonDescription
from graspforce.hand.descriptions.urdf import Inertial, Urdf

MODELS_FOLDER = Path(__file__).parents[1] / "models"
STRIBECK_VELOCITY = 0.05  # rad/s, unless a description gives another
_REQUIRED_NUMBERS = ("torque", "velocity", "rotor_inertia")  # of a motor; null in a description that is not filled in
ROBOT_DATA_PREFIX = "package://example-robot-data/"

TorqueWeight = Literal["unit", "utilisation", "copper_loss"]
Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Vector3 = tuple[float, float, float]


class PadDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The soft pad of a fingertip, which resists a moment about the contact normal.

    Attributes:
        torsional_friction: torsional friction length γ, m: the largest moment about the normal for each newton of normal
            force. A circular patch of radius a with uniform pressure has γ = 2 μ a/3.
        source: where the number comes from.
    """

    torsional_friction: Positive
    source: str


class FingerDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A finger.

    Attributes:
        name: any name.
        tip: URDF link whose frame is the tip frame.
        tip_radius: radius of a spherical tip about that frame's origin, m; null for a tip of another shape.
        pad: soft pad of the tip; null for a tip without torsional friction, a point contact.
    """

    name: str
    tip: str
    tip_radius: Positive | None = None
    pad: PadDescription | None = None


class MotorDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The motor of each joint whose name matches a pattern. A prismatic joint has m, N and rad/m in place of rad, N·m and 1.

    Attributes:
        joints: shell patterns of joint names, such as ``*_joint_1``.
        torque: largest torque at the joint in both directions, N·m.
        velocity: largest joint rate, rad/s.
        rotor_inertia: inertia of the rotor about its own axis, kg·m². At the joint it is multiplied by `gear_ratio` squared.
        source: where the numbers come from.
        gear_ratio: turns of the rotor per turn of the joint.
        holding_torque: largest torque that the gear holds at rest without current, such as a worm, N·m; null for a gear that
            the joint can drive back.
    """

    joints: tuple[str, ...]
    torque: Positive
    velocity: Positive
    rotor_inertia: NonNegative
    source: str
    gear_ratio: Positive = 1.0
    holding_torque: Positive | None = None


def motor_matches(motor: MotorDescription, joint: str) -> bool:
    """Return whether a joint's name matches one of the motor's patterns.

    Args:
        motor: the motor.
        joint: name of the joint.
    """
    return any(fnmatchcase(joint, pattern) for pattern in motor.joints)


class FrictionDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The friction of each actuated joint whose name matches a pattern, as `JointFriction` defines it.

    Attributes:
        joints: shell patterns of joint names, such as ``*_joint_1``.
        coulomb: torque of a joint in steady motion, N·m. A leader's friction includes that of its followers.
        source: where the numbers come from, such as an identification.
        stribeck: torque by which static friction exceeds `coulomb`, N·m.
        stribeck_velocity: rate at which that excess has fallen to 37 %, rad/s.
        viscous: torque per rate, N·m·s/rad.
    """

    joints: tuple[str, ...]
    coulomb: NonNegative
    source: str
    stribeck: NonNegative = 0.0
    stribeck_velocity: Positive = STRIBECK_VELOCITY
    viscous: NonNegative = 0.0


def friction_matches(friction: FrictionDescription, joint: str) -> bool:
    """Return whether a joint's name matches one of the patterns of a friction entry.

    Args:
        friction: the friction entry.
        joint: name of the joint.
    """
    return any(fnmatchcase(joint, pattern) for pattern in friction.joints)


class Coupling(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A coupling q_follower = ratio · q_leader + offset. The leader has the motor, the follower has none.

    Attributes:
        follower: name of the joint without motor.
        leader: name of the joint with the motor.
        source: where the numbers come from.
        ratio: dimensionless.
        offset: rad.
    """

    follower: str
    leader: str
    source: str
    ratio: float = 1.0
    offset: float = 0.0


class LockedJoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A joint that is kept at a fixed position.

    Attributes:
        joint: name of the joint.
        source: where the position comes from.
        position: rad.
    """

    joint: str
    source: str
    position: float = 0.0


class InertiaOverride(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The inertia of one link, in place of the URDF's.

    Attributes:
        link: name of the link.
        mass: kg.
        com: centre of mass in the link's frame, m.
        inertia: (ixx, iyy, izz, ixy, ixz, iyz) about the centre of mass, in the link's axes, kg·m².
        source: where the numbers come from.
    """

    link: str
    mass: Positive
    com: Vector3
    inertia: tuple[float, float, float, float, float, float]
    source: str

    @property
    def inertial(self) -> Inertial:
        """The same inertia as the record of a URDF link."""
        xx, yy, zz, xy, xz, yz = self.inertia
        return Inertial(self.mass, freeze(self.com), freeze([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


class HandDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A description file.

    Attributes:
        schema: version of the format.
        name: name of the hand, as in `Hand.load`.
        title: one line about the hand.
        source: where the geometry and the masses come from.
        license: of the description and the URDF.
        urdf: path relative to the description, or ``package://example-robot-data/…``.
        fingers: at least one.
        motors: every actuated joint matches exactly one.
        friction: every actuated joint matches at most one. Other joints take the URDF's ``<dynamics>`` if they are plausible.
        drives: every actuated joint matches at most one. Other joints have ideal drives that take torques.
        couplings: of joints without motors.
        tendons: couplings whose joints can stop one by one: differentials and breakaways.
        locked: joints that are kept at a fixed position.
        inertias: of links whose URDF inertia is wrong.
        neutral: the neutral posture by joint, rad. Other joints are at zero, or at the limit nearest to zero.
        allowed_contacts: links that may touch although they are not neighbours.
        torque_weight: the default cost. ``unit`` is ½‖tau‖²; ``utilisation`` divides each torque by its limit; ``copper_loss``
            is half of the heat in the windings, in W, and needs the resistance and torque constant of each drive.
        notes: further facts, one sentence or more each.
    """

    schema: Literal["graspforce/hand/1"]
    name: str
    title: str
    source: str
    license: str
    urdf: str
    fingers: Annotated[tuple[FingerDescription, ...], Meta(min_length=1)]
    motors: tuple[MotorDescription, ...]
    friction: tuple[FrictionDescription, ...] = ()
    drives: tuple[DriveDescription, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    tendons: tuple[TendonDescription, ...] = ()
    locked: tuple[LockedJoint, ...] = ()
    inertias: tuple[InertiaOverride, ...] = ()
    neutral: dict[str, float] = {}
    allowed_contacts: tuple[AllowedContact, ...] = ()
    torque_weight: TorqueWeight = "unit"
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class HandSource:
    """A description and its URDF, as read.

    Attributes:
        description: the description.
        path: its file.
        urdf_path: the URDF file.
        urdf_text: the URDF with the inertias of the description.
        urdf: links and joints of `urdf_text`.
    """

    description: HandDescription
    path: Path
    urdf_path: Path
    urdf_text: str
    urdf: Urdf


def shipped_hands() -> tuple[str, ...]:
    """Return the names of the shipped hands. No hand is loaded."""
    return tuple(sorted(path.stem for path in MODELS_FOLDER.glob("*.json")))


def find(name_or_path: str | os.PathLike[str]) -> Path:
    """Return the path of a hand's description file.

    Args:
        name_or_path: name of a shipped hand, or a path.

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


def read(name_or_path: str | os.PathLike[str], placeholders: bool = False) -> HandSource:
    """Read a description and its URDF.

    Args:
        name_or_path: name of a shipped hand, or path of a description.
        placeholders: whether motors' numbers that are not filled in are 1, instead of an error.

    Raises:
        UnknownName: neither a shipped hand nor a file.
        ModelError: not a description, or its URDF is not found or cannot be read.
    """
    path = find(name_or_path)
    description = read_description(path, placeholders)
    urdf_path = locate_urdf(description.urdf, path)
    overrides = {override.link: override.inertial for override in description.inertias}
    urdf_text = urdf.with_inertias(text(urdf_path), overrides, str(urdf_path))
    return HandSource(description, path, urdf_path, urdf_text, urdf.read(urdf_text, str(urdf_path)))


def read_description(path: Path, placeholders: bool = False) -> HandDescription:
    """Read a description without its URDF.

    Args:
        path: the description file.
        placeholders: whether motors' numbers that are not filled in are 1, instead of an error.

    Raises:
        ModelError: not a description, or numbers are to be filled in.
    """
    content = text(path)
    if content.lstrip().startswith("<"):
        raise ModelError(
            f"{path} is a URDF (XML), but a hand needs a description file (JSON) with its URDF, tip frames and motors. "
            f"To write one: graspforce hands new {path}. To check the URDF alone: graspforce hands lint {path}"
        )
    try:
        record = msgspec.json.decode(content)
        missing = unfilled_numbers(record)
        if missing and not placeholders:
            raise ModelError(f"{path}: fill in {', '.join(missing)}: the motors' data, see the field source")
        for motor in record["motors"] if missing else ():
            motor |= {key: 1.0 for key in _REQUIRED_NUMBERS if motor.get(key, 0.0) is None}
        return msgspec.convert(record, HandDescription) if missing else msgspec.json.decode(content, type=HandDescription)
    except (msgspec.DecodeError, RecursionError) as error:  # also a ValidationError, which names the field's path
        raise ModelError(f"{path}: {locate_error(content.encode(), str(error))}") from None


def unfilled_numbers(record: object) -> list[str]:
    """Return the paths of the motors' numbers that are null in a description, such as ``motors[0].torque``.

    Args:
        record: content of a description file.
    """
    motors = record.get("motors") if isinstance(record, dict) else None
    return [
        f"motors[{i}].{key}"
        for i, motor in enumerate(motors if isinstance(motors, list) else ())
        for key, value in (motor.items() if isinstance(motor, dict) else ())
        if value is None and key in _REQUIRED_NUMBERS
    ]


def locate_urdf(named: str, beside: Path) -> Path:
    """Return the path of a description's URDF, beside the description or in the package example-robot-data.

    Args:
        named: the description's `urdf`.
        beside: path of the description.

    Raises:
        ModelError: the file is not found; names the package to install if that would help.
    """
    if not named.startswith(ROBOT_DATA_PREFIX):
        path = beside.parent / named
        if not path.is_file():
            raise ModelError(f'{beside}: urdf = "{named}", but there is no file {path}')
        return path
    inside = named.removeprefix(ROBOT_DATA_PREFIX)
    for share in robot_data_folders():
        if (share / inside).is_file():
            return share / inside
    raise ModelError(
        f"{beside.stem}: the URDF {named} needs the package example-robot-data. Install it: pip install example-robot-data"
    )


def robot_data_folders() -> list[Path]:
    """Return the folders that may contain the files of the package example-robot-data, most likely first.

    The wheel puts its files in share/ below cmeel.prefix, which the wheel's own file list locates. Other distributions, such
    as conda, put them in share/ below the interpreter's prefix.
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
    """Return the text of a file.

    Args:
        path: the file, in UTF-8.

    Raises:
        ModelError: the file cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: cannot be read: {error}") from None

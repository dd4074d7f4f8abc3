"""What makes a hand model lie, and what that does to the answers.

A URDF that draws well may still weigh nothing, weigh it in the wrong place, or allow torques that no motor gives. Force
distribution believes all of it. `lint` reads a URDF, or a description with its URDF, and says what cannot be right.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.core.constants import STANDARD_GRAVITY
from graspforce.core.errors import ModelError
from graspforce.hand import coordinates, urdf
from graspforce.hand import description as descriptions
from graspforce.hand.description import HandDescription, HandSource, MotorDescription
from graspforce.hand.urdf import Inertial, Urdf, UrdfJoint, UrdfLink

_LARGEST_PLAUSIBLE_TORQUE = 5.0  # N·m: no joint of a hand of human size bears more; such hands have 0.1 to 2
_ROUNDING = 1e-6  # of the trace: moments written with six digits may miss the triangle inequality by that
_CENTRE_TOLERANCE = 2e-3  # m: a centre of mass this near the middle of the link's shapes is as good as there


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a model.

    Attributes:
        severity: "error" where answers are wrong or the hand cannot be loaded, "warning" where they may be.
        where: the link or joint.
        what: what is wrong, with the number.
        consequence: what it does to the answers.
        remedy: what to do about it.
    """

    severity: Literal["error", "warning"]
    location: str
    problem: str
    consequence: str
    remedy: str


def lint_hand(hand: str | os.PathLike[str]) -> tuple[Finding, ...]:
    """Every fault found, errors first.

    Args:
        hand: a shipped hand's name, a description file, or a URDF alone. Meshes are not opened.

    Raises:
        UnknownName: neither a shipped hand nor a file.
        ModelError: a file that cannot be read at all.
    """
    path = descriptions.find(hand)
    text = descriptions.text(path)
    if text.lstrip().startswith("<"):
        model = urdf.read(text, str(path))
        findings = [*_check_links(model, None), *_check_urdf_joints(model)]
    else:
        files = descriptions.read(path)
        findings = [
            *_check_loading(files),
            *_check_links(files.urdf, files.description),
            *_check_motors(files.urdf, files.description),
        ]
    return tuple(sorted(findings, key=lambda finding: finding.severity != "error"))


# ── links ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _check_links(model: Urdf, description: HandDescription | None) -> Iterator[Finding]:
    """Faults of every link that moves; what stands still with the palm loads no motor."""
    for link in model.links.values():
        movers = [joint for joint in model.chain(link.name) if joint.is_moving]
        if not movers:
            continue
        if link.inertial is None or link.inertial.mass <= 0:
            yield from _check_mass(model, link, movers[-1], description)
        else:
            yield from _check_inertia(link, link.inertial, movers[-1])
            yield from _check_centre_of_mass(model, link, link.inertial, movers[-1])


def _check_mass(model: Urdf, link: UrdfLink, joint: UrdfJoint, description: HandDescription | None) -> Iterator[Finding]:
    mass = 0.0 if link.inertial is None else link.inertial.mass
    if mass < 0:
        yield Finding(
            "error",
            f"link {link.name}",
            f"its mass is {mass:g} kg",
            "it falls upwards: gravity torques have the wrong sign",
            "give its mass",
        )
        return
    carried = [other for other in _rigidly_joined_links(model, link) if other.inertial is not None and other.inertial.mass > 0]
    if (carried and not link.shapes) or (not carried and link.name != joint.child):
        return  # a frame, such as a tip, on a body that has mass; or its body is named once, by the link on the joint
    problem = "has no mass" if link.inertial is None else "has mass 0"
    if carried:
        consequence = "its weight and inertia are missing from every torque"
        yield Finding(
            "warning", f"link {link.name}", problem, consequence, "give its mass and inertia, or add them to its parent's"
        )
        return
    motor = _motor_of(joint, description)
    moved = motor is not None and motor.rotor_inertia > 0
    yield Finding(
        "warning" if moved else "error",
        f"link {link.name}",
        f"{problem}, and so has everything fixed to it",
        f"{joint.name} carries no weight of it; without rotor inertia nothing resists acceleration there and M is singular",
        "give its mass and inertia, in the URDF or under inertias in the description",
    )


def _check_inertia(link: UrdfLink, inertial: Inertial, joint: UrdfJoint) -> Iterator[Finding]:
    moments = np.linalg.eigvalsh(inertial.I)  # kg·m², ascending
    remedy = "give the inertia of its shape at uniform density, in the URDF or under inertias in the description"
    if moments[0] <= 0:
        yield Finding(
            "error",
            f"link {link.name}",
            f"its inertia is not positive definite: principal moments {_number_list(moments)} kg·m²",
            f"M can lose positive definiteness; {joint.name} may accelerate against its torque",
            remedy,
        )
        return
    if moments[2] - moments[1] - moments[0] > _ROUNDING * moments.sum():
        excess = 100 * (moments[2] / (moments[0] + moments[1]) - 1)
        sides = f"{moments[2]:.3g} > {moments[0]:.3g} + {moments[1]:.3g} kg·m², by {excess:.0f} %"
        yield Finding(
            "error",
            f"link {link.name}",
            f"its inertia breaks the triangle inequality: {sides}",
            f"no mass has it; torques that accelerate {joint.name} are wrong, and simulators may refuse the file",
            remedy,
        )
    low, high = _extent(link)
    diagonal = float(np.linalg.norm(high - low))  # m
    radius = float(np.sqrt(moments[2] / inertial.mass))  # m, of gyration
    sizes = f"its radius of gyration is {1e3 * radius:.2f} mm, its diagonal {1e3 * diagonal:.1f} mm"
    if diagonal > 0 and radius > diagonal / 2:  # more than all mass at the two ends of the diagonal
        yield Finding(
            "error",
            f"link {link.name}",
            f"{sizes}: more than half",
            f"no mass of that size has it: torques that accelerate {joint.name} are too large",
            f"{remedy}; an inertia about the joint instead of the centre of mass looks like this",
        )
    elif diagonal > 0 and radius < diagonal / 20:  # a sixth of a uniform bar's
        yield Finding(
            "warning",
            f"link {link.name}",
            f"{sizes}: less than a twentieth",
            f"it turns like a point: torques that accelerate {joint.name} are too small",
            remedy,
        )


def _check_centre_of_mass(model: Urdf, link: UrdfLink, inertial: Inertial, joint: UrdfJoint) -> Iterator[Finding]:
    """The centre of mass against the middle of the link's shapes, or of its joints where the shapes are meshes."""
    remedy = "give its centre of mass, in the URDF or under inertias in the description"
    at_origin = not inertial.com.any()
    low, high = _extent(link)
    ends = [
        other.p
        for other in model.joints.values()
        if other.parent == link.name and np.linalg.norm(other.p) > 2 * _CENTRE_TOLERANCE
    ]
    if np.isfinite(low).all() and (high > low).any():
        middle, evidence = (low + high) / 2, "the middle of its shapes"
    elif ends:
        middle, evidence = np.mean(ends, axis=0) / 2, "the middle between its joints"
    else:
        if at_origin and any(shape.size is None for shape in link.shapes):
            yield Finding(
                "warning",
                f"link {link.name}",
                "its centre of mass is exactly at its origin, and its shape is a mesh",
                f"the gravity torque of {joint.name} leaves out the link's weight if the origin lies on the joint's axis",
                remedy,
            )
        return
    off = float(np.linalg.norm(inertial.com - middle))  # m
    torque = inertial.mass * STANDARD_GRAVITY * off  # N·m
    if at_origin and off > _CENTRE_TOLERANCE:
        problem = f"its centre of mass is at its origin, {1e3 * off:.1f} mm from {evidence}"
    elif np.isfinite(low).all() and off > np.linalg.norm(high - low):
        problem = f"its centre of mass is {1e3 * off:.1f} mm from {evidence}, outside them"
    else:
        return
    consequence = f"gravity torques of {joint.name} and the joints before it are wrong, in some postures by {torque:.2g} N·m"
    yield Finding("warning", f"link {link.name}", problem, consequence, remedy)


def _extent(link: UrdfLink) -> tuple[Array, Array]:
    """The least and largest corner (3,) of the box around the link's shapes in its own axes, m; NaN without any."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for shape in link.shapes:
        if shape.size is not None:
            half = np.abs(shape.R) @ shape.size / 2
            low, high = np.minimum(low, shape.p - half), np.maximum(high, shape.p + half)
    return (low, high) if np.isfinite(low).all() else (np.full(3, np.nan), np.full(3, np.nan))


def _rigidly_joined_links(model: Urdf, link: UrdfLink) -> list[UrdfLink]:
    """The links that move as one body with this one: joined to it by fixed joints only."""

    def carrier(name: str) -> str:
        moving = [joint.child for joint in model.chain(name) if joint.is_moving]
        return moving[-1] if moving else model.root

    return [other for other in model.links.values() if carrier(other.name) == carrier(link.name)]


# ── joints ────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _check_loading(files: HandSource) -> Iterator[Finding]:
    """What stops the hand from loading."""
    moving = tuple(joint.name for joint in files.urdf.joints.values() if joint.is_moving)
    try:
        coordinates.resolve_coordinates(files, moving)
    except ModelError as error:
        consequence = "the hand cannot be loaded"
        yield Finding("error", f"description {files.description.name}", str(error), consequence, "make the two files agree")


def _check_urdf_joints(model: Urdf) -> Iterator[Finding]:
    """Faults of the joints of a URDF alone, whose limits a user would take over."""
    moving = [joint for joint in model.joints.values() if joint.is_moving]
    for joint in moving:
        location = f"joint {joint.name}"
        if joint.mimic is not None:
            follows = f"{joint.mimic.leader} × {joint.mimic.multiplier:g} + {joint.mimic.offset:g}"
            yield Finding(
                "warning",
                location,
                f"mimics {follows}",
                "read as a joint of its own it gets a motor that does not exist, and the leader's torque misses its share",
                "couple it in the description file: q = T q_a + q0",
            )
        if (
            joint.type not in ("revolute", "prismatic")
            or joint.lower is None
            or joint.upper is None
            or joint.lower >= joint.upper
        ):
            yield Finding(
                "error",
                location,
                f"is {joint.type} with limits {joint.lower} and {joint.upper}",
                "postures have no bounds, and inverse kinematics answers with any",
                "give a lower limit below the upper one",
            )
        if joint.mimic is not None:
            continue
        if joint.effort is None or joint.effort <= 0:
            given = "missing" if joint.effort is None else f"{joint.effort:g}"
            yield Finding(
                "error",
                location,
                f"its effort limit is {given}",
                "with zero no grasp is feasible, without one every force is",
                "give the motor's torque at the joint in the description file",
            )
        elif joint.effort > _LARGEST_PLAUSIBLE_TORQUE:
            yield _torque_finding(location, "effort limit", joint.effort)
        if joint.friction > (joint.effort or 0.0) > 0 or joint.friction > _LARGEST_PLAUSIBLE_TORQUE:
            yield _stiction_finding(joint)
    if moving:
        yield Finding(
            "warning",
            "every joint",
            "a URDF has no rotor inertia",
            "behind a gear of ratio N a rotor counts N² times, often more than the link: accelerating torques are too small",
            "give rotor_inertia and gear_ratio in the description file",
        )


def _check_motors(model: Urdf, description: HandDescription) -> Iterator[Finding]:
    """Faults of a description's motors; the URDF's own effort limits are not used."""
    for motor in description.motors:
        location = "joints " + ", ".join(motor.joints)
        if motor.torque > _LARGEST_PLAUSIBLE_TORQUE:
            yield _torque_finding(location, "motor torque", motor.torque)
        if motor.rotor_inertia == 0:
            yield Finding(
                "warning",
                location,
                "the rotor inertia is zero",
                f"the joint feels {motor.gear_ratio:g}² times the rotor's: torques of fast motion are too small",
                "give rotor_inertia, from the motor's data sheet",
            )
    for joint in model.joints.values():
        own = _motor_of(joint, description)
        if joint.is_moving and own is not None and joint.friction > own.torque:
            yield _stiction_finding(joint)


def _torque_finding(location: str, name: str, torque: float) -> Finding:
    return Finding(
        "warning",
        location,
        f"its {name} is {torque:g} N·m, more than any joint of a hand bears",
        "grasps that the motors cannot hold count as feasible",
        "give the motor's torque at the joint in the description file",
    )


def _stiction_finding(joint: UrdfJoint) -> Finding:
    return Finding(
        "warning",
        f"joint {joint.name}",
        f"its static friction in the URDF is {joint.friction:g} N·m, more than its motor gives",
        "not used here; a simulator that reads the file has a joint that never moves",
        "mend the URDF's <dynamics> before simulating it",
    )


def _motor_of(joint: UrdfJoint, description: HandDescription | None) -> MotorDescription | None:
    if description is None:
        return None
    return next((motor for motor in description.motors if descriptions.motor_matches(motor, joint.name)), None)


def _number_list(values: npt.NDArray[np.floating[Any]]) -> str:
    return ", ".join(f"{x:.3g}" for x in values)

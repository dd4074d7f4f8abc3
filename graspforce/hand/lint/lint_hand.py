"""Checks of hand models: physically impossible or implausible values, and their effect on results.

A URDF made for drawing may have links without mass, with mass in the wrong place, or with torques that no motor has. Force
distribution uses all of these numbers. `lint_hand` reports them with their consequences and remedies.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.constants import STANDARD_GRAVITY
from graspforce.core.errors import ModelError
from graspforce.hand.descriptions import description as descriptions
from graspforce.hand.descriptions import urdf
from graspforce.hand.descriptions.description import HandDescription, HandSource, MotorDescription
from graspforce.hand.descriptions.urdf import Inertial, Urdf, UrdfJoint, UrdfLink
from graspforce.hand.drives.joint_friction import is_plausible
from graspforce.hand.kinematics import resolution
from graspforce.hand.lint.findings import GIVE_INERTIA, Finding
from graspforce.hand.lint.shape_checks import check_densities, check_gyration_radii, check_pads, check_tips
from graspforce.hand.lint.unit_checks import check_joint_numbers, check_motor_numbers

_LARGEST_PLAUSIBLE_TORQUE = 5.0  # N·m, at a joint of a hand of human size; real hands have 0.1 to 2 N·m
_LARGEST_PLAUSIBLE_FORCE = 1000.0  # N, of a prismatic joint; industrial grippers have 20 to 500 N
_ROUNDING = 1e-6  # of the trace: error of the triangle inequality for moments with six digits
_CENTRE_TOLERANCE = 2e-3  # m, between the centre of mass and the centre of the shapes

_GIVE_MASS = "give its mass and inertia, in the URDF or under inertias in the description"
_GIVE_CENTRE = "give its centre of mass, in the URDF or under inertias in the description"
_GIVE_TORQUE = "give the motor's torque at the joint in the description file"


def lint_hand(hand: str | os.PathLike[str]) -> tuple[Finding, ...]:
    """Return the faults of a hand model, errors first.

    Args:
        hand: name of a shipped hand, or path of a description or of a URDF. Meshes that are not found are not checked.

    Raises:
        UnknownName: neither a shipped hand nor a file.
        ModelError: the file cannot be read.
    """
    path = descriptions.find(hand)
    text = descriptions.text(path)
    if text.lstrip().startswith("<"):
        model = urdf.read(text, str(path))
        findings = [
            *_check_links(model, None),
            *check_gyration_radii(model, path),
            *check_densities(model, path),
            *check_joint_numbers(model),
            *_check_urdf_joints(model),
        ]
    else:
        files = descriptions.read(path, placeholders=True)
        unfilled = [*_check_filled_in(path)]
        findings = [
            *unfilled,
            *_check_loading(files),
            *_check_links(files.urdf, files.description),
            *check_gyration_radii(files.urdf, files.urdf_path),
            *check_densities(files.urdf, files.urdf_path),
            *check_joint_numbers(files.urdf),
            *check_tips(files.urdf, files.description, files.urdf_path),
            *(() if unfilled else check_motor_numbers(files.urdf, files.description)),
            *(() if unfilled else _check_motors(files.urdf, files.description)),
            *check_pads(files.urdf, files.description),
        ]
    return tuple(sorted(findings, key=lambda finding: finding.severity != "error"))


# ── links ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _check_links(model: Urdf, description: HandDescription | None) -> Iterator[Finding]:
    """Check the links that move. Links fixed to the palm load no motor."""
    for link in model.links.values():
        movers = [joint for joint in model.chain(link.name) if joint.is_moving]
        if not movers:
            continue
        if link.inertial is None or link.inertial.mass <= 0:
            yield from _check_mass(model, link, movers[-1], description)
        else:
            if not _is_point_mass(model, link, link.inertial):
                yield from _check_moments(link, link.inertial, movers[-1])
            yield from _check_centre_of_mass(model, link, link.inertial)


def _check_mass(model: Urdf, link: UrdfLink, joint: UrdfJoint, description: HandDescription | None) -> Iterator[Finding]:
    """Check a link without positive mass, moved by a joint."""
    location, mass = f"link {link.name}", 0.0 if link.inertial is None else link.inertial.mass
    if mass < 0:
        yield Finding("error", location, f"its mass is {mass:g} kg", "gravity torques have the wrong sign", "give its mass")
        return
    heavy = [other for other in _rigidly_joined_links(model, link) if other.inertial is not None and other.inertial.mass > 0]
    if (heavy and not link.shapes) or (not heavy and link.name != joint.child):
        return  # a frame without shapes on a body with mass; or part of a massless body, reported once at its joint
    problem = "has no mass" if link.inertial is None else "has mass 0"
    if heavy:
        consequence = "its weight and inertia are missing in every torque"
        yield Finding("warning", location, problem, consequence, "give its mass and inertia, or add them to its parent's")
        return
    motor = _motor_of(joint, description)
    has_rotor = motor is not None and motor.rotor_inertia > 0
    yield Finding(
        "warning" if has_rotor else "error",
        location,
        f"{problem}, like everything fixed to it",
        f"{joint.name} carries no weight of it; without rotor inertia the joint-space mass matrix M is singular",
        _GIVE_MASS,
    )


def _is_point_mass(model: Urdf, link: UrdfLink, inertial: Inertial) -> bool:
    """Return whether a link without moments of its own is fixed to a body that has some, such as the frame of a sensor."""
    joined = (other.inertial for other in _rigidly_joined_links(model, link) if other is not link)
    return not inertial.I.any() and any(other is not None and other.mass > 0 and other.I.any() for other in joined)


def _check_moments(link: UrdfLink, inertial: Inertial, joint: UrdfJoint) -> Iterator[Finding]:
    """Check the principal moments: positive, none larger than the sum of the others."""
    moments = np.linalg.eigvalsh(inertial.I)  # kg·m², ascending
    if moments[0] <= 0:
        yield Finding(
            "error",
            f"link {link.name}",
            f"its inertia is not positive definite: principal moments {', '.join(f'{x:.3g}' for x in moments)} kg·m²",
            f"M can lose positive definiteness: {joint.name} may accelerate against its torque",
            GIVE_INERTIA,
        )
    elif moments[2] - moments[1] - moments[0] > _ROUNDING * moments.sum():
        excess = 100 * (moments[2] / (moments[0] + moments[1]) - 1)
        sides = f"{moments[2]:.3g} > {moments[0]:.3g} + {moments[1]:.3g} kg·m², by {excess:.0f} %"
        yield Finding(
            "error",
            f"link {link.name}",
            f"its inertia violates the triangle inequality: {sides}",
            f"no body has this inertia; torques that accelerate {joint.name} are wrong, and simulators may reject the file",
            GIVE_INERTIA,
        )


def _check_centre_of_mass(model: Urdf, link: UrdfLink, inertial: Inertial) -> Iterator[Finding]:
    """Compare the centre of mass with the centre of the link's shapes, or of its joints if the shapes are meshes.

    The weight's force on a sliding joint does not depend on the place of the centre.
    """
    turning = [each for each in model.chain(link.name) if each.is_moving and each.type != "prismatic"]
    if not turning:
        return
    joint = turning[-1]
    at_origin = not inertial.com.any()
    low, high = _extent(link)
    ends = [
        other.p
        for other in model.joints.values()
        if other.parent == link.name and np.linalg.norm(other.p) > 2 * _CENTRE_TOLERANCE
    ]
    if np.isfinite(low).all() and (high > low).any():
        centre, evidence = (low + high) / 2, "the centre of its shapes"
    elif ends:
        centre, evidence = np.mean(ends, axis=0) / 2, "the centre between its joints"
    else:
        if at_origin and any(shape.size is None for shape in link.shapes):
            yield Finding(
                "warning",
                f"link {link.name}",
                "its centre of mass is exactly at its origin, and its shape is a mesh",
                f"the gravity torque of {joint.name} lacks the link's weight if the origin is on the joint's axis",
                _GIVE_CENTRE,
            )
        return
    offset = float(np.linalg.norm(inertial.com - centre))  # m
    torque = inertial.mass * STANDARD_GRAVITY * offset  # N·m
    if at_origin and offset > _CENTRE_TOLERANCE:
        problem = f"its centre of mass is at its origin, {1e3 * offset:.1f} mm from {evidence}"
    elif np.isfinite(low).all() and offset > np.linalg.norm(high - low):
        problem = f"its centre of mass is {1e3 * offset:.1f} mm from {evidence}, outside of them"
    else:
        return
    consequence = f"gravity torques of {joint.name} and the joints before it are wrong by up to {torque:.2g} N·m"
    yield Finding("warning", f"link {link.name}", problem, consequence, _GIVE_CENTRE)


def _extent(link: UrdfLink) -> tuple[Array, Array]:
    """Return the least and largest corner (3,) of the bounding box of the link's shapes, m; NaN without shapes."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for shape in link.shapes:
        if shape.size is not None:
            half = np.abs(shape.R) @ shape.size / 2
            low, high = np.minimum(low, shape.p - half), np.maximum(high, shape.p + half)
    return (low, high) if np.isfinite(low).all() else (np.full(3, np.nan), np.full(3, np.nan))


def _rigidly_joined_links(model: Urdf, link: UrdfLink) -> list[UrdfLink]:
    """Return the links that are joined to a link by fixed joints only, with the link itself."""

    def carrier(name: str) -> str:
        moving = [joint.child for joint in model.chain(name) if joint.is_moving]
        return moving[-1] if moving else model.root

    return [other for other in model.links.values() if carrier(other.name) == carrier(link.name)]


def _check_filled_in(path: Path) -> Iterator[Finding]:
    """Check that a new description has the numbers of its motors."""
    record = json.loads(descriptions.text(path))
    for name in descriptions.unfilled_numbers(record):
        yield Finding(
            "error",
            name,
            "is not filled in",
            "the hand cannot be loaded; the other checks take 1 for it",
            "give the number of the motor's data sheet",
        )


# ── joints ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _check_loading(files: HandSource) -> Iterator[Finding]:
    """Check that the description and the URDF agree."""
    moving = tuple(joint.name for joint in files.urdf.joints.values() if joint.is_moving)
    try:
        resolution.resolve_coordinates(files, moving)
    except ModelError as error:
        location = f"description {files.description.name}"
        yield Finding("error", location, str(error), "the hand cannot be loaded", "make the two files agree")


def _check_urdf_joints(model: Urdf) -> Iterator[Finding]:
    """Check the joints of a URDF without description."""
    moving = [joint for joint in model.joints.values() if joint.is_moving]
    for joint in moving:
        if joint.mimic is not None:
            yield Finding(
                "warning",
                f"joint {joint.name}",
                f"mimics {joint.mimic.leader} × {joint.mimic.multiplier:g} + {joint.mimic.offset:g}",
                "without a coupling it counts as a joint with its own motor, and the leader's torque lacks its share",
                "couple it in the description file: q_full = T q + q0",
            )
        yield from _check_position_limits(joint)
        if joint.mimic is None:
            yield from _check_effort(joint)
    if moving:
        yield Finding(
            "warning",
            "every joint",
            "a URDF has no rotor inertia",
            "a gear of ratio N multiplies the rotor inertia by N²; fast motion needs more torque than computed",
            "give rotor_inertia and gear_ratio in the description file",
        )


def _check_position_limits(joint: UrdfJoint) -> Iterator[Finding]:
    has_limits = joint.lower is not None and joint.upper is not None and joint.lower < joint.upper
    if joint.type in ("revolute", "prismatic") and has_limits:
        return
    yield Finding(
        "error",
        f"joint {joint.name}",
        f"is {joint.type} with limits {joint.lower} and {joint.upper}",
        "postures are unbounded, and inverse kinematics may return any of them",
        "give a lower limit below the upper limit",
    )


def _check_effort(joint: UrdfJoint) -> Iterator[Finding]:
    location = f"joint {joint.name}"
    if joint.effort is None or joint.effort <= 0:
        given = "missing" if joint.effort is None else f"{joint.effort:g}"
        consequence = "without a limit every force is feasible; with a limit of zero no grasp is feasible"
        yield Finding("error", location, f"its effort limit is {given}", consequence, _GIVE_TORQUE)
    elif joint.effort > _largest_effort([joint]):
        yield _torque_finding(location, "effort limit", joint.effort, [joint])
    torque = joint.effort or _largest_effort([joint])  # N·m; half of it is allowed for friction
    if not is_plausible(joint, torque, joint.velocity):
        yield _friction_finding(joint)


def _check_motors(model: Urdf, description: HandDescription) -> Iterator[Finding]:
    """Check the motors of a description, which replace the effort limits of the URDF."""
    for motor in description.motors:
        location = "joints " + ", ".join(motor.joints)
        own_joints = [joint for joint in model.joints.values() if descriptions.motor_matches(motor, joint.name)]
        if motor.torque > _largest_effort(own_joints):
            yield _torque_finding(location, "motor torque", motor.torque, own_joints)
        if motor.rotor_inertia == 0:
            yield Finding(
                "warning",
                location,
                "the rotor inertia is zero",
                f"the joint lacks {motor.gear_ratio:g}² times the rotor's inertia; fast motion needs more torque",
                "give rotor_inertia, from the motor's data sheet",
            )
    for joint in model.joints.values():
        own = _motor_of(joint, description)
        if joint.is_moving and own is not None and not is_plausible(joint, own.torque, own.velocity):
            yield _friction_finding(joint)
    yield from _check_friction(description)


def _check_friction(description: HandDescription) -> Iterator[Finding]:
    """Check the friction entries of a description against the weakest motor of their joints."""
    for entry in description.friction:
        own = [motor.torque for motor in description.motors if set(motor.joints) & set(entry.joints)]
        level = entry.coulomb + entry.stribeck  # N·m
        weakest = min(own, default=max((motor.torque for motor in description.motors), default=0.0))
        if level > weakest / 2.0:
            yield Finding(
                "warning",
                "joints " + ", ".join(entry.joints),
                f"their friction is {level:g} N·m, more than half of the motor's {weakest:g} N·m",
                "little torque remains for contact forces, and an error of the friction moves the object",
                "check the unit (N·m at the joint), or identify it with `graspforce hands identify`",
            )


def _all_slide(joints: Sequence[UrdfJoint]) -> bool:
    """Return whether the moving joints among some joints, at least one, are all prismatic."""
    moving = [joint.type for joint in joints if joint.is_moving]
    return bool(moving) and all(kind == "prismatic" for kind in moving)


def _largest_effort(joints: Sequence[UrdfJoint]) -> float:
    """Return the largest plausible effort of joints with one motor, N·m; N if they all slide."""
    return _LARGEST_PLAUSIBLE_FORCE if _all_slide(joints) else _LARGEST_PLAUSIBLE_TORQUE


def _torque_finding(location: str, name: str, torque: float, joints: Sequence[UrdfJoint]) -> Finding:
    unit = "N" if _all_slide(joints) else "N·m"
    problem = f"its {name} is {torque:g} {unit}, more than a joint of a hand has"
    return Finding("warning", location, problem, "grasps count as feasible that the motors cannot hold", _GIVE_TORQUE)


def _friction_finding(joint: UrdfJoint) -> Finding:
    given = [f"its static friction in the URDF is {joint.friction:g} N·m"] if joint.friction != 0.0 else []
    given += [f"its damping in the URDF is {joint.damping:g} N·m·s/rad"] if joint.damping != 0.0 else []
    return Finding(
        "warning",
        f"joint {joint.name}",
        f"{' and '.join(given)}, more than its motor can overcome",
        "graspforce takes the joint's friction as unknown; in a simulator that reads the file the joint hardly moves",
        "correct <dynamics> in the URDF, and give the joint's friction in the description",
    )


def _motor_of(joint: UrdfJoint, description: HandDescription | None) -> MotorDescription | None:
    """Return the first motor of a description that matches a joint."""
    if description is None:
        return None
    return next((motor for motor in description.motors if descriptions.motor_matches(motor, joint.name)), None)

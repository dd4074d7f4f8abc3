"""Checks of numbers in a wrong unit or of a wrong quantity: degrees, reflected inertias, zero axes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graspforce.hand.descriptions.description import HandDescription, MotorDescription, motor_matches
from graspforce.hand.descriptions.urdf import Urdf, UrdfJoint
from graspforce.hand.lint.findings import Finding

_LARGEST_ANGLE = 2.0 * np.pi  # rad, of the limit of a joint of a hand
_LARGEST_RATE = 100.0  # rad/s, of a joint; fast hands have 40
_SMALLEST_TORQUE = 2e-3  # N·m, at a joint: the weight of 10 g at 20 mm
_LARGEST_REFLECTED_INERTIA = 0.1  # kg·m², of a rotor at the joint; geared finger joints have 1e-5 to 1e-2
_LARGEST_REFLECTED_MASS = 50.0  # kg, the same at a prismatic joint


def check_joint_numbers(model: Urdf) -> Iterator[Finding]:
    """Check axes and limits of the moving joints.

    Args:
        model: links and joints.
    """
    for joint in model.joints.values():
        if joint.is_moving:
            yield from _check_axis(joint)
            yield from _check_degrees(joint)


def check_motor_numbers(model: Urdf, description: HandDescription) -> Iterator[Finding]:
    """Check units of the motors' numbers.

    Args:
        model: links and joints.
        description: the description.
    """
    for motor in description.motors:
        location = "joints " + ", ".join(motor.joints)
        driven = [joint for joint in model.joints.values() if joint.is_moving and motor_matches(motor, joint.name)]
        slides = bool(driven) and all(joint.type == "prismatic" for joint in driven)
        yield from _check_reflected_inertia(motor, location, slides)
        if slides:
            continue
        if motor.torque < _SMALLEST_TORQUE:
            yield Finding(
                "warning",
                location,
                f"its motor torque is {motor.torque:g} N·m, less than the weight of a finger needs",
                "no grasp is feasible",
                "check the unit: N·m at the joint, behind the gear",
            )
        if motor.velocity > _LARGEST_RATE:
            yield Finding(
                "warning",
                location,
                f"its largest rate is {motor.velocity:g} rad/s, more than a joint of a hand has",
                "planned motions are faster than the motor",
                "check the unit: rad/s at the joint, behind the gear; not degrees per second or revolutions per minute",
            )


def _check_axis(joint: UrdfJoint) -> Iterator[Finding]:
    length = float(np.linalg.norm(joint.axis))
    if joint.type in ("revolute", "continuous", "prismatic") and length < 1e-6:
        yield Finding(
            "error",
            f"joint {joint.name}",
            "its axis is zero",
            "the joint does not move, and the Jacobian of its finger has a zero column",
            "give the unit vector of the axis, in the joint's frame",
        )


def _check_degrees(joint: UrdfJoint) -> Iterator[Finding]:
    limits = [limit for limit in (joint.lower, joint.upper) if limit is not None]
    if joint.type == "revolute" and any(abs(limit) > _LARGEST_ANGLE for limit in limits):
        yield Finding(
            "error",
            f"joint {joint.name}",
            f"its limits are {joint.lower:g} and {joint.upper:g} rad, more than a full turn",
            "searches and plans use postures that the joint cannot reach",
            "give the limits in rad; these seem to be in degrees",
        )


def _check_reflected_inertia(motor: MotorDescription, location: str, slides: bool) -> Iterator[Finding]:
    reflected = motor.rotor_inertia * motor.gear_ratio**2
    largest, unit = (_LARGEST_REFLECTED_MASS, "kg") if slides else (_LARGEST_REFLECTED_INERTIA, "kg·m²")
    if reflected > largest:
        yield Finding(
            "error",
            location,
            f"the rotor's inertia at the joint is {reflected:.3g} {unit}: {motor.rotor_inertia:g} × {motor.gear_ratio:g}²",
            "the joint seems too heavy to move; motions need far more torque than they do",
            "give rotor_inertia of the rotor about its own axis; if it is that at the joint, give gear_ratio 1",
        )

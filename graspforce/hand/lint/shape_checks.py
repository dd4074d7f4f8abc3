"""Checks of a hand model against the shapes of its links: densities, places of the tip frames, and soft pads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from graspforce.core.errors import ModelError
from graspforce.hand.descriptions.description import FingerDescription, HandDescription
from graspforce.hand.descriptions.urdf import Urdf
from graspforce.hand.lint.findings import GIVE_INERTIA, Finding
from graspforce.hand.shapes.fingertips import Fingertip, find_fingertips
from graspforce.hand.shapes.shape_geometry import diagonal_of_shapes, distance_to_shapes, solid_moments

_DENSITIES = (100.0, 12000.0)  # kg/m³, of a link: from hollow plastic to steel, with overlapping or generous shapes
_SOFT_CONTACT_CONSTRAINTS = 4  # three velocities of the contact point, and the spin about the normal
_PAD_OFFSET = 1.25  # of the pad's radius: further away, the frame is neither at its centre nor on its surface
_LARGEST_TIP_DISTANCE = 0.005  # m, of a tip frame from the shapes of its link, beyond the tip's radius
_RADIUS_RATIOS = (0.4, 2.5)  # of a tip's radius, to that of the sphere in the end of its link


def check_gyration_radii(model: Urdf, urdf: Path) -> Iterator[Finding]:
    """Compare the radius of gyration of each moving link with the size of its shapes.

    Args:
        model: links and joints.
        urdf: path of the URDF, for its mesh files. Links whose meshes are not found are not checked.
    """
    for link in model.links.values():
        movers = [joint for joint in model.chain(link.name) if joint.is_moving]
        if not movers or link.inertial is None or link.inertial.mass <= 0 or not link.shapes:
            continue
        moments = np.linalg.eigvalsh(link.inertial.I)  # kg·m², ascending
        try:
            diagonal = diagonal_of_shapes(link.shapes, urdf)  # m
        except ModelError:
            continue
        if moments[0] <= 0 or not diagonal > 0:
            continue
        yield from _check_gyration_radius(link.name, movers[-1].name, float(np.sqrt(moments[2] / link.inertial.mass)), diagonal)


def _check_gyration_radius(link: str, joint: str, radius: float, diagonal: float) -> Iterator[Finding]:
    """Compare the largest radius of gyration of a link with the diagonal of its shapes, both in m."""
    gyration, size = f"its radius of gyration, {1e3 * radius:.2f} mm,", f"its diagonal, {1e3 * diagonal:.1f} mm"
    if radius > diagonal / 2:  # the limit: all mass at the two ends of the diagonal
        yield Finding(
            "error",
            f"link {link}",
            f"{gyration} is more than half of {size}",
            f"no body of this size has it; torques that accelerate {joint} are too large",
            f"{GIVE_INERTIA}; possibly the inertia is about the joint instead of the centre of mass, or in another unit",
        )
    elif radius < diagonal / 20:  # a sixth of a uniform bar's
        yield Finding(
            "warning",
            f"link {link}",
            f"{gyration} is less than a twentieth of {size}",
            f"the link rotates like a point mass; torques that accelerate {joint} are too small",
            GIVE_INERTIA,
        )


def check_densities(model: Urdf, urdf: Path) -> Iterator[Finding]:
    """Check the density of each moving body: all links that fixed joints join, with their shapes.

    Args:
        model: links and joints.
        urdf: path of the URDF, for its mesh files. Links whose meshes are not found are not checked.
    """
    for joint in model.joints.values():
        if not joint.is_moving:
            continue
        links = [model.links[name] for name in model.fixed_links(joint.child)]
        mass = sum(link.inertial.mass for link in links if link.inertial is not None)
        try:
            volume = sum(solid_moments(link.shapes, urdf).volume for link in links if link.shapes)
        except ModelError:
            continue
        if not volume > 0.0 or not mass > 0.0:
            continue
        density = mass / volume  # kg/m³
        if not _DENSITIES[0] <= density <= _DENSITIES[1]:
            low = density < _DENSITIES[0]
            yield Finding(
                "warning",
                f"link {joint.child}",
                f"its density is {density:.3g} kg/m³: {1e3 * mass:.3g} g in {1e6 * volume:.3g} cm³",
                f"weight and inertia at {joint.name} are too {'small' if low else 'large'}",
                "check the units of the mass (kg) and of the shapes (m)",
            )


def check_tips(model: Urdf, description: HandDescription, urdf: Path) -> Iterator[Finding]:
    """Check the tip frames of a description against the shapes of their links.

    Args:
        model: links and joints.
        description: the description.
        urdf: path of the URDF, for its mesh files. Links whose meshes are not found are not checked.
    """
    tips = {tip.link: tip for tip in find_fingertips(model, urdf)}
    for finger in description.fingers:
        if finger.tip in model.links:
            yield from _check_tip(model, finger, tips, urdf)


def check_pads(model: Urdf, description: HandDescription) -> Iterator[Finding]:
    """Check the soft pads: their size, and whether the fingers can follow a spin.

    Args:
        model: links and joints.
        description: the description.
    """
    for finger in description.fingers:
        if finger.pad is None:
            continue
        location, gamma = f"finger {finger.name}", finger.pad.torsional_friction
        if finger.tip_radius is not None and gamma > 2.0 / 3.0 * finger.tip_radius:
            yield Finding(
                "warning",
                location,
                f"its pad's torsional friction length is {1e3 * gamma:.3g} mm, more than two thirds of the tip's radius",
                "a patch as large as the tip, with friction 1, has that length; moments about the normal are overestimated",
                "check the unit (m), or measure the moment at which the pad twists off, over the normal force",
            )
        followers = {coupling.follower for coupling in description.couplings} | {lock.joint for lock in description.locked}
        chain = model.chain(finger.tip) if finger.tip in model.links else ()
        if all(joint.type == "prismatic" for joint in chain if joint.is_moving):
            continue  # a jaw, which never turns: its pad is meant to resist a spin
        joints = sum(joint.is_moving and joint.name not in followers for joint in chain)
        if joints < _SOFT_CONTACT_CONSTRAINTS:
            yield Finding(
                "warning",
                location,
                f"it has a soft pad, but only {joints} motors",
                "a soft contact constrains four motions: the finger cannot follow a spin, which its pad then resists",
                "expect smaller motions of the object, or model the tip without a pad",
            )


def _check_tip(model: Urdf, finger: FingerDescription, tips: Mapping[str, Fingertip], urdf: Path) -> Iterator[Finding]:
    location, radius = f"finger {finger.name}", finger.tip_radius or 0.0
    moving = [joint.child for joint in model.chain(finger.tip) if joint.is_moving]
    if not moving:
        return
    body = moving[-1]
    p, _ = model.pose_on(body, finger.tip)
    try:
        distance = distance_to_shapes(p, model.shapes_on(body), urdf)
    except ModelError:
        return
    if distance > radius + _LARGEST_TIP_DISTANCE:
        yield Finding(
            "error",
            location,
            f"its tip frame {finger.tip} is {1e3 * distance:.1f} mm outside of the shapes of {body}",
            "contacts are in the air, and torques have wrong levers",
            "check the unit of the frame's origin (m), or name another frame as tip",
        )
        return
    pad = tips[body].pad if body in tips else None
    if pad is None:
        return
    offset = float(np.linalg.norm(pad.centre - p))
    if offset > _PAD_OFFSET * max(pad.radius, radius):
        place = ", ".join(f"{1e3 * x:.1f}" for x in pad.centre)
        yield Finding(
            "warning",
            location,
            f"its tip frame {finger.tip} is {1e3 * offset:.1f} mm from the centre of the pad, ({place}) mm in {body}",
            "contacts are computed about the frame: they are off by as much, and so are the levers of the torques",
            "move the frame to the pad's centre; `graspforce hands new` adds such frames",
        )
    if finger.tip_radius is not None and not _RADIUS_RATIOS[0] <= finger.tip_radius / pad.radius <= _RADIUS_RATIOS[1]:
        yield Finding(
            "warning",
            location,
            f"its tip radius is {1e3 * finger.tip_radius:.3g} mm, but the end of {body} has {1e3 * pad.radius:.3g} mm",
            "contacts are off by the difference",
            "check the unit (m), and that it is the radius and not the diameter",
        )

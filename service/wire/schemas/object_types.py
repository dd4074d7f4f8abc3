"""Types of the records of poses, contacts, bodies, grasps and obstacles."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from graspforce.service.wire.schemas.array_types import (
    Matrix3,
    NotNegative,
    Positive,
    Quaternion,
    Rows3,
    Vector3,
)

Friction = NotNegative | None


class PoseRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """A pose in H: its position, and either `rotation` or `quaternion`.

    Args:
        position: position of the origin, m.
        rotation: rotation matrix by rows.
        quaternion: unit quaternion (w, x, y, z).
    """

    position: Vector3
    rotation: Matrix3 | UnsetType = UNSET
    quaternion: Quaternion | UnsetType = UNSET


class ContactRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """A contact, in O.

    Args:
        position: contact point, m.
        normal: inward normal; any length above zero.
        model: contact model.
        friction: μ; required unless frictionless.
        torsional_friction: γ of soft contacts, m.
        tangent: direction of t₁; by default n × e_x, or n × e_y where |n_x| ≥ 0.9.
        min_normal: smallest normal force, N.
        max_normal: largest normal force, N; null for no limit.
    """

    position: Vector3
    normal: Vector3
    model: Literal["frictionless", "point", "soft"] = "point"
    friction: Friction = None
    torsional_friction: Friction = None
    tangent: Vector3 | None = None
    min_normal: NotNegative = 0.0
    max_normal: Friction = None


class GraspContactRecord(ContactRecord, forbid_unknown_fields=True, kw_only=True):
    """A contact of a hand, in O.

    Args:
        finger: name of the finger that touches.
    """

    finger: str


class SphereRecord(Struct, tag_field="type", tag="sphere", forbid_unknown_fields=True, kw_only=True):
    """A sphere.

    Args:
        radius: radius, m.
    """

    radius: Positive


class CylinderRecord(Struct, tag_field="type", tag="cylinder", forbid_unknown_fields=True, kw_only=True):
    """A circular cylinder about z, with O at its centre.

    Args:
        radius: radius, m.
        height: height, m.
    """

    radius: Positive
    height: Positive


class BoxRecord(Struct, tag_field="type", tag="box", forbid_unknown_fields=True, kw_only=True):
    """A box, with O at its centre.

    Args:
        edges: lengths along x, y and z, m.
    """

    edges: Vector3


class SuperquadricRecord(Struct, tag_field="type", tag="superquadric", forbid_unknown_fields=True, kw_only=True):
    """A convex superquadric.

    Args:
        axes: half-extents along x, y and z, m.
        exponents: e1 and e2, greater than 0 and at most 2.
    """

    axes: Vector3
    exponents: Annotated[list[float], Meta(min_length=2, max_length=2)]


class MeshRecord(Struct, tag_field="type", tag="mesh", forbid_unknown_fields=True, kw_only=True):
    """A closed surface of triangles.

    Args:
        vertices: positions of the vertices in O, m.
        faces: three indices of vertices each, counter-clockwise from outside.
        spacing: distance of the grid nodes on which the surface is smoothed, m; null for 1/64 of the largest extent.
    """

    vertices: Rows3
    faces: list[Annotated[list[int], Meta(min_length=3, max_length=3)]]
    spacing: Positive | None = None


ShapeType = SphereRecord | CylinderRecord | BoxRecord | SuperquadricRecord | MeshRecord


class BodyRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """An object: a mass with inertia, or with a shape of uniform density.

    Args:
        mass: mass, kg.
        inertia: inertia about the centre of mass in O's axes, kg·m²; required without a shape.
        centre_of_mass: centre of mass in O, m; zero by default, and only with `inertia`.
        shape: surface of the object.
    """

    mass: Positive
    inertia: Matrix3 | None = None
    centre_of_mass: Vector3 | None = None
    shape: ShapeType | None = None


class GraspRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """A grasp: an object, and the contacts of a hand on it.

    Args:
        body: the object.
        contacts: the contacts, in O.
        posture: actuated joint positions, rad.
        object: pose of the object in H.
    """

    body: BodyRecord
    contacts: Annotated[list[GraspContactRecord], Meta(min_length=1)]
    posture: list[float]
    object: PoseRecord


class ObstacleRecord(PoseRecord, forbid_unknown_fields=True, kw_only=True):
    """A body at rest in H.

    Args:
        shape: its shape.
    """

    shape: SphereRecord | CylinderRecord | BoxRecord

"""What a scene looks like: pictures, camera, light, bones of the fingers. Nothing here touches anything or has mass."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp
from graspforce.hand.kinematic_tree import KinematicTree

Image = npt.NDArray[np.uint8]  # (height, width, 3)

CAMERA = "view"

TIP_COLOUR, LINK_COLOUR, OBJECT_COLOUR, FLOOR_COLOUR = (
    (0.88, 0.42, 0.22, 1.0),
    (0.36, 0.43, 0.53, 1.0),
    (0.28, 0.58, 0.78, 0.35),
    (0.9, 0.9, 0.9, 1.0),
)
FORCE_ARROW_LENGTH = 0.025  # m of arrow for a newton
_FIELD_OF_VIEW = 40.0  # degrees that the camera sees


def add_link_capsules(base: Any, bodies: Sequence[Any], tree: KinematicTree) -> None:
    """A capsule along each link, from its joint to the next one's and to its fingertip; thin ones for the palm."""
    ends = [(link.parent, link.p_PL) for link in tree.links] + [(tip.link, tip.p_LF) for tip in tree.tips]
    for number, (parent, end) in enumerate(ends):
        if np.linalg.norm(end) > 1e-3:
            body, thickness = (base, 0.004) if parent < 0 else (bodies[parent], 0.006)
            capsule = body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[thickness, 0.0, 0.0])
            capsule.fromto = [0.0, 0.0, 0.0, *end]
            make_passive_geom(capsule, f"bone {number}", LINK_COLOUR)
    for tip in tree.tips:
        ball = bodies[tip.link].add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.0065, 0.0, 0.0], pos=tip.p_LF)
        make_passive_geom(ball, f"end {tip.finger}", LINK_COLOUR)


def make_passive_geom(geom: Any, name: str, colour: tuple[float, ...]) -> None:
    """A geom that touches nothing unless a pair says so, and has no mass."""
    geom.name, geom.rgba, geom.contype, geom.conaffinity, geom.mass = name, colour, 0, 0, 0.0


def add_light_and_camera(spec: Any, grasp: Grasp, gravity_H: Array, more: Array) -> None:
    """A bright sky, a sun, the size of force arrows, and a camera that sees the whole hand with gravity pointing down.

    The whole hand: its joints and tips, the object, and more (N, 3) points of H, m.
    """
    gravity_norm = float(np.linalg.norm(gravity_H))
    up = -gravity_H / gravity_norm if gravity_norm > 0.0 else np.array([0.0, 0.0, 1.0])
    points = np.concatenate([_points(grasp), more])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    _, directions = np.linalg.eigh((points - middle).T @ (points - middle) + radius**2 * len(points) * np.outer(up, up))
    out = directions[:, 0] - (directions[:, 0] @ up) * up  # the level direction in which the hand is least deep
    out /= np.linalg.norm(out)

    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1920, 1080
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.35] * 3
    spec.visual.map.force = FORCE_ARROW_LENGTH
    spec.visual.map.znear = 0.01
    spec.visual.rgba.contactforce, spec.visual.scale.forcewidth = [0.75, 0.1, 0.1, 1.0], 0.15
    spec.stat.meanmass = 1.0  # a newton's arrow then is FORCE long
    spec.stat.meansize, spec.stat.center, spec.stat.extent = 0.02, middle, 2.0 * radius
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT)
    sky.rgb1, sky.rgb2, sky.width, sky.height = [0.97, 0.98, 1.0], [0.97, 0.98, 1.0], 64, 384
    sun = spec.worldbody.add_light(name="sun", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=middle + 2.0 * radius * up)
    sun.dir, sun.diffuse, sun.castshadow = -up - 0.4 * out, [0.5] * 3, False

    back = 0.85 * out + 0.4 * up + 0.35 * np.cross(up, out)
    back /= np.linalg.norm(back)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    axes = np.column_stack([right, np.cross(back, right), back])
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    distance = 1.05 * radius / math.sin(math.radians(_FIELD_OF_VIEW) / 2.0)
    spec.worldbody.add_camera(name=CAMERA, pos=middle + distance * back, quat=quaternion, fovy=_FIELD_OF_VIEW)


def _points(grasp: Grasp) -> Array:
    """Where the links, the fingertips and the object stand in H, m."""
    hand, points = grasp.hand, [np.zeros(3), np.array(grasp.p_HO)]
    placed: list[tuple[Array, Array]] = []
    for link, x in zip(hand.tree().links, hand.T @ grasp.q + hand.q0, strict=True):
        p, R = placed[link.parent] if link.parent >= 0 else (np.zeros(3), np.eye(3))
        p, R = p + R @ link.p_PL, R @ link.R_PL
        if link.is_prismatic:
            p = p + R @ link.axis * x
        else:
            R = R @ Rotation.from_rotvec(link.axis * x).as_matrix()
        placed.append((p, R))
        points.append(p)
    return np.array([*points, *(hand.tip_pose(grasp.q, finger.name)[0] for finger in hand.fingers)])

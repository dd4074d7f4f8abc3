"""The surroundings of a hand in a film: table, stand, lights, background, and the materials and textures of all parts."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from graspforce.core.arrays import Array
from graspforce.simulation.plants.scene_parts import FLOOR, OBJECT, make_passive_geom
from graspforce.simulation.rendering.hand_geoms import JOINT, LINK, PAD, PALM

OBJECT_COLOURS = ((126, 158, 194), (240, 243, 247))  # of its squares, 0 to 255
BACKGROUND, BACKGROUND_BELOW = (0.90, 0.93, 0.96), (0.62, 0.68, 0.75)
MATERIALS = {  # red, green, blue; specular; shininess
    LINK: ((0.27, 0.285, 0.31), 0.5, 0.4),
    PALM: ((0.36, 0.375, 0.40), 0.40, 0.35),
    JOINT: ((0.62, 0.64, 0.67), 0.80, 0.70),
    PAD: ((0.93, 0.91, 0.86), 0.15, 0.10),
}
TABLE, TABLE_COLOUR = "stage table", (0.90, 0.905, 0.91)
_CLEARANCE = 0.012  # m, from the hand's lowest point to the table
_STAND_RADIUS = 0.022  # m
_TABLE_SIZE = 1.3  # radius of the round table over that of the hand
SQUARES = 12  # around the object
_TEXTURE_SIZE = (256, 512)  # pixels


def add_materials(spec: Any) -> None:
    """Add the materials of the hand and the object's texture."""
    for name, (colour, specular, shininess) in MATERIALS.items():
        spec.add_material(name=name, rgba=[*colour, 1.0], specular=specular, shininess=shininess)
    rows, columns = np.arange(_TEXTURE_SIZE[0])[:, None], np.arange(_TEXTURE_SIZE[1])[None, :]
    dark = (rows * SQUARES // (2 * _TEXTURE_SIZE[0]) + columns * SQUARES // _TEXTURE_SIZE[1]) % 2 == 0
    first, second = (np.array(colour, np.uint8) for colour in OBJECT_COLOURS)
    pixels = np.where(dark[..., None], first, second)
    texture = spec.add_texture(
        name=OBJECT, type=mujoco.mjtTexture.mjTEXTURE_2D, width=_TEXTURE_SIZE[1], height=_TEXTURE_SIZE[0], nchannel=3
    )
    texture.data = pixels.tobytes()
    material = spec.add_material(name=OBJECT, rgba=[1.0, 1.0, 1.0, 1.0], specular=0.5, shininess=0.6)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = OBJECT


def add_stage(spec: Any, up: Array, towards: Array, base: Array, points: Array, has_gravity: bool) -> None:
    """Add background and lights, and where there is gravity a table below the hand and a stand.

    Args:
        spec: the display model's specification.
        up: (3,) unit vector against gravity, in H.
        towards: (3,) horizontal unit vector towards the camera, in H.
        base: (3,) middle of the hand's palm in H, m; the top of the stand.
        points: (M, 3) corners of the hand's and the object's parts, in H, m.
        has_gravity: whether there is an up and a down.
    """
    right = np.cross(up, towards)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = 3840, 2160
    visual.quality.shadowsize, visual.quality.offsamples = 4096, 4
    visual.quality.numslices, visual.quality.numstacks = 64, 32
    visual.map.znear, visual.map.zfar, visual.map.shadowclip, visual.map.haze = 0.05, 40.0, 1.6, 0.45
    visual.rgba.haze = [*BACKGROUND, 1.0]
    visual.headlight.ambient, visual.headlight.diffuse, visual.headlight.specular = [0.44] * 3, [0.12] * 3, [0.0] * 3
    spec.stat.center, spec.stat.extent = middle, 2.0 * radius
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT)
    sky.rgb1, sky.rgb2, sky.width, sky.height = BACKGROUND, BACKGROUND_BELOW, 256, 1536
    for name, direction, diffuse, shadow in (
        ("sun", -0.9 * up - 0.35 * towards + 0.5 * right, 0.52, True),
        ("fill", -0.3 * up - 0.6 * towards - 0.7 * right, 0.28, False),
    ):
        light = spec.worldbody.add_light(name=name, type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
        direction = direction / np.linalg.norm(direction)
        light.pos, light.dir = middle - 3.0 * radius * direction, direction
        light.diffuse, light.specular, light.castshadow = [diffuse] * 3, [0.35 * shadow + 0.1] * 3, shadow
    spec.add_material(name=TABLE, rgba=[*TABLE_COLOUR, 1.0], specular=0.2, shininess=0.2, reflectance=0.05)
    if spec.geom(FLOOR) is not None:
        spec.geom(FLOOR).material = TABLE
    if not has_gravity or spec.geom(FLOOR) is not None:
        return
    height = float((points @ up).min()) - _CLEARANCE
    axis = middle - (middle @ up) * up  # of the round table
    below = base - (base @ up - height) * up
    for name, foot, top, size in (
        (TABLE, axis + (height - 0.012) * up, axis + height * up, _TABLE_SIZE * radius),
        ("stage stand", below, base, _STAND_RADIUS),
        ("stage foot", below, below + 0.006 * up, 2.0 * _STAND_RADIUS),
    ):
        part = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[size, 0.0, 0.0])
        part.fromto = [*foot, *top]
        make_passive_geom(part, name)
        part.material = TABLE if name == TABLE else JOINT

"""Objects of the posture libraries, and other objects to test with."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from graspforce import GraspForceError, Hand
from graspforce.geometry import Box, Cylinder, Solid, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.learning import PostureLibrary

MASS = 0.05  # kg
FINGERS = {  # the fingers of all grasps of a hand
    "allegro_right": ("index", "middle", "thumb"),
    "leap_right": ("index", "middle", "thumb"),
    "dlr_hit2": ("thumb", "index", "middle"),
    "shadow_right": ("thumb", "first", "middle"),
}
_SEED = 20  # of the random sizes
_EACH = 10  # objects of each shape in the library


def library_objects() -> dict[str, Solid]:
    """Return 30 spheres, cylinders and boxes of random sizes."""
    rng = np.random.default_rng(_SEED)
    objects: dict[str, Solid] = {}
    for i in range(_EACH):
        objects[f"sphere {i}"] = Sphere(rng.uniform(0.02, 0.04))
        objects[f"cylinder {i}"] = Cylinder(rng.uniform(0.015, 0.035), rng.uniform(0.06, 0.12))
        objects[f"box {i}"] = Box(rng.uniform(0.03, 0.07, 3))
    return objects


def unseen_objects() -> dict[str, Solid]:
    """Return 20 other objects: spheres, cylinders, boxes and superquadrics."""
    rng = np.random.default_rng(_SEED + 1)
    objects: dict[str, Solid] = {}
    for i in range(5):
        objects[f"sphere {i}"] = Sphere(rng.uniform(0.02, 0.04))
        objects[f"cylinder {i}"] = Cylinder(rng.uniform(0.015, 0.035), rng.uniform(0.06, 0.12))
        objects[f"box {i}"] = Box(rng.uniform(0.03, 0.07, 3))
        objects[f"superquadric {i}"] = Superquadric(rng.uniform(0.02, 0.035, 3), rng.uniform(0.5, 1.0, 2))
    return objects


@cache
def library(hand_name: str, folder: Path) -> PostureLibrary:
    """Return the library of a hand: from its file, or of new grasps, which are then written to the file.

    Args:
        hand_name: a hand in `FINGERS`.
        folder: folder of the file.
    """
    path = folder / f"postures_{hand_name}.csv"
    if path.exists():
        return PostureLibrary.load(path)
    hand, grasps, names = Hand.load(hand_name), [], []
    for name, shape in library_objects().items():
        try:
            grasps.append(find_grasp(hand, Body.solid(shape, MASS), FINGERS[hand_name]))
            names.append(name)
        except GraspForceError:
            continue  # this hand cannot hold the object with these fingers
    made = PostureLibrary.from_grasps(grasps, names)
    folder.mkdir(parents=True, exist_ok=True)
    made.save(path)
    return made

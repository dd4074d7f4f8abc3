"""Moves of shipped hands that tests of tracking, of the command line and the benchmark execute in MuJoCo."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.control import ControlSettings
from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.planning import StraightPath
from support.hands import load

EARTH = np.array([0.0, 0.0, -9.81])  # m/s²
SETTINGS = ControlSettings(slip_margin=1.0, gravity_H=EARTH)
FINGERS = {
    "four_finger": ("finger_1", "finger_2", "finger_3"),
    "dlr_hit2": ("thumb", "index", "little"),
    "allegro_right": ("index", "ring", "thumb"),
}
# Moves within reach of each grasp: m in H, and a rotation vector, rad.
MOVES = {
    "four_finger": ((0.0, 0.0, -0.005), (0.0, 0.0, 0.1)),
    "dlr_hit2": ((-0.005, 0.0, 0.005), (0.1, 0.0, 0.1)),
    "allegro_right": ((-0.006, 0.004, 0.004), (0.1, 0.1, 0.0)),
}


@cache
def find_move_grasp(name: str, seed: int = 0) -> Grasp:
    """Return the grasp of a sphere of 50 g and 30 mm radius by three fingers."""
    return find_grasp(load(name), Body.solid(Sphere(0.03), 0.05), FINGERS[name], friction=0.7, gravity_H=EARTH, seed=seed)


def straight_path(grasp: Grasp, displacement: Array, turn: Array) -> StraightPath:
    """Return the path from the grasp by a displacement in H, m, and a rotation vector in H, rad."""
    R_goal = Rotation.from_rotvec(turn).as_matrix() @ grasp.R_HO
    return StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + np.asarray(displacement), R_goal)

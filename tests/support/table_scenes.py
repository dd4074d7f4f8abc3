"""A table scene with a known grasp, made without a search."""

from __future__ import annotations

import functools

import numpy as np

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core.constants import STANDARD_GRAVITY
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from graspforce.simulation.cycle.table_scene import TableScene, hand_clearance

RADIUS = 0.03  # m
MASS = 0.1  # kg
_NORMALS = {"index": (-0.003, -0.897, -0.443), "middle": (0.0, 0.494, -0.869), "thumb": (0.003, 0.778, 0.628)}


@functools.cache
def ball_scene() -> TableScene:
    """Return the Allegro hand above a ball on a table, held by index finger, middle finger and thumb."""
    hand = Hand.load("allegro_right")
    normals = {name: np.array(n) / np.linalg.norm(n) for name, n in _NORMALS.items()}
    contacts = ContactSet.stack([Contact(-RADIUS * n, n, 0.6) for n in normals.values()])
    p_HO, R_HO = np.array([0.0941, 0.0232, 0.0068]), np.eye(3)
    q_start = [0.16, 0.8, 0.94, 0.63, 0.03, 0.68, 0.89, 0.62, 0.0, 0.0, 0.0, 0.0, 1.27, 0.85, 0.75, 0.76]
    fingers = tuple(normals)
    q = hand.grasp_posture(fingers, contacts, p_HO, R_HO, q_start)
    grasp = Grasp(hand, Body.solid(Sphere(RADIUS), MASS), fingers, contacts, q, p_HO, R_HO)
    down = np.array([0.936, 0.127, -0.328])
    scene = TableScene(grasp, STANDARD_GRAVITY * down / np.linalg.norm(down), RADIUS, 0.0)
    return TableScene(grasp, scene.gravity_H, scene.height, hand_clearance(scene, q))

"""Holds of the shipped hands, for tests of control: round tips on known shapes, bare tips on a body that is only mass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from hands_for_tests import load
from scipy.spatial.transform import Rotation

from graspforce import Contact, ContactSet, Hand
from graspforce.body import Body
from graspforce.hold import Hold
from graspforce.shapes import Box, Cylinder, Sphere, Superquadric
from graspforce.shapes.shape import Solid

FOUR = ("finger_1", "finger_2", "finger_3", "finger_4")
ALLEGRO = ("index", "middle", "thumb")
FIVE = ("thumb", "index", "middle", "ring", "little")


def bare(hand: Hand) -> Hand:
    """The same hand, its fingers touching with the origins of their tip frames."""
    return replace(hand, fingers=tuple(replace(finger, tip_radius=None) for finger in hand.fingers))


def touching(hand: Hand, fingers: tuple[str, ...], shape: Solid, p_HO, turn=(0.0, 0.0, 0.0), mass=0.05, **contact) -> Hold:
    """The fingers touch the object where it is nearest to their tips in the neutral posture."""
    p_HO, R_HO = np.array(p_HO), Rotation.from_rotvec(turn).as_matrix()
    tips = np.array([hand.tip_pose(hand.neutral, finger)[0] for finger in fingers])
    feet = shape.nearest((tips - p_HO) @ R_HO)
    said = {"friction": 0.7, "max_normal": 20.0, **contact}
    contacts = ContactSet.stack([Contact(p, n, **said) for p, n in zip(feet, shape.inward_normal(feet), strict=True)])
    q = hand.grasp_posture(fingers, contacts, p_HO, R_HO)
    return Hold(hand, Body.solid(shape, mass), fingers, contacts, q, p_HO, R_HO)


def five_fingers(**contact) -> Hold:
    """The five planar fingers of anthropomorphic15 about a body without a shape, each pressing towards its middle."""
    hand = bare(load("anthropomorphic15"))
    q = [0.418, 1.089, 1.19, 1.312, 0.398, 1.01, 0.997, 0.624, 0.831, 1.423, 0.747, 0.896, 1.314, 0.6, 1.014]  # rad
    tips = np.array([hand.tip_pose(q, finger)[0] for finger in FIVE])
    p_HO, said = np.array([0.0165, -0.004, 0.0674]), {"friction": 0.7, "max_normal": 20.0, **contact}
    contacts = ContactSet.stack([Contact(tip - p_HO, p_HO - tip, **said) for tip in tips])
    return Hold(hand, Body(0.05, np.diag([2e-5, 3e-5, 2.5e-5]), [1e-3, 0.0, 2e-3]), FIVE, contacts, q, p_HO, np.eye(3))


_MADE: dict[str, Callable[[], Hold]] = {
    "four_finger sphere": lambda: touching(load("four_finger"), FOUR, Sphere(0.036), [0.0, 0.0, 0.055]),
    "four_finger cylinder": lambda: touching(load("four_finger"), FOUR, Cylinder(0.036, 0.1), [0.0, 0.0, 0.055]),
    "four_finger box": lambda: touching(load("four_finger"), FOUR, Box([0.06, 0.06, 0.05]), [0.0, 0.0, 0.055]),
    "four_finger superquadric": lambda: touching(
        load("four_finger"), FOUR, Superquadric([0.036, 0.034, 0.03], [0.9, 0.8]), [0.0, 0.0, 0.055]
    ),
    "allegro_right sphere": lambda: touching(load("allegro_right"), ALLEGRO, Sphere(0.03), [0.0983, 0.0384, 0.0283]),
    "allegro_right cylinder": lambda: touching(
        load("allegro_right"), ALLEGRO, Cylinder(0.028, 0.12), [0.1049, 0.0406, 0.0442], [2.313, 1.738, 0.534]
    ),
    "allegro_right box": lambda: touching(
        load("allegro_right"), ALLEGRO, Box([0.05, 0.055, 0.06]), [0.1017, 0.039, 0.0292], [-0.556, 1.476, -1.327]
    ),
    "dlr_hit2 sphere": lambda: touching(bare(load("dlr_hit2")), FIVE[:4], Sphere(0.03), [0.0838, -0.0084, 0.0745]),
    "anthropomorphic15": five_fingers,
}
NAMES = list(_MADE)
ROUND = [name for name in NAMES if name.startswith(("four_finger", "allegro"))]  # tips that roll


@cache
def hold(name: str) -> Hold:
    """One of `NAMES`; skips the test where the hand's model is not installed."""
    return _MADE[name]()

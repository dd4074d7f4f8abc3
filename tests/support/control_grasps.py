"""Grasps of the shipped hands, for tests of control: spherical tips on known shapes, point tips on a body without shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce import Contact, ContactSet, Hand
from graspforce.geometry import Box, Cylinder, Sphere, Superquadric
from graspforce.geometry.shape import Solid
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.drive import Drive
from support.hands import load

FOUR_FINGERS = ("finger_1", "finger_2", "finger_3", "finger_4")
ALLEGRO_FINGERS = ("index", "middle", "thumb")
FIVE_FINGERS = ("thumb", "index", "middle", "ring", "little")


def with_point_tips(hand: Hand) -> Hand:
    """Return the hand with fingers that touch with the origins of their tip frames."""
    return replace(hand, fingers=tuple(replace(finger, tip_radius=None) for finger in hand.fingers))


def make_nearest_grasp(
    hand: Hand, fingers: tuple[str, ...], shape: Solid, p_HO, turn=(0.0, 0.0, 0.0), mass=0.05, **contact
) -> Grasp:
    """Return a grasp whose contacts are the surface points closest to the fingertips in the neutral posture."""
    p_HO, R_HO = np.array(p_HO), Rotation.from_rotvec(turn).as_matrix()
    tips = np.array([hand.tip_pose(hand.neutral, finger)[0] for finger in fingers])
    closest_points = shape.project_to_surface((tips - p_HO) @ R_HO)
    fields = {"friction": 0.7, "max_normal": 20.0, **contact}
    contacts = ContactSet.stack(
        [Contact(p, n, **fields) for p, n in zip(closest_points, shape.inward_normal(closest_points), strict=True)]
    )
    q = hand.grasp_posture(fingers, contacts, p_HO, R_HO)
    return Grasp(hand, Body.solid(shape, mass), fingers, contacts, q, p_HO, R_HO)


def make_posture_grasp(hand: Hand, fingers: tuple[str, ...], shape: Solid, q, p_HO, turn, **contact) -> Grasp:
    """Return a grasp of an object of 50 g whose contacts are the surface points closest to the fingertips in a posture."""
    q, p_HO, R_HO = np.array(q), np.array(p_HO), Rotation.from_rotvec(turn).as_matrix()
    tips = np.array([hand.tip_pose(q, finger)[0] for finger in fingers])
    closest_points = shape.project_to_surface((tips - p_HO) @ R_HO)
    pairs = zip(closest_points, shape.inward_normal(closest_points), strict=True)
    contacts = ContactSet.stack([Contact(p, n, friction=0.7, **contact) for p, n in pairs])
    return Grasp(hand, Body.solid(shape, 0.05), fingers, contacts, q, p_HO, R_HO)


def redundant_dex3_grasp() -> Grasp:
    """Return a ball between two parallel fingers of two joints and a thumb: one constraint is redundant up to 1e-4."""
    hand = load("dex3_right").with_drives(Drive())
    q = [-0.008457738, 0.020430755, -0.884729521, 0.577484759, 1.0656799, 0.57961385, 1.061206262]  # rad
    p_HO, turn = [0.03005797, 3.566e-06, 0.062784241], [1.698882684, 0.678988493, 2.139149453]
    return make_posture_grasp(hand, ("thumb", "index", "middle"), Sphere(0.03), q, p_HO, turn)


def soft_box_grasp() -> Grasp:
    """Return a box between fingers with four motors and soft pads, close to a loss of rank."""
    hand = load("allegro_right").with_pads(0.005)
    q = [0.006021222, 0.731515622, 0.938803453, 0.710678182, 0.087529235, 0.592617886, 0.866738763, 0.612022161]  # rad
    q += [-0.00023421, -0.000331445, 0.035410668, -0.000500067, 1.26006612, 0.866390793, 0.627296727, 0.775134608]
    p_HO, turn = [0.097712501, 0.009092418, 0.010909621], [2.586538312, -0.610763629, 0.330083394]
    box = Box([0.05, 0.05, 0.05])
    return make_posture_grasp(hand, ALLEGRO_FINGERS, box, q, p_HO, turn, model="soft", torsional_friction=0.005)


def five_finger_grasp(**contact) -> Grasp:
    """Return a grasp of the five planar fingers of anthropomorphic15 on a body without shape."""
    hand = with_point_tips(load("anthropomorphic15"))
    q = [0.418, 1.089, 1.19, 1.312, 0.398, 1.01, 0.997, 0.624, 0.831, 1.423, 0.747, 0.896, 1.314, 0.6, 1.014]  # rad
    tips = np.array([hand.tip_pose(q, finger)[0] for finger in FIVE_FINGERS])
    p_HO, fields = np.array([0.0165, -0.004, 0.0674]), {"friction": 0.7, "max_normal": 20.0, **contact}
    contacts = ContactSet.stack([Contact(tip - p_HO, p_HO - tip, **fields) for tip in tips])
    return Grasp(hand, Body(0.05, np.diag([2e-5, 3e-5, 2.5e-5]), [1e-3, 0.0, 2e-3]), FIVE_FINGERS, contacts, q, p_HO, np.eye(3))


def with_all_contact_models(grasp: Grasp, seed: int) -> Grasp:
    """Return the grasp with contacts of all models in turn, and a centre of mass away from the object's origin."""
    rng, contacts = np.random.default_rng(seed), []
    for i, contact in enumerate(grasp.contacts.contacts):
        fields = ({}, {"model": "soft", "torsional_friction": 0.004}, {"model": "frictionless", "friction": None})[i % 3]
        point = Contact(contact.position, contact.normal, friction=0.7, max_normal=20.0)
        contacts.append(replace(contact, **fields) if fields else point)
    body = Body(0.07, grasp.body.inertia + 1e-5 * np.eye(3), 0.01 * rng.normal(size=3), grasp.body.shape)
    return replace(grasp, contacts=ContactSet.stack(contacts), body=body)


_GRASPS: dict[str, Callable[[], Grasp]] = {
    "four_finger sphere": lambda: make_nearest_grasp(load("four_finger"), FOUR_FINGERS, Sphere(0.036), [0.0, 0.0, 0.055]),
    "four_finger cylinder": lambda: make_nearest_grasp(
        load("four_finger"), FOUR_FINGERS, Cylinder(0.036, 0.1), [0.0, 0.0, 0.055]
    ),
    "four_finger box": lambda: make_nearest_grasp(
        load("four_finger"), FOUR_FINGERS, Box([0.06, 0.06, 0.05]), [0.0, 0.0, 0.055]
    ),
    "four_finger superquadric": lambda: make_nearest_grasp(
        load("four_finger"), FOUR_FINGERS, Superquadric([0.036, 0.034, 0.03], [0.9, 0.8]), [0.0, 0.0, 0.055]
    ),
    "allegro_right sphere": lambda: make_nearest_grasp(
        load("allegro_right"), ALLEGRO_FINGERS, Sphere(0.03), [0.0983, 0.0384, 0.0283]
    ),
    "allegro_right cylinder": lambda: make_nearest_grasp(
        load("allegro_right"), ALLEGRO_FINGERS, Cylinder(0.028, 0.12), [0.1049, 0.0406, 0.0442], [2.313, 1.738, 0.534]
    ),
    "allegro_right box": lambda: make_nearest_grasp(
        load("allegro_right"), ALLEGRO_FINGERS, Box([0.05, 0.055, 0.06]), [0.1017, 0.039, 0.0292], [-0.556, 1.476, -1.327]
    ),
    "dlr_hit2 sphere": lambda: make_nearest_grasp(
        with_point_tips(load("dlr_hit2")), FIVE_FINGERS[:4], Sphere(0.03), [0.0838, -0.0084, 0.0745]
    ),
    "anthropomorphic15": five_finger_grasp,
}
GRASP_NAMES = list(_GRASPS)
ROUND_TIP_GRASPS = [name for name in GRASP_NAMES if name.startswith(("four_finger", "allegro"))]  # with tips that roll


@cache
def named_grasp(name: str) -> Grasp:
    """Return one of `GRASP_NAMES`; skip the test if the model of the hand is not installed."""
    return _GRASPS[name]()

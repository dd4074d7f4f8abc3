"""The grasp of a sphere by three fingers of the Allegro hand, used by the tests of plant and closed loop."""

from __future__ import annotations

import numpy as np

from graspforce import Contact, ContactSet
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from support.hands import load

PALM_UP = (-9.81, 0.0, 0.0)  # m/s²; in the Allegro hand's H, x points out of the palm


def three_finger_grasp(mu: float = 0.7, model: str = "point", mass: float = 0.05) -> Grasp:
    """Return the grasp of a sphere of 30 mm radius by index, middle and thumb."""
    hand, shape = load("allegro_right"), Sphere(0.03)
    torsion = 0.005 if model == "soft" else None  # m
    contacts = ContactSet.stack(
        [
            Contact(-shape.radius * np.array(n) / np.linalg.norm(n), n, mu, model, torsional_friction=torsion)
            for n in ([-0.2, -0.45, -0.9], [-0.2, 0.45, -0.9], [-0.2, 0.0, 1.0])
        ]
    )
    p_HO = np.array([0.07, 0.03, 0.01])
    fingers = ("index", "middle", "thumb")
    q = hand.grasp_posture(fingers, contacts, p_HO, np.eye(3))
    return Grasp(hand, Body.solid(shape, mass), fingers, contacts, q, p_HO, np.eye(3))

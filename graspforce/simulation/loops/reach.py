"""Whether the fingers can follow a motion of the held object."""

from __future__ import annotations

import numpy as np

from graspforce.control.state import object_motion
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.loops.reference import Reference

_SAMPLES = 24  # instants of the motion
_ROLLING = 0.01  # m: a fingertip that rolls on the object may be so far from its first contact


def find_unreachable(grasp: Grasp, reference: Reference, duration: float) -> tuple[float, str] | None:
    """Return the first instant at which a finger cannot reach its contact, and the finger's name; None if all can.

    The contacts move with the object. A fingertip may be up to 10 mm nearer to its start, because it rolls. The fingers'
    postures are within the joint limits; forces and collisions are not checked.

    Args:
        grasp: the grasp at the start.
        reference: desired motion.
        duration: time of the motion, s.
    """
    start = _tip_places(grasp, grasp.p_HO, grasp.R_HO)
    for t in np.linspace(0.0, duration, _SAMPLES + 1):
        motion = object_motion(reference(float(t)))
        places = _tip_places(grasp, motion.p_HO, motion.R_HO)
        for name, place, first in zip(grasp.fingers, places, start, strict=True):
            distance = float(np.linalg.norm(place - first))  # m
            if distance <= _ROLLING:
                continue
            try:
                grasp.hand.inverse_kinematics(name, place + (first - place) * _ROLLING / distance, grasp.q)
            except InvalidInput:
                return float(t), name
    return None


def _tip_places(grasp: Grasp, p_HO: Array, R_HO: Array) -> Array:
    """Return the (N, 3) places of the tip frames in H, m, whose pads touch the contacts of the object at a pose."""
    radii = np.array([grasp.hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])
    centres_O = grasp.contacts.p_OC - radii[:, None] * grasp.contacts.R_OC[:, :, 2]
    places: Array = p_HO + centres_O @ R_HO.T
    return places

"""Postures of the fingers that do not touch the object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search.batch_kinematics import BatchKinematics

_STEPS = 20  # postures between stretched and neutral that are tried


def relax_idle_fingers(grasp: Grasp, clearance: float = 0.01) -> Grasp:
    """Return the grasp with each idle finger as close to its neutral posture as the clearance allows.

    `find_grasp` stretches idle fingers out of the way. Here an idle finger's joints move together,
    q = q_stretched + s (q_neutral − q_stretched), with the largest s in [0, 1] for which all smaller s are clear, too.

    Args:
        grasp: the grasp; contacts and touching fingers stay as they are.
        clearance: least distance from idle fingers to the object and to other fingers, m.

    Raises:
        InvalidInput: the clearance is negative.
    """
    arrays.check_number(clearance, "clearance", minimum=0.0)
    hand, shape = grasp.hand, grasp.body.shape
    kinematics = BatchKinematics(hand)
    q = np.array(grasp.q)
    held = {j for name in grasp.fingers for j in hand.finger(name).joints}  # a palm's fold may move idle fingers, too
    for index, finger in enumerate(hand.fingers):
        if finger.name in grasp.fingers:
            continue
        joints = [j for j in finger.joints if j not in held]
        shares = np.linspace(0.0, 1.0, _STEPS + 1)
        candidates = np.tile(q, (len(shares), 1))
        candidates[:, joints] += shares[:, None] * (hand.neutral[joints] - q[joints])
        centres = kinematics.evaluate(candidates).sphere_centres
        own = kinematics.sphere_finger == index
        radii = kinematics.sphere_radii
        distance = _least_distance(centres[:, own], centres[:, ~own], radii[own], radii[~own])
        if shape is not None:
            local = (centres[:, own] - grasp.p_HO) @ grasp.R_HO
            to_object = shape.phi(local.reshape(-1, 3)).reshape(len(shares), -1) - radii[own]
            distance = np.minimum(distance, to_object.min(axis=1))
        blocked = np.flatnonzero(distance < np.minimum(clearance, distance[0]))
        q[joints] = candidates[(blocked[0] if len(blocked) else len(shares)) - 1, joints]
    return replace(grasp, q=q)


def _least_distance(a: Array, b: Array, a_radii: Array, b_radii: Array) -> Array:
    """Return the least distance between two sets of spheres (B, I, 3) and (B, J, 3), (B,) m; infinite for an empty set."""
    apart = np.linalg.norm(a[:, :, None] - b[:, None], axis=3) - a_radii[:, None] - b_radii
    return np.asarray(apart.min(axis=(1, 2), initial=np.inf))

"""Motions of a held object that the contacts allow: rolling without slip, with joint motions that follow."""

from __future__ import annotations

import numpy as np

from graspforce.contact.compiled_kinematics import rolling_contacts
from graspforce.contact.kinematics import RollingContacts
from graspforce.contact.motion import BodyMotion
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.control.contacts.mobility import MassFactor, compute_accelerations
from graspforce.control.settings import ControlSettings
from graspforce.core.arrays import Array, freeze
from graspforce.grasp.grasp import Grasp

_DEFAULTS = ControlSettings()


def contacts_at_rest(grasp: Grasp) -> RollingContacts:
    """Return the contacts of a grasp, with hand and object at rest in it.

    Args:
        grasp: hand, object and contacts.
    """
    hand = grasp.hand
    radii = np.array([hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])  # m
    tips = hand.model.tip_motion(grasp.q, np.zeros(hand.n), [hand.frame_id(name) for name in grasp.fingers])
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    return rolling_contacts(tips, radii, rest, grasp.body.shape, grasp.contacts, grasp.contacts.R_OC)


def feasible_twists(grasp: Grasp, settings: ControlSettings = _DEFAULTS) -> Array:
    """Return the twists of the object that the contacts allow in the posture of a grasp.

    Contacts at the tips of fingers with enough joints allow all twists. Each contact on an inner link or on the palm takes some
    away: an object that touches the palm with friction cannot move there, and the controller holds it in its place.

    Args:
        grasp: hand, object and contacts.
        settings: with `rank_tolerance`.

    Returns:
        (r, 6) orthonormal rows in H's axes, about O, m/s and rad/s; none if the object is fixed.
    """
    A, B, beta = ContactConstraints.from_contacts(grasp.contacts).constraint_rows(contacts_at_rest(grasp))
    inputs = A, B, np.zeros_like(beta), np.zeros(6), np.zeros(grasp.hand.n), MassFactor.from_body(grasp.body)
    fixed_O = compute_accelerations(*inputs, settings.rank_tolerance).uncontrollable
    _, _, axes = np.linalg.svd(np.vstack([fixed_O, np.zeros((1, 6))]))
    allowed = axes[len(fixed_O) :].reshape(-1, 2, 3) @ grasp.R_HO.T
    return freeze(allowed.reshape(-1, 6))

"""Share of the commanded torques that the motors make, from the motion of hand and object.

While the fingers hold the object, the contact forces f meet the equations of the hand and of the object,

    Jᵀ f = s tau − tau_u,      G f = w,

with the commanded torques tau, the torques tau_u of the motion without contact, the wrench w that the object needs, and the
share s of the motors: s = 1 for drives as modelled. The rows are divided by their uncertainty. Without f, by a projection onto
the left null space of [Jᵀ; G], they are a s = b. A load that is heavier by 1/s has the same effect as motors that are weaker by
s.

The means of a window of states enter, with accelerations from the change of the rates in the window.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.geometry.rotations import rotation_log
from graspforce.grasp.grasp import Grasp

_TORQUE_ERROR = 5e-3  # of torques, as a fraction of their limits; without limits, N·m
_WEIGHT_ERROR = 0.02  # of the object's wrench, as a fraction of its weight
_LEVER = 0.03  # m: moments count with forces at this distance
_RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False, slots=True)
class HeldState:
    """A state of hand and object with the torques that were commanded in it.

    Attributes:
        t: time, s.
        q: (n,) joint positions, rad.
        v: (n,) joint rates, rad/s.
        object: motion of the object in H, without acceleration.
        tau: (n,) commanded torques, N·m.
        contacts: the present contacts in O.
    """

    t: float
    q: Array
    v: Array
    object: BodyMotion
    tau: Array
    contacts: ContactSet


@dataclass(frozen=True, eq=False, slots=True)
class ShareEquation:
    """The equation of one window: a s = b in units of its uncertainty, and how the contacts slid.

    Attributes:
        t: end of the window, s.
        duration: length of the window, s.
        information: aᵀ a.
        product: aᵀ b.
        square: bᵀ b.
        sliding: (N, 2) sliding of the fingers on the object along both tangents, m.
    """

    t: float
    duration: float
    information: float
    product: float
    square: float
    sliding: Array


def share_equation(grasp: Grasp, states: list[HeldState], gravity_H: Array) -> ShareEquation:
    """Return the equation of a window of states.

    Args:
        grasp: hand and object as modelled.
        states: consecutive states, at least two.
        gravity_H: (3,) acceleration of gravity in H, m/s².
    """
    first, last, middle = states[0], states[-1], states[len(states) // 2]
    dt = last.t - first.t  # s
    hand, body = grasp.hand, grasp.body
    rates = np.mean([each.v for each in states], axis=0)
    tau = np.mean([each.tau for each in states[:-1]], axis=0)
    twist = np.mean([each.object.twist for each in states], axis=0)
    tau_u = hand.inverse_dynamics(middle.q, rates, (last.v - first.v) / dt, gravity_H)
    acceleration = (last.object.twist - first.object.twist) / dt
    p_HO, R_HO = middle.object.p_HO, middle.object.R_HO
    w = body.wrench(BodyMotion(p_HO, R_HO, twist, acceleration), gravity_H)
    contacts = middle.contacts
    J = hand.contact_jacobian(middle.q, grasp.fingers, contacts, p_HO, R_HO)
    G = grasp_matrix(contacts)
    scale = np.concatenate([_torque_errors(grasp), _wrench_errors(grasp, gravity_H)])
    left = np.concatenate([J.T, G]) / scale[:, None]
    U, singular, _ = np.linalg.svd(left)
    null = U[:, int(np.count_nonzero(singular > _RANK_TOLERANCE * singular[0])) :].T
    a = null @ (np.concatenate([tau, np.zeros(6)]) / scale)
    b = null @ (np.concatenate([tau_u, -w]) / scale)
    moved = R_HO.T @ (last.object.p_HO - first.object.p_HO)
    turned = rotation_log(first.object.R_HO.T @ last.object.R_HO)
    slid = J @ (last.q - first.q) - G.T @ np.concatenate([moved, turned])  # positions: noise of rates would add up
    sliding = contacts.pad(slid)[:, :2]
    return ShareEquation(last.t, dt, float(a @ a), float(a @ b), float(b @ b), sliding)


def _torque_errors(grasp: Grasp) -> Array:
    """Return (n,) uncertainties of the joint torques, N·m."""
    hand = grasp.hand
    largest = 0.5 * (hand.torque_upper - hand.torque_lower)
    own = np.where(np.isfinite(largest), _TORQUE_ERROR * largest, _TORQUE_ERROR)
    return np.asarray(own + hand.friction.coulomb + hand.friction.stribeck)


def _wrench_errors(grasp: Grasp, gravity_H: Array) -> Array:
    """Return (6,) uncertainties of the object's wrench, N and N·m."""
    force = _WEIGHT_ERROR * grasp.body.mass * max(float(np.linalg.norm(gravity_H)), 1.0)
    return np.array([force] * 3 + [_LEVER * force] * 3)

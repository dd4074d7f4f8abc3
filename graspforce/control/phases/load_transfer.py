"""Wrenches on the object beside gravity and the fingers: from the table, and from the acceleration of the hand's base.

Torques that accelerate the links with the base are here, too.

While the table carries the part 1 − s of the object's weight, the wrench that the fingers must supply is

    w(s) = w − (1 − s) w_table,

with the reaction w_table of an object at rest, − m g at its centre of mass. In a base that accelerates with a, the object also
needs m a there.
"""

from __future__ import annotations

import numpy as np

from graspforce.control.phases.cycle_plan import BaseMotion
from graspforce.core.arrays import Array, freeze
from graspforce.grasp.body import Body
from graspforce.hand.hand import Hand


def table_wrench(body: Body, R_HO: Array, gravity_H: Array, share: float) -> Array:
    """Return the wrench of the table that carries a part of the object's weight, (6,) about O's origin, in O, N and N·m.

    Args:
        body: the object.
        R_HO: (3, 3) axes of the object in H.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        share: part of the weight that the table carries, 0 to 1.
    """
    return force_at_centre(body, R_HO.T @ (-share * body.mass * gravity_H))


def inertial_wrench(body: Body, R_HO: Array, acceleration: Array) -> Array:
    """Return the inertial wrench of an accelerating base, −m a, (6,) about O's origin, in O, N and N·m.

    Args:
        body: the object.
        R_HO: (3, 3) axes of the object in H.
        acceleration: (3,) a, of the base in the axes of H, m/s².
    """
    return force_at_centre(body, R_HO.T @ (-body.mass * acceleration))


def accelerated_torque(hand: Hand, tau: Array, q: Array, base: BaseMotion) -> Array:
    """Return torques with those that accelerate the links with the base, (n,) N·m, within the motors' limits.

    Args:
        hand: the hand.
        tau: (n,) torques for a base at rest, N·m.
        q: (n,) joint positions, rad.
        base: motion of the base.
    """
    if not base.a.any():
        return tau
    return freeze(np.clip(tau + hand.gravity_torque(q, -base.a), hand.torque_lower, hand.torque_upper))


def force_at_centre(body: Body, force: Array) -> Array:
    """Return the wrench of a force at the centre of mass, (6,) about O's origin, in O, N and N·m.

    Args:
        body: the object.
        force: (3,) in O, N.
    """
    return np.append(force, np.cross(body.p_OM, force))

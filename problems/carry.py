"""Force problems of a hand that carries a box along a sinusoid (Al-Gallaf, undated), one for each instant.

`graspforce.problems` does not import this module, because hands load Pinocchio.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.force.problem import ForceProblem
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand

FINGERS = ("finger_1", "finger_2", "finger_3", "finger_4")
CENTRE = (0.0, 0.0, 0.055)  # m, in H: centre of the box at the start and the end of the path
HALF_WIDTH, HALF_SPAN = 0.03, 0.0225  # m: contacts at x = ±HALF_WIDTH, y = ±HALF_SPAN in O
_CORNERS = ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))  # signs of x and y for each finger
_AXES = np.eye(3)  # R_HO: the axes of O and H are parallel
_TIME_STEP = 1e-4  # s, of the central difference: error of order 1e-8, its square; rounding below 1e-10


@dataclass(frozen=True, eq=False, slots=True)
class CarryStep:
    """One instant of the carry.

    Args:
        time: s, from 0.
        p_HO: (3,) position of the box in H, m; the axes of O and H are parallel.
        q, v, a: (n,) joint positions, rad, rates, rad/s, and accelerations, rad/s².
        problem: the force problem of this instant.
    """

    time: float
    p_HO: Array
    q: Array
    v: Array
    a: Array
    problem: ForceProblem


def sinusoidal_carry(
    hand: Hand | None = None,
    *,
    steps: int = 101,
    period: float = 1.0,
    travel_y: float = 0.012,
    travel_z: float = 0.012,
    mass: float = 0.15,
    friction: float = 0.6,
    max_normal: float = 15.0,
    gravity_H: tuple[float, float, float] = GRAVITY_PALM_UP,
) -> tuple[CarryStep, ...]:
    """Return the force problems of a box that four fingertips carry out and back, from rest to rest.

        p(t) = p₀ + (0, travel_y, travel_z) (1 − cos 2πt/T)/2,    G f = w = m (p̈ − g),
        J_c v = ṗ,    J_c a = p̈ − J̇_c v,                        J_c: Jacobian of all tip centres

    The box does not rotate. Path and forces are symmetric about t = T/2. Rolling is neglected: the contacts stay fixed on the
    box.

    Args:
        hand: a hand with the fingers `FINGERS` of three joints each (default: "four_finger").
        steps: number of instants, evenly spaced from 0 to ``period`` inclusive.
        period: T, s.
        travel_y: travel of the box along H's y axis, m.
        travel_z: travel of the box along H's z axis, m.
        mass: mass of the box, kg; its centre of mass is its centre.
        friction: μ of all contacts.
        max_normal: largest normal force of each contact, N.
        gravity_H: (3,) acceleration of gravity in H, m/s².

    Raises:
        InvalidInput: a number is out of range, the hand has other joints, or the fingers cannot reach the path.
        UnknownName: a hand with twelve joints lacks one of the fingers.
    """
    fields.check_integer(steps, "steps", minimum=2, maximum=1_000_000)
    period = arrays.check_number(period, "period", above=0.0)
    mass = arrays.check_number(mass, "mass", above=0.0)
    travel = np.array([0.0, arrays.check_number(travel_y, "travel_y"), arrays.check_number(travel_z, "travel_z")])
    hand = Hand.load("four_finger") if hand is None else hand
    if hand.n != 3 * len(FINGERS) or any(len(hand.finger(name).joints) != 3 for name in FINGERS):
        raise InvalidInput("hand", hand.name, "a hand whose four fingers have three joints each, without other joints")
    contacts = _contacts(friction, max_normal)
    rate = 2.0 * np.pi / period  # rad/s

    carry_steps, q = [], hand.neutral
    for time in np.linspace(0.0, period, steps):
        p_HO = CENTRE + travel * (1.0 - np.cos(rate * time)) / 2.0  # m
        velocity = travel * rate * np.sin(rate * time) / 2.0  # m/s
        acceleration = travel * rate**2 * np.cos(rate * time) / 2.0  # m/s²
        q = hand.grasp_posture(FINGERS, contacts, p_HO, _AXES, q)
        v, a = _motion(hand, q, velocity, acceleration)
        force = mass * (acceleration - arrays.check_array(gravity_H, "gravity_H", (3,)))  # N
        tau_u = hand.inverse_dynamics(q, v, a, gravity_H)  # N·m
        actuation = hand.actuation(q, FINGERS, contacts, p_HO, _AXES, tau_u=tau_u)
        problem = ForceProblem(contacts, [*force, 0.0, 0.0, 0.0], actuation, name=f"carry at {time:.4g} s")
        carry_steps.append(CarryStep(float(time), freeze(p_HO), q, v, a, problem))
    return tuple(carry_steps)


def _contacts(friction: float, max_normal: float) -> ContactSet:
    """Return two contacts on each side of the box, with normals along x."""
    contacts = []
    for x, y in _CORNERS:
        position, normal = np.array([x * HALF_WIDTH, y * HALF_SPAN, 0.0]), np.array([-x, 0.0, 0.0])
        contacts.append(Contact(position, normal, friction, max_normal=max_normal))
    return ContactSet.stack(contacts)


def _motion(hand: Hand, q: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
    """Return the joint rates and accelerations that move all tip centres with the box."""
    v = np.linalg.solve(_centre_jacobian(hand, q), np.tile(velocity, len(FINGERS)))
    J_next, J_previous = _centre_jacobian(hand, q + _TIME_STEP * v), _centre_jacobian(hand, q - _TIME_STEP * v)
    J_dot_v = (J_next - J_previous) @ v / (2.0 * _TIME_STEP)  # m/s²
    a = np.linalg.solve(_centre_jacobian(hand, q), np.tile(acceleration, len(FINGERS)) - J_dot_v)
    return freeze(v), freeze(a)


def _centre_jacobian(hand: Hand, q: Array) -> Array:
    """Return J_c (12, n), which maps joint rates to the velocities of the tip centres in H."""
    return np.vstack([hand.point_jacobian(q, name, hand.tip_pose(q, name)[0])[:3] for name in FINGERS])

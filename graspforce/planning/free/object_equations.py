"""What holds at an instant while fingers move an object between them, as equations of scaled variables.

The object's pose is p = p₀ + L y_p and R = C(r) R₀, r = A y_r Cayley's parameters, regular up to half a turn from R₀, which
stands in the middle of the move. Forces are written in H, so that a finger's equations and the object's share few variables:

    tau = M q̈ + h + Jᵀ f + J_ωᵀ (r n × f),    Σ f = m (p̈_M − g),    Σ x × f = R (I α + ω × I ω) + …,
    ‖f_t‖ ≤ μ f_n − margin as (μ f_n − margin)² ≥ ‖f‖² − f_n²,
    |q̇ + q̈ h/2| ≤ its limit: where q̈ is linear between knots, q̇ lies between its values there and this one

c = tip(q) − p is where the middle of the tip's ball is from the object's origin, n the inward normal and x = c + r n the
contact. Where it stays on the object, c = R c₀ and its two time derivatives say so. Where it rolls, the object's point at x and
the finger's have the same velocity, and it stays so,

    ċ_F + ω_F × r n = ṗ + ω × x,    c̈_F + ω̇_F × r n + ω_F × (r n)˙ = p̈ + α × x + ω × ẋ,    ċ_F = J q̇,

and then r n = −r/ρ x over a ball of radius ρ about the object's origin, likewise with what of x is across its axis over a
tube, and r R n₀ over a plane: distances to the surface stay what they were, so that no roots are needed. Joint rates and
accelerations are variables of their own: so every equation stays short, and its second derivatives with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import casadi as ca
import numpy as np

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.planning.nlp.equations import Equations, equations
from graspforce.planning.nlp.symbolic_finger import symbolic_finger


@dataclass(frozen=True, slots=True)
class VariableScales:
    """What scaled variables count in.

    Args:
        length: of the object's position, m.
        turn: of Cayley's parameters.
        time: s.
        joint: of joint angles in rates and accelerations, rad.
        force: N.
    """

    length: float
    turn: float
    time: float
    joint: float
    force: float

    @property
    def numbers(self) -> tuple[float, ...]:
        return (self.length, self.turn, self.time, self.joint, self.force)


FIXED, ON_PLANE, ON_SPHERE, ON_CYLINDER = (
    "stays",
    "flat",
    "ball",
    "tube",
)  # how a contact moves: not at all, or over which surface


class _Parameters:
    """Given numbers, taken one after the other."""

    def __init__(self) -> None:
        self._all: list[ca.SX] = []

    def take(self, count: int = 1) -> ca.SX:
        self._all.append(ca.SX.sym(f"p{len(self._all)}", count))
        return self._all[-1]

    @property
    def all(self) -> ca.SX:
        return ca.vertcat(*self._all)


@dataclass(frozen=True, eq=False, slots=True)
class _ObjectMotion:
    """The object's motion in H, from scaled variables."""

    p: ca.SX
    C: ca.SX
    p_d: ca.SX
    p_dd: ca.SX
    omega: ca.SX
    alpha: ca.SX

    @classmethod
    def of(cls, y: ca.SX, v: ca.SX, a: ca.SX, p_0: ca.SX, length: ca.SX, turn: ca.SX, time: ca.SX) -> _ObjectMotion:
        r, r_d, r_dd = turn * y[3:], turn / time * v[3:], turn / time**2 * a[3:]
        s = 2.0 / (1.0 + ca.dot(r, r))
        S = ca.skew(r)
        rate = r_d + ca.cross(r, r_d)
        alpha = s * (r_dd + ca.cross(r, r_dd)) - s**2 * ca.dot(r, r_d) * rate
        C = ca.SX.eye(3) + s * (S + S @ S)
        return cls(p_0 + length * y[:3], C, length / time * v[:3], length / time**2 * a[:3], s * rate, alpha)


def _tip_to_contact(surface: str, x: ca.SX, axis: ca.SX, radius: ca.SX, ratio: ca.SX) -> ca.SX:
    """r n: from the middle of a tip's ball to the contact at x, m; the axis in H."""
    if surface in (FIXED, ON_PLANE):
        return radius * axis
    return -ratio * (x if surface == ON_SPHERE else x - ca.dot(x, axis) * axis)


def _tip_to_contact_rate(surface: str, x: ca.SX, c_d: ca.SX, axis: ca.SX, omega: ca.SX, radius: ca.SX, ratio: ca.SX) -> ca.SX:
    """Its time derivative, m/s."""
    axis_d, share = ca.cross(omega, axis), ratio / (1.0 + ratio)
    if surface == ON_PLANE:
        return radius * axis_d
    if surface == ON_SPHERE:
        return -share * c_d
    along = ca.dot(x, axis)  # as much as of c
    along_d = ca.dot(c_d, axis) + (1.0 + ratio) * ca.dot(x, axis_d)  # axis_d is across the axis, where c is longer than x
    return -share * (c_d - along * axis_d - along_d * axis)


@lru_cache(maxsize=64)
def finger_equations(hand: Hand, finger: str, free: tuple[int, ...], surface: str = FIXED) -> Equations:
    """A finger that holds the object: 9 rows of contact, its joints' torques and rates over their limits, f_n, the cone.

    Contact: c and its two derivatives where it stays; where it rolls, velocities, accelerations, and the arm x.
    Variables: y, v, a of the object (6 each), of the joints that move as they like (``free``, places in the finger's joints),
    q, q̇, q̈ of the others, f, T, and x where the contact rolls. Of joints that others lead where contacts stay, q is not scaled.
    Numbers: units, gravity_H, p₀, c₀ at R₀, at R₀ the normal, or the axis of a tube, r, r/ρ, torque and speed limits, μ,
    slip margin, h/T.
    """
    model = symbolic_finger(hand, finger, hand.neutral)
    m, k = len(model.joints), len(free)
    y, v, a = (ca.SX.sym(name, 6) for name in ("y", "v", "a"))
    e, e_d, e_dd = (ca.SX.sym(name, k) for name in ("e", "e_d", "e_dd"))
    x, x_d, x_dd = (ca.SX.sym(name, m - k) for name in ("x", "x_d", "x_dd"))
    f = ca.SX.sym("f", 3)
    given = _Parameters()
    length, turn, time, joint, force = (given.take() for _ in range(5))
    gravity, p_0, began, axis, radius, ratio = (given.take(size) for size in (3, 3, 3, 3, 1, 1))
    limit, fastest, mu, margin, part = given.take(m), given.take(m), given.take(), given.take(), given.take()
    T = ca.SX.sym("T")

    order = [*free, *(i for i in range(m) if i not in free)]
    back = [order.index(i) for i in range(m)]
    q = ca.vertcat(joint * e, x if surface == FIXED else joint * x)[back]
    q_d, q_dd = joint / time * ca.vertcat(e_d, x_d)[back], joint / time**2 * ca.vertcat(e_dd, x_dd)[back]
    J = model.jacobian(q)
    at = _ObjectMotion.of(y, v, a, p_0, length, turn, time)
    going, gaining = J @ q_d, J @ q_dd + model.bias(q, q_d)
    c, c_d, c_dd = model.tip(q) - at.p, going[:3] - at.p_d, gaining[:3] - at.p_dd
    axis_H, arm = at.C @ axis, ca.SX.sym("arm", 0 if surface == FIXED else 3)
    touched = length * arm
    inward = _tip_to_contact(surface, touched, axis_H, radius, ratio)
    if surface == FIXED:
        place = at.C @ began
        swept = ca.cross(at.omega, place)
        contact = [
            (c - place) / length,
            (c_d - swept) * time / length,
            (c_dd - ca.cross(at.alpha, place) - ca.cross(at.omega, swept)) * time**2 / length,
        ]
    else:
        rate = _tip_to_contact_rate(surface, touched, c_d, axis_H, at.omega, radius, ratio)
        slip = c_d + ca.cross(going[3:], inward) - ca.cross(at.omega, touched)
        grip = c_dd + ca.cross(gaining[3:], inward) + ca.cross(going[3:], rate)
        grip -= ca.cross(at.alpha, touched) + ca.cross(at.omega, c_d + rate)
        contact = [slip * time / length, grip * time**2 / length, (c + inward) / length - arm]
    f_H = force * f
    tau = model.torque(q, q_d, q_dd, gravity) + J[:3, :].T @ f_H + J[3:, :].T @ ca.cross(inward, f_H)
    peak = (q_d + q_dd * part * T * time / 2.0) / fastest
    pressing = ca.dot(axis_H, f) if surface in (FIXED, ON_PLANE) else ca.dot(inward, f) / radius
    cone = (mu * pressing - margin / force) ** 2 - ca.dot(f, f) + pressing**2
    g = ca.vertcat(*contact, tau / limit, peak, pressing, cone)
    variables = ca.vertcat(y, v, a, e, e_d, e_dd, x, x_d, x_dd, f, T, arm)
    return equations(f"{_identifier(hand.name)}_{_identifier(finger)}_{surface}", variables, given.all, g)


@lru_cache(maxsize=64)
def ideal_finger_equations() -> Equations:
    """An ideal finger: f_n and the cone. Variables: y_r (3), f. Numbers: units, n at R₀, μ, slip margin."""
    y, f = ca.SX.sym("y", 3), ca.SX.sym("f", 3)
    given = _Parameters()
    _, turn, _, _, force = (given.take() for _ in range(5))
    n, mu, margin = given.take(3), given.take(), given.take()
    rest = ca.SX.zeros(6)
    at = _ObjectMotion.of(ca.vertcat(ca.SX.zeros(3), y), rest, rest, ca.SX.zeros(3), ca.SX(1), turn, ca.SX(1))
    pressing = ca.dot(at.C @ n, f)
    cone = (mu * pressing - margin / force) ** 2 - ca.dot(f, f) + pressing**2
    return equations("ideal", ca.vertcat(y, f), given.all, ca.vertcat(pressing, cone))


@lru_cache(maxsize=64)
def object_equations(is_rolling: tuple[bool, ...]) -> Equations:
    """The object: Newton's and Euler's laws about O, 6 rows.

    Variables: y_r, v, a (3 + 6 + 6), the forces of the contacts, and x of those that roll.
    Numbers: units, gravity_H, mass, p_OM at R₀, inertia at R₀ (9, column by column), p_OC at R₀ of each contact that stays, a
    length.
    """
    y, v, a = ca.SX.sym("y", 3), ca.SX.sym("v", 6), ca.SX.sym("a", 6)
    forces = [ca.SX.sym(f"f{i}", 3) for i in range(len(is_rolling))]
    rolled = [ca.SX.sym(f"x{i}", 3) for i in range(sum(is_rolling))]
    given = _Parameters()
    length, turn, time, _, force = (given.take() for _ in range(5))
    gravity, mass, p_OM, inertia = given.take(3), given.take(), given.take(3), ca.reshape(given.take(9), 3, 3)
    stays = [given.take(3) for _ in range(len(is_rolling) - len(rolled))]
    lever = given.take()
    at = _ObjectMotion.of(ca.vertcat(ca.SX.zeros(3), y), v, a, ca.SX.zeros(3), length, turn, time)
    com = at.C @ p_OM
    centre = at.p_dd + ca.cross(at.alpha, com) + ca.cross(at.omega, ca.cross(at.omega, com))
    wanted = mass * (centre - gravity)  # N
    omega_0, alpha_0 = at.C.T @ at.omega, at.C.T @ at.alpha
    spin = at.C @ (inertia @ alpha_0 + ca.cross(omega_0, inertia @ omega_0))  # N·m
    total, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    over, beside = iter(rolled), iter(stays)
    for f, moves in zip(forces, is_rolling, strict=True):
        total += force * f
        moment += ca.cross(length * next(over) if moves else at.C @ next(beside), force * f)
    g = ca.vertcat(total - wanted, (moment - spin - ca.cross(com, wanted)) / lever) / force
    word = "".join("r" if moves else "s" for moves in is_rolling)
    return equations(f"object_{word}", ca.vertcat(y, v, a, *forces, *rolled), given.all, g)


def _identifier(name: str) -> str:
    return "".join(letter if letter.isalnum() and letter.isascii() else "_" for letter in name)


def choose_free_joints(J: Array, count: int) -> tuple[int, ...]:
    """Which ``count`` of a finger's joints may move as they like: those without which the others move the tip best.

    Args:
        J: (3, m) the tip's Jacobian.
    """

    def strength(left: tuple[int, ...]) -> float:
        kept = [i for i in range(J.shape[1]) if i not in left]
        return float(np.linalg.svd(J[:, kept], compute_uv=False)[-1])

    return max(combinations(range(J.shape[1]), count), key=strength)

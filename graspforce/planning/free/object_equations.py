"""Equations at one instant of fingers that move an object, in scaled variables.

The object's pose is p = p₀ + L y_p and R = C(r) R₀ with r = A y_r, the Cayley parameters, which are regular up to half a turn
from R₀. R₀ is the orientation in the middle of the move. Forces are written in H, so that fingers and object share few
variables.

The motors of a finger, with J and J_ω the Jacobians of its tip and r n the vector from the tip's centre to the contact:

    tau = M q̈ + h + Jᵀ f + J_ωᵀ (r n × f)

The object, as the CasADi form of `Body.wrench`, with c_M its centre of mass from O:

    Σ f = m (p̈_M − g),    Σ x × f = R (I α + ω × I ω) + c_M × m (p̈_M − g)

The friction cone ‖f_t‖ ≤ μ f_n − margin, without roots:

    (μ f_n − margin)² ≥ ‖f‖² − f_n²

Joint speeds between the knots, where q̈ is linear:

    |q̇ + q̈ h/2| ≤ q̇_max

The contact x = c + r n, where c = tip(q) − p is the tip's centre from O and n the inward normal. If it does not roll, c = R c₀
holds, with its first and second time derivatives. If it rolls, finger and object have equal velocities at x, and their time
derivatives are equal too. This is the CasADi form of the rolling law of `graspforce.contact.kinematics`:

    ċ_F + ω_F × r n = ṗ + ω × x,    ċ_F = J q̇

    c̈_F + ω̇_F × r n + ω_F × (r n)˙ = p̈ + α × x + ω × ẋ

A soft contact has a moment m about n, and M = m n is a variable, too. With the length γ of its torsional friction the cone is

    (μ f_n − margin)² ≥ ‖f‖² − f_n² + (μ m/γ)²

and the motors also bear J_ωᵀ M. If it rolls, it does not spin: n·(ω_F − ω) = 0, and its time derivative vanishes.

Closed forms give r n: −r/ρ x on a sphere of radius ρ about O; the same with the part of x across the axis on a cylinder; r R n₀
on a plane; and from the gradient of its function on a superquadric. The distance from the surface stays constant.
Joint rates and accelerations are separate variables: this keeps every equation, and its second derivatives, short.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import casadi as ca
import numpy as np

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.planning.free.superquadric_surface import SuperquadricSurface
from graspforce.planning.nlp.equations import Equations, make_equations
from graspforce.planning.nlp.symbolic_finger import symbolic_finger

# how a contact moves over the object
FIXED, ON_PLANE, ON_SPHERE, ON_CYLINDER, ON_SUPERQUADRIC = "fixed", "plane", "sphere", "cylinder", "superquadric"
SUPERQUADRIC_SIZES = (9, 3, 2)  # further parameters of a finger on a superquadric: R₀, half-axes and exponents


@dataclass(frozen=True, slots=True)
class VariableScales:
    """Scales of the variables.

    Args:
        length: of the object's position, m.
        turn: of the Cayley parameters.
        time: of time, s.
        joint: of joint angles, rad.
        force: of forces, N.
    """

    length: float
    turn: float
    time: float
    joint: float
    force: float

    @property
    def parameter_values(self) -> Array:
        """Return the values of the equations' first five parameters."""
        return np.array([self.length, self.turn, self.time, self.joint, self.force])


class _Parameters:
    """Parameters of a set of equations, in the order in which they are taken."""

    def __init__(self) -> None:
        self._symbols: list[ca.SX] = []

    def take(self, count: int = 1) -> ca.SX:
        """Return ``count`` new parameters."""
        self._symbols.append(ca.SX.sym(f"p{len(self._symbols)}", count))
        return self._symbols[-1]

    @property
    def all(self) -> ca.SX:
        return ca.vertcat(*self._symbols)


@dataclass(frozen=True, eq=False, slots=True)
class _ObjectMotion:
    """The object's motion in H: position p, rotation C from R₀, and their rates."""

    p: ca.SX
    C: ca.SX
    p_d: ca.SX
    p_dd: ca.SX
    omega: ca.SX
    alpha: ca.SX

    @classmethod
    def from_variables(cls, states: tuple[ca.SX, ca.SX, ca.SX], p_0: ca.SX, scales: tuple[ca.SX, ...]) -> _ObjectMotion:
        """Return the motion of y, v and a (6 each), for scales of length, turn and time."""
        (y, v, a), (length, turn, time) = states, scales
        r, r_d, r_dd = turn * y[3:], turn / time * v[3:], turn / time**2 * a[3:]
        s = 2.0 / (1.0 + ca.dot(r, r))
        S = ca.skew(r)
        rate = r_d + ca.cross(r, r_d)
        alpha = s * (r_dd + ca.cross(r, r_dd)) - s**2 * ca.dot(r, r_d) * rate
        C = ca.SX.eye(3) + s * (S + S @ S)
        return cls(p_0 + length * y[:3], C, length / time * v[:3], length / time**2 * a[:3], s * rate, alpha)

    @classmethod
    def rotation_only(cls, y_r: ca.SX, turn: ca.SX) -> _ObjectMotion:
        """Return the pose at rest with position zero, for Cayley parameters ``turn`` y_r."""
        zero, rest = ca.SX.zeros(3), ca.SX.zeros(6)
        return cls.from_variables((ca.vertcat(zero, y_r), rest, rest), zero, (ca.SX(1), turn, ca.SX(1)))


@dataclass(frozen=True, eq=False, slots=True)
class _TipMotion:
    """A tip's motion in H: its centre c from O with rates relative to O, and the tip's own angular rates."""

    c: ca.SX
    c_d: ca.SX
    c_dd: ca.SX
    omega: ca.SX
    alpha: ca.SX


@dataclass(frozen=True, eq=False, slots=True)
class _RollingSurface:
    """The surface under a rolling tip: its kind, its normal or axis in H, the tip's radius r, and r/ρ."""

    kind: str
    axis: ca.SX
    radius: ca.SX
    ratio: ca.SX

    def tip_to_contact(self, x: ca.SX) -> ca.SX:
        """Return r n, from the tip's centre to the contact at x, m."""
        if self.kind in (FIXED, ON_PLANE):
            return self.radius * self.axis
        return -self.ratio * (x if self.kind == ON_SPHERE else x - ca.dot(x, self.axis) * self.axis)

    def tip_to_contact_rate(self, x: ca.SX, c_d: ca.SX, omega: ca.SX) -> ca.SX:
        """Return the time derivative of r n, m/s."""
        axis_d, share = ca.cross(omega, self.axis), self.ratio / (1.0 + self.ratio)
        if self.kind == ON_PLANE:
            return self.radius * axis_d
        if self.kind == ON_SPHERE:
            return -share * c_d
        along = ca.dot(x, self.axis)  # equals c·axis
        along_d = ca.dot(c_d, self.axis) + (1.0 + self.ratio) * ca.dot(x, axis_d)  # across the axis c = (1 + r/ρ) x
        return -share * (c_d - along * axis_d - along_d * self.axis)

    def normal(self, x: ca.SX) -> ca.SX:
        """Return n for the contact at x."""
        return self.axis if self.kind in (FIXED, ON_PLANE) else self.tip_to_contact(x) / self.radius

    def normal_force(self, x: ca.SX, f: ca.SX) -> ca.SX:
        """Return f_n of the scaled force f in H."""
        return ca.dot(self.normal(x), f)


@lru_cache(maxsize=64)
def finger_equations(
    hand: Hand, finger: str, independent: tuple[int, ...], surface: str = FIXED, is_soft: bool = False
) -> Equations:
    """Return the equations of a finger that holds the object.

    Rows: 9 of the contact, the joints' torques and then their rates relative to the limits, f_n, and the cone. The rows of the
    contact are c and its two derivatives if it does not roll; else velocities, accelerations, and the arm x. A soft contact has
    further rows after these: velocity and acceleration of its spin if it rolls, and M − m n.
    Variables: y, v, a of the object (6 each), y, v, a of the independent joints, q, q̇, q̈ of the others, f, T, and x if the
    contact rolls, and M and m of a soft contact over γ. The dependent joints' q is not scaled if the contact does not roll.
    Parameters: scales, gravity_H, p₀, c₀ at R₀, the normal or axis at R₀, r, r/ρ, torque and speed limits, μ, slip margin, h/T;
    γ of a soft contact; on a superquadric also R₀ by columns, its half-axes and its exponents.

    Args:
        hand: the hand.
        finger: its finger.
        independent: places of the independent joints among the finger's joints.
        surface: how the contact moves: FIXED, ON_PLANE, ON_SPHERE, ON_CYLINDER or ON_SUPERQUADRIC.
        is_soft: whether the contact is soft.
    """
    model = symbolic_finger(hand, finger, hand.neutral)
    m, k = len(model.joints), len(independent)
    states = ca.SX.sym("y", 6), ca.SX.sym("v", 6), ca.SX.sym("a", 6)
    e, e_d, e_dd = (ca.SX.sym(name, k) for name in ("e", "e_d", "e_dd"))
    d, d_d, d_dd = (ca.SX.sym(name, m - k) for name in ("d", "d_d", "d_dd"))
    f, T, arm = ca.SX.sym("f", 3), ca.SX.sym("T"), ca.SX.sym("arm", 0 if surface == FIXED else 3)
    parameters = _Parameters()
    length, turn, time, joint, force = (parameters.take() for _ in range(5))
    gravity, p_0, c_0, axis, radius, ratio = (parameters.take(size) for size in (3, 3, 3, 3, 1, 1))
    torque_limit, speed_limit, mu, margin, step = (parameters.take(size) for size in (m, m, 1, 1, 1))
    gamma = parameters.take() if is_soft else ca.SX(0)
    moment, twist_moment = ca.SX.sym("M", 3 * is_soft), ca.SX.sym("m", 1 * is_soft)

    order = [*independent, *(i for i in range(m) if i not in independent)]
    back = [order.index(i) for i in range(m)]
    q = ca.vertcat(joint * e, d if surface == FIXED else joint * d)[back]
    q_d, q_dd = joint / time * ca.vertcat(e_d, d_d)[back], joint / time**2 * ca.vertcat(e_dd, d_dd)[back]
    at = _ObjectMotion.from_variables(states, p_0, (length, turn, time))
    J = model.jacobian(q)
    twist, acceleration = J @ q_d, J @ q_dd + model.bias(q, q_d)
    tip = _TipMotion(model.tip(q) - at.p, twist[:3] - at.p_d, acceleration[:3] - at.p_dd, twist[3:], acceleration[3:])
    under: _RollingSurface | SuperquadricSurface = _RollingSurface(surface, at.C @ axis, radius, ratio)
    if surface == ON_SUPERQUADRIC:
        R_0, axes, exponents = (parameters.take(size) for size in SUPERQUADRIC_SIZES)
        under = SuperquadricSurface(at.C @ ca.reshape(R_0, 3, 3), axes, exponents, radius)
    x = length * arm
    if surface == FIXED:
        contact = _fixed_contact(at, tip, c_0, length, time)
    else:
        contact = _rolling_contact(at, tip, under, arm, length, time)
    inward, f_H = under.tip_to_contact(x), force * f
    if is_soft and surface != FIXED:
        contact += _spin(at, tip, inward / radius, under.tip_to_contact_rate(x, tip.c_d, at.omega) / radius, time)
    if is_soft:
        contact.append(moment - twist_moment * under.normal(x))
    tau = model.torque(q, q_d, q_dd, gravity) + J[:3, :].T @ f_H + J[3:, :].T @ ca.cross(inward, f_H)
    if is_soft:
        tau += J[3:, :].T @ (force * gamma * moment)
    peak = (q_d + q_dd * step * T * time / 2.0) / speed_limit
    f_n = under.normal_force(x, f)
    cone = (mu * f_n - margin / force) ** 2 - ca.dot(f, f) + f_n**2
    if is_soft:
        cone -= (mu * twist_moment) ** 2
    g = ca.vertcat(*contact, tau / torque_limit, peak, f_n, cone)
    variables = ca.vertcat(*states, e, e_d, e_dd, d, d_d, d_dd, f, T, arm, moment, twist_moment)
    kind = f"soft_{surface}" if is_soft else surface
    return make_equations(f"{_identifier(hand.name)}_{_identifier(finger)}_{kind}", variables, parameters.all, g)


def _fixed_contact(at: _ObjectMotion, tip: _TipMotion, c_0: ca.SX, length: ca.SX, time: ca.SX) -> list[ca.SX]:
    """Return c − R c₀ and its first and second time derivatives, scaled."""
    c = at.C @ c_0
    c_d = ca.cross(at.omega, c)
    acceleration = tip.c_dd - ca.cross(at.alpha, c) - ca.cross(at.omega, c_d)
    return [(tip.c - c) / length, (tip.c_d - c_d) * time / length, acceleration * time**2 / length]


def _rolling_contact(
    at: _ObjectMotion,
    tip: _TipMotion,
    under: _RollingSurface | SuperquadricSurface,
    arm: ca.SX,
    length: ca.SX,
    time: ca.SX,
) -> list[ca.SX]:
    """Return the errors of velocity and acceleration of the rolling law at x, and of x = c + r n, scaled."""
    x = length * arm
    inward, rate = under.tip_to_contact(x), under.tip_to_contact_rate(x, tip.c_d, at.omega)
    velocity = tip.c_d + ca.cross(tip.omega, inward) - ca.cross(at.omega, x)
    acceleration = tip.c_dd + ca.cross(tip.alpha, inward) + ca.cross(tip.omega, rate)
    acceleration -= ca.cross(at.alpha, x) + ca.cross(at.omega, tip.c_d + rate)
    return [velocity * time / length, acceleration * time**2 / length, (tip.c + inward) / length - arm]


def _spin(at: _ObjectMotion, tip: _TipMotion, n: ca.SX, n_d: ca.SX, time: ca.SX) -> list[ca.SX]:
    """Return velocity and acceleration of the finger's spin over the object, scaled."""
    omega, alpha = tip.omega - at.omega, tip.alpha - at.alpha
    return [ca.dot(n, omega) * time, (ca.dot(n, alpha) + ca.dot(n_d, omega)) * time**2]


@lru_cache(maxsize=64)
def ideal_finger_equations(is_soft: bool = False) -> Equations:
    """Return the equations of an ideal finger.

    Rows: f_n and the cone; M − m n of a soft contact before them. Variables: y_r (3), f (3), and M and m of a soft contact.
    Parameters: scales, n at R₀, μ, slip margin.

    Args:
        is_soft: whether the contact is soft.
    """
    y_r, f = ca.SX.sym("y", 3), ca.SX.sym("f", 3)
    moment, twist_moment = ca.SX.sym("M", 3 * is_soft), ca.SX.sym("m", 1 * is_soft)
    parameters = _Parameters()
    _, turn, _, _, force = (parameters.take() for _ in range(5))
    n, mu, margin = parameters.take(3), parameters.take(), parameters.take()
    n_H = _ObjectMotion.rotation_only(y_r, turn).C @ n
    f_n = ca.dot(n_H, f)
    cone = (mu * f_n - margin / force) ** 2 - ca.dot(f, f) + f_n**2
    if not is_soft:
        return make_equations("ideal", ca.vertcat(y_r, f), parameters.all, ca.vertcat(f_n, cone))
    g = ca.vertcat(moment - twist_moment * n_H, f_n, cone - (mu * twist_moment) ** 2)
    return make_equations("ideal_soft", ca.vertcat(y_r, f, moment, twist_moment), parameters.all, g)


@lru_cache(maxsize=64)
def object_equations(is_rolling: tuple[bool, ...], is_soft: tuple[bool, ...] = ()) -> Equations:
    """Return the object's equations of motion, Newton's and Euler's laws about O.

    Rows: 3 of forces and 3 of moments. Variables: y_r, v, a (3 + 6 + 6), the contact forces in H, x of rolling contacts, and
    M/γ of soft ones. Parameters: scales, gravity_H, mass, p_OM at R₀, inertia at R₀ (9), p_OC at R₀ of each contact that does
    not roll, a length, and γ of each soft contact.

    Args:
        is_rolling: whether each contact rolls.
        is_soft: whether each contact is soft; none by default.
    """
    y_r, v, a = ca.SX.sym("y", 3), ca.SX.sym("v", 6), ca.SX.sym("a", 6)
    forces = [ca.SX.sym(f"f{i}", 3) for i in range(len(is_rolling))]
    arms = [ca.SX.sym(f"x{i}", 3) for i in range(sum(is_rolling))]
    moments = [ca.SX.sym(f"M{i}", 3) for i in range(sum(is_soft))]
    parameters = _Parameters()
    length, turn, time, _, force = (parameters.take() for _ in range(5))
    gravity, mass, p_OM, inertia = (parameters.take(size) for size in (3, 1, 3, 9))
    fixed_arms = [parameters.take(3) for _ in range(len(is_rolling) - len(arms))]
    lever = parameters.take()
    gammas = [parameters.take() for _ in moments]
    at = _ObjectMotion.from_variables((ca.vertcat(ca.SX.zeros(3), y_r), v, a), ca.SX.zeros(3), (length, turn, time))
    c, I_0 = at.C @ p_OM, ca.reshape(inertia, 3, 3)
    p_dd_M = at.p_dd + ca.cross(at.alpha, c) + ca.cross(at.omega, ca.cross(at.omega, c))
    force_needed = mass * (p_dd_M - gravity)  # N
    omega_0, alpha_0 = at.C.T @ at.omega, at.C.T @ at.alpha
    moment_needed = at.C @ (I_0 @ alpha_0 + ca.cross(omega_0, I_0 @ omega_0)) + ca.cross(c, force_needed)  # N·m
    total, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    rolling, fixed = iter(arms), iter(fixed_arms)
    for f, rolls in zip(forces, is_rolling, strict=True):
        total += force * f
        moment += ca.cross(length * next(rolling) if rolls else at.C @ next(fixed), force * f)
    for M, gamma in zip(moments, gammas, strict=True):
        moment += force * gamma * M
    g = ca.vertcat(total - force_needed, (moment - moment_needed) / lever) / force
    name = "object_" + "".join("r" if rolls else "s" for rolls in is_rolling) + f"_{len(moments)}"
    return make_equations(name, ca.vertcat(y_r, v, a, *forces, *arms, *moments), parameters.all, g)


@lru_cache(maxsize=1)
def acceleration_equations() -> Equations:
    """Return the squares of the object's accelerations relative to their limits, (‖p̈‖/limit)² and (‖α‖/limit)².

    Variables: y_r, v, a (3 + 6 + 6). Parameters: scales, the limits in m/s² and rad/s².
    """
    y_r, v, a = ca.SX.sym("y", 3), ca.SX.sym("v", 6), ca.SX.sym("a", 6)
    parameters = _Parameters()
    length, turn, time, _, _ = (parameters.take() for _ in range(5))
    linear, angular = parameters.take(), parameters.take()
    at = _ObjectMotion.from_variables((ca.vertcat(ca.SX.zeros(3), y_r), v, a), ca.SX.zeros(3), (length, turn, time))
    g = ca.vertcat(ca.sumsqr(at.p_dd) / linear**2, ca.sumsqr(at.alpha) / angular**2)
    return make_equations("accelerations", ca.vertcat(y_r, v, a), parameters.all, g)


def choose_independent_joints(J: Array, count: int) -> tuple[int, ...]:
    """Return the joints of a finger to take as independent, such that the others move the tip best.

    "Best" is the largest smallest singular value of the others' Jacobian.

    Args:
        J: (3, m) linear Jacobian of the tip.
        count: number of independent joints.
    """

    def smallest_singular_value(independent: tuple[int, ...]) -> float:
        others = [i for i in range(J.shape[1]) if i not in independent]
        return float(np.linalg.svd(J[:, others], compute_uv=False)[-1])

    return max(combinations(range(J.shape[1]), count), key=smallest_singular_value)


def _identifier(name: str) -> str:
    """Return a name as a C identifier."""
    return "".join(letter if letter.isalnum() and letter.isascii() else "_" for letter in name)

"""Rows of the cone program of the fastest motion along a path.

Variables are x = (b, a, λ knot by knot, c, d), each divided by its scale. The scale of b at a knot is a common one times a
profile over s, which is the shape of b for constant acceleration and braking.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from graspforce.contact.contact import ContactSet
from graspforce.core.arrays import Array
from graspforce.force.backends.clarabel import ConeSizes
from graspforce.planning.interpolation import Indices
from graspforce.planning.path.dynamics import PathAccelerations, PathDynamics
from graspforce.planning.path.force_map import ForceMap

Discretisation = Literal["trapezoid", "left"]
RowKind = Literal["equal", "least", "cone"]
_MIDPOINT_RISE = 0.25  # of Δ (aᵢ − aᵢ₊₁): b halfway between two knots over the mean of theirs


@dataclass(frozen=True, eq=False, slots=True)
class LimitMargins:
    """Margins to keep from each limit at each knot, so that the motion between the knots stays inside too.

    Args:
        slip: (K, N) margin of friction, N.
        normal: (K, N) margin of both normal force limits, N.
        torque: (K, n) margin of both torque limits, N·m.
        speed: (K,) margin of b_max, relative to it.
        acceleration: (K,) margin of all limits of accelerations, relative to them.
    """

    slip: Array
    normal: Array
    torque: Array
    speed: Array
    acceleration: Array

    @classmethod
    def slip_only(cls, dynamics: PathDynamics, slip_margin: float = 0.0) -> LimitMargins:
        """Return margins of friction only.

        Args:
            dynamics: equations of motion at K knots.
            slip_margin: margin at every contact, N.
        """
        (K, n), N = dynamics.tau_0.shape, 0 if dynamics.contacts is None else len(dynamics.contacts)
        return cls(np.full((K, N), slip_margin), np.zeros((K, N)), np.zeros((K, n)), np.zeros(K), np.zeros(K))


def speed_profile(s: Array) -> Array:
    """Return b (K,) of constant acceleration to the middle and constant braking, of order one; zero at both ends.

    Args:
        s: (K,) path parameters.
    """
    profile = 4.0 * s * (1.0 - s)
    profile[[0, -1]] = 0.0
    return np.asarray(profile)


class ProgramRows:
    """Rows of the program under construction: right − A x in a cone.

    Args:
        s: (K,) path parameters.
        d: number of λ of a knot.
        b_scale: scale of b and a, 1/s².
        force_scale: scale of forces, N.
        rests: whether b is zero at both ends; a path that is eased there has another b.
    """

    def __init__(self, s: Array, d: int, b_scale: float, force_scale: float, rests: bool = True) -> None:
        K = len(s)
        self.K, self.b_scale, self.force_scale = K, b_scale, force_scale
        self.rests, self.profile = rests, speed_profile(s) if rests else np.ones(K)
        self.timed = np.arange(1, K - 1) if rests else np.arange(K)  # knots with a c
        self.b_scales = b_scale * np.where(self.profile > 0.0, self.profile, 1.0)  # of each knot, 1/s²
        self.lam = 2 * K + d * np.arange(K)[:, None] + np.arange(d)  # places of each knot's λ
        self.c = 2 * K + K * d
        self.d = self.c + len(self.timed)
        self.size = self.d + K - 1
        self._parts: dict[RowKind, list[tuple[sparse.coo_matrix, Array]]] = {"equal": [], "least": [], "cone": []}

    def add(self, kind: RowKind, rows: Indices, columns: Indices, values: Array, right: Array) -> None:
        """Add rows by their entries.

        Args:
            kind: "equal" for zero, "least" for nonnegative, "cone" for second-order cones.
            rows: row of each entry, from 0.
            columns: column of each entry.
            values: the entries.
            right: right-hand sides.
        """
        entries = (np.ravel(values), (np.ravel(rows), np.ravel(columns)))
        self._parts[kind].append((sparse.coo_matrix(entries, shape=(len(right), self.size)), right))

    def add_at_knots(self, kind: RowKind, constant: Array, per_b: Array, per_a: Array, per_lam: Array | None) -> None:
        """Add r rows at each knot: constant + per_b b + per_a a + per_lam λ in the cone.

        Args:
            kind: as `add`.
            constant: (K, r).
            per_b: (K, r).
            per_a: (K, r).
            per_lam: (K, r, d), or None.
        """
        K, r = constant.shape
        row = np.arange(K * r).reshape(K, r)
        knot = np.broadcast_to(np.arange(K)[:, None], (K, r))
        rows, columns, values = [row, row], [knot, knot + K], [-self.b_scales[:, None] * per_b, -self.b_scale * per_a]
        if per_lam is not None and per_lam.size:
            shape = per_lam.shape
            rows.append(np.broadcast_to(row[:, :, None], shape))
            columns.append(np.broadcast_to(self.lam[:, None], shape))
            values.append(-self.force_scale * per_lam)
        flat = [np.concatenate([np.ravel(each) for each in part]) for part in (rows, columns, values)]
        nonzero = flat[2] != 0.0
        self.add(kind, flat[0][nonzero], flat[1][nonzero], flat[2][nonzero], constant.ravel())

    def add_forces(self, kind: RowKind, select: Array, forces: ForceMap, constant: Array) -> None:
        """Add rows at each knot: select f + constant in the cone.

        Args:
            kind: as `add`.
            select: (r, k).
            forces: the forces f.
            constant: (K, r).
        """
        if len(select):
            f_0, f_b, f_a = (f @ select.T for f in (forces.f_0, forces.f_b, forces.f_a))
            self.add_at_knots(kind, constant + f_0, f_b, f_a, select @ forces.null)

    def stacked(self, force_cones: tuple[int, ...]) -> tuple[sparse.csc_matrix, Array, ConeSizes]:
        """Return A, the right-hand sides and the cones, in Clarabel's order.

        Args:
            force_cones: sizes of the first cones, those of friction and jerk; the other cones have size 3.
        """
        parts = [part for kind in self._parts.values() for part in kind]
        A = sparse.vstack([matrix for matrix, _ in parts], format="csc")
        count = {kind: sum(len(right) for _, right in found) for kind, found in self._parts.items()}
        time_cones = (count["cone"] - sum(force_cones)) // 3
        cones = ConeSizes(count["equal"], count["least"], force_cones + (3,) * time_cones)
        return A, np.concatenate([right for _, right in parts]), cones


def add_motion(rows: ProgramRows, steps: Array, discretisation: Discretisation) -> None:
    """Add b = 0 at both ends of a path that rests there, and b' = 2a between the knots.

    Args:
        rows: the program.
        steps: (K − 1,) differences Δ of s.
        discretisation: "trapezoid" for a linear between knots, "left" for constant a.
    """
    K = rows.K
    i = np.arange(K - 1)
    if rows.rests:
        rows.add("equal", np.arange(2), np.array([0, K - 1]), np.ones(2), np.zeros(2))
    left, right = (steps, steps) if discretisation == "trapezoid" else (2.0 * steps, 0.0 * steps)
    columns = np.stack([i + 1, i, K + i, K + i + 1])
    b = rows.b_scales / rows.b_scale
    scale = np.maximum(b[1:], b[:-1])
    values = np.stack([b[1:], -b[:-1], -left, -right]) / scale
    rows.add("equal", np.tile(i, (4, 1)), columns, values, np.zeros(K - 1))


def add_speed_limits(rows: ProgramRows, dynamics: PathDynamics, margins: LimitMargins, steps: Array) -> None:
    """Add b ≤ b_max at the knots and halfway between them, where b is (bᵢ + bᵢ₊₁)/2 + Δ (aᵢ − aᵢ₊₁)/4.

    Args:
        rows: the program.
        dynamics: equations of motion at K knots.
        margins: margins of the limits.
        steps: (K − 1,) differences Δ of s.
    """
    K = rows.K
    knots = np.flatnonzero(np.isfinite(dynamics.b_max[1:-1])) + 1
    b_max = dynamics.b_max * (1.0 - margins.speed) / rows.b_scales
    rows.add("least", np.arange(len(knots)), knots, 1.0 / b_max[knots], np.ones(len(knots)))
    i = np.flatnonzero(np.isfinite(dynamics.b_max_between))
    margin = np.maximum(margins.speed[i], margins.speed[i + 1])
    b_max = dynamics.b_max_between[i] * (1.0 - margin) / rows.b_scale
    b, rise = rows.b_scales / rows.b_scale, _MIDPOINT_RISE * steps[i]
    values = np.stack([b[i] / 2.0, b[i + 1] / 2.0, rise, -rise]) / b_max
    rows.add("least", np.tile(np.arange(len(i)), (4, 1)), np.stack([i, i + 1, K + i, K + i + 1]), values, np.ones(len(i)))


def add_joint_accelerations(rows: ProgramRows, accelerations: PathAccelerations, margins: LimitMargins) -> None:
    """Add |q' a + q'' b| ≤ limit of each joint.

    Args:
        rows: the program.
        accelerations: shares of the limits.
        margins: margins of the limits.
    """
    per_b, per_a = accelerations.joints_b, accelerations.joints_a
    if per_a.shape[1]:
        most = np.broadcast_to(1.0 - margins.acceleration[:, None], per_a.shape)
        for sign in (1.0, -1.0):
            rows.add_at_knots("least", most, sign * per_b, sign * per_a, None)


def add_object_accelerations(rows: ProgramRows, accelerations: PathAccelerations, margins: LimitMargins) -> None:
    """Add ‖x_a a + x_b b‖ ≤ limit of the object's position and rotation as cones.

    Args:
        rows: the program.
        accelerations: shares of the limits.
        margins: margins of the limits.
    """
    K, count, _ = accelerations.object_a.shape
    if count:
        constant, per_b, per_a = np.zeros((3, K, count, 3))
        constant[:, :, 0] = 1.0 - margins.acceleration[:, None]
        per_b[:, :, 1:], per_a[:, :, 1:] = accelerations.object_b, accelerations.object_a
        size = (K, 3 * count)
        rows.add_at_knots("cone", constant.reshape(size), per_b.reshape(size), per_a.reshape(size), None)


def add_torques(rows: ProgramRows, dynamics: PathDynamics, margins: LimitMargins, forces: ForceMap) -> None:
    """Add both torque limits of every joint whose torque varies, relative to half its range.

    Args:
        rows: the program.
        dynamics: equations of motion at K knots.
        margins: margins of the limits.
        forces: the contact forces.
    """
    torques = [
        tau + np.einsum("ikn,ik->in", dynamics.J, f)
        for tau, f in ((dynamics.tau_0, forces.f_0), (dynamics.tau_b, forces.f_b), (dynamics.tau_a, forces.f_a))
    ]
    per_lam = dynamics.J.swapaxes(1, 2) @ forces.null
    variation = [np.abs(term).max(axis=0, initial=0.0) for term in (torques[1], torques[2], per_lam.max(axis=2, initial=0.0))]
    joints = np.flatnonzero(np.maximum.reduce(variation) > 0.0)
    half = ((dynamics.upper - dynamics.lower) / 2.0)[joints]  # N·m
    constant, per_b, per_a = (torque[:, joints] / half for torque in torques)
    per_lam = per_lam[:, joints] / half[:, None]
    margin = margins.torque[:, joints]
    rows.add_at_knots("least", (dynamics.upper[joints] - margin) / half - constant, -per_b, -per_a, -per_lam)
    rows.add_at_knots("least", constant - (dynamics.lower[joints] + margin) / half, per_b, per_a, per_lam)


def add_normal_forces(rows: ProgramRows, contacts: ContactSet, margins: LimitMargins, forces: ForceMap) -> None:
    """Add normal force limits, and |m_n| ≤ γ f_n at soft contacts without friction.

    Args:
        rows: the program.
        contacts: the N contacts.
        margins: margins of the limits.
        forces: the contact forces.
    """
    scale, normal = rows.force_scale, contacts.normal_rows
    lower = np.flatnonzero((contacts.min_normal > 0) | (contacts.mu == 0.0))
    upper = np.flatnonzero(np.isfinite(contacts.max_normal))
    for sign, chosen, limit in ((1.0, lower, contacts.min_normal), (-1.0, upper, contacts.max_normal)):
        select = np.zeros((len(chosen), contacts.size))
        select[np.arange(len(chosen)), normal[chosen]] = sign / scale
        rows.add_forces("least", select, forces, -(sign * limit[chosen] + margins.normal[:, chosen]) / scale)
    twisting = np.flatnonzero((contacts.mu == 0.0) & (contacts.gamma > 0.0))
    for sign in (1.0, -1.0):
        select = np.zeros((len(twisting), contacts.size))
        select[np.arange(len(twisting)), normal[twisting]] = 1.0 / scale
        select[np.arange(len(twisting)), normal[twisting] + 1] = sign / (contacts.gamma[twisting] * scale)
        rows.add_forces("least", select, forces, np.zeros((rows.K, len(twisting))))


def add_friction_cones(rows: ProgramRows, contacts: ContactSet, margins: LimitMargins, forces: ForceMap) -> tuple[int, ...]:
    """Add the friction cones, and return their sizes.

    Args:
        rows: the program.
        contacts: the N contacts.
        margins: margins of the limits.
        forces: the contact forces.
    """
    scale, normal = rows.force_scale, contacts.normal_rows
    blocks, slip_margins = [], []
    for i in np.flatnonzero(contacts.mu > 0.0):
        n, is_soft = normal[i], contacts.gamma[i] > 0.0
        block = np.zeros((4 if is_soft else 3, contacts.size))
        block[[0, 1, 2], [n, n - 2, n - 1]] = np.array([contacts.mu[i], 1.0, 1.0]) / scale
        if is_soft:
            block[3, n + 1] = contacts.mu[i] / (contacts.gamma[i] * scale)
        blocks.append(block)
        slip_margins.append(np.column_stack([margins.slip[:, i] / scale, np.zeros((rows.K, len(block) - 1))]))
    if blocks:
        rows.add_forces("cone", np.vstack(blocks), forces, -np.hstack(slip_margins))
    return tuple(len(block) for block in blocks) * rows.K


def add_time(rows: ProgramRows) -> None:
    """Add cᵢ² ≤ bᵢ as ‖(2c, b − 1)‖ ≤ b + 1, and (cᵢ + cᵢ₊₁) dᵢ ≥ 1 as ‖(2, c + c⁺ − d)‖ ≤ c + c⁺ + d, scaled.

    At rest b and c are zero. Ends at rest have no c, since their cones would have no interior.

    Args:
        rows: the program.
    """
    K, size = rows.K, np.sqrt(rows.profile)
    timed = rows.timed
    i, one = np.arange(len(timed)), np.ones(len(timed))
    rows.add(
        "cone",
        np.concatenate([3 * i, 3 * i + 1, 3 * i + 2]),
        np.concatenate([timed, rows.c + i, timed]),
        np.concatenate([-one, -2.0 * one, -one]),
        np.tile([1.0, 0.0, -1.0], len(timed)),
    )
    scale = size[:-1] + size[1:]  # of c + c⁺, and the inverse of that of d
    j = np.arange(K - 1)
    first, every = int(timed[0]), np.ones(K - 1)
    left, right = j[first:], j[: K - 1 - first]  # intervals with a c on that side
    before, after = size[:-1][left] / scale[left], size[1:][right] / scale[right]
    rows.add(
        "cone",
        np.concatenate([3 * left, 3 * right, 3 * j, 3 * left + 2, 3 * right + 2, 3 * j + 2]),
        np.concatenate([rows.c + left - first, rows.c + right + 1 - first, rows.d + j] * 2),
        np.concatenate([-before, -after, -every, -before, -after, every]),
        np.tile([0.0, 2.0, 0.0], K - 1),
    )

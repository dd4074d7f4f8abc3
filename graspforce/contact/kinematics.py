"""Contacts that roll: where round fingertips touch the object now, how contacts move, and what keeps them from slipping.

A ball of radius r about a fingertip's origin c touches the object at the point x of its surface that is nearest to c; the
inward normal n there points from c to x. Finger and object have the same velocity at x,

    ċ + ω_F × (x − c) = ṗ + ω_O × (x − p),

p the object's origin, and stay so when the time derivatives agree too, x moving as the contact does, ẋ = ṗ + ω_O × (x − p) + u:

    c̈ + ω̇_F × (x − c) + ω_F × (ẋ − ċ) = p̈ + ω̇_O × (x − p) + ω_O × (ẋ − ṗ).

u is the contact's velocity over the object, by Montana's first equation (The Kinematics of Contact and Grasp, 1988):
u = (1 + r S)⁻¹ ċ_rel across n, S the surface's shape operator and ċ_rel the velocity of c as the object sees it. (1 + r S)⁻¹ is
the derivative of the nearest point, so u is taken as the rate of the nearest point itself: one law for every shape, edges
included.

A tip without a radius touches with its origin, always at the same place of the object.

The finger's spin over the object, n·(ω_F − ω_O), stays when n·(ω̇_F − ω̇_O) + ṅ·(ω_F − ω_O) = 0. The normal leads from c to x,
so it turns as the two part: ṅ is what (ẋ − ċ)/|x − c| has across n. Where a tip has no radius, n turns with the object.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from graspforce.contact.contact import ContactModel, ContactSet
from graspforce.contact.motion import BodyMotion, TipMotion
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.compiled import native
from graspforce.geometry import Shape
from graspforce.geometry.vectors import skew

_MIN_DISTANCE = 1e-9  # m: a middle nearer to the surface than this gives no normal
_MIN_TURN = 1e-9  # rad: n nearer to the last t₁ than this leaves nothing of it
_DIFFERENCE_STEP = (
    1e-4  # s: the nearest point's rate is a central difference over ± this, 10 µm at 0.1 m/s; its error is of second order
)


@dataclass(frozen=True, eq=False, slots=True)
class TipContactState:
    """Where N fingertips stood on the object at one instant, for the next to see how far they slid.

    Attributes:
        p_OF, R_OF: (N, 3) in m and (N, 3, 3): their tip frames in O.
        p_OC: (N, 3) where they touched, in O, m.
    """

    p_OF: Array
    R_OF: Array
    p_OC: Array

    def to_dict(self) -> dict[str, Any]:
        """Return a plain record: tip positions `tips`, their axes `tip_frames`, and the contact `positions`, all in O."""
        return {"tips": self.p_OF.tolist(), "tip_frames": self.R_OF.tolist(), "positions": self.p_OC.tolist()}

    @classmethod
    def from_dict(cls, record: object, count: int, field: str = "tip_contacts") -> TipContactState:
        """Read the state from a plain record.

        Args:
            record: `tips` (N, 3) in m, `tip_frames` (N, 3, 3) and `positions` (N, 3) in m, all in O.
            count: number of contacts N.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["tips", "tip_frames", "positions"])
        return cls(
            arrays.check_array(values["tips"], f"{field}.tips", (count, 3)),
            arrays.check_rotations(values["tip_frames"], f"{field}.tip_frames", count),
            arrays.check_array(values["positions"], f"{field}.positions", (count, 3)),
        )


@dataclass(frozen=True, eq=False, slots=True)
class Spin:
    """How N fingers spin about the normals of their contacts.

    Attributes:
        A: (N, n) joint rates to the fingers' angular velocities about n.
        B: (N, 6) the object's twist, in O's axes, to its own about n.
        beta: (N,) what the angular accelerations lack: A q̈ = B a + beta keeps n·(ω_F − ω_O), rad/s²; a in O's axes.
    """

    A: Array
    B: Array
    beta: Array


@dataclass(frozen=True, eq=False, slots=True)
class RollingContacts:
    """N contacts at one instant.

    Attributes:
        p_OC: (N, 3) where they are, in O, m.
        R_OC: (N, 3, 3) their frames in O, t₁ turned no more about n than the normals' turning asks.
        J: (k, n) the contact Jacobian: tau = Jᵀ f.
        A: (3 N, n) joint rates to the velocities of the fingers' points at the contacts, in the contact frames, m/rad.
        B: (3 N, 6) the object's twist, in O's axes, to the velocities of its points there: the transpose of point contacts' G.
        beta: (3 N,) what the points' accelerations lack: A q̈ = B a + beta keeps the contacts, m/s²; a in O's axes.
        velocity: (N, 3) of the fingers' points at the contacts, in the contact frames, m/s.
        gap: (N,) how far the fingertips are off the surface, m; negative where they press into it.
        touched: where the fingertips stand on the object.
        spin: the fingers' spin; None where all are point contacts.
    """

    p_OC: Array
    R_OC: Array
    J: Array
    A: Array
    B: Array
    beta: Array
    velocity: Array
    gap: Array
    tip_contacts: TipContactState
    spin: Spin | None = None


def rolling_contacts(
    tips: TipMotion, radii: Array, motion: BodyMotion, shape: Shape | None, contacts: ContactSet, R_before: Array
) -> RollingContacts:
    """The contacts of fingertips that touch an object.

    Args:
        tips: the fingertips, in the contacts' order.
        radii: (N,) of their balls, m; zero for a tip that touches with its origin.
        motion: the object's pose and twist.
        shape: its surface; None where nobody knows it: flat about each contact.
        contacts: where the hold began, in O, and what the contacts can bear.
        R_before: (N, 3, 3) the contact frames at the last step, in O, which the tangents follow.
    """
    form = primitive_parameters(shape)
    if native is None or form is None:
        return rolling_contacts_reference(tips, radii, motion, shape, contacts, R_before)
    count, n = len(radii), tips.rates.shape[2] - 2
    answer = np.empty((), _cached_block_dtype(count, n))
    rates = np.ascontiguousarray(tips.rates)
    now, held = (motion.p_HO, motion.R_HO, motion.twist), (contacts.p_OC, contacts.R_OC)
    native.roll(form, tips.p_HF, tips.R_HF, rates, radii, *now, *held, R_before, answer)
    return contacts_from_block(answer, contacts)


def rolling_contacts_reference(
    tips: TipMotion, radii: Array, motion: BodyMotion, shape: Shape | None, contacts: ContactSet, R_before: Array
) -> RollingContacts:
    """`rolling_contacts` for every shape, as the equations stand; takes six times as long as the compiled ones."""
    count, n = len(radii), tips.rates.shape[2] - 2
    R_HO, twist = motion.R_HO, motion.twist
    omega = twist[3:] @ R_HO  # rad/s, in O, as is all from here on
    turning = skew(-omega)  # 1/s: y @ turning = ω_O × y

    seen = np.empty((count, 9))  # c − p, ċ − ṗ and ω_F − ω_O of each tip
    np.subtract(tips.p_HF, motion.p_HO, out=seen[:, :3])
    np.subtract(tips.twist, twist, out=seen[:, 3:])
    c, c_rate, spin = (seen.reshape(-1, 3) @ R_HO).reshape(count, 3, 3).transpose(1, 0, 2)
    x, R_OC, surface_velocity, gap = _find_contacts(c, c_rate - c @ turning, radii, shape, contacts, R_before)
    x_rate = x @ turning + surface_velocity  # ẋ − ṗ, m/s

    arms = np.empty((3, count, 3))
    arms[0], arms[1], arms[2] = x - c, x, x_rate - c_rate  # the last: ẋ − ċ
    across = skew(-arms)  # R_CO @ across: e·(ω × y) = (y × e)·ω, for each axis e of C
    R_CO = R_OC.transpose(0, 2, 1)
    taking = np.empty((2, count, 3, 2, 3))  # twists at c, and at p, to velocities at x along the axes of C
    taking[:, :, :, 0], taking[:, :, :, 1] = R_CO, R_CO @ across[:2]
    B = taking[1].reshape(-1, 6)
    at_contact = (taking[0].reshape(-1, 3) @ R_HO.T).reshape(count, 3, 6) @ tips.rates  # A, velocity, and what drifts
    bent = x_rate @ turning - (across[2] @ (spin + omega)[:, :, None])[:, :, 0]  # ω_O × (ẋ − ṗ) − ω_F × (ẋ − ċ), m/s²
    beta = ((R_CO @ bent[:, :, None])[:, :, 0] - at_contact[:, :, n + 1]).ravel()

    J = A = at_contact[:, :, :n].reshape(-1, n)
    spin_rows = None
    if contacts.models != count * (ContactModel.POINT,):
        n_O = R_CO[:, 2]
        turned = ((n_O @ R_HO.T)[:, None] @ tips.rates[:, 3:])[:, 0]  # of the fingers' angular rates, about n
        n_rate = np.where(radii[:, None] > 0.0, _normal_rates(arms[2], n_O, gap + radii), n_O @ turning)  # 1/s
        spin_rows = Spin(turned[:, :n], np.hstack([np.zeros((count, 3)), n_O]), -turned[:, n + 1] - _dot(n_rate, spin)[:, 0])
        J = _contact_jacobian(A, spin_rows, contacts)
    tip_contacts = TipContactState(c, R_HO.T @ tips.R_HF, x)
    for part in (c, tip_contacts.R_OF, x, R_OC):
        part.setflags(write=False)  # the next step goes on from them
    return RollingContacts(x, R_OC, J, A, B, beta, at_contact[:, :, n], gap, tip_contacts, spin_rows)


def primitive_parameters(shape: Shape | None) -> tuple[int, float, float, float] | None:
    """The shape as the compiled law knows it; None where that does not."""
    return _FLAT if shape is None else shape.primitive_parameters


def field_shapes(count: int, n: int) -> dict[str, tuple[int, ...]]:
    """What the compiled law writes one after the other of N contacts of a hand with n joints: names and shapes."""
    shapes: dict[str, tuple[int, ...]] = {
        "p_OC": (count, 3),
        "R_OC": (count, 3, 3),
        "A": (3 * count, n),
        "B": (3 * count, 6),
        "beta": (3 * count,),
    }
    shapes |= {"velocity": (count, 3), "gap": (count,), "p_OF": (count, 3), "R_OF": (count, 3, 3)}
    shapes |= {"spin_A": (count, n), "spin_B": (count, 6), "spin_beta": (count,)}
    return shapes


def block_dtype(field_shapes: dict[str, tuple[int, ...]]) -> np.dtype[Any]:
    """The type of a block of float64 in which the parts lie one after the other."""
    return np.dtype([(name, np.float64, shape) for name, shape in field_shapes.items()])


@cache
def _cached_block_dtype(count: int, n: int) -> np.dtype[Any]:
    return block_dtype(field_shapes(count, n))


def contacts_from_block(block: Any, contacts: ContactSet, J: Array | None = None) -> RollingContacts:
    """The record of what the compiled law wrote; J where it is known already."""
    block.setflags(write=False)
    p_OC, A, spin_rows = block["p_OC"], block["A"], None
    if contacts.models != len(contacts) * (ContactModel.POINT,):
        spin_rows = Spin(block["spin_A"], block["spin_B"], block["spin_beta"])
    if J is None:
        J = A if spin_rows is None else _contact_jacobian(A, spin_rows, contacts)
    tip_contacts, moving = TipContactState(block["p_OF"], block["R_OF"], p_OC), (block["beta"], block["velocity"], block["gap"])
    return RollingContacts(p_OC, block["R_OC"], J, A, block["B"], *moving, tip_contacts, spin_rows)


def _contact_jacobian(A: Array, spin_rows: Spin, contacts: ContactSet) -> Array:
    """(k, n) the contact Jacobian where some contacts bear moments about their normals."""
    count, n = spin_rows.A.shape
    padded = np.empty((count, 4, n))
    padded[:, :3], padded[:, 3] = A.reshape(count, 3, n), spin_rows.A
    return np.asarray(padded.reshape(-1, n)[contacts.columns])


def slip_velocity(rolling: RollingContacts, motion: BodyMotion) -> Array:
    """(N, 2) how fast fingertips slide over the object, along t₁ and t₂, m/s."""
    twist_O = (motion.twist.reshape(2, 3) @ motion.R_HO).ravel()
    return np.asarray((rolling.velocity - (rolling.B @ twist_O).reshape(-1, 3))[:, :2])


def slip_displacement(before: TipContactState, now: TipContactState, R_OC: Array) -> Array:
    """(N, 2) how far fingertips slid over the object between two instants, along t₁ and t₂ of R_OC, m.

    The point of the finger that touched then has gone away from the point of the object that it touched. Rolling moves the two
    apart along the normal alone, to second order in the step; and errors of single positions do not add up over many steps.
    """
    if native is not None:
        answer = np.empty((len(R_OC), 2))  # m
        native.slip_displacement(before.p_OF, before.R_OF, before.p_OC, now.p_OF, now.R_OF, R_OC, answer)
        return answer
    lever = (before.p_OC - before.p_OF)[:, :, None]
    apart = now.p_OF - before.p_OC + (now.R_OF @ (before.R_OF.transpose(0, 2, 1) @ lever))[:, :, 0]  # m, in O
    return np.asarray((apart[:, None, :] @ R_OC[:, :, :2])[:, 0])


def _find_contacts(
    c: Array, c_rate: Array, radii: Array, shape: Shape | None, contacts: ContactSet, R_before: Array
) -> tuple[Array, Array, Array, Array]:
    """Points and frames, the points' velocity over the object, and gaps, for tips at c that move at c_rate, all in O."""
    sizes = radii.tolist()
    if not any(sizes):
        return contacts.p_OC, contacts.R_OC, np.zeros(c.shape), _tangent_plane_gaps(contacts, c)
    count = len(c)
    if shape is None:
        n = contacts.R_OC[:, :, 2]
        x, surface_velocity = c + _dot(contacts.p_OC - c, n) * n, c_rate - _dot(c_rate, n) * n
    else:
        step, near = _DIFFERENCE_STEP * c_rate, np.empty((3, count, 3))  # m
        near[0], near[1], near[2] = c, c + step, c - step
        closest_points = shape.closest_points(near.reshape(-1, 3))
        x, surface_velocity = (
            closest_points[:count],
            (closest_points[count : 2 * count] - closest_points[2 * count :]) * (0.5 / _DIFFERENCE_STEP),
        )
    placed = map(_contact_frame, (x - c).tolist(), R_before.tolist())
    frames = np.array([number for each in placed for number in each]).reshape(count, 10)
    R_OC, gap = frames[:, :9].reshape(count, 3, 3), frames[:, 9] - radii
    if not all(sizes):
        bare = [size == 0.0 for size in sizes]
        x, surface_velocity = np.array(x), np.array(surface_velocity)
        x[bare], R_OC[bare], surface_velocity[bare] = contacts.p_OC[bare], contacts.R_OC[bare], 0.0
        gap[bare] = _tangent_plane_gaps(contacts, c)[bare]
    return x, R_OC, surface_velocity, gap


def _contact_frame(inward: list[float], before: list[list[float]]) -> tuple[float, ...]:
    """A contact's frame by rows, and how far, in m, the surface is from a ball's middle that sees it at ``inward``.

    In plain numbers, as NumPy takes twice as long for so few.

    n leads from the middle to the surface, or away from it where the middle is inside, which the last n tells apart.
    t₂ = n × t₁' is carried on from the last t₁'; where n has turned into t₁' itself, as over an edge, the last t₂ stays.
    """
    (ax, kx, bx), (ay, ky, by), (az, kz, bz) = before
    x, y, z = inward
    away = math.copysign(math.hypot(x, y, z), x * bx + y * by + z * bz)  # m
    nx, ny, nz = (x / away, y / away, z / away) if abs(away) > _MIN_DISTANCE else (bx, by, bz)
    ux, uy, uz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    size = math.hypot(ux, uy, uz)
    if size > _MIN_TURN:
        ux, uy, uz = ux / size, uy / size, uz / size
    else:
        ux, uy, uz = kx, ky, kz
    return (uy * nz - uz * ny, ux, nx, uz * nx - ux * nz, uy, ny, ux * ny - uy * nx, uz, nz, away)


def _normal_rates(apart: Array, n: Array, away: Array) -> Array:
    """(N, 3) ṅ of normals that lead from balls' middles to the surface, ``away`` m off; the two part at ``apart``, m/s."""
    far = np.abs(away) > _MIN_DISTANCE
    return np.divide(apart - _dot(apart, n) * n, away[:, None], out=np.zeros(n.shape), where=far[:, None])


def _tangent_plane_gaps(contacts: ContactSet, c: Array) -> Array:
    """(N,) how far points are off the contacts where a hold began, against their normals, m."""
    return np.asarray(_dot(contacts.p_OC - c, contacts.R_OC[:, :, 2])[:, 0])


def _dot(a: Array, b: Array) -> Array:
    """(N, 1) inner products of (N, 3) vectors."""
    return np.asarray((a * b) @ _ONES)


_FLAT = (0, 0.0, 0.0, 0.0)  # as Shape.closed_form, of a body whose shape nobody knows
_ONES = np.ones((3, 1))

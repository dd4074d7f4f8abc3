"""Rolling contact: the reference law of where fingertips touch the object, and how the contacts move.

A spherical fingertip with radius r and centre c touches the object at x, the closest point of its surface to c. The inward
normal n points from c to x. Without slip, finger and object have the same velocity at x,

    ċ + ω_F × (x − c) = ṗ + ω_O × (x − p),

where p is the object's origin. The contact keeps rolling if the time derivatives agree too, with the contact point moving at
ẋ = ṗ + ω_O × (x − p) + u:

    c̈ + ω̇_F × (x − c) + ω_F × (ẋ − ċ) = p̈ + ω̇_O × (x − p) + ω_O × (ẋ − ṗ).

u is the velocity of the contact point over the object's surface (Montana, 1988): u = (1 + r S)⁻¹ ċ_rel in the tangent plane,
with the shape operator S and the velocity ċ_rel of c relative to the object. (1 + r S)⁻¹ is the derivative of the closest
point. So u is computed as the rate of the closest point, which holds for every shape, edges included.

A fingertip without a radius touches with its origin, always at the same point of the object.

The spin of the finger over the object, n·(ω_F − ω_O), stays constant if n·(ω̇_F − ω̇_O) + ṅ·(ω_F − ω_O) = 0. The normal points
from c to x, so ṅ is the tangential part of (ẋ − ċ)/|x − c|. At a fingertip without a radius, n turns with the object.

`rolling_contacts_reference` is the reference of this law. Its other forms, and the tests that compare them with it:

- C, `csrc/control/contact_kinematics.c`, called by `contact.compiled_kinematics`: tests/contact/test_compiled_kinematics.py
- NumPy for many postures, without accelerations, `planning.tip_contacts`: tests/planning/test_reference_laws.py
- CasADi, `planning.free.object_equations`: tests/planning/test_reference_laws.py
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from graspforce.contact.contact import ContactModel, ContactSet
from graspforce.contact.motion import BodyMotion, TipMotion
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord
from graspforce.geometry import Shape
from graspforce.geometry.vectors import skew

_MIN_DISTANCE = 1e-9  # m; a centre closer to the surface gives no normal
_MIN_TURN = 1e-9  # rad; if n is closer to the previous t₁, the tangent plane contains no part of it
_DIFFERENCE_STEP = 1e-4  # s; the closest point's rate is a central difference over ± this, 10 µm at 0.1 m/s

_ONES = np.ones((3, 1))


@dataclass(frozen=True, eq=False, slots=True)
class TipContactState:
    """Poses of N fingertips and their contact points in O at one instant; the state from which slip is measured.

    Attributes:
        p_OF: (N, 3) origins of the tip frames in O, m.
        R_OF: (N, 3, 3) axes of the tip frames in O, columns.
        p_OC: (N, 3) contact points in O, m.
    """

    p_OF: Array
    R_OF: Array
    p_OC: Array

    def to_dict(self) -> JsonRecord:
        """Return a plain record: tip positions `tips`, their axes `tip_frames`, and the contact `positions`, all in O."""
        return {"tips": self.p_OF.tolist(), "tip_frames": self.R_OF.tolist(), "positions": self.p_OC.tolist()}

    @classmethod
    def from_dict(cls, record: object, count: int, field: str = "tip_contacts") -> TipContactState:
        """Read the state from a plain record.

        Args:
            record: `tips` (N, 3) in m, `tip_frames` (N, 3, 3) and `positions` (N, 3) in m, all in O.
            count: number of contacts N.
            field: path of the record, for error messages.

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
    """Spin of N fingers about the contact normals: A q̈ = B a + beta keeps n·(ω_F − ω_O) constant, with a in O.

    Attributes:
        A: (N, n) joint rates to the fingers' angular velocities about n.
        B: (N, 6) the object's twist in O to its angular velocity about n.
        beta: (N,) convective terms, rad/s².
    """

    A: Array
    B: Array
    beta: Array


@dataclass(frozen=True, eq=False, slots=True)
class RollingContacts:
    """N contacts at one instant: A q̈ = B a + beta keeps them rolling, with the object's acceleration a in O.

    Attributes:
        p_OC: (N, 3) contact points in O, m.
        R_OC: (N, 3, 3) contact frames in O. The tangents follow the normal without turning about it.
        J: (k, n) contact Jacobian: tau = Jᵀ f.
        A: (3 N, n) joint rates to the velocities of the fingers' material points at the contacts, in C, m/rad.
        B: (3 N, 6) the object's twist in O to the velocities of its material points there, in C; Gᵀ of point contacts.
        beta: (3 N,) convective terms, m/s².
        velocity: (N, 3) velocities of the fingers' material points at the contacts, in C, m/s.
        gap: (N,) distances of the fingertips from the surface, m; negative in penetration.
        tip_contacts: the fingertips' poses and contact points in O.
        spin: the fingers' spin; None if all contacts are point contacts.
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


def rolling_contacts_reference(
    tips: TipMotion, radii: Array, motion: BodyMotion, shape: Shape | None, contacts: ContactSet, R_before: Array
) -> RollingContacts:
    """Return the contacts of fingertips with an object of any shape.

    Args:
        tips: the fingertips, in the order of the contacts.
        radii: (N,) fingertip radii, m; zero for a tip that touches with its origin.
        motion: pose and twist of the object.
        shape: the object's surface; None for a plane through each contact.
        contacts: contact positions and frames at the start of the grasp, in O, and the contact models.
        R_before: (N, 3, 3) contact frames in O at the previous step, which the tangents follow.
    """
    count, n = len(radii), tips.rates.shape[2] - 2
    R_HO, twist = motion.R_HO, motion.twist
    omega = twist[3:] @ R_HO  # rad/s; in O, as all vectors below
    turning = skew(-omega)  # 1/s: y @ turning = ω_O × y

    relative = np.empty((count, 9))  # c − p, ċ − ṗ and ω_F − ω_O
    np.subtract(tips.p_HF, motion.p_HO, out=relative[:, :3])
    np.subtract(tips.twist, twist, out=relative[:, 3:])
    c, c_rate, spin = (relative.reshape(-1, 3) @ R_HO).reshape(count, 3, 3).transpose(1, 0, 2)
    x, R_OC, surface_velocity, gap = _find_contacts(c, c_rate - c @ turning, radii, shape, contacts, R_before)
    x_rate = x @ turning + surface_velocity  # m/s: ẋ − ṗ

    arms = np.empty((3, count, 3))
    arms[0], arms[1], arms[2] = x - c, x, x_rate - c_rate  # the last: ẋ − ċ
    across = skew(-arms)  # R_CO @ across: e·(ω × y) = (y × e)·ω, for each axis e of C
    R_CO = R_OC.transpose(0, 2, 1)
    to_contact = np.empty((2, count, 3, 2, 3))  # twists at c, and at p, to velocities at x in C
    to_contact[:, :, :, 0], to_contact[:, :, :, 1] = R_CO, R_CO @ across[:2]
    B = to_contact[1].reshape(-1, 6)
    rates = (to_contact[0].reshape(-1, 3) @ R_HO.T).reshape(count, 3, 6) @ tips.rates  # A, velocity and drift
    convective = x_rate @ turning - (across[2] @ (spin + omega)[:, :, None])[:, :, 0]  # ω_O × (ẋ − ṗ) − ω_F × (ẋ − ċ), m/s²
    beta = ((R_CO @ convective[:, :, None])[:, :, 0] - rates[:, :, n + 1]).ravel()

    J = A = rates[:, :, :n].reshape(-1, n)
    spin_rows = None
    if contacts.models != count * (ContactModel.POINT,):
        n_O = R_CO[:, 2]
        about_n = ((n_O @ R_HO.T)[:, None] @ tips.rates[:, 3:])[:, 0]  # angular rates of the tips about n
        n_rate = np.where(radii[:, None] > 0.0, _normal_rates(arms[2], n_O, gap + radii), n_O @ turning)  # 1/s
        spin_beta = -about_n[:, n + 1] - _dot(n_rate, spin)[:, 0]
        spin_rows = Spin(about_n[:, :n], np.hstack([np.zeros((count, 3)), n_O]), spin_beta)
        J = stack_jacobian(A, spin_rows, contacts)
    tip_contacts = TipContactState(c, R_HO.T @ tips.R_HF, x)
    for array in (c, tip_contacts.R_OF, x, R_OC):
        array.setflags(write=False)  # the next step starts from them
    return RollingContacts(x, R_OC, J, A, B, beta, rates[:, :, n], gap, tip_contacts, spin_rows)


def stack_jacobian(A: Array, spin: Spin, contacts: ContactSet) -> Array:
    """Return the contact Jacobian J of contacts of which some transmit moments about their normals.

    Args:
        A: (3 N, n) the rows of the contact velocities.
        spin: the rows of the spin.
        contacts: the contact models.

    Returns:
        (k, n), in the rows of the stacked forces.
    """
    count, n = spin.A.shape
    padded = np.empty((count, 4, n))
    padded[:, :3], padded[:, 3] = A.reshape(count, 3, n), spin.A
    return np.asarray(padded.reshape(-1, n)[contacts.columns])


def slip_velocity(rolling: RollingContacts, motion: BodyMotion) -> Array:
    """Return the velocities at which fingertips slip over the object.

    Args:
        rolling: the contacts.
        motion: pose and twist of the object.

    Returns:
        (N, 2) along t₁ and t₂, m/s.
    """
    twist_O = (motion.twist.reshape(2, 3) @ motion.R_HO).ravel()
    return np.asarray((rolling.velocity - (rolling.B @ twist_O).reshape(-1, 3))[:, :2])


def slip_displacement_reference(before: TipContactState, now: TipContactState, R_OC: Array) -> Array:
    """Return how far fingertips slipped over the object between two instants.

    It is the tangential distance between the two material points, of finger and object, that were in contact before. Rolling
    separates them along the normal only, to second order in the step. Errors of positions do not accumulate over steps.

    Args:
        before: the state at the earlier instant.
        now: the state at the later instant.
        R_OC: (N, 3, 3) contact frames in O.

    Returns:
        (N, 2) along t₁ and t₂ of R_OC, m.
    """
    lever = (before.p_OC - before.p_OF)[:, :, None]
    apart = now.p_OF - before.p_OC + (now.R_OF @ (before.R_OF.transpose(0, 2, 1) @ lever))[:, :, 0]  # m, in O
    return np.asarray((apart[:, None, :] @ R_OC[:, :, :2])[:, 0])


def _find_contacts(
    c: Array, c_rate: Array, radii: Array, shape: Shape | None, contacts: ContactSet, R_before: Array
) -> tuple[Array, Array, Array, Array]:
    """Return contact points, frames, velocities over the surface and gaps, for tips at c that move at c_rate, in O."""
    sizes = radii.tolist()
    if not any(sizes):
        return contacts.p_OC, contacts.R_OC, np.zeros(c.shape), _tangent_plane_gaps(contacts, c)
    if shape is None:
        n = contacts.R_OC[:, :, 2]
        x, surface_velocity = c + _dot(contacts.p_OC - c, n) * n, c_rate - _dot(c_rate, n) * n
    else:
        step, near = _DIFFERENCE_STEP * c_rate, np.empty((3, len(c), 3))  # m
        near[0], near[1], near[2] = c, c + step, c - step
        x, forward, backward = shape.closest_points(near.reshape(-1, 3)).reshape(near.shape)
        surface_velocity = (forward - backward) * (0.5 / _DIFFERENCE_STEP)
    frames = np.array([_contact_frame(*pair) for pair in zip((x - c).tolist(), R_before.tolist(), strict=True)])
    R_OC, gap = frames[:, :9].reshape(-1, 3, 3), frames[:, 9] - radii
    if not all(sizes):
        bare = [size == 0.0 for size in sizes]
        x, surface_velocity = np.array(x), np.array(surface_velocity)
        x[bare], R_OC[bare], surface_velocity[bare] = contacts.p_OC[bare], contacts.R_OC[bare], 0.0
        gap[bare] = _tangent_plane_gaps(contacts, c)[bare]
    return x, R_OC, surface_velocity, gap


def _contact_frame(inward: list[float], before: list[list[float]]) -> tuple[float, ...]:
    """Return a contact frame, row by row, and the signed distance of the surface from the tip's centre along n, in m.

    n points from the centre to the surface, or the other way if the centre is inside the object; the previous n decides
    between the two. t₂ = n × t₁' with the previous t₁'. If n has turned into t₁' itself, as over an edge, t₂ stays.

    Scalar arithmetic: NumPy's overhead dominates for so few numbers.

    Args:
        inward: vector from the centre to the closest point, m.
        before: the previous frame, row by row.
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
    """Return ṅ (N, 3) of normals from centres to the surface, ``away`` m long, which separate at ``apart``, m/s."""
    far = np.abs(away) > _MIN_DISTANCE
    return np.divide(apart - _dot(apart, n) * n, away[:, None], out=np.zeros(n.shape), where=far[:, None])


def _tangent_plane_gaps(contacts: ContactSet, c: Array) -> Array:
    """Return the (N,) distances of points from the initial contacts, against their normals, m."""
    return np.asarray(_dot(contacts.p_OC - c, contacts.R_OC[:, :, 2])[:, 0])


def _dot(a: Array, b: Array) -> Array:
    """Return the (N, 1) inner products of (N, 3) vectors."""
    return np.asarray((a * b) @ _ONES)

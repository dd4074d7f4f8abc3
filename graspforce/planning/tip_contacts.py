"""Fingertip contacts in many postures at once, and the joint rates that keep them from slipping.

This is the batched form of the rolling law of `graspforce.contact.kinematics`, in velocities only. A round tip of radius r
with its centre at c touches the object at x, the closest point of the surface. Finger and object have the same velocity at x:

    ċ + ω_F × (x − c) = ṗ + ω_O × (x − p)

A soft contact also keeps n·ω_F = n·ω_O. A contact without friction keeps only the component along n. The centre of a tip
that does not roll keeps its place on the object. Source: Montana (1988).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import contact_jacobians
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.geometry.vectors import skew
from graspforce.planning.task import GraspTask, ObjectTask

_SPIN_LENGTH = 0.03  # m: weighs spin against sliding, the speed at this distance from n; about the radius of a small object
_DIFFERENCE_STEP = 1e-5  # m: step of the central difference of the closest point; its error is of second order
_MIN_DISTANCE = 1e-9  # m: at a smaller distance between centre and surface the normal is undefined


@dataclass(frozen=True, eq=False, slots=True)
class TipContacts:
    """N fingertips on the object in M postures.

    Args:
        p_OC: (M, N, 3) contact positions in O, m.
        R_OC: (M, N, 3, 3) contact frames in O.
        p_OF: (M, N, 3) origins of the tip frames in O, m.
        tip_jacobians: (M, N, 6, n) Jacobians of the tips at their origins, in H's axes, m/rad and 1.
        contact_twists: (M, N, 6, n) Jacobians of the tips at the contacts, likewise.
    """

    p_OC: Array
    R_OC: Array
    p_OF: Array
    tip_jacobians: Array
    contact_twists: Array


def locate_contacts(task: GraspTask, q: Array, p_HO: Array, R_HO: Array) -> TipContacts:
    """Return the contacts of the fingertips in M postures.

    Args:
        task: the task.
        q: (M, n) postures, rad.
        p_HO: (M, 3) positions of the object, m.
        R_HO: (M, 3, 3) its orientations.
    """
    p_HF, jacobians = task.hand.model.frame_jacobians(q, [task.hand.frame_id(name) for name in task.fingers])
    p_OF = (p_HF - p_HO[:, None]) @ R_HO
    p_OC = closest_points(task, p_OF)
    levers = p_HO[:, None] + p_OC @ R_HO.transpose(0, 2, 1) - p_HF
    return TipContacts(p_OC, contact_frames(task, p_OC, p_OF), p_OF, jacobians, _jacobians_at_offsets(jacobians, levers))


def closest_points(task: GraspTask, p_OF: Array) -> Array:
    """Return the contact positions (M, N, 3) in O, m.

    Args:
        task: the task.
        p_OF: (M, N, 3) origins of the tip frames in O, m.
    """
    contacts, rolling = task.contacts, task.is_rolling
    p_OC = np.tile(contacts.p_OC, (len(p_OF), 1, 1))
    if rolling.any():
        c = p_OF[:, rolling]
        if task.body.shape is None:  # a plane at each contact
            n = contacts.R_OC[rolling, :, 2]
            p_OC[:, rolling] = c + _dot(contacts.p_OC[rolling] - c, n) * n
        else:
            p_OC[:, rolling] = task.body.shape.closest_points(c.reshape(-1, 3)).reshape(c.shape)
    return p_OC


def closest_point_rates(task: GraspTask, p_OF: Array, rates: Array) -> Array:
    """Return the velocities (M, N, 3) of the contacts over the object, in O, m/s, by central differences.

    Args:
        task: the task.
        p_OF: (M, N, 3) origins of the tip frames in O, m.
        rates: (M, N, 3) their velocities in O, m/s.
    """
    step = _DIFFERENCE_STEP / max(float(np.abs(rates).max(initial=0.0)), 1e-300)  # s
    return np.asarray((closest_points(task, p_OF + step * rates) - closest_points(task, p_OF - step * rates)) / (2.0 * step))


def contact_frames(task: ObjectTask, p_OC: Array, p_OF: Array | None = None) -> Array:
    """Return the contact frames (M, N, 3, 3) in O: those of the start, rotated by the smallest rotation that aligns n.

    Args:
        task: the task.
        p_OC: (M, N, 3) contact positions in O, m.
        p_OF: (M, N, 3) origins of the tip frames in O, m; they give the normals. By default the surface gives them.

    Raises:
        InvalidInput: a contact on an edge, if ``p_OF`` is not given.
    """
    contacts, rolling, shape = task.contacts, task.is_rolling, task.body.shape
    R_OC = np.tile(contacts.R_OC, (len(p_OC), 1, 1, 1))
    if shape is None or not rolling.any():
        return R_OC
    first = contacts.R_OC[rolling]
    if p_OF is None:
        p = shape.closest_points(p_OC[:, rolling].reshape(-1, 3))  # between knots, positions are interpolated
        n = shape.inward_normal(p).reshape(len(p_OC), -1, 3)
    else:
        n = p_OC[:, rolling] - p_OF[:, rolling]
        distance = np.linalg.norm(n, axis=2, keepdims=True)  # m
        n = np.where(distance > _MIN_DISTANCE, n / np.maximum(distance, _MIN_DISTANCE), first[:, :, 2])
    axis = np.cross(first[:, :, 2], n)  # R = 1 + S + S²/(1 + cos θ), S y = axis × y
    S = skew(axis)
    one_plus_cos = 1.0 + _dot(first[:, :, 2], n)[..., None]
    R_OC[:, rolling] = (np.eye(3) + S + S @ S / np.maximum(one_plus_cos, _MIN_DISTANCE)) @ first
    return R_OC


def drift(task: GraspTask, tips: TipContacts) -> Array:
    """Return the contact errors (M, N), m.

    For a rolling tip this is the change of its centre's height over the surface since the start; for a fixed tip, the distance
    of its centre from its place on the object.

    Args:
        task: the task.
        tips: the contacts of the fingertips.
    """
    centres = task.tip_centres
    start_heights = np.linalg.norm(closest_points(task, centres[None])[0] - centres, axis=1)
    heights = np.linalg.norm(tips.p_OC - tips.p_OF, axis=2) - start_heights
    return np.asarray(np.where(task.is_rolling, np.abs(heights), np.linalg.norm(tips.p_OF - centres, axis=2)))


def edge_contact(task: ObjectTask, p_OC: Array) -> tuple[int, int, str] | None:
    """Return the first contact that has rolled onto an edge, where the surface has no normal.

    Args:
        task: the task.
        p_OC: (M, N, 3) contact positions in O, m.

    Returns:
        Its indices in M and N, and the name of the edge; None if there is none.
    """
    rolling = np.flatnonzero(task.is_rolling)
    if task.body.shape is None or not len(rolling):
        return None
    try:
        task.body.shape.inward_normal(p_OC[:, rolling].reshape(-1, 3))
    except InvalidInput as error:
        instant, i = divmod(int(error.field.removeprefix("p_O[").removesuffix("]")), len(rolling))
        return instant, int(rolling[i]), str(error.allowed).split("not ", 1)[-1]
    return None


def constraints(task: GraspTask, tips: TipContacts, R_HO: Array, p_d: Array, omega: Array) -> tuple[Array, Array]:
    """Return A (M, c, n) and b (M, c) of the rolling constraints A q̇ = b.

    Rows are components in the contact frames: three for each contact, or one for a rolling contact without friction. Rows of
    spin follow, as speeds at 30 mm from the normal.

    Args:
        task: the task.
        tips: the contacts of the fingertips.
        R_HO: (M, 3, 3) orientations of the object.
        p_d: (M, 3) derivatives of its position in H, with respect to time or any other parameter.
        omega: (M, 3) its angular velocities in O, with respect to the same parameter.
    """
    M, rolling = len(R_HO), task.is_rolling
    R_CO = tips.R_OC.swapaxes(-1, -2)
    R_CH = R_CO @ R_HO.transpose(0, 2, 1)[:, None]
    twists = np.where(rolling[:, None, None], tips.contact_twists, tips.tip_jacobians)
    points = np.where(rolling[:, None], tips.p_OC, tips.p_OF)
    speed = (p_d[:, None] @ R_HO) + np.cross(omega[:, None], points)  # of the object's points, in O
    A = (R_CH @ twists[:, :, :3]).reshape(M, -1, twists.shape[3])
    b = (R_CO @ speed[..., None]).reshape(M, -1)
    rows, spins = task.constrained
    A, b = A[:, rows], b[:, rows]
    if len(spins):
        A = np.concatenate([A, _SPIN_LENGTH * (R_CH[:, spins, 2:] @ twists[:, spins, 3:])[:, :, 0]], axis=1)
        b = np.concatenate([b, _SPIN_LENGTH * (R_CO[:, spins, 2] @ omega[:, :, None])[:, :, 0]], axis=1)
    return A, b


def contact_jacobians_at(task: GraspTask, q: Array, p_HO: Array, R_HO: Array, p_OC: Array, R_OC: Array) -> Array:
    """Return the contact Jacobians J (M, k, n) at given contact positions, whether or not the tips touch there.

    Args:
        task: the task.
        q: (M, n) postures, rad.
        p_HO: (M, 3) positions of the object, m.
        R_HO: (M, 3, 3) its orientations.
        p_OC: (M, N, 3) contact positions in O, m.
        R_OC: (M, N, 3, 3) contact frames in O.
    """
    p_HC = p_HO[:, None] + p_OC @ R_HO.transpose(0, 2, 1)
    twists = task.hand.model.point_jacobians(q, [task.hand.frame_id(name) for name in task.fingers], p_HC)
    return contact_jacobians(task.contacts, twists, R_HO, R_OC)


def contacts_at(contacts: ContactSet, p_OC: Array, R_OC: Array) -> ContactSet:
    """Return the contacts moved to other places on the object.

    Args:
        contacts: the contacts.
        p_OC: (N, 3) new positions in O, m.
        R_OC: (N, 3, 3) new contact frames in O.
    """
    return replace(contacts, p_OC=freeze(p_OC), R_OC=freeze(R_OC))


def _jacobians_at_offsets(jacobians: Array, levers: Array) -> Array:
    """Return the Jacobians (M, N, 6, n) at points offset by ``levers`` (M, N, 3) from the tips' origins: v + ω × lever."""
    x, y, z = np.moveaxis(levers, -1, 0)[..., None]
    omega, twists = jacobians[:, :, 3:], np.array(jacobians)
    twists[:, :, 0] += omega[:, :, 1] * z - omega[:, :, 2] * y
    twists[:, :, 1] += omega[:, :, 2] * x - omega[:, :, 0] * z
    twists[:, :, 2] += omega[:, :, 0] * y - omega[:, :, 1] * x
    return twists


def _dot(a: Array, b: Array) -> Array:
    """Return inner products over the last axis, which is kept with length 1."""
    return np.asarray((a * b).sum(axis=-1, keepdims=True))

"""Where fingertips touch the object in many postures at once, and the motion that keeps them from slipping.

A round tip of radius r about its frame's origin c touches the object at the point x of its surface that is nearest to c, and
rolls there: finger and object have the same velocity at x,

    ċ + ω_F × (x − c) = ṗ + ω_O × (x − p).

The place where they touch moves over both. A soft contact does not spin about the normal either, n·ω_F = n·ω_O; a contact
without friction keeps its distance only. A tip without a radius, and any tip of a task whose contacts do not roll, has its
origin c where it began on the object. Montana, The Kinematics of Contact and Grasp (1988).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from graspforce.contact.matrices import contact_jacobians
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.planning.task import Task

_SPIN_LENGTH = 0.03  # m: spin counts beside velocities as the speed that it makes this far from n, a small object's radius
_DIFFERENCE_STEP = (
    1e-5  # m: half the way over which the nearest point's rate is a difference; it errs by the square of its part of r
)
_TINY = 1e-9  # m: a middle nearer to the surface than this gives no normal


@dataclass(frozen=True, eq=False, slots=True)
class TipContacts:
    """N fingertips on the object in M postures.

    Args:
        p_OC: (M, N, 3) where they touch it, in O, m.
        R_OC: (M, N, 3, 3) the contact frames in O.
        p_OF: (M, N, 3) the origins of the tip frames in O, m.
        tips: (M, N, 6, n) the tips' Jacobians at their origins, in H's axes, m/rad and 1.
        twists: (M, N, 6, n) likewise at the contacts.
    """

    p_OC: Array
    R_OC: Array
    p_OF: Array
    tips: Array
    twists: Array


def locate_contacts(task: Task, q: Array, p_HO: Array, R_HO: Array) -> TipContacts:
    """The contacts of a hand's fingers in postures q (M, n), the object at p_HO (M, 3), R_HO (M, 3, 3)."""
    assert task.hand is not None  # asked only where fingers hold an object
    p_HF, tips = task.hand.model.frame_jacobians(q, [task.hand.frame_id(name) for name in task.fingers])
    p_OF = (p_HF - p_HO[:, None]) @ R_HO
    p_OC = closest_points(task, p_OF)
    arms = p_HO[:, None] + p_OC @ R_HO.transpose(0, 2, 1) - p_HF
    return TipContacts(p_OC, contact_frames(task, p_OC, p_OF), p_OF, tips, _jacobians_at_offsets(tips, arms))


def closest_points(task: Task, p_OF: Array) -> Array:
    """(M, N, 3) where tips with their origins at p_OF (M, N, 3) touch the object, in O, m."""
    contacts = task.contacts
    assert contacts is not None
    p_OC = np.tile(contacts.p_OC, (len(p_OF), 1, 1))
    if task.is_rolling.any():
        c = p_OF[:, task.is_rolling]
        shape = None if task.body is None else task.body.shape
        if shape is None:  # flat about each contact
            n = contacts.R_OC[task.is_rolling, :, 2]
            p_OC[:, task.is_rolling] = c + _dot(contacts.p_OC[task.is_rolling] - c, n) * n
        else:
            p_OC[:, task.is_rolling] = shape.closest_points(c.reshape(-1, 3)).reshape(c.shape)
    return p_OC


def closest_point_rates(task: Task, p_OF: Array, rates: Array) -> Array:
    """(M, N, 3) how fast the contacts move over the object while the tips' origins move at ``rates`` (M, N, 3) in O."""
    step = _DIFFERENCE_STEP / max(float(np.abs(rates).max(initial=0.0)), 1e-300)
    return np.asarray((closest_points(task, p_OF + step * rates) - closest_points(task, p_OF - step * rates)) / (2.0 * step))


def contact_frames(task: Task, p_OC: Array, p_OF: Array | None = None) -> Array:
    """(M, N, 3, 3) the contact frames in O: those where the move began, turned by the least that brings n to where it is.

    Args:
        p_OC: (M, N, 3) where the contacts are, in O, m.
        p_OF: (M, N, 3) the origins of the tips that touch there; without them n is asked of the shape.

    Raises:
        InvalidInput: without ``p_OF``, a contact on an edge.
    """
    contacts = task.contacts
    assert contacts is not None
    R_OC = np.tile(contacts.R_OC, (len(p_OC), 1, 1, 1))
    shape = None if task.body is None else task.body.shape
    if shape is None or not task.is_rolling.any():
        return R_OC
    first = contacts.R_OC[task.is_rolling]
    if p_OF is None:
        n = shape.inward_normal(p_OC[:, task.is_rolling].reshape(-1, 3)).reshape(len(p_OC), -1, 3)
    else:
        n = p_OC[:, task.is_rolling] - p_OF[:, task.is_rolling]
        away = np.linalg.norm(n, axis=2, keepdims=True)
        n = np.where(away > _TINY, n / np.maximum(away, _TINY), first[:, :, 2])
    axis = np.cross(first[:, :, 2], n)  # R = 1 + S + S²/(1 + cos), S y = axis × y
    S = np.cross(axis[..., None, :], np.eye(3)).swapaxes(-1, -2)
    near = 1.0 + _dot(first[:, :, 2], n)[..., None]
    R_OC[:, task.is_rolling] = (np.eye(3) + S + S @ S / np.maximum(near, _TINY)) @ first
    return R_OC


def drift(task: Task, touch: TipContacts) -> Array:
    """(M, N) how far tips that roll are off the height over the surface at which they began, and others off their place, m."""
    began = task.tip_centres
    heights = np.linalg.norm(touch.p_OC - touch.p_OF, axis=2) - np.linalg.norm(
        closest_points(task, began[None])[0] - began, axis=1
    )
    return np.asarray(np.where(task.is_rolling, np.abs(heights), np.linalg.norm(touch.p_OF - began, axis=2)))


def edge_contact(task: Task, p_OC: Array) -> tuple[int, int, str] | None:
    """The first of contacts (M, N, 3) that has rolled to where the surface has no normal: which of M, which of N, and where."""
    rolling = np.flatnonzero(task.is_rolling)
    if task.body is None or task.body.shape is None or not len(rolling):
        return None
    try:
        task.body.shape.inward_normal(p_OC[:, rolling].reshape(-1, 3))
    except InvalidInput as error:
        place, which = divmod(int(error.field.removeprefix("p_O[").removesuffix("]")), len(rolling))
        return place, int(rolling[which]), str(error.allowed).split("not ", 1)[-1]
    return None


def constraints(task: Task, touch: TipContacts, R_HO: Array, p_d: Array, omega: Array) -> tuple[Array, Array]:
    """A (M, c, n) and b (M, c) of A q̇ = b: what keeps contacts from slipping and tips from leaving.

    Rows are in contact frames, three a contact, then spins as speeds; a contact that rolls without friction has its third only.

    Args:
        touch: the contacts.
        R_HO: (M, 3, 3).
        p_d, omega: (M, 3) the velocity of O's origin in H, and the angular velocity in O; of time or of any other parameter.
    """
    contacts, M = task.contacts, len(R_HO)
    assert contacts is not None
    R_CO = touch.R_OC.swapaxes(-1, -2)
    R_CH = R_CO @ R_HO.transpose(0, 2, 1)[:, None]
    twists = np.where(task.is_rolling[:, None, None], touch.twists, touch.tips)
    points = np.where(task.is_rolling[:, None], touch.p_OC, touch.p_OF)
    speed = (p_d[:, None] @ R_HO) + np.cross(omega[:, None], points)  # of the object's points, in O
    A = (R_CH @ twists[:, :, :3]).reshape(M, -1, twists.shape[3])
    b = (R_CO @ speed[..., None]).reshape(M, -1)
    kept, spins = task.constrained
    A, b = A[:, kept], b[:, kept]
    if len(spins):
        A = np.concatenate([A, _SPIN_LENGTH * (R_CH[:, spins, 2:] @ twists[:, spins, 3:])[:, :, 0]], axis=1)
        b = np.concatenate([b, _SPIN_LENGTH * (R_CO[:, spins, 2] @ omega[:, :, None])[:, :, 0]], axis=1)
    return A, b


def contact_jacobians_at(task: Task, q: Array, p_HO: Array, R_HO: Array, p_OC: Array, R_OC: Array) -> Array:
    """(M, k, n) J of contact forces at places that are known, whether or not tips touch there."""
    assert task.hand is not None
    assert task.contacts is not None
    p_HC = p_HO[:, None] + p_OC @ R_HO.transpose(0, 2, 1)
    twists = task.hand.model.point_jacobians(q, [task.hand.frame_id(name) for name in task.fingers], p_HC)
    return contact_jacobians(task.contacts, twists, R_HO, R_OC)


def _jacobians_at_offsets(tips: Array, arms: Array) -> Array:
    """(M, N, 6, n) Jacobians at points that stand ``arms`` (M, N, 3) away from the tips' origins: v + ω × arm."""
    x, y, z = np.moveaxis(arms, -1, 0)[..., None]
    omega, twists = tips[:, :, 3:], np.array(tips)
    twists[:, :, 0] += omega[:, :, 1] * z - omega[:, :, 2] * y
    twists[:, :, 1] += omega[:, :, 2] * x - omega[:, :, 0] * z
    twists[:, :, 2] += omega[:, :, 0] * y - omega[:, :, 1] * x
    return twists


def _dot(a: Any, b: Any) -> Array:
    return np.asarray((a * b).sum(axis=-1, keepdims=True))

"""The fingers' joints along an object's path: what keeps contacts from slipping, integrated along s, then a spline.

    A(q, s) q' = b(s),    q' = A⁺ b

says that fingertips roll on the object, or stay where they are on it, `touch.constraints`; the pseudo-inverse moves the joints
least, which decides what a finger with more than three joints does with its freedom. It is integrated panel by panel by
collocation at Chebyshev's points: q = q₀ + ∫ A⁺ b again and again until nothing changes (Picard), all points at once. A spline
of seventh degree through them then *is* the joints' path, so that q' and q'' are its own derivatives to rounding. It is held
against A q' = b between its nodes, and gets more nodes until it follows to `_SLIP_TOLERANCE`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import make_interp_spline

from graspforce.contact.matrices import contact_jacobians
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import Hand
from graspforce.planning import tip_contacts
from graspforce.planning.failure import SINGULAR, UNREACHABLE, PlanFailure, joint_limit_failure
from graspforce.planning.path.paths import ContactPoints, JointPath, JointPoints, ObjectPath, PosePoints
from graspforce.planning.task import Task

_SLIP_TOLERANCE = (
    1e-7  # m: what a tip slips, or leaves the surface, at most along the path; a tenth of what a plan's check lets pass
)
_NEWTON_TOLERANCE = 1e-11  # m: where Newton's steps to the first posture stop
_PICARD_TOLERANCE = 1e-10  # rad: where the integration's do
_MAX_NEWTON_STEPS, _MAX_PICARD_ROUNDS = 12, 40
_DEGREE, _NODES = 7, 16  # of the spline; intervals between nodes in a panel
_WIDEST, _NARROWEST = (1.0, 0.5, 0.25, 0.125, 0.0625), 1.0 / 64.0  # of s: panels
_RANK_TOLERANCE = 1e-2  # a direction in which the tips move less than this beside their quickest one is lost
_BLOCKED_TOLERANCE = 1e-6  # the part of the path's speed in a lost direction that rounding does not explain
_LOCATION_TOLERANCE = 1e-3  # of s: how exactly a refusal says where
_LIMIT_TOLERANCE = 1e-6  # rad: a limit exceeded by less is rounding

_CHEBYSHEV_NODES = (1.0 - np.cos(np.pi * np.arange(_NODES + 1) / _NODES)) / 2.0  # of a panel: Chebyshev's points
_TO_SERIES = np.linalg.inv(chebyshev.chebvander(2.0 * _CHEBYSHEV_NODES - 1.0, _NODES))
_INTEGRAL = chebyshev.chebvander(2.0 * _CHEBYSHEV_NODES - 1.0, _NODES + 1) @ chebyshev.chebint(_TO_SERIES, scl=0.5, lbnd=-1.0)


def follow_object_path(task: Task, path: ObjectPath, q_start: Array | None = None) -> JointPath | PlanFailure:
    """The joints' path on which no contact slips.

    Args:
        task: with a hand and an object.
        path: the object's.
        q_start: (n,) a posture near the first one, rad; by default neutral.

    Returns:
        The joints' path, or why there is none, with the place and the joint.
    """
    q = start_posture(task, path, q_start)
    if isinstance(q, PlanFailure):
        return q
    for widest in _WIDEST:
        tracked = _integrate(task, path, q, widest)
        if isinstance(tracked, PlanFailure):
            return tracked
        s, postures = tracked
        joints = JointPath(make_interp_spline(s, postures, k=_DEGREE))
        if _stays_on_contacts(task, path, joints, np.concatenate([s[:-1] + part * np.diff(s) for part in (0.25, 0.5)])):
            return joints
    return PlanFailure(UNREACHABLE, "The path bends too sharply for the fingers to follow it smoothly.")


def contact_points(task: Task, poses: PosePoints, joints: JointPoints | None) -> ContactPoints:
    """Where the contacts are along a path, and the fingers' Jacobians there."""
    contacts = task.contacts
    assert contacts is not None  # asked only where there is an object
    if joints is None or task.hand is None:
        p_OC = np.tile(contacts.p_OC, (len(poses.p), 1, 1))
        R_OC = np.tile(contacts.R_OC, (len(poses.p), 1, 1, 1))
        return ContactPoints(p_OC, np.zeros(p_OC.shape), R_OC, np.zeros((len(p_OC), contacts.size, 0)))
    now = tip_contacts.locate_contacts(task, joints.q, poses.p, poses.R)
    in_H = (now.tips[:, :, :3] @ joints.q_s[:, None, :, None])[..., 0] - poses.p_s[:, None]
    rates = in_H @ poses.R - np.cross(poses.omega[:, None], now.p_OF)
    J = contact_jacobians(contacts, now.twists, poses.R, now.R_OC)
    return ContactPoints(now.p_OC, tip_contacts.closest_point_rates(task, now.p_OF, rates), now.R_OC, J)


def start_posture(task: Task, path: ObjectPath, q_start: Array | None) -> Array | PlanFailure:
    """Where the tips' middles are where the contacts say."""
    hand, contacts = task.hand, task.contacts
    assert hand is not None  # asked only where fingers hold an object
    assert contacts is not None
    first = path.points(np.zeros(1))
    try:
        q = np.array(hand.grasp_posture(task.fingers, contacts, first.p[0], first.R[0], q_start))
    except InvalidInput as error:
        return PlanFailure(UNREACHABLE, f"At the start, {reach_error_text(task, error)}", 0.0)
    wanted, used = first.p + task.tip_centres @ first.R[0].T, _finger_joints(task)
    for _ in range(_MAX_NEWTON_STEPS):
        p, J = hand.tips_along(q[None], task.fingers)
        missed = (wanted - p[0]).ravel()  # m
        if np.abs(missed).max() <= _NEWTON_TOLERANCE:
            break
        q[used] += np.linalg.lstsq(J[0].reshape(-1, hand.n)[:, used], missed, rcond=_RANK_TOLERANCE)[0]
    if np.abs(missed).max() > _SLIP_TOLERANCE:
        i = int(np.abs(missed.reshape(-1, 3)).max(axis=1).argmax())
        far = 1e3 * float(np.linalg.norm(missed.reshape(-1, 3)[i]))  # mm
        return PlanFailure(
            UNREACHABLE, f"At the start the contact of {task.fingers[i]} is out of its reach, by {far:.2g} mm.", 0.0
        )
    return q


def _integrate(task: Task, path: ObjectPath, q: Array, widest: float) -> tuple[Array, Array] | PlanFailure:
    """s (K,) and the postures there (K, n), from the first on."""
    all_s, postures, begin, width = [np.zeros(1)], [q[None]], 0.0, widest
    while begin < 1.0:
        s = begin + (min(begin + width, 1.0) - begin) * _CHEBYSHEV_NODES
        panel = _integrate_panel(task, path, s, q)
        if panel is None and width > _NARROWEST:
            width /= 2.0
            continue
        if panel is None:
            return _panel_failure(task, path, s, q)
        failure = _first_failure(task, path, s, *panel)
        if failure is not None:
            return failure
        all_s, postures = [*all_s, s[1:]], [*postures, panel[0][1:]]
        begin, q = float(s[-1]), panel[0][-1]
    return np.concatenate(all_s), np.concatenate(postures)


def _integrate_panel(task: Task, path: ObjectPath, s: Array, q_first: Array) -> tuple[Array, _Rates] | None:
    """(K, n) the postures at a panel's points s, and their rates; None where rounds do not settle."""
    at, width = path.points(s), s[-1] - s[0]
    q, change = np.tile(q_first, (len(s), 1)), np.inf
    for _ in range(_MAX_PICARD_ROUNDS):
        rates = _rates(task, at, q)
        better = q_first + width * (_INTEGRAL @ rates.q_s)
        before, change = change, float(np.abs(better - q).max())
        q = better
        if change <= _PICARD_TOLERANCE:
            return q, rates
        if change > np.pi or (change > before and change < 1e-3):  # never on a path that points resolve
            return None
    return None


@dataclass(frozen=True, eq=False, slots=True)
class _Rates:
    """How joints follow at K places.

    Args:
        q_s: (K, n).
        blocked: (K, c) the part of b in lost directions, of each constraint.
        asked: (K,) how large b is.
        lost: (K, m, n_used) the directions of joints that move no tip; zeros where they do.
    """

    q_s: Array
    blocked: Array
    rhs_norm: Array
    lost: Array


def _rates(task: Task, at: PosePoints, q: Array) -> _Rates:
    now = tip_contacts.locate_contacts(task, q, at.p, at.R)
    A, b = tip_contacts.constraints(task, now, at.R, at.p_s, at.omega)
    used = _finger_joints(task)
    u, sigma, v = np.linalg.svd(A[:, :, used], full_matrices=False)
    kept = sigma > _RANK_TOLERANCE * sigma[:, :1]
    along = np.where(kept, (u.swapaxes(1, 2) @ b[:, :, None])[:, :, 0], 0.0)
    q_s = np.zeros(q.shape)
    q_s[:, used] = (v.swapaxes(1, 2) @ (along / np.where(kept, sigma, 1.0))[:, :, None])[:, :, 0]
    blocked = b - (u @ along[:, :, None])[:, :, 0]
    return _Rates(q_s, blocked, np.linalg.norm(b, axis=1), np.where(kept[:, :, None], 0.0, v))


def _finger_joints(task: Task) -> list[int]:
    hand = task.hand
    assert hand is not None
    return sorted({joint for name in task.fingers for joint in hand.finger(name).joints})


def _stays_on_contacts(task: Task, path: ObjectPath, joints: JointPath, s: Array) -> bool:
    """Whether no contact slips or leaves on the spline, between its nodes."""
    at, now = path.points(s), joints.points(s)
    touched = tip_contacts.locate_contacts(task, now.q, at.p, at.R)
    A, b = tip_contacts.constraints(task, touched, at.R, at.p_s, at.omega)
    slips = float(np.abs((A @ now.q_s[:, :, None])[:, :, 0] - b).mean(axis=0).max())  # m over the whole path
    return max(slips, float(tip_contacts.drift(task, touched).max())) <= _SLIP_TOLERANCE


def _panel_failure(task: Task, path: ObjectPath, s: Array, q: Array) -> PlanFailure:
    """Why a narrow panel does not settle: in steps of `_LOCATION_TOLERANCE` to the first place that ends the path."""
    fine = np.linspace(s[0], s[-1], int(np.ceil((s[-1] - s[0]) / _LOCATION_TOLERANCE)) + 1)
    at, postures, rates = path.points(fine), [], []
    for k in range(len(fine)):
        here = _rates(task, _point_at(at, k), q[None])
        found = _first_failure(task, path, fine[k : k + 1], q[None], here)
        if found is not None:
            return found
        q = q + _LOCATION_TOLERANCE * here.q_s[0]
        postures.append(q)
        rates.append(here)
    reason = f"At s = {s[0]:.3f} the path bends too sharply for the fingers to follow it smoothly."
    return PlanFailure(UNREACHABLE, reason, float(s[0]))


def _point_at(at: PosePoints, k: int) -> PosePoints:
    return PosePoints(*(getattr(at, name)[k : k + 1] for name in PosePoints.__slots__))


def _first_failure(task: Task, path: ObjectPath, s: Array, q: Array, rates: _Rates) -> PlanFailure | None:
    """Why the path ends at the first of the places s where it does, to `_LOCATION_TOLERANCE`; None where it goes on at all of them."""
    k = _first_end(task, path.points(s), q, rates)
    if k is None:
        return None
    if k > 0 and s[k] - s[k - 1] > _LOCATION_TOLERANCE:  # nodes are coarse
        series = _TO_SERIES @ q
        fine = np.linspace(s[k - 1], s[k], int(np.ceil((s[k] - s[k - 1]) / _LOCATION_TOLERANCE)) + 1)
        q = chebyshev.chebvander(2.0 * (fine - s[0]) / (s[-1] - s[0]) - 1.0, _NODES) @ series
        at = path.points(fine)
        s, rates = fine, _rates(task, at, q)
        k = _first_end(task, at, q, rates)
        k = len(s) - 1 if k is None else k
    return _failure_at(task, _point_at(path.points(s), k), float(s[k]), q[k], rates, k)


def _first_end(task: Task, at: PosePoints, q: Array, rates: _Rates) -> int | None:
    """The first of K places where the path ends; None where it goes on."""
    hand, used = task.hand, _finger_joints(task)
    assert hand is not None
    ends = np.linalg.norm(rates.blocked, axis=1) > _BLOCKED_TOLERANCE * rates.rhs_norm
    ends |= np.maximum(hand.q_lower - q, q - hand.q_upper)[:, used].max(axis=1) > _LIMIT_TOLERANCE
    edge_contact = tip_contacts.edge_contact(task, tip_contacts.locate_contacts(task, q, at.p, at.R).p_OC)
    if edge_contact is not None:
        ends[edge_contact[0]] = True
    return int(ends.argmax()) if ends.any() else None


def _failure_at(task: Task, at: PosePoints, s: float, q: Array, rates: _Rates, k: int) -> PlanFailure:
    """Why the path ends at s."""
    hand, used = task.hand, _finger_joints(task)
    assert hand is not None
    now = tip_contacts.locate_contacts(task, q[None], at.p, at.R)
    if np.linalg.norm(rates.blocked[k]) > _BLOCKED_TOLERANCE * rates.rhs_norm[k]:
        constrained, spins = task.constrained
        count = int(constrained.sum())
        blocked = np.zeros(len(constrained))
        blocked[constrained] = rates.blocked[k, :count]
        spun = np.abs(rates.blocked[k, count:])
        if spun.max(initial=0.0) > np.abs(blocked).max():
            return _spin_failure(hand, task.fingers[int(spins[spun.argmax()])], s)
        i = int(np.linalg.norm(blocked.reshape(-1, 3), axis=1).argmax())
        direction = at.R[0] @ now.R_OC[0, i] @ blocked.reshape(-1, 3)[i]
        return _singular_failure(hand, task.fingers[i], s, direction, rates.lost[k], used)
    edge_contact = tip_contacts.edge_contact(task, now.p_OC)
    if edge_contact is not None:
        _, i, where = edge_contact
        reason = f"At s = {s:.3f} the contact of {task.fingers[i]} has rolled to where the surface has no normal: {where}."
        return PlanFailure(UNREACHABLE, reason, s)
    beyond = np.maximum(hand.q_lower - q, q - hand.q_upper)[used]
    joint = used[int(beyond.argmax())]
    return joint_limit_failure(s, hand.joints[joint], float(q[joint]))


def _singular_failure(hand: Hand, finger: str, s: float, direction: Array, lost: Array, used: list[int]) -> PlanFailure:
    """A finger cannot move its tip where the path goes: too few joints, or a singular posture."""
    along = ", ".join(f"{x:.2f}" for x in direction / np.linalg.norm(direction))
    own = [used.index(i) for i in hand.finger(finger).joints]
    if len(own) < 3:
        word = f"{len(own)} joint{'s' if len(own) > 1 else ''}"
        joint = hand.joints[used[own[-1]]].name
        reason = f"At s = {s:.3f} finger {finger}, which has {word}, cannot move its tip along ({along}) in H as the path asks."
        return PlanFailure(SINGULAR, reason, s, joint)
    share = np.abs(lost[:, own]).max(axis=0)
    joint = hand.joints[used[own[int(share.argmax())]]].name
    reason = (
        f"At s = {s:.3f} finger {finger} is singular: its tip cannot be moved along ({along}) in H as the path asks, "
        f"but by turning joint {joint} beyond measure."
    )
    return PlanFailure(SINGULAR, reason, s, joint)


def _spin_failure(hand: Hand, finger: str, s: float) -> PlanFailure:
    """A soft fingertip would have to spin on the object."""
    count, joint = len(hand.finger(finger).joints), hand.joints[hand.finger(finger).joints[-1]].name
    reason = (
        f"At s = {s:.3f} the soft tip of {finger} would have to spin on the object: with {count} joints it cannot turn about "
        f"the contact's normal as the object does."
    )
    return PlanFailure(SINGULAR, reason, s, joint)


def reach_error_text(task: Task, error: InvalidInput) -> str:
    """The words of an error of inverse kinematics, with the finger in place of a field."""
    field = error.field.split("]")[0].removeprefix("contacts[")
    finger = task.fingers[int(field)] if field.isdigit() else "a finger"
    return f"the contact of {finger} must be {error.allowed}."

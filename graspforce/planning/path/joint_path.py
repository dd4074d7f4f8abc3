"""The joints' path that follows an object's path without slip: integration of the rolling constraints along s, then a spline.

    A(q, s) q' = b(s),    q' = A⁺ b

These are the constraints of `graspforce.planning.tip_contacts`. The pseudo-inverse gives the smallest joint rates, which fixes
the freedom of a finger with more than three joints. Integration is by collocation at Chebyshev points, panel by panel: Picard
iteration q = q₀ + ∫ A⁺ b at all points of a panel at once, until it converges. The joints' path is a spline of degree seven
through these points, so that q' and q'' are its exact derivatives. Between its nodes it is checked against A q' = b; narrower
panels follow until it meets the slip tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import make_interp_spline

from graspforce.contact.matrices import contact_jacobians
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.planning import tip_contacts
from graspforce.planning.failure import UNREACHABLE, PlanFailure, joint_limit_failure
from graspforce.planning.path.paths import ContactPoints, JointPath, JointPoints, ObjectPath, PosePoints
from graspforce.planning.path.singularity import blocked_failure
from graspforce.planning.task import GraspTask, IdealTask

_SLIP_TOLERANCE = 1e-7  # m: largest slip, or distance from the surface; a tenth of what the check of a plan allows
_NEWTON_TOLERANCE = 1e-11  # m: of the start posture
_PICARD_TOLERANCE = 1e-10  # rad: of the integration
_MAX_NEWTON_STEPS, _MAX_PICARD_ROUNDS = 12, 40
_DEGREE, _NODES = 7, 16  # degree of the spline; intervals between the nodes of a panel
_PANEL_WIDTHS, _MIN_PANEL_WIDTH = (1.0, 0.5, 0.25, 0.125, 0.0625), 1.0 / 64.0  # of s
_RANK_TOLERANCE = 1e-2  # relative singular value below which a direction of a tip is lost
_BLOCKED_TOLERANCE = 1e-6  # share of b in lost directions above which a path cannot be followed
_LOCATION_TOLERANCE = 1e-3  # of s: accuracy of the place that a failure names
_LIMIT_TOLERANCE = 1e-6  # rad: smaller excesses of a joint limit are rounding errors

_CHEBYSHEV_NODES = (1.0 - np.cos(np.pi * np.arange(_NODES + 1) / _NODES)) / 2.0  # on [0, 1]
_TO_SERIES = np.linalg.inv(chebyshev.chebvander(2.0 * _CHEBYSHEV_NODES - 1.0, _NODES))
_INTEGRAL = chebyshev.chebvander(2.0 * _CHEBYSHEV_NODES - 1.0, _NODES + 1) @ chebyshev.chebint(_TO_SERIES, scl=0.5, lbnd=-1.0)

_TOO_SHARP = "bends too sharply for the fingers to follow it smoothly"


def follow_object_path(task: GraspTask, path: ObjectPath, q_start: Array | None = None) -> JointPath | PlanFailure:
    """Return the joints' path on which no contact slips.

    Args:
        task: the task.
        path: the object's path.
        q_start: (n,) posture near the start, rad; the neutral posture by default.

    Returns:
        The joints' path, or the reason why there is none, with the place and the joint.
    """
    q = start_posture(task, path, q_start)
    if isinstance(q, PlanFailure):
        return q
    for width in _PANEL_WIDTHS:
        integrated = _integrate(task, path, q, width)
        if isinstance(integrated, PlanFailure):
            return integrated
        s, postures = integrated
        joints = JointPath(make_interp_spline(s, postures, k=_DEGREE))
        if _stays_on_contacts(task, path, joints, np.concatenate([s[:-1] + part * np.diff(s) for part in (0.25, 0.5)])):
            return joints
    return PlanFailure(UNREACHABLE, f"The path {_TOO_SHARP}.")


def contact_points(task: GraspTask, poses: PosePoints, joints: JointPoints) -> ContactPoints:
    """Return the contacts along a path, and the contact Jacobians.

    Args:
        task: the task.
        poses: the object at K values of s.
        joints: the joints at the same values.
    """
    now = tip_contacts.locate_contacts(task, joints.q, poses.p, poses.R)
    rates_H = (now.tip_jacobians[:, :, :3] @ joints.q_s[:, None, :, None])[..., 0] - poses.p_s[:, None]
    rates = rates_H @ poses.R - np.cross(poses.omega[:, None], now.p_OF)
    J = contact_jacobians(task.contacts, now.contact_twists, poses.R, now.R_OC)
    return ContactPoints(now.p_OC, tip_contacts.closest_point_rates(task, now.p_OF, rates), now.R_OC, J)


def fixed_contact_points(task: IdealTask, count: int) -> ContactPoints:
    """Return the contacts of ideal fingers along a path; they do not move over the object.

    Args:
        task: the task.
        count: number of values of s.
    """
    contacts = task.contacts
    p_OC, R_OC = np.tile(contacts.p_OC, (count, 1, 1)), np.tile(contacts.R_OC, (count, 1, 1, 1))
    return ContactPoints(p_OC, np.zeros(p_OC.shape), R_OC, np.zeros((count, contacts.size, 0)))


def start_posture(task: GraspTask, path: ObjectPath, q_start: Array | None) -> Array | PlanFailure:
    """Return the posture (n,) whose fingertips touch the contacts at the start, rad, or the reason why there is none.

    Args:
        task: the task.
        path: the object's path.
        q_start: (n,) posture near it, rad; the neutral posture if None.
    """
    hand, first = task.hand, path.points(np.zeros(1))
    try:
        q = np.array(hand.grasp_posture(task.fingers, task.contacts, first.p[0], first.R[0], q_start))
    except InvalidInput as error:
        return PlanFailure(UNREACHABLE, f"At the start, {reach_error_text(task, error)}", 0.0)
    centres, used = first.p + task.tip_centres @ first.R[0].T, _finger_joints(task)
    for _ in range(_MAX_NEWTON_STEPS):
        p, J = hand.tips_along(q[None], task.fingers)
        error_H = (centres - p[0]).ravel()  # m
        if np.abs(error_H).max() <= _NEWTON_TOLERANCE:
            break
        q[used] += np.linalg.lstsq(J[0].reshape(-1, hand.n)[:, used], error_H, rcond=_RANK_TOLERANCE)[0]
    if np.abs(error_H).max() > _SLIP_TOLERANCE:
        errors = error_H.reshape(-1, 3)
        i = int(np.abs(errors).max(axis=1).argmax())
        distance = 1e3 * float(np.linalg.norm(errors[i]))  # mm
        reason = f"At the start the contact of {task.fingers[i]} is out of its reach by {distance:.2g} mm."
        return PlanFailure(UNREACHABLE, reason, 0.0)
    return q


def reach_error_text(task: GraspTask, error: InvalidInput) -> str:
    """Return the message of an error of inverse kinematics, with the finger's name in place of the field.

    Args:
        task: the task.
        error: the error of `Hand.grasp_posture`.
    """
    index = error.field.split("]")[0].removeprefix("contacts[")
    finger = task.fingers[int(index)] if index.isdigit() else "a finger"
    return f"the contact of {finger} must be {error.allowed}."


def _integrate(task: GraspTask, path: ObjectPath, q: Array, widest: float) -> tuple[Array, Array] | PlanFailure:
    """Return s (K,) and the postures (K, n) from the first one on."""
    all_s, postures, begin, width = [np.zeros(1)], [q[None]], 0.0, widest
    while begin < 1.0:
        s = begin + (min(begin + width, 1.0) - begin) * _CHEBYSHEV_NODES
        panel = _integrate_panel(task, path, s, q)
        if panel is None and width > _MIN_PANEL_WIDTH:
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


def _integrate_panel(task: GraspTask, path: ObjectPath, s: Array, q_first: Array) -> tuple[Array, _Rates] | None:
    """Return the postures (K, n) at a panel's points s and their rates; None if the iteration does not converge."""
    at, width = path.points(s), s[-1] - s[0]
    q, change = np.tile(q_first, (len(s), 1)), np.inf
    for _ in range(_MAX_PICARD_ROUNDS):
        rates = _rates(task, at, q)
        better = q_first + width * (_INTEGRAL @ rates.q_s)
        last_change, change = change, float(np.abs(better - q).max())
        q = better
        if change <= _PICARD_TOLERANCE:
            return q, rates
        if change > np.pi or (change > last_change and change < 1e-3):  # the points do not resolve the path
            return None
    return None


@dataclass(frozen=True, eq=False, slots=True)
class _Rates:
    """Joint rates at K places of a path.

    Args:
        q_s: (K, n) rates q'.
        blocked: (K, c) part of b in lost directions.
        rhs_norm: (K,) norms of b.
        lost: (K, m, n_used) directions of the joints that move no tip; zero for directions that do.
    """

    q_s: Array
    blocked: Array
    rhs_norm: Array
    lost: Array

    @property
    def is_blocked(self) -> Array:
        """Return (K,) whether the path needs a motion in a lost direction."""
        return np.asarray(np.linalg.norm(self.blocked, axis=1) > _BLOCKED_TOLERANCE * self.rhs_norm)


def _rates(task: GraspTask, at: PosePoints, q: Array) -> _Rates:
    """Return the rates in postures q (K, n) by the pseudo-inverse of A."""
    now = tip_contacts.locate_contacts(task, q, at.p, at.R)
    A, b = tip_contacts.constraints(task, now, at.R, at.p_s, at.omega)
    used = _finger_joints(task)
    u, sigma, v = np.linalg.svd(A[:, :, used], full_matrices=False)
    kept = sigma > _RANK_TOLERANCE * sigma[:, :1]
    projection = np.where(kept, (u.swapaxes(1, 2) @ b[:, :, None])[:, :, 0], 0.0)
    q_s = np.zeros(q.shape)
    q_s[:, used] = (v.swapaxes(1, 2) @ (projection / np.where(kept, sigma, 1.0))[:, :, None])[:, :, 0]
    blocked = b - (u @ projection[:, :, None])[:, :, 0]
    return _Rates(q_s, blocked, np.linalg.norm(b, axis=1), np.where(kept[:, :, None], 0.0, v))


def _finger_joints(task: GraspTask) -> list[int]:
    """Return the joints of the fingers that touch the object."""
    return sorted({joint for name in task.fingers for joint in task.hand.finger(name).joints})


def _stays_on_contacts(task: GraspTask, path: ObjectPath, joints: JointPath, s: Array) -> bool:
    """Return whether no contact slips or separates at s, between the nodes of the spline."""
    at, now = path.points(s), joints.points(s)
    tips = tip_contacts.locate_contacts(task, now.q, at.p, at.R)
    A, b = tip_contacts.constraints(task, tips, at.R, at.p_s, at.omega)
    slip = float(np.abs((A @ now.q_s[:, :, None])[:, :, 0] - b).mean(axis=0).max())  # m over the whole path
    return max(slip, float(tip_contacts.drift(task, tips).max())) <= _SLIP_TOLERANCE


def _panel_failure(task: GraspTask, path: ObjectPath, s: Array, q: Array) -> PlanFailure:
    """Return why the integration of a narrow panel does not converge, by small steps to the place where the path ends."""
    fine = np.linspace(s[0], s[-1], int(np.ceil((s[-1] - s[0]) / _LOCATION_TOLERANCE)) + 1)
    at = path.points(fine)
    for k in range(len(fine)):
        here = _rates(task, at.select(k), q[None])
        failure = _first_failure(task, path, fine[k : k + 1], q[None], here)
        if failure is not None:
            return failure
        q = q + _LOCATION_TOLERANCE * here.q_s[0]
    return PlanFailure(UNREACHABLE, f"At s = {s[0]:.3f} the path {_TOO_SHARP}.", float(s[0]))


def _first_failure(task: GraspTask, path: ObjectPath, s: Array, q: Array, rates: _Rates) -> PlanFailure | None:
    """Return why the path ends at the first of the places s where it does; None if it goes on at all of them."""
    k = _first_end(task, path.points(s), q, rates)
    if k is None:
        return None
    if k > 0 and s[k] - s[k - 1] > _LOCATION_TOLERANCE:  # locate it between the nodes
        series = _TO_SERIES @ q
        fine = np.linspace(s[k - 1], s[k], int(np.ceil((s[k] - s[k - 1]) / _LOCATION_TOLERANCE)) + 1)
        q = chebyshev.chebvander(2.0 * (fine - s[0]) / (s[-1] - s[0]) - 1.0, _NODES) @ series
        at = path.points(fine)
        s, rates = fine, _rates(task, at, q)
        k = _first_end(task, at, q, rates)
        k = len(s) - 1 if k is None else k
    return _failure_at(task, path.points(s).select(k), float(s[k]), q[k], rates, k)


def _first_end(task: GraspTask, at: PosePoints, q: Array, rates: _Rates) -> int | None:
    """Return the index of the first of K places where the path ends; None if it goes on."""
    ends = rates.is_blocked | (_limit_excess(task, q).max(axis=1) > _LIMIT_TOLERANCE)
    edge = tip_contacts.edge_contact(task, tip_contacts.locate_contacts(task, q, at.p, at.R).p_OC)
    if edge is not None:
        ends[edge[0]] = True
    return int(ends.argmax()) if ends.any() else None


def _failure_at(task: GraspTask, at: PosePoints, s: float, q: Array, rates: _Rates, k: int) -> PlanFailure:
    """Return why the path ends at s, in the posture q and with the rates of index k."""
    now = tip_contacts.locate_contacts(task, q[None], at.p, at.R)
    if rates.is_blocked[k]:
        R_HC = at.R[0] @ now.R_OC[0]
        return blocked_failure(task, s, R_HC, rates.blocked[k], dict(zip(_finger_joints(task), rates.lost[k].T, strict=True)))
    edge = tip_contacts.edge_contact(task, now.p_OC)
    if edge is not None:
        _, i, name = edge
        reason = f"At s = {s:.3f} the contact of {task.fingers[i]} rolls onto an edge, where the surface has no normal: {name}."
        return PlanFailure(UNREACHABLE, reason, s)
    joint = _finger_joints(task)[int(_limit_excess(task, q[None])[0].argmax())]
    return joint_limit_failure(s, task.hand.joints[joint], float(q[joint]))


def _limit_excess(task: GraspTask, q: Array) -> Array:
    """Return the amounts (K, n_used) by which the fingers' joints exceed their position limits, rad; negative inside."""
    hand = task.hand
    return np.asarray(np.maximum(hand.q_lower - q, q - hand.q_upper)[:, _finger_joints(task)])

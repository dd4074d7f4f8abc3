"""Whether the fingers can follow a motion of the held object, and hold it all the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control.state import object_motion
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.problem import ForceProblem
from graspforce.force.solver import solve
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from graspforce.planning.regrasp.rolling_motion import HeldObject, RollingMotion
from graspforce.simulation.loops.reference import Reference

_SAMPLES = 24  # instants of the motion
_ROLLING_STEPS = 60  # of the motion, with a check of the forces after each
_CENTRINGS = (0.0, 1.0)  # 1/s: redundant joints stay, or return to the middle of their ranges
_TOLERATED = 1e-3  # m: the controller lets the object stay behind so far, without slipping
_AT_LIMIT = 0.05  # rad: so near to its limit, a joint ends a motion
_ROLLING = 0.01  # m: a fingertip that rolls on the object may be so far from its first contact


def find_unreachable(grasp: Grasp, reference: Reference, duration: float) -> tuple[float, str] | None:
    """Return the first instant at which a finger cannot reach its contact, and the finger's name; None if all can.

    The contacts move with the object. A fingertip may be up to 10 mm nearer to its start, because it rolls. The fingers'
    postures are within the joint limits; forces and collisions are not checked.

    Args:
        grasp: the grasp at the start.
        reference: desired motion.
        duration: time of the motion, s.
    """
    start = _tip_places(grasp, grasp.p_HO, grasp.R_HO)
    for t in np.linspace(0.0, duration, _SAMPLES + 1):
        motion = object_motion(reference(float(t)))
        places = _tip_places(grasp, motion.p_HO, motion.R_HO)
        for name, place, first in zip(grasp.fingers, places, start, strict=True):
            distance = float(np.linalg.norm(place - first))  # m
            if distance <= _ROLLING:
                continue
            try:
                grasp.hand.inverse_kinematics(name, place + (first - place) * _ROLLING / distance, grasp.q)
            except InvalidInput:
                return float(t), name
    return None


def find_unholdable(grasp: Grasp, reference: Reference, duration: float, gravity_H: Array) -> tuple[float, str] | None:
    """Return the first instant at which the fingers cannot hold the object on its motion, s, and the reason; None if they can.

    The fingertips roll on the object as it moves. A finger ends the motion if its tip loses a direction, or a joint reaches its
    limit, whether or not redundant joints return to the middle of their ranges; the object may stay behind by 1 mm. The
    contacts end it if no forces within friction cones and motor limits accelerate the object as desired.

    Args:
        grasp: the grasp at the start, by fingertips.
        reference: desired motion.
        duration: time of the motion, s.
        gravity_H: (3,) acceleration of gravity in H, m/s².
    """
    shape = grasp.body.shape
    if shape is None:
        return None
    start, farthest = HeldObject(0.0, grasp.q, grasp.fingers, grasp.contacts), list[HeldObject]()
    for centring in _CENTRINGS:
        rolling = RollingMotion(grasp.hand, shape, _TimedPath(reference), centring)
        farthest = max(farthest, rolling.roll(start, duration, duration / _ROLLING_STEPS), key=len)
        if len(farthest) > _ROLLING_STEPS:
            break
    for state in farthest:
        motion, held = object_motion(reference(state.u)), state.contacts
        actuation = grasp.hand.actuation(state.q, grasp.links, held, motion.p_HO, motion.R_HO, gravity_H=gravity_H)
        problem = ForceProblem(held, grasp.body.wrench(motion, gravity_H), actuation)
        if (infeasibility := solve(problem).infeasibility) is not None:
            return state.u, infeasibility.explanation
    end = farthest[-1]
    if len(farthest) in (1, _ROLLING_STEPS + 1):  # fingers with few joints cannot roll at all; or it has reached the end
        return None
    places = [_contact_points(grasp, reference, float(t)) for t in np.linspace(end.u, duration, _SAMPLES + 1)]
    missing = max(float(np.linalg.norm(place - places[0], axis=1).max()) for place in places)  # m
    return None if missing <= _TOLERATED else (end.u, _end_reason(grasp.hand, rolling, end))


def _contact_points(grasp: Grasp, reference: Reference, t: float) -> Array:
    """Return where the first contacts of the object are at a time, (N, 3) in H, m."""
    motion = object_motion(reference(t))
    points: Array = motion.p_HO + grasp.contacts.p_OC @ motion.R_HO.T
    return points


def _end_reason(hand: Hand, rolling: RollingMotion, end: HeldObject) -> str:
    """Return why the fingers cannot roll on from a state."""
    room = np.minimum(end.q - hand.q_lower, hand.q_upper - end.q)  # rad
    joints = [j for name in end.fingers for j in hand.finger(name).joints]
    nearest = min(joints, key=lambda j: float(room[j]))
    if room[nearest] < _AT_LIMIT:
        return f"joint {hand.joint_names[nearest]} reaches its limit"
    return f"{rolling.weakest_finger(end)} loses a direction in which it moves its tip"


@dataclass(frozen=True, slots=True)
class _TimedPath:
    """A reference motion as a path whose parameter is the time."""

    reference: Reference

    def motion(self, u: float, rate: float = 0.0) -> BodyMotion:
        """Return the pose at a time, s, with the twist at a rate of the time, 0 or 1."""
        now = object_motion(self.reference(u))
        return BodyMotion(now.p_HO, now.R_HO, rate * now.twist)


def _tip_places(grasp: Grasp, p_HO: Array, R_HO: Array) -> Array:
    """Return the (N, 3) places of the tip frames in H, m, whose pads touch the contacts of the object at a pose."""
    radii = np.array([grasp.hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])
    centres_O = grasp.contacts.p_OC - radii[:, None] * grasp.contacts.R_OC[:, :, 2]
    places: Array = p_HO + centres_O @ R_HO.T
    return places

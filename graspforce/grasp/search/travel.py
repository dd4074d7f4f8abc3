"""How far the fingers can translate a grasped object, by integration of the rolling contacts.

Both sides of a rolling contact have one velocity. While the object moves along d without rotation, A q̇ = (d, …, d), where A
stacks the Jacobians of the contact points. The null space returns the joints to the posture of the grasp, as the controller
does:

    q̇ = A⁺ (d, …, d) + (1 − A⁺ A) k (q_grasp − q).

A soft contact also fixes the finger's spin about the normal: one more row of A, with a zero beside d. A finger of three
joints cannot meet it. A finger of four joints cannot meet it in some postures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Solid
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search.batch_kinematics import BatchKinematics
from graspforce.grasp.search.candidates import CandidateMeasures, Candidates, GeometryRequirements, Indices
from graspforce.grasp.search.common_joints import own_joints, without_common_joints
from graspforce.grasp.search.goal import SearchGoal
from graspforce.hand.hand import Hand

_STEPS = 5  # of the midpoint rule
_SINGULAR_RATIO = 0.01  # singular values of A below this fraction of the largest count as zero, as in the controller
_VELOCITY_TOLERANCE = 1e-3  # of ‖d‖, of the velocity of a contact
_CONTACT_TOLERANCE = 1e-4  # m, of the distance between tip and surface, including the integration error
_LIMIT_MARGIN = 0.02  # rad, that joints keep from their limits; prismatic joints in units of `joint_scale`
_MIN_TIP_SPEED = 0.002  # m/rad: a tip that is slower in some direction is near a singular posture
_SPIN_ARM = 0.03  # m: lever that turns spin into a velocity, as in the controller
_SPIN_STEP = 2e-4  # m: the largest step with soft contacts, whose singular postures are narrow
_NO_CONTACTS: Indices = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, eq=False, slots=True)
class TravelLimit:
    """How far the fingers can move the object in one direction.

    Attributes:
        direction: (3,) unit vector in H.
        distance: the distance reached, m, a multiple of one fifth of the travel that was simulated.
        reason: why the next fifth is not possible; empty if the whole travel is possible.
    """

    direction: Array
    distance: float
    reason: str


def travel_limits(grasp: Grasp, travel: float = 0.005, *, clearance: float = 0.002) -> tuple[TravelLimit, ...]:
    """Compute how far the fingers can translate the object both ways along each axis of H.

    Each axis is first turned to the nearest direction in which all the fingers can move. Planar fingers move the object in
    the intersection of their planes only. Joints that move all fingers, such as a wrist, keep their positions.

    A direction ends where

    - a joint comes within 0.02 rad of a limit,
    - a finger comes near a singular posture, or cannot follow the object,
    - a soft fingertip would have to spin on the object,
    - a tip leaves the surface or rolls over an edge, or
    - the object, a finger or the palm would touch another part.

    Args:
        grasp: a grasp of a solid by round fingertips.
        travel: distance to simulate, m, > 0.
        clearance: overlap allowed between the object and the last link of a touching finger, m, as in `find_grasp`.

    Returns:
        Two limits for each direction, at most six.

    Raises:
        InvalidInput: the shape of the body is not a solid, or a number is out of range.
    """
    shape, hand = grasp.body.shape, without_common_joints(grasp.hand, grasp.q)
    if not isinstance(shape, Solid):
        given = None if shape is None else type(shape).__name__
        raise InvalidInput("grasp.body.shape", given, "a sphere, cylinder, box, superquadric or mesh")
    travel = arrays.check_number(travel, "travel", above=0.0)
    clearance = arrays.check_number(clearance, "clearance", minimum=0.0)
    kinematics, names = BatchKinematics(hand), [finger.name for finger in hand.fingers]
    fingers = tuple(names.index(name) for name in grasp.fingers)
    requirements = GeometryRequirements(clearance, 0.0, freeze(np.zeros(3)), freeze(np.zeros(3)), travel)
    goal = SearchGoal(hand, kinematics, shape, fingers, requirements)
    q = grasp.q[own_joints(grasp.hand)]
    p_O = (goal.tip_centres(q[None])[0] - grasp.p_HO) @ grasp.R_HO
    x = np.concatenate([q, grasp.p_HO, np.zeros(3), np.ones(len(fingers))])
    face = goal.face_distances(p_O).face_distance.argmax(axis=1)
    candidates = Candidates(x[None], grasp.R_HO[None], face[None])
    return simulate_travel(goal, candidates, np.flatnonzero(grasp.contacts.gamma))


def simulate_travel(goal: SearchGoal, candidates: Candidates, soft: Indices = _NO_CONTACTS) -> tuple[TravelLimit, ...]:
    """Compute how far a candidate can be moved both ways along each direction of its fingers.

    Args:
        goal: the search goal, which contains the travel.
        candidates: one candidate, exact: its tips touch.
        soft: indices of the soft contacts.
    """
    travel, d = goal.requirements.travel, np.vstack([goal.travel_directions, -goal.travel_directions])
    if travel == 0.0 or len(d) == 0:
        return ()
    motion = _RollingTravel(goal, candidates, d, soft)
    start = motion.start
    q, p = np.repeat(start.q, len(d), axis=0), np.repeat(start.p_HO, len(d), axis=0)
    h, reasons, distance = travel / _STEPS, [""] * len(d), np.zeros(len(d))
    substeps = int(np.ceil(h / _SPIN_STEP)) if len(soft) else 1
    for step in range(_STEPS):
        error = np.zeros((len(d), len(goal.fingers) + len(soft)))
        for _ in range(substeps):
            rate, error_start = motion.joint_rates(q, p)
            rate, error_middle = motion.joint_rates(q + 0.5 * h / substeps * rate, p + 0.5 * h / substeps * d)
            q, p = q + h / substeps * rate, p + h / substeps * d
            error = np.maximum(error, np.maximum(error_start, error_middle))
        measures = motion.measure(q, p)
        for b in range(len(d)):
            if not reasons[b]:
                reasons[b] = motion.stop_reason(measures, b, error[b])
                distance[b] = travel * (step + 1) / _STEPS if not reasons[b] else distance[b]
        if all(reasons):
            break
    return tuple(
        TravelLimit(direction, float(far), _reason_text(direction, far + h, reason) if reason else "")
        for direction, far, reason in zip(d, distance, reasons, strict=True)
    )


class _RollingTravel:
    """One candidate that moves in several directions at once, d (B, 3)."""

    def __init__(self, goal: SearchGoal, candidates: Candidates, d: Array, soft: Indices) -> None:
        self._goal, self._candidates, self._d, self._soft = goal, candidates, d, soft
        self.start = goal.measure(candidates)

    def joint_rates(self, q: Array, p_HO: Array) -> tuple[Array, Array]:
        """Compute q̇ per metre of the object's travel.

        Args:
            q: (B, n) postures, rad.
            p_HO: (B, 3) positions of the object in H, m.

        Returns:
            (B, n) joint rates, rad/m, and (B, N + S) the velocity error of each contact and spin, as fractions of ‖d‖.
        """
        B, N, d, soft = len(q), len(self._goal.fingers), self._d, self._soft
        points, spin = self._goal.contact_jacobians(q, p_HO, self.start.R_HO, self._candidates.face)
        A = np.concatenate([points.reshape(B, 3 * N, -1), _SPIN_ARM * spin[:, soft]], axis=1)
        inverse = np.linalg.pinv(A, rcond=_SINGULAR_RATIO)
        target = np.hstack([np.tile(d, N), np.zeros((B, len(soft)))])[..., None]
        back = (self.start.q - q)[..., None] / self._goal.requirements.travel
        rate = inverse @ (target - A @ back) + back
        error = (target - A @ rate)[..., 0]
        point_error = np.linalg.norm(error[:, : 3 * N].reshape(B, N, 3), axis=2)
        return rate[..., 0], np.hstack([point_error, np.abs(error[:, 3 * N :])])

    def measure(self, q: Array, p_HO: Array) -> CandidateMeasures:
        """Compute the measures of the grasp in postures q (B, n) with the object at p_HO (B, 3)."""
        B, weights = len(q), self._goal.unpack(self._candidates.x)[3]
        x = np.hstack([q, p_HO, np.zeros((B, 3)), np.repeat(weights, B, axis=0)])
        R_HO, face = np.repeat(self.start.R_HO, B, axis=0), np.repeat(self._candidates.face, B, axis=0)
        return self._goal.measure(Candidates(x, R_HO, face))

    def stop_reason(self, m: CandidateMeasures, b: int, error: Array) -> str:
        """Return why the grasp is not possible any more in direction b; empty if it is.

        Args:
            m: measures in all directions.
            b: index of the direction.
            error: (N + S,) velocity errors on the last step, of each contact and spin.
        """
        goal, N = self._goal, len(self._goal.fingers)
        hand, names = goal.hand, [finger.name for finger in goal.hand.fingers]
        q = m.q[b]
        margin = (np.minimum(q - hand.q_lower, hand.q_upper - q) / goal.joint_scale)[goal.used_joints]
        if margin.min() < _LIMIT_MARGIN:
            return _limit_text(hand, int(goal.used_joints[margin.argmin()]), q)
        spins = np.isin(np.arange(N), self._soft[error[N:] > _VELOCITY_TOLERANCE])
        conditions: list[tuple[npt.NDArray[np.bool_], str]] = [
            (spins, "cannot follow without spinning on the object"),
            (error[:N] > _VELOCITY_TOLERANCE, "cannot follow the object"),
            (m.min_tip_speed[b] < _MIN_TIP_SPEED, "is near a singular posture"),
            (np.abs(m.contact_distance[b]) > _CONTACT_TOLERANCE, "leaves the object"),
            (m.edge_distance[b] < 0.0, "rolls over an edge"),
        ]
        for is_met, text in conditions:
            if is_met.any():
                return f"{names[goal.fingers[int(is_met.argmax())]]} {text}"
        if m.link_gap[b].min() < 0.0:
            return f"the links of {names[int(m.link_gap[b].argmin())]} touch the object"
        if m.finger_gap[b].min(initial=np.inf) < 0.0:
            return "two fingers touch each other"
        return "the palm touches the object" if m.palm_gap[b] < 0.0 else ""


def _reason_text(direction: Array, distance: float, reason: str) -> str:
    axis = int(np.abs(direction).argmax())
    name = f"{'-' if direction[axis] < 0.0 else '+'}{'xyz'[axis]}"
    if abs(direction[axis]) <= 1.0 - 1e-9:
        name = "[" + ", ".join(f"{x:.2f}" for x in direction) + "]"
    return f"after {1e3 * distance:.3g} mm along {name} of H, {reason}"


def _limit_text(hand: Hand, j: int, q: Array) -> str:
    above, below = float(q[j] - hand.q_lower[j]), float(hand.q_upper[j] - q[j])  # rad
    limit, margin = (hand.q_lower[j], above) if above < below else (hand.q_upper[j], below)
    side = "from" if margin >= 0.0 else "beyond"
    unit = hand.joints[j].position_unit
    return f"{hand.joints[j].name} is {abs(margin):.3f} {unit} {side} its limit {limit:.3f} {unit}"

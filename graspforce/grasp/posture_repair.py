"""Contacts of a posture from elsewhere: close small gaps between fingertips and object, and name what is wrong.

Postures of other programs, of datasets or of a teleoperated hand leave gaps or overlaps of some millimetres. The joints of the
touching fingers move by the least ‖Δq‖ that brings each tip, a sphere of radius r with centre c, onto the surface:

    d(c_i(q)) = r_i     for every touching finger i,     q_min ≤ q ≤ q_max,

with the signed distance d. Newton steps solve it; joints at a limit are held. Joints that move all fingers stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.geometry import Shape
from graspforce.hand.collision import LinkGap, hand_collision
from graspforce.hand.hand import Hand

_TOLERANCE = 1e-10  # m, of the distance between a tip and the surface
_MAX_STEPS = 50
_LARGEST_STEP = 0.2  # rad, of a joint in one Newton step: farther away the linearisation says nothing
_LINK_SAMPLES = 9  # points between the last joint and the tip
_ROUNDING = 1e-9  # m


@dataclass(frozen=True, slots=True)
class PostureOptions:
    """What a posture may lack, and the contacts that it makes.

    Args:
        repair: largest distance by which a fingertip may be off the surface, and be moved, m, ≥ 0.
        overlap: largest overlap of two links, or of a link and the object, m, ≥ 0.
        friction: μ of all contacts, > 0.
        max_normal: largest normal force of each contact, N, > 0.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    repair: float = 0.005
    overlap: float = 0.0
    friction: float = 0.6
    max_normal: float = 20.0

    def __post_init__(self) -> None:
        set_fields(
            self,
            repair=arrays.check_number(self.repair, "repair", minimum=0.0),
            overlap=arrays.check_number(self.overlap, "overlap", minimum=0.0),
            friction=arrays.check_number(self.friction, "friction", above=0.0),
            max_normal=arrays.check_number(self.max_normal, "max_normal", above=0.0),
        )


@dataclass(frozen=True, eq=False, slots=True)
class RepairedPosture:
    """A posture in which fingertips touch an object.

    Attributes:
        fingers: names of the N touching fingers.
        q: (n,) joint positions, rad.
        p_OC: (N, 3) contact points in O, m.
        normals: (N, 3) inward normals in O.
        apart: a sentence part for each other finger: how far it is from the object.
    """

    fingers: tuple[str, ...]
    q: Array
    p_OC: Array
    normals: Array
    apart: tuple[str, ...]


def repair_posture(
    hand: Hand, shape: Shape, q: Array, p_HO: Array, R_HO: Array, fingers: Sequence[str] | None, options: PostureOptions
) -> RepairedPosture:
    """Move fingertips onto the surface of an object, and check the posture.

    Args:
        hand: the hand.
        shape: the object's surface.
        q: (n,) joint positions, rad; positions beyond the limits are moved onto them.
        p_HO: (3,) position of the object in H, m.
        R_HO: (3, 3) axes of the object in H.
        fingers: names of the fingers that touch; by default all whose tip is at most `options.repair` off the surface.
        options: what the posture may lack.

    Raises:
        InvalidInput: the posture does not hold the object; its text names every fault.
        UnknownName: the hand has no finger of that name.
    """
    scene = _Scene(hand, shape, p_HO, R_HO)
    every = [finger.name for finger in hand.fingers]
    gaps = dict(zip(every, scene.gaps(q, every).tolist(), strict=True))
    near = [name for name in every if abs(gaps[name]) <= options.repair + _ROUNDING]
    touching = near if fingers is None else [hand.finger(name).name for name in fingers]
    limit = f"more than the {1e3 * options.repair:g} mm that may be repaired"
    apart = [f"{name} is {_distance(gaps[name])}" for name in every if name not in touching]
    faults = [f"{name} is {_distance(gaps[name])}, {limit}" for name in touching if name not in near]
    faults += [
        f"{name} is {_distance(gaps[name])}, {limit}" for name in every if name not in touching and gaps[name] < -_ROUNDING
    ]
    if len(touching) < 2 and not faults:
        faults = [f"{text}, {limit}" for text in apart] or [f"{hand.name} has one finger alone"]
    if faults:
        raise _refusal(q, faults)
    repaired = scene.close_gaps(q, touching)
    faults = scene.faults(q, repaired, touching, options)
    if faults:
        raise _refusal(q, faults)
    centres = scene.centres(repaired, touching)
    p_OC = shape.project_to_surface(centres)
    try:
        normals = shape.inward_normal(p_OC)
    except InvalidInput as error:
        place = int(error.field.partition("[")[2].rstrip("]"))
        raise _refusal(q, [f"{touching[place]} touches an edge or a corner of the object"]) from None
    return RepairedPosture(tuple(touching), freeze(repaired), p_OC, normals, tuple(apart))


class _Scene:
    """A hand and an object at rest."""

    def __init__(self, hand: Hand, shape: Shape, p_HO: Array, R_HO: Array) -> None:
        self._hand, self._shape, self._p, self._R = hand, shape, p_HO, R_HO

    def _to_object(self, p_H: npt.ArrayLike) -> Array:
        return np.asarray((np.asarray(p_H) - self._p) @ self._R)

    def centres(self, q: Array, names: Sequence[str]) -> Array:
        """Return the centres (N, 3) of tips in O, m."""
        return self._to_object([self._hand.tip_pose(q, name)[0] for name in names])

    def gaps(self, q: Array, names: Sequence[str]) -> Array:
        """Return the distances (N,) of tips from the surface, m; negative for an overlap."""
        radii = [self._hand.finger(name).tip_radius or 0.0 for name in names]
        return self._shape.signed_distance(self.centres(q, names)) - radii

    def _distances(self, p_O: Array) -> tuple[Array, Array]:
        """Return the signed distances (N,) of points from the surface, m, and their gradients (N, 3)."""
        x = np.asarray(self._shape.project_to_surface(p_O))
        sign = np.where(self._shape.phi(p_O) < 0.0, -1.0, 1.0)
        distance = sign * np.linalg.norm(p_O - x, axis=1)
        on_surface = np.abs(distance) < _TOLERANCE
        if on_surface.any():
            outwards = self._shape._gradient(x)
            norms = np.maximum(np.linalg.norm(outwards, axis=1), 1e-300)
            away = np.where(on_surface[:, None], outwards / norms[:, None], 0.0)
        else:
            away = np.zeros_like(p_O)
        away[~on_surface] = (p_O - x)[~on_surface] / distance[~on_surface, None]
        return distance, away

    def close_gaps(self, q: Array, names: Sequence[str]) -> Array:
        """Return the posture after Newton steps that bring the tips onto the surface."""
        hand = self._hand
        lower, upper = hand.q_lower, hand.q_upper
        used = np.zeros(hand.n, dtype=bool)
        for name in names:
            used[list(hand.finger(name).joints)] = True
        used[list(hand.common_joints)] = False
        radii = np.array([hand.finger(name).tip_radius or 0.0 for name in names])
        q = np.clip(q, lower, upper)
        for _ in range(_MAX_STEPS):
            distance, away = self._distances(self.centres(q, names))
            lack = radii - distance
            if np.abs(lack).max() <= _TOLERANCE:
                break
            jacobians = [hand.point_jacobian(q, name, hand.tip_pose(q, name)[0]) for name in names]
            A = np.stack(
                [(self._R @ a) @ J[:3] for a, J in zip(away, jacobians, strict=True)]
            )  # (N, n): rates of the distances
            step = _least_step(A, lack, used, q, lower, upper)
            q = np.clip(q + step, lower, upper)
        return np.asarray(q)

    def faults(self, given: Array, q: Array, names: Sequence[str], options: PostureOptions) -> list[str]:
        """Return the faults of a repaired posture, in words."""
        hand, faults = self._hand, []
        moved = np.linalg.norm(self.centres(q, names) - self.centres(given, names), axis=1)
        for name, gap, way in zip(names, self.gaps(q, names).tolist(), moved.tolist(), strict=True):
            if abs(gap) > 10.0 * _TOLERANCE:
                stopped = [hand.joints[j].name for j in hand.finger(name).joints if q[j] in (hand.q_lower[j], hand.q_upper[j])]
                why = f"with {', '.join(stopped)} at a limit" if stopped else "and its joints cannot move it along the normal"
                faults.append(f"{name} stays {_distance(gap)}, {why}")
            elif way > options.repair + _ROUNDING:
                faults.append(
                    f"{name} moves {1e3 * way:.1f} mm, more than the {1e3 * options.repair:g} mm that may be repaired"
                )
        return faults + self._overlaps(q, names, options.overlap)

    def _overlaps(self, q: Array, names: Sequence[str], allowed: float) -> list[str]:
        """Return the overlaps of links with each other and with the object, in words."""
        tips = {tip.finger: tip for tip in self._hand.tree().tips}
        touching = [tips[name].link for name in names]
        collision = hand_collision(self._hand)
        gaps: list[LinkGap] = collision.link_gaps(q)
        gaps += collision.object_gaps(q, self._shape, self._p, self._R, touching)
        found: dict[tuple[str, str], float] = {}
        for gap in gaps:
            if gap.distance < -allowed:
                found.setdefault((gap.first, gap.second), gap.distance)
        faults = [
            f"{first} and {'the object' if second == 'object' else second} overlap by {-1e3 * distance:.1f} mm"
            for (first, second), distance in found.items()
        ]
        for name in names:  # the last link may be as thick as the tip, but must not pass through the object
            p, R = self._hand.tip_pose(q, name)
            joint = p - R @ tips[name].R_LF.T @ tips[name].p_LF  # m, the origin of the link that carries the tip
            line = joint + np.linspace(0.0, 1.0, _LINK_SAMPLES)[:, None] * (p - joint)
            depth = -float(self._distances(self._to_object(line))[0].min())
            if depth > allowed + 1e3 * _ROUNDING:
                faults.append(f"the last link of {name} passes {1e3 * depth:.1f} mm deep through the object")
        return faults


def _least_step(A: Array, lack: Array, used: npt.NDArray[np.bool_], q: Array, lower: Array, upper: Array) -> Array:
    """Return the least step with A Δq = lack whose joints do not leave their limits."""
    free = used.copy()
    while True:
        step = np.zeros(len(q))
        step[free] = np.linalg.lstsq(A[:, free], lack, rcond=1e-6)[0]
        beyond = free & (((q <= lower) & (step < 0.0)) | ((q >= upper) & (step > 0.0)))
        if not beyond.any():
            break
        free &= ~beyond
    largest = float(np.abs(step).max(initial=0.0))
    return step * min(1.0, _LARGEST_STEP / largest) if largest > 0.0 else step


def _distance(gap: float) -> str:
    """Return the words for the distance of a tip from the object, m."""
    return f"{1e3 * gap:.1f} mm from the object" if gap >= 0.0 else f"{-1e3 * gap:.1f} mm inside the object"


def _refusal(q: Array, faults: Sequence[str]) -> InvalidInput:
    return InvalidInput("q", q, "a posture that holds the object: " + "; ".join(faults))

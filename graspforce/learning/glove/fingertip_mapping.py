"""Fingertips of one hand, such as that of a glove's model, mapped to another hand with limits and without collisions.

Each target is the source's fingertip relative to a point of its palm, turned, scaled and shifted into the frame of the other
hand. The posture minimises

    ½ Σ w_i² ‖p_i(q) − p_i*‖² + ½ ρ² ‖q − q_previous‖²,   q_lower ≤ q ≤ q_upper,

by damped Gauss–Newton steps with projection onto the limits. If links would then be closer than the clearance, one finger
after the other goes from the previous posture towards the new one as far as it keeps the clearance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.hand.collision import HandCollision
from graspforce.hand.hand import Hand

_IN_LINE = 1e-6  # m: points this near to a line have no rotation about it
_STEPS = 30  # of Gauss–Newton, at most
_STEP_TOLERANCE = 1e-7  # rad
_BISECTIONS = 4  # of a finger's way to the new posture


@dataclass(frozen=True, eq=False, slots=True)
class FingertipMap:
    """Correspondence of two hands.

    Args:
        fingers: the source's finger for each finger of the target hand that follows.
        scale: ratio of the lengths of the target hand and the source, > 0.
        R_HS: (3, 3) axes of the source's base in the target hand's base H.
        p_HS: (3,) place of the source's base in H after scaling, m.
        smoothing: ρ, m/rad: weight of the joint motion, ≥ 0. It decides between postures with equal fingertips.
        clearance: least distance between links that must not touch, m, ≥ 0.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    fingers: Mapping[str, str]
    scale: float = 1.0
    R_HS: npt.ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    p_HS: npt.ArrayLike = (0.0, 0.0, 0.0)
    smoothing: float = 0.003
    clearance: float = 0.0

    def __post_init__(self) -> None:
        if not self.fingers:
            raise InvalidInput("fingers", self.fingers, "at least one finger")
        names = {fields.check_text(a, "fingers"): fields.check_text(b, "fingers") for a, b in self.fingers.items()}
        set_fields(
            self,
            fingers=names,
            scale=arrays.check_number(self.scale, "scale", above=0.0),
            R_HS=arrays.check_rotation(self.R_HS, "R_HS"),
            p_HS=arrays.check_array(self.p_HS, "p_HS", (3,)),
            smoothing=arrays.check_number(self.smoothing, "smoothing", minimum=0.0),
            clearance=arrays.check_number(self.clearance, "clearance", minimum=0.0),
        )

    def targets(self, tips_S: Mapping[str, npt.ArrayLike]) -> dict[str, Array]:
        """Return the targets of the other hand's fingertips, (3,) in H, m.

        Args:
            tips_S: (3,) fingertip of each of the source's fingers in the source's base, m.

        Raises:
            InvalidInput: a fingertip is missing.
        """
        found = {}
        for finger, source in self.fingers.items():
            if source not in tips_S:
                raise InvalidInput("tips_S", sorted(tips_S), f"fingertips with that of {source}")
            p_S = arrays.check_array(tips_S[source], f"tips_S.{source}", (3,))
            found[finger] = freeze(np.asarray(self.p_HS) + self.scale * (np.asarray(self.R_HS) @ p_S))
        return found


def fit_fingertip_map(
    fingers: Mapping[str, str], tips_S: npt.ArrayLike, tips_H: npt.ArrayLike, smoothing: float = 0.003, clearance: float = 0.0
) -> FingertipMap:
    """Fit scale, rotation and place of the source to paired fingertips, such as those of the same grasps, by least squares.

    Source: Umeyama (1991).

    Args:
        fingers: the source's finger for each finger of the target hand that follows.
        tips_S: (N, 3) fingertips of the source in its base, m, at least three that are not in line.
        tips_H: (N, 3) corresponding fingertips of the target hand in H, m.
        smoothing: as in `FingertipMap`.
        clearance: as in `FingertipMap`.

    Raises:
        InvalidInput: an argument is not allowed.
    """
    from scipy.spatial.transform import Rotation  # imported here to keep the package fast to import

    a = arrays.check_array(tips_S, "tips_S", (None, 3))
    b = arrays.check_array(tips_H, "tips_H", (len(a), 3))
    x, y = a - a.mean(axis=0), b - b.mean(axis=0)
    if len(a) < 3 or min(np.linalg.svd(x, compute_uv=False)[1], np.linalg.svd(y, compute_uv=False)[1]) < _IN_LINE:
        raise InvalidInput("tips_S", a, "at least three fingertips that are not in line")
    R = Rotation.align_vectors(y, x)[0].as_matrix()
    scale = float(np.sum(y * (x @ R.T)) / np.sum(x * x))
    if scale <= 0.0:
        raise InvalidInput("tips_H", b, "fingertips in the arrangement of the source, not its mirror image")
    return FingertipMap(fingers, scale, R, b.mean(axis=0) - scale * R @ a.mean(axis=0), smoothing, clearance)


@dataclass(frozen=True, eq=False, slots=True)
class MappedPosture:
    """The posture of the target hand for one frame.

    Attributes:
        q: (n,) joint positions, rad, within the limits.
        errors: distance of each following fingertip from its target, m, by finger.
        is_held_back: whether collisions kept the hand from the nearest posture.
    """

    q: Array
    errors: dict[str, float]
    is_held_back: bool


class FingertipMapper:
    """Maps a stream of fingertips to postures of a hand. Each frame starts from the posture of the frame before.

    Args:
        hand: the target hand.
        correspondence: the fingers and the frame of the source.
        q_start: (n,) first posture, rad; neutral by default. It keeps the clearance.

    Attributes:
        q: (n,) posture of the last frame, rad.

    Raises:
        InvalidInput: an argument is not allowed, or the first posture does not keep the clearance.
        UnknownName: the hand has no finger of that name.
    """

    def __init__(self, hand: Hand, correspondence: FingertipMap, q_start: npt.ArrayLike | None = None) -> None:
        self.hand, self.correspondence = hand, correspondence
        self._frames = [hand.frame_id(name) for name in correspondence.fingers]
        self._collision = HandCollision(hand)
        q = hand.neutral if q_start is None else arrays.check_array(q_start, "q_start", (hand.n,))
        self.q = freeze(np.clip(q, hand.q_lower, hand.q_upper))
        if not self._is_clear(self.q):
            raise InvalidInput("q_start", self.q, f"a posture whose links are {correspondence.clearance:g} m apart")

    def step(self, tips_S: Mapping[str, npt.ArrayLike]) -> MappedPosture:
        """Return the posture for one frame of fingertips.

        Args:
            tips_S: (3,) fingertip of each of the source's fingers in the source's base, m.

        Raises:
            InvalidInput: a fingertip is missing or no place.
        """
        targets = self.correspondence.targets(tips_S)
        stacked = np.array(list(targets.values()))
        q = self._nearest(stacked)
        is_held_back = not self._is_clear(q)
        self.q = freeze(self._clear_part(q) if is_held_back else q)
        reached, _ = self.hand.model.frame_jacobians(self.q[None], self._frames)
        distance = np.linalg.norm(reached[0] - stacked, axis=1)
        return MappedPosture(self.q, dict(zip(targets, distance.tolist(), strict=True)), is_held_back)

    def _nearest(self, targets: Array) -> Array:
        """Return the posture nearest to targets (F, 3), m, within the limits."""
        hand, rho = self.hand, self.correspondence.smoothing
        q, damping = np.array(self.q), 1e-6
        cost, e, J = self._cost(q, targets)
        for _ in range(_STEPS):
            gradient = J.T @ e + rho**2 * (self.q - q)
            held = ((q <= hand.q_lower) & (gradient < 0.0)) | ((q >= hand.q_upper) & (gradient > 0.0))
            free = ~held
            H = J[:, free].T @ J[:, free] + (rho**2 + damping) * np.eye(int(free.sum()))
            step = np.zeros_like(q)
            step[free] = np.linalg.solve(H, gradient[free])
            tried = np.clip(q + step, hand.q_lower, hand.q_upper)
            new_cost, new_e, new_J = self._cost(tried, targets)
            if new_cost < cost:
                moved = float(np.abs(tried - q).max())
                q, cost, e, J, damping = tried, new_cost, new_e, new_J, max(damping / 10.0, 1e-9)
                if moved < _STEP_TOLERANCE:
                    break
            else:
                damping *= 10.0
                if damping > 1.0:
                    break
        return q

    def _cost(self, q: Array, targets: Array) -> tuple[float, Array, Array]:
        """Return the objective, the errors (3 F,) of the fingertips, m, and their Jacobian (3 F, n), m/rad."""
        p, J = self.hand.model.frame_jacobians(q[None], self._frames)
        e = (targets - p[0]).ravel()
        rest = self.correspondence.smoothing * (q - self.q)
        return float(0.5 * (e @ e + rest @ rest)), e, np.asarray(J[0, :, :3].reshape(len(e), -1))

    def _is_clear(self, q: Array) -> bool:
        """Return whether all links keep the clearance."""
        gaps = self._collision.link_gaps(q)
        return not gaps or gaps[0].distance >= self.correspondence.clearance

    def _clear_part(self, q: Array) -> Array:
        """Return a posture towards another one that keeps the clearance: each finger goes as far as it can, in turn."""
        now = np.array(self.q)
        for finger in self.hand.fingers:
            goal = now.copy()
            goal[list(finger.joints)] = q[list(finger.joints)]
            if not (goal != now).any():
                continue
            if self._is_clear(goal):
                now = goal
                continue
            low, high = 0.0, 1.0
            for _ in range(_BISECTIONS):
                middle = (low + high) / 2.0
                low, high = (middle, high) if self._is_clear(now + middle * (goal - now)) else (low, middle)
            now = now + low * (goal - now)
        return now

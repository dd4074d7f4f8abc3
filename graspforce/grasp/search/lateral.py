"""Candidates of lateral grasps: the object between the thumb's tip and the side of the index finger.

Many postures are drawn at once. A posture is suitable if the thumb's tip is beside a link of the index finger, and the distance
between both surfaces is the distance of two opposite points of the object. A candidate places the object with these points at
both surfaces. The object approaches the index finger until it touches; the thumb then closes onto the point opposite to this
contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.geometry import Solid
from graspforce.grasp.search.batch_kinematics import BatchKinematics
from graspforce.grasp.search.closing import GAP, ClosingFinger, TouchScene
from graspforce.grasp.search.opposite_points import OppositePoints, find_opposite_points, ray_widths
from graspforce.grasp.search.sampling import search_limits
from graspforce.hand.hand import Hand

_POSTURES = 3000  # that are drawn at once
_DRAWS = 40  # candidates from them
_PAIRS = 300
_SIDE_SHARE = 0.3  # of half its range around neutral, in which joints that do not close a finger are sampled
_CURL = (0.0, 0.9)  # of the way from the open to the closed end of the closing joints, for the index finger
_OTHER_CURLS = (0.6, 0.4, 0.2, 0.0)  # the same from neutral, for the other fingers; those without overlaps are taken
_SIDE_COS = 0.0  # least cosine between the axis of the finger's last joint, outwards, and the line to the thumb
_PREFERENCE = 2.0  # power of the share of the places, the best first, from which one is drawn
_PLACES = (0.1, 0.9)  # part of a link's length on which the object may be placed
_SHORTEST = 0.012  # m, of a link that the object may touch
_ASIDE = 0.008  # m: largest distance of the thumb from the plane across the link
_FIT = (-0.002, 0.008)  # m: distance of the surfaces less that of the opposite points
_LEAN = 0.1  # largest sine of the angle by which the thumb's last link leans over the object
_NORMAL_COS = 0.8  # least cosine between the normal at the index finger's contact and the line to the thumb: 37°
_SPINS = 4  # of the object about that line, of which the one with the largest gap to other links is taken
_TILT = 0.1  # rad: standard deviation of the object's turn about axes across the line
_APPROACH, _APPROACH_STEP = 0.02, 0.004  # m, from which the object approaches, and in steps
_OPEN, _PRESS = 0.012, 0.004  # m: the thumb starts before the surface, and aims behind it
_FAR = 0.015  # m, from the thumb's tip in the drawn posture, of a target that is not tried
_AIMS = 3  # targets of the thumb's tip, each nearer to a contact opposite to the index finger's
_STARTS = 4  # postures of the thumb, nearest to a target, from which its posture is computed
_ITERATIONS = 12  # of damped least squares
_DAMPING = 1e-5  # m²
_REACHED = 4e-3  # m: largest distance of the tip from its target; friction allows as much
_CONVERGED = 1e-4  # m
_STALLED = 0.98  # ratio of the distances after and before an iteration
_CLOSING_STEPS = 8


@dataclass(frozen=True, eq=False, slots=True)
class _Places:
    """Suitable postures with the places of the object.

    Attributes:
        q: (B, n) postures, rad.
        p: (B, 3) points on the axes of the index finger's links, in H, m.
        across: (B, 3) directions from these points to the thumb's tip.
        width: (B,) distance of the surfaces along them, m.
        thickness: (B,) distance of the link's surface from the point along them, m.
        thumb_tips: (B, 3) centres of the thumb's tip, m.
        leans: (B,) whether the thumb's last link leans over the object.
    """

    q: Array
    p: Array
    across: Array
    width: Array
    thickness: Array
    thumb_tips: Array
    leans: npt.NDArray[np.bool_]


class LateralSampler:
    """Random candidates of lateral grasps.

    Args:
        hand: the hand.
        shape: surface of the object.
        kinematics: of the hand.
        scene: the hand and the object.
        fingers: the joints that close the fingers.
        thumb: index of the thumb.
        first: index of the index finger.
    """

    def __init__(
        self,
        hand: Hand,
        shape: Solid,
        kinematics: BatchKinematics,
        scene: TouchScene,
        fingers: tuple[ClosingFinger, ...],
        thumb: int,
        first: int,
    ) -> None:
        self._hand, self._shape, self._kinematics, self._scene = hand, shape, kinematics, scene
        self._fingers, self._thumb, self._first = fingers, thumb, first
        self._limits = search_limits(hand)
        self._own = [j for j in hand.fingers[thumb].joints if j not in hand.common_joints]
        frames = np.array([body.frame for body in scene.bodies[:-1]])
        self._of_thumb = np.flatnonzero(np.isin(frames, fingers[thumb].frames))
        self._others = np.setdiff1d(np.arange(len(frames)), self._of_thumb)
        self._of_first = np.flatnonzero(np.isin(frames, fingers[first].frames))
        bases = hand.model.joint_origins(hand.neutral)[kinematics.first_links]
        others = [f for f in range(len(fingers)) if f not in (thumb, first)]
        self._neighbour = min(others, key=lambda f: float(np.linalg.norm(bases[f] - bases[first])), default=thumb)
        self._places: _Places | None = None
        self._pairs: OppositePoints | None = None
        self._batches = 0
        self._usable, self._drawn = np.zeros(0, dtype=np.intp), 0  # places without a known overlap, and candidates from them

    def sample(self, rng: np.random.Generator) -> tuple[Array, Array, Array] | None:
        """Return posture, position and axes of the object of a random candidate; None if it does not touch both fingers.

        Args:
            rng: random generator.
        """
        if self._pairs is None:
            self._pairs = find_opposite_points(self._shape, rng, _PAIRS)
        if self._places is None or not len(self._usable) or self._drawn >= _DRAWS:
            self._places, self._drawn = self._suitable_places(rng, self._pairs), 0
            self._batches += 1
            upright = np.flatnonzero(~self._places.leans)  # alone in every other batch
            self._usable = upright if self._batches % 2 and len(upright) else np.arange(len(self._places.q))
        places, b = self._places, self._draw_place(rng)
        if b is None:
            return None
        q, across = places.q[b], places.across[b]
        suitable = np.flatnonzero(_fits(places.width[b] - self._pairs.width))
        k = int(rng.choice(suitable))
        surface = places.p[b] + places.thickness[b] * across
        turns = [_axes_along(self._pairs.normal[k], across, rng) for _ in range(_SPINS)]
        near = [self._scene.part_gap(q, surface - R @ self._pairs.first[k], R, self._others) for R in turns]
        R_HO = turns[int(np.argmax(near))]
        placed = self._approach(q, surface - R_HO @ self._pairs.first[k], across, R_HO)
        if placed is None:
            return None
        point = self._opposite(q, placed, R_HO, across)
        if point is None:
            return None
        radius = float(self._kinematics.tip_radii[self._thumb])
        if np.linalg.norm(point[0] + radius * point[1] - places.thumb_tips[b]) > _FAR:
            return None
        closed = self._close(q, placed, R_HO, *point)
        return None if closed is None else (closed, placed, R_HO)

    def _draw_place(self, rng: np.random.Generator) -> int | None:
        """Return the index of a random place whose posture has no overlaps, preferably a lateral one; None without one."""
        assert self._places is not None  # made before
        self._drawn += 1
        while len(self._usable):
            k = int(rng.random() ** _PREFERENCE * len(self._usable))
            b = int(self._usable[k])
            if self._scene.link_gap(self._places.q[b]) >= 0.0:
                return b
            self._usable = np.delete(self._usable, k)
        return None

    def _suitable_places(self, rng: np.random.Generator, pairs: OppositePoints) -> _Places:
        """Return the postures in which the thumb's tip is beside a link of the index finger, with a pair that fits between."""
        q = self._draw_postures(rng)
        motion, links = self._kinematics.evaluate(q), self._kinematics.links
        chain, tips = self._fingers[self._first].frames, motion.tip_centres
        axis = motion.R_HL[chain[-1]] @ links[chain[-1]].axis
        outside = motion.p_HL[chain[-1]] - motion.p_HL[self._fingers[self._neighbour].frames[-1]]
        axis *= np.sign((axis * outside).sum(axis=1))[:, None]  # away from the next finger
        ends = np.stack([*(motion.p_HL[i] for i in chain), tips[:, self._first]], axis=1)
        thumb, found = tips[:, self._thumb], list[tuple[Array, ...]]()
        for k, link in enumerate(chain):
            along = ends[:, k + 1] - ends[:, k]
            length = np.linalg.norm(along, axis=1)
            if length.min() < _SHORTEST:
                continue
            along = along / length[:, None]
            share = ((thumb - ends[:, k]) * along).sum(axis=1)
            place = ends[:, k] + np.clip(share, _PLACES[0] * length, _PLACES[1] * length)[:, None] * along
            line = thumb - place
            aside = np.abs((line * along).sum(axis=1))
            line = line - (line * along).sum(axis=1)[:, None] * along
            distance = np.linalg.norm(line, axis=1)
            across = line / np.maximum(distance, 1e-9)[:, None]
            thickness = self._thickness(link, motion.R_HL[link], across)
            width = distance - thickness - self._kinematics.tip_radii[self._thumb]
            fits = _fits(width[:, None] - pairs.width).any(axis=1)
            cosine = (across * axis).sum(axis=1)
            base = motion.p_HL[self._fingers[self._thumb].frames[-1]] - thumb
            leans = (base * across).sum(axis=1) < -_LEAN * np.linalg.norm(base, axis=1)  # over the object
            kept = fits & (aside < _ASIDE) & (cosine > _SIDE_COS)
            found.append(
                (q[kept], place[kept], across[kept], width[kept], thickness[kept], thumb[kept], leans[kept], cosine[kept])
            )
        every = [np.concatenate(parts) for parts in zip(*found, strict=True)]
        free = np.flatnonzero(~self._overlaps(every[0]))
        order = free[np.argsort(-every.pop()[free], kind="stable")]  # the most lateral first
        return _Places(*(part[order] for part in every))

    def _draw_postures(self, rng: np.random.Generator) -> Array:
        """Return postures (B, n), rad: the other fingers curl together, and the thumb is anywhere in its limits."""
        hand, (lower, upper) = self._hand, self._limits
        q = np.tile(hand.neutral, (_POSTURES, 1))
        own = [j for j in hand.fingers[self._first].joints if j not in hand.common_joints]
        q[:, own] += _SIDE_SHARE * ((upper - lower)[own] / 2.0) * rng.uniform(-1.0, 1.0, (_POSTURES, len(own)))
        curl = rng.uniform(*_CURL, _POSTURES)
        others = self._other_curls()
        other = others[rng.integers(len(others), size=_POSTURES)]
        for f in range(len(self._fingers)):
            if f != self._thumb:
                self._bend(q, f, curl if f == self._first else other, f == self._first)
        q[:, self._own] = rng.uniform(lower[self._own], upper[self._own], (_POSTURES, len(self._own)))
        common = list(hand.common_joints)
        q[:, common] = hand.neutral[common]
        return np.clip(q, lower, upper)

    def _other_curls(self) -> Array:
        """Return the curls of the other fingers in which no links overlap, with the thumb and the index finger in neutral."""
        free = []
        for curl in _OTHER_CURLS:
            q = np.array(self._hand.neutral)[None]
            for f in range(len(self._fingers)):
                if f not in (self._thumb, self._first):
                    self._bend(q, f, np.array([curl]))
            if self._scene.link_gap(q[0]) >= 0.0:
                free.append(curl)
        return np.array(free or [0.0])

    def _bend(self, q: Array, f: int, curl: Array, is_from_open: bool = False) -> None:
        """Bend the closing joints of a finger in postures (B, n), by shares (B,) of the way from neutral or open to closed."""
        lower, upper = self._limits
        for j, sign in zip(self._fingers[f].joints, self._fingers[f].signs, strict=True):
            first, end = (lower[j], upper[j]) if sign > 0.0 else (upper[j], lower[j])
            start = first if is_from_open else self._hand.neutral[j]
            q[:, j] = start + curl * (end - start)

    def _overlaps(self, q: Array) -> npt.NDArray[np.bool_]:
        """Return whether spheres inside the thumb and inside other links overlap in postures (B, n); not those of neutral."""
        kinematics = self._kinematics
        of_thumb = kinematics.sphere_finger == self._thumb
        radii = np.concatenate([kinematics.sphere_radii[~of_thumb], kinematics.palm_radii])
        least = kinematics.sphere_radii[of_thumb][:, None] + radii
        gaps = []
        for each in (kinematics.evaluate(self._hand.neutral[None]), kinematics.evaluate(q)):
            others = np.concatenate([each.sphere_centres[:, ~of_thumb], each.palm_centres], axis=1)
            gaps.append(np.linalg.norm(each.sphere_centres[:, of_thumb, None] - others[:, None], axis=3) - least)
        return np.asarray(((gaps[1] < 0.0) & (gaps[0] >= 0.0)).any(axis=(1, 2)))

    def _thickness(self, link: int, R_HL: Array, across: Array) -> Array:
        """Return half the thickness of a link's shapes along directions (B, 3) in H, m; zero for a link without shapes."""
        found = np.zeros(len(across))
        for shape in self._kinematics.collision.shapes:
            if shape.link == link:
                local = np.abs(np.einsum("bji,bj->bi", R_HL @ shape.R_LS, across))
                found = np.maximum(found, (shape.size / 2.0 / np.maximum(local, 1e-9)).min(axis=1))
        return found

    def _approach(self, q: Array, p_HO: Array, across: Array, R_HO: Array) -> Array | None:
        """Return where the object touches the index finger first; None if it does not, or overlaps another link there."""
        start = p_HO + _APPROACH * across

        def gap(s: float) -> float:
            return self._scene.part_gap(q, start - s * across, R_HO, self._of_first)

        longest = 2.0 * _APPROACH
        s = self._scene.first_touch(gap, longest, _APPROACH_STEP)
        placed = start - s * across
        if s == 0.0 or s >= longest:
            return None
        gaps = self._scene.object_gaps(q, placed, R_HO, GAP)[0]
        return None if np.delete(gaps, self._of_thumb).min() < 0.0 else np.asarray(placed)

    def _opposite(self, q: Array, p_HO: Array, R_HO: Array, across: Array) -> tuple[Array, Array] | None:
        """Return the point opposite to the index finger's contact and the outward normal there, in H; None without one.

        There is none for a contact whose normal is far from the direction `across` the link.
        """
        gaps, points = self._scene.object_gaps(q, p_HO, R_HO, 1e-3)
        k = int(self._of_first[gaps[self._of_first].argmin()])
        p = self._shape.closest_points(((points[k, 1] - p_HO) @ R_HO)[None])
        gradient = self._shape._gradient(p)
        size = np.linalg.norm(gradient)
        if size == 0.0:
            return None
        inward = -gradient / size
        if (R_HO @ inward[0]) @ across < _NORMAL_COS:
            return None
        width, is_opposite = ray_widths(self._shape, p, inward)
        if not is_opposite[0]:
            return None
        end = self._shape.closest_points(p + width[0] * inward)
        out = self._shape._gradient(end)[0]
        return p_HO + R_HO @ end[0], R_HO @ (out / np.linalg.norm(out))

    def _close(self, q: Array, p_HO: Array, R_HO: Array, point: Array, out: Array) -> Array | None:
        """Return the posture in which the thumb touches the object near a point; None if it cannot."""
        target = point + float(self._kinematics.tip_radii[self._thumb]) * out
        postures, distances = self._approached(self._starts(q, target), target)
        for reached in postures[distances < _REACHED]:
            aim, closed = target, None
            for _ in range(_AIMS):
                touched = self._touch(reached, p_HO, R_HO, aim, out)
                if touched is None:
                    break
                closed = touched
                gaps, points = self._scene.object_gaps(closed, p_HO, R_HO, 1e-3)
                miss = point - points[int(self._of_thumb[gaps[self._of_thumb].argmin()]), 1]
                if np.linalg.norm(miss) < _REACHED / 2.0:
                    break
                aim = aim + miss - (miss @ out) * out
            if closed is not None:
                return closed
        return None

    def _touch(self, q: Array, p_HO: Array, R_HO: Array, aim: Array, out: Array) -> Array | None:
        """Return the posture in which the thumb first touches the object on the way to a target of its tip; None without one.

        Args:
            q: (n,) posture with the thumb near the target, rad.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object.
            aim: (3,) the tip's target in H, m.
            out: (3,) outward normal of the object there.
        """
        ends = aim + np.array([[_OPEN], [-_PRESS]]) * out
        (start, end), moving = self._approached(np.tile(q, (2, 1)), ends)[0], np.array(self._fingers[self._thumb].frames)

        def gap(s: float) -> float:
            return self._scene.least_gap(start + s * (end - start), p_HO, R_HO, moving)

        if gap(0.0) < GAP:
            return None
        s = self._scene.first_touch(gap, 1.0, 1.0 / _CLOSING_STEPS)
        return np.asarray(start + s * (end - start)) if s < 1.0 else None

    def _starts(self, q: Array, target: Array) -> Array:
        """Return a posture with the thumb's postures whose tips are nearest to a target."""
        assert self._places is not None  # made before
        distance = np.linalg.norm(self._places.thumb_tips - target, axis=1)
        nearest = np.argsort(distance, kind="stable")[:_STARTS]
        starts = np.tile(q, (1 + len(nearest), 1))
        starts[1:, self._own] = self._places.q[nearest][:, self._own]
        return starts

    def _approached(self, q: Array, target: Array) -> tuple[Array, Array]:
        """Return postures with the thumb's tip near points of H, (3,) or (B, 3), m, from postures (B, n), and its distances, m.

        The method is damped least squares.
        """
        (lower, upper), last = self._limits, np.full(len(q), np.inf)
        for k in range(_ITERATIONS + 1):
            motion = self._kinematics.evaluate(q)
            error = target - motion.tip_centres[:, self._thumb]
            distances = np.linalg.norm(error, axis=1)
            if k == _ITERATIONS or ((distances < _CONVERGED) | (distances > _STALLED * last)).all():
                break
            last = distances
            J = motion.linear_jacobians[:, self._thumb][:, :, self._own]
            step = J.swapaxes(1, 2) @ np.linalg.solve(J @ J.swapaxes(1, 2) + _DAMPING * np.eye(3), error[..., None])
            q = np.array(q)
            q[:, self._own] = np.clip(q[:, self._own] + step[..., 0], lower[self._own], upper[self._own])
        return q, distances


def _fits(play: Array) -> npt.NDArray[np.bool_]:
    """Return whether opposite points fit between two surfaces, from the distance that remains, m."""
    return np.asarray((play > _FIT[0]) & (play < _FIT[1]))


def _axes_along(normal: Array, across: Array, rng: np.random.Generator) -> Array:
    """Return random axes of the object that turn its normal into a direction near `across`, (3, 3)."""
    direction = across + _TILT * rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    spin = rng.uniform(0.0, 2.0 * np.pi)
    return np.asarray(_frame(direction, spin) @ _frame(normal, 0.0).T)


def _frame(z: Array, spin: float) -> Array:
    """Return axes (3, 3) whose third is a unit vector, with the first at an angle about it."""
    x = np.cross(z, np.eye(3)[int(np.abs(z).argmin())])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    return np.stack([np.cos(spin) * x + np.sin(spin) * y, np.cos(spin) * y - np.sin(spin) * x, z], axis=1)

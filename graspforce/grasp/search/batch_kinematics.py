"""Kinematics of many postures of one hand at once: tips, their Jacobians, and spheres along the fingers.

A search evaluates thousands of similar postures, so they are computed together. `Hand` computes the same numbers for one
posture.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array, freeze
from graspforce.grasp.search.link_spheres import LinkSphere, cover, finger_spheres
from graspforce.hand.collision import HandCollision
from graspforce.hand.hand import Hand
from graspforce.hand.kinematics.kinematic_tree import Link, Tip

_SINGULAR_RATIO = 1e-6  # smallest over largest tip speed below which a direction counts as impossible
_PLANAR_RATIO = 0.01  # the same for directions that a controller could use


@dataclass(frozen=True, eq=False, slots=True)
class PostureKinematics:
    """Tips and spheres of a hand in B postures.

    Attributes:
        tip_centres: (B, F, 3) centres of the tips of all F fingers in H, m.
        linear_jacobians: (B, F, 3, n) velocities of these centres per actuated joint rate, in H, m/rad.
        angular_jacobians: (B, F, 3, n) angular velocities of the tips per actuated joint rate, in H.
        sphere_centres: (B, S, 3) centres of the spheres of the fingers in H, m, finger by finger, from the base to the tip.
        palm_centres: (B, P, 3) centres of the spheres of the base and of links that carry several fingers, in H, m.
        p_HL: (B, 3) origin of each link in H, m.
        R_HL: (B, 3, 3) axes of each link in H.
    """

    tip_centres: Array
    linear_jacobians: Array
    angular_jacobians: Array
    sphere_centres: Array
    palm_centres: Array
    p_HL: list[Array]
    R_HL: list[Array]


class BatchKinematics:
    """The kinematic chains of a hand's fingers, evaluated in many postures at once.

    Attributes:
        links: the moving links.
        collision: the hand's collision shapes, for exact distances.
        tip_radii: (F,) radii of the tips, m; zero where the description gives none.
        tip_links: (F,) index of the link that carries each tip.
        first_links: (F,) index of the first link that belongs to each finger alone.
        own_links: (F,) indices of all of these, base first.
        blocked_joints: (n,) whether each joint belongs to a finger that overlaps the palm if all fingers are stretched.
        first_sphere: (F,) index of each finger's first sphere; its last one is the sphere of the tip.
        sphere_finger: (S,) index of each sphere's finger.
        sphere_radii: (S,) radii of the fingers' spheres, m.
        last_link_excess: (S,) how far each sphere on the link that carries the tip exceeds the tip's radius about the line from
            the link's joint to the tip, m; negative infinity for the other links, infinity for spheres about the tip.
        palm_radii: (P,) radii of the spheres of the palm, m.
        direction_counts: (F,) number of directions in which each finger can move its tip; 2 for a planar finger.
    """

    def __init__(self, hand: Hand) -> None:
        self._T, self._q0 = hand.T, hand.q0
        tree = hand.tree()
        self.links, self._tips = tree.links, tree.tips
        self._turns = [_rotation_terms(link) for link in tree.links]
        self._chains = [_chain(tree.links, tip) for tip in tree.tips]
        self.tip_radii = np.array([tip.radius or 0.0 for tip in tree.tips])
        self.tip_links = [tip.link for tip in tree.tips]
        self.collision = HandCollision(hand)
        shared = _shared_links(self._chains)
        own = [[i for i in chain if i not in shared] for chain in self._chains]
        self.first_links = [chain[0] for chain in own]
        self.own_links = [tuple(chain) for chain in own]
        self.blocked_joints = _blocked_joints(hand, self.collision, own)
        spheres = [finger_spheres(tree, chain, tip, self.collision) for chain, tip in zip(own, tree.tips, strict=True)]
        self.first_sphere = np.cumsum([0, *(len(each) for each in spheres)])[:-1]
        self.sphere_finger = np.repeat(np.arange(len(spheres)), [len(each) for each in spheres])
        self._spheres = _SphereGroups(sphere for each in spheres for sphere in each)
        self.sphere_radii = self._spheres.radii
        self.last_link_excess = np.concatenate(
            [_last_link_excess(each, tip) for each, tip in zip(spheres, tree.tips, strict=True)]
        )
        palm = [shape for shape in self.collision.shapes if shape.link in shared or shape.link == -1]
        covers = [(shape.link, *cover(shape)) for shape in palm]
        self._palm = _SphereGroups(LinkSphere(link, p, radius) for link, centres, radius in covers for p in centres)
        self.palm_radii = self._palm.radii
        spread = np.linspace(0.2, 0.8, 9)[:, None] * (hand.q_upper - hand.q_lower) + hand.q_lower
        U, sigma, _ = np.linalg.svd(self.evaluate(spread).linear_jacobians)
        self.direction_counts = np.count_nonzero(sigma > _SINGULAR_RATIO * sigma[..., :1], axis=2).max(axis=0)
        # directions that each finger cannot move its tip in, from the postures of the spread that are not singular
        self._impossible = [
            np.vstack([U[b, f, :, d:].T for b in range(len(spread)) if sigma[b, f, d - 1] > _PLANAR_RATIO * sigma[b, f, 0]])
            for f, d in enumerate(self.direction_counts)
        ]

    def evaluate(self, q: Array) -> PostureKinematics:
        """Compute tips, Jacobians and spheres in postures.

        Args:
            q: (B, n) postures, rad.
        """
        x = q @ self._T.T + self._q0  # all joint positions, rad
        p, R = self._link_poses(x)
        tips = [p[tip.link] + R[tip.link] @ tip.p_LF for tip in self._tips]
        linear = np.zeros((len(q), len(tips), 3, len(self.links)))
        angular = np.zeros_like(linear)
        for f, chain in enumerate(self._chains):
            origins = np.stack([p[i] for i in chain] + [tips[f]], axis=1)
            axes = np.stack([R[i] @ self.links[i].axis for i in chain], axis=1)
            slides = np.array([self.links[i].is_prismatic for i in chain])[:, None]
            linear[:, f, :, chain] = np.where(slides, axes, np.cross(axes, tips[f][:, None] - origins[:, :-1])).swapaxes(0, 1)
            angular[:, f, :, chain] = np.where(slides, 0.0, axes).swapaxes(0, 1)
        return PostureKinematics(
            tip_centres=np.stack(tips, axis=1),
            linear_jacobians=linear @ self._T,
            angular_jacobians=angular @ self._T,
            sphere_centres=self._spheres.centres(p, R),
            palm_centres=self._palm.centres(p, R),
            p_HL=p,
            R_HL=R,
        )

    def travel_directions(self, fingers: tuple[int, ...]) -> Array:
        """Return the directions along which some fingers together can move an object.

        Each axis of H is turned to the nearest direction in which every one of the fingers can move its tip. A planar finger
        never leaves its plane. So there are three directions for fingers without such a limit, fewer where two axes turn to
        the same direction, and none where the fingers have no direction in common.

        Args:
            fingers: indices of the fingers.

        Returns:
            (K, 3) unit vectors in H, K ≤ 3.
        """
        impossible = np.vstack([self._impossible[f] for f in fingers])
        _, sigma, rows = np.linalg.svd(np.vstack([impossible, np.zeros((3, 3))]))
        common = rows[np.count_nonzero(sigma > _PLANAR_RATIO * max(1.0, sigma[0])) :]
        found: list[Array] = []
        for direction in common.T @ common:
            size = float(np.linalg.norm(direction))
            if size > _PLANAR_RATIO and all(abs(direction @ other) < (1.0 - _PLANAR_RATIO) * size for other in found):
                found.append(direction / size)
        return np.array(found).reshape(-1, 3)

    def _link_poses(self, x: Array) -> tuple[list[Array], list[Array]]:
        """Return origins (B, 3), m, and axes (B, 3, 3) in H of every link, at joint positions x (B, n_full)."""
        p: list[Array] = []
        R: list[Array] = []
        for i, link in enumerate(self.links):
            constant, sine, versine = self._turns[i]
            R_PL = constant + np.sin(x[:, i, None, None]) * sine + (1.0 - np.cos(x[:, i, None, None])) * versine
            p_PL = np.broadcast_to(link.p_PL, (len(x), 3))
            if link.is_prismatic:
                p_PL = p_PL + x[:, i, None] * (link.R_PL @ link.axis)
                R_PL = np.broadcast_to(link.R_PL, (len(x), 3, 3))
            if link.parent >= 0:
                p_PL, R_PL = p[link.parent] + (R[link.parent] @ p_PL[..., None])[..., 0], R[link.parent] @ R_PL
            p.append(p_PL)
            R.append(R_PL)
        return p, R


def palm_normal(hand: Hand, kinematics: BatchKinematics, R_HP: Array) -> Array:
    """Return the axis of the palm nearest to the mean direction from the fingers' bases to their tips in the neutral posture.

    Args:
        hand: the hand without its common joints.
        kinematics: its kinematics.
        R_HP: (3, 3) axes of the palm in H.
    """
    bases = hand.model.joint_origins(hand.neutral)[kinematics.first_links]
    direction = kinematics.evaluate(hand.neutral[None]).tip_centres[0].mean(axis=0) - bases.mean(axis=0)
    along = direction @ R_HP
    axis = np.abs(along).argmax()
    return freeze(np.sign(along[axis]) * R_HP[:, axis])


def rotations(v: Array) -> Array:
    """Return the rotations by rotation vectors: exp(v̂) = 1 + sin θ/θ v̂ + (1 − cos θ)/θ² v̂², θ = ‖v‖.

    Args:
        v: (B, 3) rotation vectors, rad.

    Returns:
        (B, 3, 3).
    """
    theta = np.linalg.norm(v, axis=1)[:, None, None]
    K = np.zeros((len(v), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    K -= K.transpose(0, 2, 1)
    return np.asarray(np.eye(3) + np.sinc(theta / np.pi) * K + 0.5 * np.sinc(theta / (2.0 * np.pi)) ** 2 * K @ K)


def _rotation_terms(link: Link) -> tuple[Array, Array, Array]:
    """Return A, B, C of R_PL exp(x â) = A + sin x B + (1 − cos x) C, with a the joint axis."""
    x, y, z = link.axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return link.R_PL, link.R_PL @ K, link.R_PL @ K @ K


def _chain(links: tuple[Link, ...], tip: Tip) -> list[int]:
    """Return the indices of the links from the base to a tip."""
    chain, i = [], tip.link
    while i >= 0:
        chain.append(i)
        i = links[i].parent
    return chain[::-1]


def _shared_links(chains: list[list[int]]) -> set[int]:
    """Return the links in the chains of several fingers, such as a wrist and the folds of a palm."""
    return {i for i in set().union(*chains) if sum(i in chain for chain in chains) > 1}


def _blocked_joints(hand: Hand, collision: HandCollision, own: list[list[int]]) -> npt.NDArray[np.bool_]:
    """Return whether each joint belongs to a finger that overlaps the palm if all fingers are stretched, (n,)."""
    frames = {body.name: body.frame for body in collision.bodies}
    moving, blocked = {link for links in own for link in links}, np.zeros(hand.n, dtype=bool)
    for gap in collision.link_gaps(np.clip(0.0, hand.q_lower, hand.q_upper)):
        ends = {frames[gap.first], frames[gap.second]}
        if gap.distance < 0.0 and ends - moving:
            for finger, links in zip(hand.fingers, own, strict=True):
                blocked[list(finger.joints)] |= bool(ends & set(links))
    return blocked


def _last_link_excess(spheres: list[LinkSphere], tip: Tip) -> Array:
    """Return how far the spheres of a finger exceed the tip's radius about the axis of the last link; see the class."""
    radius, length = tip.radius or 0.0, float(np.linalg.norm(tip.p_LF))
    axis = tip.p_LF / length if length > 0.0 else np.zeros(3)
    excess = []
    for sphere in spheres:
        if sphere.link != tip.link:
            excess.append(-np.inf)
        elif np.linalg.norm(sphere.p - tip.p_LF) <= radius:
            excess.append(np.inf)
        else:
            excess.append(float(np.linalg.norm(np.cross(sphere.p, axis))) + sphere.radius - radius)
    return np.array(excess)


class _SphereGroups:
    """Spheres by the link that carries them, in the given order."""

    def __init__(self, spheres: Iterable[LinkSphere]) -> None:
        every = list(spheres)
        self.radii = np.array([sphere.radius for sphere in every])
        links = np.array([sphere.link for sphere in every], dtype=np.intp)
        p = np.array([sphere.p for sphere in every]).reshape(-1, 3)
        self._groups = [(link, np.flatnonzero(links == link), p[links == link]) for link in sorted(set(links.tolist()))]

    def centres(self, p: list[Array], R: list[Array]) -> Array:
        """Return the centres (B, S, 3) in H at link origins p (B, 3), m, and axes R (B, 3, 3) of every link."""
        found = np.empty((len(p[0]), len(self.radii), 3))
        for link, index, local in self._groups:
            found[:, index] = local if link < 0 else p[link][:, None] + local @ R[link].swapaxes(1, 2)
        return found

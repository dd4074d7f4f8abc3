"""Kinematics of many postures of one hand at once: tips, their Jacobians, and spheres along the fingers.

A search evaluates thousands of similar postures, so they are computed together. `Hand` computes the same numbers for one
posture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.hand.kinematic_tree import Link, Tip

_SINGULAR_RATIO = 1e-6  # smallest over largest tip speed below which a direction counts as impossible
_PLANAR_RATIO = 0.01  # the same for directions that a controller could use


@dataclass(frozen=True, eq=False, slots=True)
class PostureKinematics:
    """Tips and spheres of a hand in B postures.

    Attributes:
        tip_centres: (B, F, 3) centres of the tips of all F fingers in H, m.
        linear_jacobians: (B, F, 3, n) velocities of these centres per actuated joint rate, in H, m/rad.
        angular_jacobians: (B, F, 3, n) angular velocities of the tips per actuated joint rate, in H.
        sphere_centres: (B, S, 3) centres of the spheres along the links in H, m, finger by finger, from the base to the tip.
    """

    tip_centres: Array
    linear_jacobians: Array
    angular_jacobians: Array
    sphere_centres: Array


class BatchKinematics:
    """The kinematic chains of a hand's fingers, evaluated in many postures at once.

    Attributes:
        tip_radii: (F,) radii of the tips, m; zero where the description gives none. The links get the same thickness.
        first_sphere: (F,) index of each finger's first sphere.
        sphere_finger: (S,) index of each sphere's finger.
        on_last_link: (S,) true for a sphere on the link that carries the tip, beyond the link's joint.
        is_tip_sphere: (S,) true for the sphere of the tip itself.
        direction_counts: (F,) number of directions in which each finger can move its tip; 2 for a planar finger.
    """

    def __init__(self, hand: Hand) -> None:
        self._T, self._q0 = hand.T, hand.q0
        tree = hand.tree()
        self._links, self._tips = tree.links, tree.tips
        self._turns = [_rotation_terms(link) for link in tree.links]
        self._chains = [_chain(tree.links, tip) for tip in tree.tips]
        self.tip_radii = np.array([tip.radius or 0.0 for tip in tree.tips])
        shared = _shared_links(self._chains)
        places = [_sphere_positions(tree.links, chain, tip, shared) for chain, tip in zip(self._chains, tree.tips, strict=True)]
        self._sphere_positions = places
        self.first_sphere = np.cumsum([0, *(len(each) for each in places)])[:-1]
        self.sphere_finger = np.repeat(np.arange(len(places)), [len(each) for each in places])
        self.is_tip_sphere = np.array([share == 1.0 for each in places for _, share in each])
        self.on_last_link = np.array([k == each[-1][0] and share > 0.0 for each in places for k, share in each])
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
        linear = np.zeros((len(q), len(tips), 3, len(self._links)))
        angular = np.zeros_like(linear)
        sphere_centres = []
        for f, chain in enumerate(self._chains):
            origins = np.stack([p[i] for i in chain] + [tips[f]], axis=1)
            axes = np.stack([R[i] @ self._links[i].axis for i in chain], axis=1)
            slides = np.array([self._links[i].is_prismatic for i in chain])[:, None]
            linear[:, f, :, chain] = np.where(slides, axes, np.cross(axes, tips[f][:, None] - origins[:, :-1])).swapaxes(0, 1)
            angular[:, f, :, chain] = np.where(slides, 0.0, axes).swapaxes(0, 1)
            k = np.array([k for k, _ in self._sphere_positions[f]])
            share = np.array([[share] for _, share in self._sphere_positions[f]])
            sphere_centres.append(origins[:, k] + share * (origins[:, k + 1] - origins[:, k]))
        return PostureKinematics(
            tip_centres=np.stack(tips, axis=1),
            linear_jacobians=linear @ self._T,
            angular_jacobians=angular @ self._T,
            sphere_centres=np.concatenate(sphere_centres, axis=1),
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
        for i, link in enumerate(self._links):
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


def _sphere_positions(links: tuple[Link, ...], chain: list[int], tip: Tip, shared: set[int]) -> list[tuple[int, float]]:
    """Return the spheres of a finger: (index in the chain, fraction of the distance to the next joint or the tip).

    Neighbouring spheres are at most one radius apart. Between two of them a corner can come at most 0.13 radii closer to the
    axis of the link than one radius. Links that carry several fingers have no spheres.
    """
    ends = [links[i].p_PL for i in chain[1:]] + [tip.p_LF]
    counts = [max(1, int(np.ceil(np.linalg.norm(end) / tip.radius))) if tip.radius else 2 for end in ends]
    own = [k for k, i in enumerate(chain) if i not in shared]
    return [(k, j / counts[k]) for k in own for j in range(counts[k])] + [(len(counts) - 1, 1.0)]

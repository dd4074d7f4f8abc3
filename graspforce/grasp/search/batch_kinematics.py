"""Many postures of one hand at once: where its tips stand, how they move, and the spheres that fill its fingers.

A search looks at thousands of postures, most of them close to each other, so they are worked out together; `Hand` gives the
same numbers, one posture at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.hand.kinematic_tree import Link, Tip

_FIXED = 1e-6  # of the speed in the best direction: below it a finger cannot move its tip
_PLANE = 0.01  # likewise, for what a controller makes of it


@dataclass(frozen=True, eq=False, slots=True)
class PostureKinematics:
    """B postures.

    Attributes:
        tips: (B, F, 3) the middles of all fingers' tips in H, m.
        jacobians: (B, F, 3, n) the tips' velocities per actuated joint rate, in H, m/rad.
        spins: (B, F, 3, n) their angular velocities per actuated joint rate, in H.
        spheres: (B, S, 3) middles of spheres along the links, m, finger by finger, each from the base to the tip's ball.
    """

    tips: Array
    jacobians: Array
    spins: Array
    sphere_centres: Array


class BatchKinematics:
    """A hand as chains of links.

    Attributes:
        radii: (F,) of the tips' balls, m, zero where the description gives none. The links are taken to be as thick.
        first: (F,) where each finger's spheres begin.
        owner: (S,) the finger of each sphere.
        last: (S,) whether a sphere lies on a link that carries a tip, beyond its joint.
        tip: (S,) whether it is the tip's ball.
        directions: (F,) in how many a finger can move its tip: two where it is planar.
    """

    def __init__(self, hand: Hand) -> None:
        self._T, self._q0 = hand.T, hand.q0
        tree = hand.tree()
        self._links = tree.links
        self._turns = [_turn(link) for link in tree.links]
        self._tips = tree.tips
        self._chains = [_chain(tree.links, tip) for tip in tree.tips]
        self.radii = np.array([tip.radius or 0.0 for tip in tree.tips])
        along = self._sphere_positions = [
            _sphere_positions(tree.links, c, tip) for c, tip in zip(self._chains, tree.tips, strict=True)
        ]
        self.first = np.cumsum([0, *(len(each) for each in along)])[:-1]
        self.sphere_finger = np.repeat(np.arange(len(along)), [len(each) for each in along])
        self.tip = np.array([x == 1.0 for each in along for _, x in each])
        self.on_last_link = np.array([k == each[-1][0] and x > 0.0 for each in along for k, x in each])
        spread = np.linspace(0.2, 0.8, 9)[:, None] * (hand.q_upper - hand.q_lower) + hand.q_lower
        U, sigma, _ = np.linalg.svd(self.postures(spread).jacobians, full_matrices=False)
        self.directions = np.count_nonzero(sigma > _FIXED * sigma[..., :1], axis=2).max(axis=0)
        # across what each finger can move in, at some posture of the spread that is not singular
        self._lost = [
            np.vstack([U[b, f, :, d:].T for b in range(len(spread)) if sigma[b, f, d - 1] > _PLANE * sigma[b, f, 0]])
            for f, d in enumerate(self.directions)
        ]

    def postures(self, q: Array) -> PostureKinematics:
        """The postures q (B, n), rad."""
        x = q @ self._T.T + self._q0
        places: list[Array] = []
        turns: list[Array] = []
        for i, link in enumerate(self._links):
            still, sine, versine = self._turns[i]
            R = still + np.sin(x[:, i, None, None]) * sine + (1.0 - np.cos(x[:, i, None, None])) * versine
            p = np.broadcast_to(link.p_PL, (len(q), 3))
            if link.is_prismatic:
                p, R = p + x[:, i, None] * (link.R_PL @ link.axis), np.broadcast_to(link.R_PL, (len(q), 3, 3))
            if link.parent >= 0:
                p, R = places[link.parent] + (turns[link.parent] @ p[..., None])[..., 0], turns[link.parent] @ R
            places.append(p)
            turns.append(R)
        tips = [places[tip.link] + turns[tip.link] @ tip.p_LF for tip in self._tips]
        J = np.zeros((len(q), len(tips), 3, len(self._links)))
        spins = np.zeros_like(J)
        sphere_centres = []
        for f, chain in enumerate(self._chains):
            at = np.stack([places[i] for i in chain] + [tips[f]], axis=1)
            axes = np.stack([turns[i] @ self._links[i].axis for i in chain], axis=1)
            is_prismatic = np.array([self._links[i].is_prismatic for i in chain])[:, None]
            J[:, f, :, chain] = np.where(is_prismatic, axes, np.cross(axes, tips[f][:, None] - at[:, :-1])).swapaxes(0, 1)
            spins[:, f, :, chain] = np.where(is_prismatic, 0.0, axes).swapaxes(0, 1)
            k, share = (
                np.array([k for k, _ in self._sphere_positions[f]]),
                np.array([[share] for _, share in self._sphere_positions[f]]),
            )
            sphere_centres.append(at[:, k] + share * (at[:, k + 1] - at[:, k]))
        return PostureKinematics(np.stack(tips, axis=1), J @ self._T, spins @ self._T, np.concatenate(sphere_centres, axis=1))

    def travel_directions(self, fingers: tuple[int, ...]) -> Array:
        """(K, 3) unit vectors in H: its axes, each turned to the nearest direction that all of some fingers can move in.

        A planar finger cannot leave its plane: no posture changes that, so what is across it is no way. Three where every
        finger moves its tip every way, fewer where axes turn to the same direction, none where nothing is common to all.
        """
        lost = np.vstack([self._lost[f] for f in fingers])
        _, sigma, rows = np.linalg.svd(np.vstack([lost, np.zeros((3, 3))]))
        common = rows[np.count_nonzero(sigma > _PLANE * max(1.0, sigma[0])) :]
        found: list[Array] = []
        for direction in common.T @ common:
            size = float(np.linalg.norm(direction))
            if size > _PLANE and all(abs(direction @ other) < (1.0 - _PLANE) * size for other in found):
                found.append(direction / size)
        return np.array(found).reshape(-1, 3)


def rotations(v: Array) -> Array:
    """(B, 3, 3) the rotations about and by the vectors v (B, 3), rad: exp(v̂) = 1 + sin θ/θ v̂ + (1 − cos θ)/θ² v̂²."""
    theta = np.linalg.norm(v, axis=1)[:, None, None]
    K = np.zeros((len(v), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    K -= K.transpose(0, 2, 1)
    return np.asarray(np.eye(3) + np.sinc(theta / np.pi) * K + 0.5 * np.sinc(theta / (2.0 * np.pi)) ** 2 * K @ K)


def _turn(link: Link) -> tuple[Array, Array, Array]:
    """A, B, C of R_PL exp(x â) = A + sin x B + (1 − cos x) C."""
    x, y, z = link.axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return link.R_PL, link.R_PL @ K, link.R_PL @ K @ K


def _chain(links: tuple[Link, ...], tip: Tip) -> list[int]:
    """The links that carry a tip, base first."""
    chain, i = [], tip.link
    while i >= 0:
        chain.append(i)
        i = links[i].parent
    return chain[::-1]


def _sphere_positions(links: tuple[Link, ...], chain: list[int], tip: Tip) -> list[tuple[int, float]]:
    """Where spheres sit: (place in the chain, share of the way to the next joint or the tip).

    They are at most a radius apart, so that a corner between two of them is at most 0.13 radii nearer to the link's axis.
    """
    ends = [links[i].p_PL for i in chain[1:]] + [tip.p_LF]
    counts = [max(1, int(np.ceil(np.linalg.norm(end) / tip.radius))) if tip.radius else 2 for end in ends]
    return [(k, j / count) for k, count in enumerate(counts) for j in range(count)] + [(len(counts) - 1, 1.0)]

"""Random candidates of the grasp search."""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.grasp.search.candidates import Candidates, Indices
from graspforce.grasp.search.faces import FaceDistances
from graspforce.grasp.search.goal import SearchGoal
from graspforce.grasp.search.prior import PosturePrior
from graspforce.grasp.search.side_conditions import OPPOSED_COS
from graspforce.hand.hand import Hand

_SAMPLES = 300  # random candidates for each set of fingers
_LIMIT_RATIO = 0.05  # fraction of its range that each joint keeps from its limits
_POSTURE_SPREAD = 0.6  # fraction of half its range around rest in which a joint is sampled


def sample_candidates(goal: SearchGoal, rng: np.random.Generator, prior: PosturePrior | None = None) -> Candidates:
    """Sample postures, with the object between one finger and the others and one of its axes along the line.

    Args:
        goal: the least-squares problem.
        rng: random generator.
        prior: distribution of the postures, with the joints of the goal's hand; by default uniform around rest.
    """
    B, N, hand = _SAMPLES, len(goal.fingers), goal.hand
    half = (hand.q_upper - hand.q_lower) / 2.0
    lower, upper = search_limits(hand)
    spread = _POSTURE_SPREAD * half
    q = goal.rest + spread * rng.uniform(-1.0, 1.0, (B, hand.n)) if prior is None else prior.sample(B, rng)
    q = np.clip(q, lower, upper)
    tips = goal.tip_centres(q)
    rows, alone = np.arange(B), rng.integers(1 if goal.requirements.side.opposing else N, size=B)
    one = tips[rows, alone]
    others = (tips.sum(axis=1) - one) / (N - 1)
    p_HO = (one + others) / 2.0
    R_HO = random_axes(one - others, rng)
    weights = np.full((B, N), 0.5 / (N - 1))  # λ: the single finger balances the others
    weights[rows, alone] = 0.5
    p_O = ((tips - p_HO[:, None]) @ R_HO).reshape(-1, 3)
    faces = goal.rough_faces(p_O)
    face = faces.face_distance.argmax(axis=1).reshape(B, N)
    if goal.requirements.side.opposing:
        face = _opposed(face, faces, goal.requirements.side.opposing)
    return Candidates(np.hstack([q, p_HO, np.zeros((B, 3)), weights]), R_HO, face)


def _opposed(face: Indices, faces: FaceDistances, opposing: int) -> Indices:
    """Return the faces of candidates, (B, N), with faces for the opposing fingers that oppose the first finger's.

    Args:
        face: (B, N) nearest face of each finger.
        faces: distances of the fingertips, B N points.
        opposing: number of fingers, after the first, that oppose it.
    """
    (B, N), P = face.shape, faces.face_distance.shape[1]
    distance, normal = faces.face_distance.reshape(B, N, P), faces.normal.reshape(B, N, P, 3)
    first = normal[np.arange(B), 0, face[:, 0]]
    opposed, chosen = -(normal @ first[:, None, :, None])[..., 0] > OPPOSED_COS, face.copy()
    nearest = np.where(opposed, distance, -np.inf).argmax(axis=2)
    for k in range(1, 1 + opposing):
        has_one = opposed[:, k].any(axis=1)
        chosen[has_one, k] = nearest[has_one, k]
    return np.asarray(chosen)


def random_axes(v: Array, rng: np.random.Generator) -> Array:
    """Return axes (B, 3, 3), a random one of them along each vector, the others at a random angle about it.

    Args:
        v: (B, 3) vectors.
        rng: random generator.
    """
    B = len(v)
    x = v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12)
    y = np.cross(x, rng.normal(size=(B, 3)))
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    axes = np.stack([x, y, np.cross(x, y)], axis=-1)
    first = rng.integers(3, size=B)
    return np.asarray(np.take_along_axis(axes, ((np.arange(3) - first[:, None]) % 3)[:, None, :], axis=2))


def search_limits(hand: Hand) -> tuple[Array, Array]:
    """Return the joint limits of the search, rad, inside the joints' own.

    Args:
        hand: the hand.
    """
    margin = _LIMIT_RATIO * (hand.q_upper - hand.q_lower)
    return hand.q_lower + margin, hand.q_upper - margin

"""Inverse kinematics of one finger for a tip position: bounded, damped Newton steps from several starts.

Minimises ½‖p(q) − p*‖² over lower ≤ q ≤ upper by the method of Levenberg and Marquardt. With e = p* − p(q), each step d solves

    (JᵀJ + λ 1) d = Jᵀ e

for the joints that the gradient does not hold at a limit, and is clipped to the limits. λ grows after a step that does not
reduce ‖e‖. The Newton iteration of the DLR-HIT II dual-platform study (algorithm 1) has neither damping nor limits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array

REACH_TOLERANCE = 1e-6  # m, of a reached target: below the resolution of a hand's encoders
_STEP_TOLERANCE = 1e-10  # m, where the steps end: far below REACH_TOLERANCE, so that paths of solutions are smooth
_MAX_STEPS = 100
_RANDOM_STARTS = 24  # tried after the starts of the caller

TipFunction = Callable[[Array], tuple[Array, Array]]  # q → tip position (3,), m, and its Jacobian (3, m), m/rad


@dataclass(frozen=True, eq=False, slots=True)
class IkResult:
    """The posture of a finger nearest to the target.

    Attributes:
        q: (m,) joint positions of the finger, rad.
        p: (3,) tip position, m.
        distance: distance of the tip from the target, m.
    """

    q: Array
    p: Array
    distance: float


def solve(tip: TipFunction, target: Array, lower: Array, upper: Array, starts: Iterable[Array]) -> IkResult:
    """Return the first posture that reaches the target, or the nearest one if none reaches it.

    Args:
        tip: kinematics of the tip.
        target: (3,) p*, m.
        lower: (m,) least joint positions, rad.
        upper: (m,) largest joint positions, rad.
        starts: postures to start from, in order; those after the first that reaches are not computed.
    """
    candidates = _starts(starts, lower, upper)
    best = _minimise(tip, target, lower, upper, next(candidates))
    while best.distance > REACH_TOLERANCE and (start := next(candidates, None)) is not None:
        result = _minimise(tip, target, lower, upper, start)
        if result.distance < best.distance:
            best = result
    return best


def _starts(given: Iterable[Array], lower: Array, upper: Array) -> Iterator[Array]:
    """Yield the given starts inside the limits, the middle of the limits, and random postures."""
    yield from (np.clip(start, lower, upper) for start in given)
    yield (lower + upper) / 2.0
    shares = np.random.default_rng(0).uniform(size=(_RANDOM_STARTS, len(lower)))  # the same in every call
    yield from lower + shares * (upper - lower)


def _minimise(tip: TipFunction, target: Array, lower: Array, upper: Array, q: Array) -> IkResult:
    """Descend from one start."""
    p, J = tip(q)
    e = target - p
    if not len(q):
        return IkResult(q, p, float(np.linalg.norm(e)))  # no joint may move
    damping = 1e-3  # λ, divided by the largest diagonal entry of JᵀJ
    for _ in range(_MAX_STEPS):
        gradient = J.T @ e
        free = ~(((q <= lower) & (gradient < 0)) | ((q >= upper) & (gradient > 0)))
        scale = float((J * J).sum(axis=0).max())
        if np.linalg.norm(e) <= _STEP_TOLERANCE or not free.any() or np.abs(gradient[free]).max() <= 1e-14 * max(scale, 1e-12):
            break
        step = np.zeros_like(q)
        J_free = J[:, free]
        step[free] = np.linalg.solve(J_free.T @ J_free + damping * scale * np.eye(int(free.sum())), gradient[free])
        q_next = np.clip(q + step, lower, upper)
        p_next, J_next = tip(q_next)
        if np.linalg.norm(target - p_next) < np.linalg.norm(e):
            q, p, J, e = q_next, p_next, J_next, target - p_next
            damping = max(damping / 10.0, 1e-14)
        elif damping > 1e6:
            break
        else:
            damping *= 10.0
    return IkResult(q, p, float(np.linalg.norm(e)))

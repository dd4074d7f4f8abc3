"""Where the joints of one finger must stand for its tip to be at a point: bounded, damped Newton steps from several starts.

Minimises ½‖p(q) − p*‖² over lower ≤ q ≤ upper. Each step solves (JᵀJ + λ 1) d = Jᵀ e on the joints that the gradient does not
hold at a limit, and is cut at the limits; λ grows where a step does not bring the tip nearer (Levenberg and Marquardt, with
the active set of a projected gradient). Source: 002, Algorithm 1, mended: its update is written back, and limits are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array

REACH_TOLERANCE = 1e-6  # m: a tip this near is there; a thousandth of what a hand's encoders resolve
_STEP_TOLERANCE = 1e-10  # m: where the steps stop, so that a path of answers is smooth to well below REACHED
_STEPS = 100
_STARTS = 24  # spread postures tried when those of the caller fail


@dataclass(frozen=True, eq=False, slots=True)
class IkResult:
    """The best posture q of the finger, its tip p (3,) in m, and how far that is from the target, m."""

    q: Array
    p: Array
    distance: float


def solve(
    tip: Callable[[Array], tuple[Array, Array]], target: Array, lower: Array, upper: Array, starts: Sequence[Array]
) -> IkResult:
    """The first posture that reaches the target, or the nearest of all that were tried.

    Args:
        tip: q → p (3,) in m, and its Jacobian (3, m) in m/rad.
        target: p* (3,), m.
        lower, upper: (m,) joint limits, rad.
        starts: postures to start from, the caller's first.
    """
    best: IkResult | None = None
    for start in _starts(starts, lower, upper):
        found = _minimise(tip, target, lower, upper, start)
        if best is None or found.distance < best.distance:
            best = found
        if best.distance <= REACH_TOLERANCE:
            break
    assert best is not None  # there is always a start
    return best


def _starts(given: Sequence[Array], lower: Array, upper: Array) -> Iterator[Array]:
    yield from (np.clip(start, lower, upper) for start in given)
    yield (lower + upper) / 2.0
    spread = np.random.default_rng(0).uniform(size=(_STARTS, len(lower)))  # the same on every call
    yield from lower + spread * (upper - lower)


def _minimise(tip: Callable[[Array], tuple[Array, Array]], target: Array, lower: Array, upper: Array, q: Array) -> IkResult:
    p, J = tip(q)
    e = target - p
    damping = 1e-3  # of JᵀJ's largest diagonal entry
    for _ in range(_STEPS):
        pull = J.T @ e
        free = ~(((q <= lower) & (pull < 0)) | ((q >= upper) & (pull > 0)))
        scale = float((J * J).sum(axis=0).max())
        if np.linalg.norm(e) <= _STEP_TOLERANCE or not free.any() or np.abs(pull[free]).max() <= 1e-14 * max(scale, 1e-12):
            break
        step = np.zeros_like(q)
        J_free = J[:, free]
        step[free] = np.linalg.solve(J_free.T @ J_free + damping * scale * np.eye(int(free.sum())), pull[free])
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

"""Refinement of one candidate of the grasp search by least squares, in the components of a prior or in all variables."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from graspforce.core.arrays import Array
from graspforce.grasp.search.candidates import Candidates
from graspforce.grasp.search.goal import SearchGoal
from graspforce.grasp.search.prior import PosturePrior
from graspforce.grasp.search.sampling import search_limits

_PROJECTION_STEPS = 8  # of Newton's method onto exact contact
_DIFFERENCE_STEP = 1e-7  # rad and m, of forward differences
_CONTACT_TOLERANCE = 1e-10  # m, of the distance between a tip and the surface
_PRIOR_SPAN = 2.5  # largest amplitude in the prior, in standard deviations
_LEAST_SPAN = 1e-3  # rad: least range of an amplitude
_PRIOR_EVALUATIONS = 10  # of the residuals, in the components of a prior


def refine(goal: SearchGoal, start: Candidates, preference_weight: float) -> Candidates:
    """Refine one candidate by least squares, then project it onto exact contact.

    Args:
        goal: the least-squares problem.
        start: one candidate.
        preference_weight: weight of the preferences.
    """
    hand, N = goal.hand, len(goal.fingers)
    lower, upper = search_limits(hand)
    free = np.full(6, np.inf)
    bounds = (np.concatenate([lower, -free, np.full(N, 0.1)]), np.concatenate([upper, free, np.ones(N)]))
    scale = np.concatenate([np.ones(hand.n), np.full(3, 0.05), np.ones(3), np.ones(N)])
    result = _minimise(goal, start, start.x[0], bounds, scale, lambda x: x, preference_weight, 80, 1e-3)
    x = _project_to_contact(goal, lambda x: _moved(start, x), result.x, scale)
    return _moved(start, np.concatenate([np.clip(x[: hand.n], hand.q_lower, hand.q_upper), x[hand.n :]])[None])


def refine_in_prior(goal: SearchGoal, start: Candidates, prior: PosturePrior) -> Candidates:
    """Refine one candidate over the amplitudes of a prior, the object's pose and the weights of the forces.

    Args:
        goal: the least-squares problem.
        start: one candidate.
        prior: the prior, with the joints of the goal's hand.
    """
    n, b, N = goal.hand.n, len(prior.deviations), len(goal.fingers)
    lower, upper = search_limits(goal.hand)
    span, free = np.maximum(_PRIOR_SPAN * prior.deviations, _LEAST_SPAN), np.full(6, np.inf)
    bounds = (np.concatenate([-span, -free, np.full(N, 0.1)]), np.concatenate([span, free, np.ones(N)]))
    scale = np.concatenate([np.ones(b), np.full(3, 0.05), np.ones(3), np.ones(N)])
    amplitudes = np.linalg.lstsq(prior.components.T, start.x[0, :n] - prior.mean, rcond=None)[0]

    def variables(y: Array) -> Array:
        q = np.clip(prior.mean + y[:, :b] @ prior.components, lower, upper)
        return np.hstack([q, y[:, b:]])

    y = np.concatenate([amplitudes, start.x[0, n:]])
    result = _minimise(goal, start, y, bounds, scale, variables, 1.0, _PRIOR_EVALUATIONS, 1e-2)
    return _moved(start, variables(result.x[None]))


def _minimise(
    goal: SearchGoal,
    start: Candidates,
    y: Array,
    bounds: tuple[Array, Array],
    scale: Array,
    variables: Callable[[Array], Array],
    preference_weight: float,
    evaluations: int,
    tolerance: float,
) -> Any:
    """Return SciPy's result of the least squares over y; `variables` maps rows of y to the variables of candidates."""
    from scipy.optimize import least_squares  # imported here, because it is slow to import

    latest: list[tuple[Array, Array]] = []  # the last variables, and the residuals there and at a step along each of them

    def evaluate(y: Array) -> Array:
        if not latest or not np.array_equal(latest[0][0], y):
            steps = np.vstack([y, y + _DIFFERENCE_STEP * np.eye(len(y))])
            r = goal.residuals(_moved(start, variables(steps)), preference_weight, goal.faces_near_first)
            latest[:] = [(y.copy(), r)]
        return latest[0][1]

    def residuals(y: Array) -> Array:
        return np.asarray(evaluate(y)[0])

    def jacobian(y: Array) -> Array:
        r = evaluate(y)
        return np.asarray((r[1:] - r[0]).T / _DIFFERENCE_STEP)

    return least_squares(
        residuals,
        np.clip(y, *bounds),
        jacobian,
        np.asarray(bounds),
        "trf",
        x_scale=scale,
        ftol=tolerance,
        xtol=1e-6,
        gtol=1e-6,
        max_nfev=evaluations,
    )


def _moved(start: Candidates, x: Array) -> Candidates:
    """Return candidates with other variables (B, n + 6 + N), and the axes and faces of one candidate."""
    return Candidates(x, np.repeat(start.R_start, len(x), axis=0), np.repeat(start.face, len(x), axis=0))


def _project_to_contact(goal: SearchGoal, candidates: Callable[[Array], Candidates], x: Array, scale: Array) -> Array:
    """Return the nearest variables with zero contact distances, by Newton steps of least norm."""
    for _ in range(_PROJECTION_STEPS):
        step, here = 1e-6 * np.eye(len(x)), candidates(x[None])
        points = goal.tip_points(candidates(np.vstack([x, x + step, x - step])))
        faces, contact = goal.face_distances(points[0]), (np.arange(len(goal.fingers)), here.face[0])
        distance = faces.face_distance[contact] - goal.radii
        if np.abs(distance).max() < _CONTACT_TOLERANCE:
            break
        moved = (points[1 : len(x) + 1] - points[len(x) + 1 :]) / 2e-6
        J = -(moved * faces.normal[contact]).sum(axis=2).T * scale  # ∇d is the outward normal
        x = x - scale * (np.linalg.pinv(J) @ distance)
    return x

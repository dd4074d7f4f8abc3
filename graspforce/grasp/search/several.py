"""Several different grasps of one object, ranked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import numpy.typing as npt

from graspforce.core import fields
from graspforce.core.arrays import Array
from graspforce.core.constants import STANDARD_GRAVITY
from graspforce.core.errors import InvalidInput
from graspforce.force.problem_options import Objective
from graspforce.force.solver import solve
from graspforce.grasp.body import Body
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search.checks import closure_quality
from graspforce.grasp.search.options import GraspSearchOptions
from graspforce.grasp.search.search import find_grasp
from graspforce.hand.hand import Hand

MAX_COUNT = 100
_SEEDS = 2**32  # after the last one comes 0
_TRIES = 3  # searches for each wanted grasp
_DIFFERENT = 0.01  # m: grasps with the same fingers differ if a contact is this far from the other's, in H


class GraspRank(Enum):
    """The measure that ranks grasps."""

    MARGIN = "margin"  # least slip margin in six directions of gravity, within the motors' limits, N
    ROBUSTNESS = "robustness"  # quality of the force closure, 0 to 1
    CLEARANCE = "clearance"  # least distance of bodies that must not touch, m


@dataclass(frozen=True, slots=True)
class GraspMeasures:
    """Measures of a grasp.

    Attributes:
        margin: least over ±x, ±y, ±z of H of the largest slip margin that all contacts can have at once under that gravity of
            9.81 m/s², within the motors' limits, N; 0 if it cannot be held in some direction.
        robustness: largest t ≤ 1 for which forces f with G f = 0 and f_n ≤ 1 keep ‖f_t‖ ≤ μ (f_n − t) at all contacts; 0
            without force closure.
        clearance: least distance between two links that must not touch, or between a link and the object, m; without the
            links of touching fingertips. Infinite without collision shapes.
    """

    margin: float
    robustness: float
    clearance: float

    def value(self, rank: GraspRank | str) -> float:
        """Return the measure of a rank.

        Args:
            rank: which measure, or its name.
        """
        return float(getattr(self, GraspRank(rank).value))


@dataclass(frozen=True, eq=False, slots=True)
class RankedGrasp:
    """A grasp with its measures.

    Attributes:
        grasp: the grasp.
        measures: its measures.
        seed: seed of `find_grasp` that finds it.
    """

    grasp: Grasp
    measures: GraspMeasures
    seed: int


def measure_grasp(grasp: Grasp) -> GraspMeasures:
    """Compute the measures of a grasp.

    Args:
        grasp: the grasp; its contacts have friction.
    """
    margins = []
    for g in STANDARD_GRAVITY * np.vstack([np.eye(3), -np.eye(3)]):
        solution = solve(grasp.force_problem(g, objective=Objective("margin")), explain=False)
        margins.append(float(solution.objective or 0.0) if solution.found else 0.0)
    friction = min(contact.friction or 0.0 for contact in grasp.contacts.contacts)
    gap = SceneCollision(grasp.hand, grasp.body.shape, grasp.fingers).least_gap(grasp.q, grasp.p_HO, grasp.R_HO)
    robustness = closure_quality(grasp.contacts, friction) if friction > 0.0 else 0.0
    return GraspMeasures(min(margins), robustness, np.inf if gap is None else gap.distance)


def find_grasps(
    hand: Hand,
    body: Body,
    count: int,
    fingers: Sequence[str] | None = None,
    *,
    rank: GraspRank | str = GraspRank.MARGIN,
    friction: float = 0.6,
    gravity_H: npt.ArrayLike | None = None,
    seed: int = 0,
    options: GraspSearchOptions | None = None,
    callback: Callable[[int, int], bool] | None = None,
) -> tuple[RankedGrasp, ...]:
    """Find several different grasps of an object, the best first.

    Each is the grasp of `find_grasp` for one of the seeds seed, seed + 1, …, of which 3 `count` are tried at most. Two grasps
    differ if they have different fingers, or if a contact of one is at least 10 mm from the same finger's contact of the other,
    in H. Turning a symmetric object about its axis therefore makes no different grasp.

    Args:
        hand: the hand.
        body: the object.
        count: number of grasps, from 1 to 100. Fewer are returned if no more are found.
        fingers: as in `find_grasp`.
        rank: measure that orders the grasps, a `GraspRank` or its name.
        friction: as in `find_grasp`.
        gravity_H: as in `find_grasp`.
        seed: first seed, ≥ 0.
        options: as in `find_grasp`. The budget is that of all searches together.
        callback: called after each search with the numbers of searches and of different grasps found; returns False to stop.

    Raises:
        InvalidInput: an argument is not allowed, or no grasp was found; then with the message of the first search.
        UnknownName: the hand has no finger of that name.
    """
    fields.check_integer(count, "count", minimum=1, maximum=MAX_COUNT)
    measure = (
        rank
        if isinstance(rank, GraspRank)
        else GraspRank(fields.check_choice(rank, "rank", [each.value for each in GraspRank]))
    )
    options = GraspSearchOptions() if options is None else options
    shared = None if options.budget is None else options.budget / count  # s, for each search
    found: list[RankedGrasp] = []
    first_error: InvalidInput | None = None
    for k in range(_TRIES * count):
        try:
            grasp = find_grasp(
                hand,
                body,
                fingers,
                friction=friction,
                gravity_H=gravity_H,
                seed=(seed + k) % _SEEDS,
                options=replace(options, budget=shared),
            )
        except InvalidInput as error:
            if error.field != "body":  # an argument that no seed mends
                raise
            first_error = first_error or error
        else:
            if all(_is_different(grasp, other.grasp) for other in found):
                found.append(RankedGrasp(grasp, measure_grasp(grasp), (seed + k) % _SEEDS))
        is_over = options.budget is not None and k + 1 >= count
        if len(found) == count or is_over or (callback is not None and not callback(k + 1, len(found))):
            break
    if not found and first_error is not None:
        raise first_error
    return tuple(sorted(found, key=lambda each: -each.measures.value(measure)))


def _is_different(a: Grasp, b: Grasp) -> bool:
    """Return whether two grasps have different fingers or contacts."""
    if set(a.fingers) != set(b.fingers):
        return True
    order = [b.fingers.index(name) for name in a.fingers]
    return bool(np.linalg.norm(_points_H(a) - _points_H(b)[order], axis=1).max() >= _DIFFERENT)


def _points_H(grasp: Grasp) -> Array:
    """Return the contact points in H, (N, 3), m."""
    return np.asarray(grasp.p_HO + grasp.contacts.p_OC @ grasp.R_HO.T)

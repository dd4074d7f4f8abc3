"""The wrenches that contacts and motors can supply: the largest ball in the set, and its volume.

Moments are about the contacts' centroid and divided by the characteristic length L, so that wrenches are in N.
"""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.contact.inscribed_ball import InscribedBall, build_hull, inscribed_ball
from graspforce.contact.matrices import characteristic_length, normalised_grasp_matrix, numerical_rank
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.force.backends import registry
from graspforce.force.cone_program import conic_program
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.status import Status

_FACETS = ((50, 8), (200, 4), (math.inf, 3))  # largest number of contacts, and the facets of their pyramids
_UNBOUNDED = 1e12  # force units: a larger support value comes from a set without bound


@dataclass(frozen=True, slots=True)
class VolumeBounds:
    """Bounds on the volume of a set of wrenches.

    Args:
        lower: volume with inner pyramids as friction cones, N⁶.
        upper: volume with outer pyramids, N⁶.
    """

    lower: float
    upper: float


def limited_wrench_ball(
    problem: ForceProblem,
    centre: npt.ArrayLike | None = None,
    tolerance: float = 1e-3,
    *,
    deadline: float = np.inf,
) -> InscribedBall | None:
    """Return the largest ball of wrenches that the contacts supply within the limits of normal forces and motor torques.

    About zero it is the ε of Ferrari and Canny with the motors' limits; about the wrench of the problem it is the largest
    disturbance in any direction that the grasp can resist in addition.

    Args:
        problem: the contacts, cones, motors and limits; its objective is not used.
        centre: (6,) centre of the ball about O, in O, N and N·m; by default the problem's wrench.
        tolerance: relative difference of the bounds on the radius at which the search ends.
        deadline: time of the clock `time.perf_counter` after which the search is given up, s.

    Returns:
        The ball, N; of radius 0 if the centre is not inside the set. None if the set is unbounded or empty, or
            after the deadline.

    Raises:
        InvalidInput: a wrong shape, or numbers that are not finite.
    """
    w = problem.w if centre is None else arrays.check_array(centre, "centre", (6,))
    plain = ForceProblem(problem.contacts, w, problem.actuation, problem.cone, Objective("force"))
    program = conic_program(plain)
    L = plain.length
    lengths = np.array([1.0, 1.0, 1.0, L, L, L])
    balance = program.A[:6] * (program.wrench_units / lengths)[:, None]  # N for each variable
    middle = plain.w_centred / lengths  # N
    m = len(program.q)
    free = dataclasses.replace(program, P=np.zeros((m, m)), A=program.A[6:], b=program.b[6:])
    solve_program = registry.general_backend().solve_program
    unit = float(program.wrench_units[0])  # N

    def support(u: Array) -> tuple[float, Array]:
        if time.perf_counter() > deadline:
            raise _NoSupport
        result = solve_program(dataclasses.replace(free, q=-(u @ balance) / unit))
        if result.status is not Status.OPTIMAL or not result.converged:
            raise _NoSupport
        point = balance @ result.x - middle
        if not np.abs(point).max() < _UNBOUNDED * unit:
            raise _NoSupport
        return float(u @ point), point

    try:
        return inscribed_ball(support, tolerance)
    except _NoSupport:
        return None


class _NoSupport(Exception):
    """There is no support value in a direction: the set is unbounded or empty, or the deadline has passed."""


def wrench_volume(contacts: ContactSet, facets: int | None = None) -> VolumeBounds:
    """Return bounds on the volume of the wrenches that contacts with Σ f_n ≤ 1 N supply. Source: Li and Sastry (1988).

    The volume is that of the convex hull of zero and of the wrenches of all pyramid edges. Inner pyramids bound it from below
    and outer ones from above; without friction both are exact.

    Args:
        contacts: the contacts.
        facets: facets of each pyramid, 3 to 16; by default 8 for at most 50 contacts, 4 up to 200, and 3 for more, whose hulls
            take about a second.

    Raises:
        InvalidInput: another number of facets.
    """
    if facets is None:
        facets = next(count for most, count in _FACETS if len(contacts) <= most)
    fields.check_integer(facets, "facets", minimum=3, maximum=16)
    return VolumeBounds(_pyramid_volume(contacts, facets, "inner"), _pyramid_volume(contacts, facets, "outer"))


def _pyramid_volume(contacts: ContactSet, facets: int, side: friction.PyramidSide) -> float:
    """Return the volume of the hull of zero and of all pyramid edges, N⁶."""
    L = characteristic_length(contacts)
    bases = normalised_grasp_matrix(contacts).reshape(6, -1, 4)
    points = [np.zeros((1, 6))]
    for i, (mu, gamma) in enumerate(zip(contacts.mu.tolist(), contacts.gamma.tolist(), strict=True)):
        points.append((friction.pyramid_rays(facets, side, mu, gamma) * (1.0, 1.0, 1.0, 1.0 / L)) @ bases[:, i].T)
    wrenches = np.unique(np.vstack(points), axis=0)
    if len(wrenches) < 7 or numerical_rank(wrenches - wrenches.mean(axis=0)) < 6:
        return 0.0
    return float(build_hull(wrenches).volume)

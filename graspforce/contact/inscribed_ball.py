"""The largest ball about the origin in a convex set of wrenches, from the set's support function alone.

A set W with the support function h(u) = max {uᵀw : w in W} contains a ball of radius ε = min h(u) over all unit u. The hull of
support points is inside W, so that its nearest facet bounds ε from below; every h(u) bounds ε from above. Each step adds the
support point of the nearest facet's normal, until both bounds agree. Source: Zheng (2013).

Only the hull near its nearest facet is refined: some ten support points suffice where a hull of all points has thousands of
facets. The set may have a curved surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from graspforce.contact.matrices import RANK_TOLERANCE
from graspforce.core import arrays
from graspforce.core.arrays import Array

Support = Callable[[Array], tuple[float, Array]]

_MAX_FACETS = 10_000  # of the hull; sets that need more keep a gap between the bounds
_DISPLACEMENT = 1e-10  # of the points, relative: far above rounding, far below the tolerance
_SAME_NORMAL = 1e-6  # difference of the normals with and without the displacement
_EXACT = 1e-9  # relative difference of bounds that are equal up to the displacement


@dataclass(frozen=True, eq=False, slots=True)
class InscribedBall:
    """The largest ball about the origin in a set of wrenches, bounded from both sides.

    Args:
        radius: lower bound on ε; the ball of this radius is inside the set. 0 if the origin is not inside.
        upper: upper bound on ε; 0 if the origin is not inside.
        direction: (6,) unit wrench u with h(u) = upper: the weakest direction, moments divided by the length.
        points: number of support points.
    """

    radius: float
    upper: float
    direction: Array
    points: int


def inscribed_ball(support: Support, tolerance: float = 1e-4) -> InscribedBall:
    """Return the largest ball about the origin in a convex set.

    Args:
        support: returns h(u) and a point w of the set with uᵀw = h(u), for a unit u (6,).
        tolerance: relative difference of the bounds at which the search ends; 0 for polytopes, whose facets are found exactly.

    Returns:
        The ball. Its bounds agree to the tolerance, or the hull has reached 10⁴ facets: sets with a continuum of weakest
        directions need many.
    """
    # a fixed rotation: contacts along the axes give points of a hull that are exactly coplanar, where Qhull has no precision
    Q = np.linalg.qr(np.random.default_rng(1992).normal(size=(6, 6)))[0]
    tolerance = max(tolerance, _EXACT)

    def rotated_support(u: Array) -> tuple[float, Array]:
        value, point = support(Q @ u)
        return value, Q.T @ point

    points = _full_dimensional_points(rotated_support)
    if points is None:
        return InscribedBall(0.0, 0.0, np.zeros(6), 12)
    hull = _Hull(points)
    upper, weakest = np.inf, np.zeros(6)
    while True:
        u, lower = hull.nearest_facet()
        value, point = rotated_support(u)
        if value < upper:
            upper, weakest = value, u
        if upper <= 0.0 or upper - lower <= tolerance * upper or hull.facet_count > _MAX_FACETS:
            break
        hull.add(point)
    upper = max(upper, 0.0)
    return InscribedBall(min(max(lower, 0.0), upper), upper, arrays.freeze(Q @ weakest), hull.count)


class _Hull:
    """The convex hull of points that are added one by one.

    Each point is moved by some 10⁻¹⁰ of its size, since Qhull's merging of coplanar facets can fail when points are added.
    """

    def __init__(self, points: Array) -> None:
        from scipy.spatial import ConvexHull  # imported here because it is slow to import

        self._rng = np.random.default_rng(2013)
        self._points = points
        self._hull = ConvexHull(self._moved(points), incremental=True)

    @property
    def count(self) -> int:
        """The number of points."""
        return len(self._points)

    @property
    def facet_count(self) -> int:
        """The number of facets."""
        return len(self._hull.equations)

    def nearest_facet(self) -> tuple[Array, float]:
        """Return the outward normal (6,) of the facet nearest to the origin, and its distance, < 0 beyond the origin.

        Both are those of the facet through the points that were not moved, unless these span no facet.
        """
        equations = self._hull.equations
        nearest = int(equations[:, 6].argmax())
        normal, distance = equations[nearest, :6], -float(equations[nearest, 6])
        corners = self._points[self._hull.simplices[nearest]]
        edges = corners[1:] - corners[0]
        exact = np.linalg.svd(edges)[2][5]
        exact = exact if exact @ normal > 0.0 else -exact
        if np.abs(exact - normal).max() > _SAME_NORMAL:
            return normal, distance
        return exact, float(exact @ corners.mean(axis=0))

    def add(self, point: Array) -> None:
        """Add a point."""
        self._points = np.vstack([self._points, point])
        self._hull.add_points(self._moved(point[None]))

    def _moved(self, points: Array) -> Array:
        """Return the points, moved in a random direction."""
        size = _DISPLACEMENT * np.abs(points).max()
        return np.asarray(points + size * self._rng.uniform(-1.0, 1.0, points.shape))


def build_hull(points: Array) -> Any:
    """Return Qhull's hull of (m, 6) points that span six dimensions.

    Where Qhull finds no precise hull, such as at coincident facets, the points are moved by some 10⁻¹³ of their size (its
    option QJ), which gives a hull of all points.

    Args:
        points: (m, 6) points.

    Returns:
        A `scipy.spatial.ConvexHull`.
    """
    from scipy.spatial import ConvexHull, QhullError  # imported here because it is slow to import

    try:
        return ConvexHull(points)
    except QhullError:
        return ConvexHull(points, qhull_options="QJ")


def _full_dimensional_points(support: Support) -> Array | None:
    """Return (m, 6) support points that span six dimensions; None if the set is flat within rounding."""
    points, last = np.array([support(u)[1] for u in (*np.eye(6), *-np.eye(6))]), -1
    while True:
        centre = points.mean(axis=0)
        sigma, rows = np.linalg.svd(points - centre)[1:]
        rank = int(np.count_nonzero(sigma > RANK_TOLERANCE * sigma[0])) if sigma[0] > 0.0 else 0
        if rank == 6:
            return points
        if rank == last:  # the points in the direction that was missing are no farther apart than rounding
            return None
        u, last = rows[rank], rank
        more = np.array([support(u)[1], support(-u)[1]])
        if np.abs((more - centre) @ u).max() <= RANK_TOLERANCE * np.abs(more).max():
            return None
        points = np.vstack([points, more])

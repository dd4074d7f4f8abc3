"""Grasp quality measures of the contacts alone: smallest singular value and the Ferrari–Canny ε."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import characteristic_length, normalised_grasp_matrix, numerical_rank
from graspforce.core import arrays, fields


def smallest_singular_value(contacts: ContactSet) -> float:
    """Return σ_min(G̃): the wrench for each newton of contact force in the worst direction. Source: Li and Sastry (1988).

    Moments are about the contacts' centroid and divided by L, so the result depends neither on O nor on the unit of length.

    Args:
        contacts: the contacts.

    Returns:
        σ_min, N/N; zero if rank G < 6.
    """
    G = normalised_grasp_matrix(contacts)[:, contacts.columns]
    return float(np.linalg.svd(G, compute_uv=False)[5]) if numerical_rank(G) == 6 else 0.0


def ferrari_canny(contacts: ContactSet, facets: int = 16) -> float:
    """Return ε: the largest wrench that contacts with Σ f_n ≤ 1 N supply in every direction. Source: Ferrari and Canny (1992).

    It is the radius of the largest ball about the origin in the convex hull of the wrenches of all pyramid edges at
    f_n = 1 N. The pyramids are inner ones: ε is at most its exact value, and approaches it with more facets. Moments are about
    the contacts' centroid and divided by L.

    Args:
        contacts: the contacts.
        facets: facets of each pyramid, 3 to 256.

    Returns:
        ε, N; zero if the grasp is not force closed.

    Raises:
        InvalidInput: another number of facets.
    """
    fields.check_integer(facets, "facets", minimum=3, maximum=256)
    bases = normalised_grasp_matrix(contacts).reshape(6, -1, 4)
    per_length = np.array([1.0, 1.0, 1.0, 1.0 / characteristic_length(contacts)])
    coefficients = enumerate(zip(contacts.mu.tolist(), contacts.gamma.tolist(), strict=True))
    wrenches = [
        (friction.pyramid_rays(facets, "inner", mu, gamma) * per_length) @ bases[:, i].T for i, (mu, gamma) in coefficients
    ]
    return max(inscribed_ball_radius(np.vstack(wrenches)), 0.0)


def inscribed_ball_radius(wrenches: npt.ArrayLike) -> float:
    """Return the radius of the largest ball about the origin in the convex hull of wrenches.

    The radius is the smallest distance of a facet from the origin. It is negative if the origin is outside: minus the largest
    distance by which a facet's plane is beyond the origin.

    Args:
        wrenches: (m, 6) in N, with moments divided by a length.

    Returns:
        The radius, N; zero if the wrenches do not span six dimensions (singular values below `RANK_TOLERANCE` of the largest
        count as zero).

    Raises:
        InvalidInput: not an (m, 6) array of finite numbers.
    """
    from scipy.spatial import ConvexHull, QhullError  # imported here because it is slow to import

    w = arrays.check_array(wrenches, "wrenches", (None, 6))
    largest = float(np.abs(w).max(initial=0.0))
    if largest == 0.0 or numerical_rank((w - w.mean(axis=0)) / largest) < 6:
        return 0.0
    try:
        hull = ConvexHull(w / largest)
    except QhullError:  # flat within Qhull's precision
        return 0.0
    return float(largest * -hull.equations[:, 6].max())

"""Grasp quality measures of the contacts alone: smallest singular value and the Ferrari–Canny ε with L1 and L∞ limits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.contact.inscribed_ball import InscribedBall, build_hull, inscribed_ball
from graspforce.contact.matrices import characteristic_length, normalised_grasp_matrix, numerical_rank
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array

NormalLimit: TypeAlias = Literal["sum", "each"]


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


def ferrari_canny(contacts: ContactSet, facets: int | None = None, limit: NormalLimit = "sum") -> float:
    """Return ε: the largest wrench that limited contacts supply in every direction. Source: Ferrari and Canny (1992).

    Args:
        contacts: the contacts.
        facets: as in `wrench_ball`.
        limit: as in `wrench_ball`.

    Returns:
        ε, N, the lower bound of `wrench_ball`; zero if the grasp is not force closed.

    Raises:
        InvalidInput: another number of facets, or another limit.
    """
    return wrench_ball(contacts, facets, limit).radius


def wrench_ball(contacts: ContactSet, facets: int | None = None, limit: NormalLimit = "sum") -> InscribedBall:
    """Return the largest ball of wrenches about zero that limited contacts supply: its radius is ε of Ferrari and Canny (1992).

    The normal forces are limited by Σ f_n ≤ 1 N ("sum", the L1 limit) or by f_n ≤ 1 N at each contact ("each", the L∞ limit).
    Moments are about the contacts' centroid and divided by L (`characteristic_length`).

    Args:
        contacts: the contacts.
        facets: None for exact friction cones, for which the bounds agree to 1e-4; or the facets of inner pyramids, 3 to 256,
            for which ε is exact, at most the ε of the exact cones.
        limit: "sum" or "each".

    Returns:
        The ball, N; zero if the grasp is not force closed.

    Raises:
        InvalidInput: another number of facets, or another limit.
    """
    fields.check_choice(limit, "limit", get_args(NormalLimit))
    if facets is not None:
        fields.check_integer(facets, "facets", minimum=3, maximum=256)
    bases = normalised_grasp_matrix(contacts).reshape(6, -1, 4)
    if numerical_rank(bases.reshape(6, -1)) < 6:
        return InscribedBall(0.0, 0.0, np.zeros(6), 0)
    gamma = contacts.gamma / characteristic_length(contacts)
    unit_forces = _cone_support(contacts.mu, gamma) if facets is None else _pyramid_support(contacts.mu, gamma, facets)

    def support(u: Array) -> tuple[float, Array]:
        z = np.einsum("rnc,r->nc", bases, u)
        f = unit_forces(z)  # (N, 4), f_n = 1 N each
        values = np.einsum("nc,nc->n", z, f)
        if limit == "sum":
            best = int(values.argmax())
            used = np.arange(len(values)) == best
        else:
            used = values > 0.0
        return float(values[used].sum()), np.einsum("rnc,nc->r", bases[:, used], f[used])

    return inscribed_ball(support, 1e-4 if facets is None else 0.0)


def _cone_support(mu: Array, gamma: Array) -> Callable[[Array], Array]:
    """Return the function of z (N, 4) that returns the forces (N, 4) with f_n = 1 N in the cones for which zᵀf is greatest."""
    size = np.stack([mu, mu, gamma], axis=1)

    def unit_forces(z: Array) -> Array:
        direction = size * z[:, [friction.F_T1, friction.F_T2, friction.M_N]]
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        f = size * np.divide(direction, length, out=np.zeros_like(direction), where=length > 0.0)
        return np.column_stack([f[:, :2], np.ones(len(f)), f[:, 2]])

    return unit_forces


def _pyramid_support(mu: Array, gamma: Array, facets: int) -> Callable[[Array], Array]:
    """Return the function of z (N, 4) that returns the edges (N, 4) of inner pyramids for which zᵀf is greatest."""
    coefficients = zip(mu.tolist(), gamma.tolist(), strict=True)
    rays = [friction.pyramid_rays(facets, "inner", *pair) for pair in coefficients]

    def unit_forces(z: Array) -> Array:
        return np.array([edges[int((edges @ one).argmax())] for edges, one in zip(rays, z, strict=True)])

    return unit_forces


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
    w = arrays.check_array(wrenches, "wrenches", (None, 6))
    largest = float(np.abs(w).max(initial=0.0))
    if largest == 0.0 or numerical_rank((w - w.mean(axis=0)) / largest) < 6:
        return 0.0
    return float(largest * -build_hull(w / largest).equations[:, 6].max())

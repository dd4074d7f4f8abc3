"""The friction cone of a contact: exact cone, dual cone, inner and outer pyramids, projection and margins.

All functions take padded forces f = (f_t1, f_t2, f_n, m_n) in the contact frame, in N and N·m. Components that the contact
model lacks are zero. So one law holds for all three contact models:

    K  = { f : √(‖f_t‖²/μ² + m_n²/γ²) ≤ f_n },          where a zero coefficient forces its component to zero,
    K* = { z : √(μ²‖z_t‖² + γ²z_m²)  ≤ z_n },            the dual cone {z : zᵀf ≥ 0 for all f in K},

with μ = γ = 0 for a frictionless contact and γ = 0 for a point contact.

Sources: Al-Gallaf (undated), eq. (14), with an inward normal so that f_n ≥ 0; the elliptic soft-finger law is from Howe and
Cutkosky (1996).
"""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import numpy as np

from graspforce.core.arrays import Array

PyramidSide: TypeAlias = Literal["inner", "outer"]
PYRAMID_SIDES: tuple[PyramidSide, ...] = get_args(PyramidSide)

F_T1, F_T2, F_N, M_N = range(4)  # columns of a padded force


def required_friction(f: Array, mu: Array, gamma: Array) -> Array:
    """Return the tangential force that friction must transmit: ‖f_t‖, and √(‖f_t‖² + (μ m_n/γ)²) with torsion.

    Args:
        f: (…, 4) padded contact forces, N and N·m, contact frame.
        mu: (…) friction coefficients.
        gamma: (…) torsional friction lengths, m.

    Returns:
        (…), N.
    """
    tangential = np.hypot(f[..., F_T1], f[..., F_T2])  # N
    if np.count_nonzero(gamma) == 0:
        return np.asarray(tangential)
    lever = np.divide(mu, gamma, out=np.zeros_like(mu * gamma), where=gamma > 0)  # 1/m
    return np.asarray(np.hypot(tangential, lever * f[..., M_N]))


def slip_margin(f: Array, mu: Array, gamma: Array) -> Array:
    """Return the friction that remains, μ f_n − `required_friction`. The contact slips where it is negative.

    Args:
        f: (…, 4) padded contact forces, N and N·m, contact frame.
        mu: (…) friction coefficients.
        gamma: (…) torsional friction lengths, m.

    Returns:
        (…), N.
    """
    return np.asarray(mu * f[..., F_N] - required_friction(f, mu, gamma))


def violation(f: Array, mu: Array, gamma: Array) -> Array:
    """Return how far a force is outside the exact cone; zero inside.

    Args:
        f: (…, 4) padded contact forces, N and N·m, contact frame.
        mu: (…) friction coefficients.
        gamma: (…) torsional friction lengths, m.

    Returns:
        (…), N.
    """
    pull = np.maximum(-f[..., F_N], 0.0)
    slip = np.maximum(-slip_margin(f, mu, gamma), 0.0)
    # The moment's share of the slip vanishes with μ, so the moment has its own limit |m_n|/γ ≤ f_n, and zero where γ = 0.
    length = np.where(gamma > 0, gamma, 1.0)  # m
    torsion = np.maximum(np.abs(f[..., M_N]) / length - np.where(gamma > 0, f[..., F_N], 0.0), 0.0)
    return np.asarray(np.maximum.reduce([pull, slip, torsion]))


def dual_violation(z: Array, mu: Array, gamma: Array) -> Array:
    """Return how far a multiplier is outside the dual cone K*; zero inside.

    Args:
        z: (…, 4) multipliers of padded contact forces.
        mu: (…) friction coefficients.
        gamma: (…) torsional friction lengths, m.

    Returns:
        (…), in the unit of z_n.
    """
    needed = np.hypot(mu * np.hypot(z[..., F_T1], z[..., F_T2]), gamma * z[..., M_N])
    return np.asarray(np.maximum(needed - z[..., F_N], 0.0))


def project(f: Array, mu: Array) -> Array:
    """Return the Euclidean projection of forces onto the point-contact cone.

    Inside the cone: f. Inside the polar cone, μ‖f_t‖ ≤ −f_n: zero. Elsewhere: the closest point of the cone's surface,
    f_n' = (f_n + μ‖f_t‖)/(1 + μ²), ‖f_t'‖ = μ f_n'. Source: Parikh and Boyd (2014), section 6.3.2.

    Args:
        f: (…, 3) forces (f_t1, f_t2, f_n), N, contact frame.
        mu: (…) friction coefficients.

    Returns:
        (…, 3), N.
    """
    tangential = np.hypot(f[..., F_T1], f[..., F_T2])  # N
    normal = f[..., F_N]  # N
    cosine = 1.0 / np.hypot(1.0, mu)  # of the friction angle
    along = np.maximum(cosine * normal + mu * cosine * tangential, 0.0)  # N, distance from the apex along the surface
    inside = tangential <= mu * normal
    scale = np.divide(mu * cosine * along, tangential, out=np.zeros_like(tangential), where=tangential > 0)
    on_surface = np.stack([scale * f[..., F_T1], scale * f[..., F_T2], cosine * along], axis=-1)
    return np.asarray(np.where(inside[..., None], f, on_surface))


def pyramid_friction(mu: Array, facets: int, side: PyramidSide) -> Array:
    """Return the coefficient μ' of a pyramid's facets: μ cos(π/m) for the inner pyramid, μ for the outer one.

    Args:
        mu: (…) friction coefficients.
        facets: m, the number of facets about the normal.
        side: "inner" or "outer".
    """
    return np.asarray(mu * np.cos(np.pi / facets)) if side == "inner" else np.asarray(mu)


def pyramid_facets(facets: int, side: PyramidSide, gamma: float) -> Array:
    """Return the rows a of a pyramid's linear law a·(f_t1/μ', f_t2/μ', m_n/γ) ≤ f_n.

    Without torsion the m rows are (cos 2πk/m, sin 2πk/m, 0). With torsion, the inner pyramid is the linear law
    ‖f_t‖/μ + |m_n|/γ ≤ f_n of Prattichizzo and Trinkle (2008), which is inside the elliptic cone. The outer pyramid limits
    the tangential force and the moment separately.

    Args:
        facets: m, the number of facets about the normal; facet k faces 2πk/m from t₁.
        side: "inner" or "outer".
        gamma: torsional friction length, m; zero for no torsion.

    Returns:
        (rows, 3) coefficients of (f_t1/μ', f_t2/μ', m_n/γ).
    """
    angle = 2.0 * np.pi * np.arange(facets) / facets  # rad
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(facets)])
    if gamma == 0.0:
        return ring
    torsion = np.array([[0.0, 0.0, 1.0]])
    if side == "inner":
        return np.vstack([ring + torsion, ring - torsion])
    return np.vstack([ring, torsion, -torsion])


def pyramid_margin(f: Array, mu: float, gamma: float, facets: int, side: PyramidSide) -> float:
    """Return the friction that remains in a pyramid, μ' f_n − max a·(f_t1, f_t2, μ' m_n/γ), in N.

    Args:
        f: (4,) padded contact force, N and N·m, contact frame.
        mu: friction coefficient.
        gamma: torsional friction length, m.
        facets: m, the number of facets about the normal.
        side: "inner" or "outer".
    """
    mu_facet = float(pyramid_friction(np.asarray(mu), facets, side))
    lever = mu_facet / gamma if gamma > 0 else 0.0  # 1/m
    needed = pyramid_facets(facets, side, gamma) @ np.array([f[F_T1], f[F_T2], lever * f[M_N]])  # N
    return mu_facet * float(f[F_N]) - float(needed.max())


def pyramid_rays(facets: int, side: PyramidSide, mu: float, gamma: float) -> Array:
    """Return the edges of a pyramid, as forces with f_n = 1 N.

    The pyramid is their conic hull: z is in its dual cone if zᵀr ≥ 0 for all rays r.

    Args:
        facets: m, the number of facets about the normal.
        side: "inner" or "outer".
        mu: friction coefficient.
        gamma: torsional friction length, m.

    Returns:
        (rays, 4) padded forces, N and N·m.
    """
    angle = 2.0 * np.pi * (np.arange(facets) + 0.5) / facets  # rad, between two facets
    radius = mu if side == "inner" else mu / np.cos(np.pi / facets)
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.ones(facets), np.zeros(facets)])
    if gamma == 0.0:
        return ring
    torsion = np.array([[0.0, 0.0, 0.0, gamma]])
    if side == "inner":
        normal = np.array([[0.0, 0.0, 1.0, 0.0]])
        return np.vstack([ring, normal + torsion, normal - torsion])
    return np.vstack([ring + torsion, ring - torsion])

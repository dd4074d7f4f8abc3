"""The friction cone of a contact: exact, dual, inner and outer pyramid, projection, margin.

Every function takes forces padded to four components, f = (f_t1, f_t2, f_n, m_n), in N and N·m in the contact frame, with
zeros where the contact's model has no such component. Then one law holds for all three contact models,

    K  = { f : √(‖f_t‖²/μ² + m_n²/γ²) ≤ f_n },          a zero coefficient forcing its component to zero,
    K* = { z : √(μ²‖z_t‖² + γ²z_m²)  ≤ z_n },            the dual cone, {z : zᵀf ≥ 0 for every f in K},

with μ = γ = 0 for a frictionless contact and γ = 0 for a point contact. Source: 001 (14), mended (inward normal, so f_n ≥ 0),
with the elliptic soft-finger law of Howe and Cutkosky (1996).
"""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array

F_T1, F_T2, F_N, M_N = range(4)  # columns of a padded force


def required_friction(f: Array, mu: Array, gamma: Array) -> Array:
    """What friction must bear, in N: ‖f_t‖, or √(‖f_t‖² + (μ m_n/γ)²) where a moment about the normal is borne too.

    Args:
        f: (…, 4) padded contact forces, N and N·m, contact frame.
        mu: (…) friction coefficients.
        gamma: (…) torsional friction lengths, m.
    """
    tangential = np.hypot(f[..., F_T1], f[..., F_T2])  # N
    if np.count_nonzero(gamma) == 0:  # nobody bears a moment
        return np.asarray(tangential)
    lever = np.divide(mu, gamma, out=np.zeros_like(mu * gamma), where=gamma > 0)  # 1/m
    return np.asarray(np.hypot(tangential, lever * f[..., M_N]))


def slip_margin(f: Array, mu: Array, gamma: Array) -> Array:
    """The friction that is left, μ f_n − load, in N. Negative: the contact slips. Arguments as in `required_friction`."""
    return np.asarray(mu * f[..., F_N] - required_friction(f, mu, gamma))


def violation(f: Array, mu: Array, gamma: Array) -> Array:
    """How far a force is outside the exact cone, in N; zero inside. Arguments as in `required_friction`."""
    pull = np.maximum(-f[..., F_N], 0.0)
    slip = np.maximum(-slip_margin(f, mu, gamma), 0.0)
    # The slip of a moment fades with μ, so the moment is held to its own limit too; one where γ = 0 cannot be borne at all.
    length = np.where(gamma > 0, gamma, 1.0)  # m
    twist = np.maximum(np.abs(f[..., M_N]) / length - np.where(gamma > 0, f[..., F_N], 0.0), 0.0)
    return np.asarray(np.maximum.reduce([pull, slip, twist]))


def dual_violation(z: Array, mu: Array, gamma: Array) -> Array:
    """How far a multiplier is outside the dual cone K*, in the units of z_n; zero inside.

    Args:
        z: (…, 4) multipliers of padded contact forces.
        mu: (…) friction coefficients.
        gamma: (…) torsional friction lengths, m.
    """
    reach = np.hypot(mu * np.hypot(z[..., F_T1], z[..., F_T2]), gamma * z[..., M_N])
    return np.asarray(np.maximum(reach - z[..., F_N], 0.0))


def project(f: Array, mu: Array) -> Array:
    """The nearest force of the point-contact cone, in the Euclidean sense.

    Inside: f. Inside the polar cone, μ‖f_t‖ ≤ −f_n: zero. Else the foot of the perpendicular on the mantle,
    f_n' = (f_n + μ‖f_t‖)/(1 + μ²), ‖f_t'‖ = μ f_n'. Parikh and Boyd, Proximal Algorithms (2014), section 6.3.2.

    Args:
        f: (…, 3) forces (f_t1, f_t2, f_n), N, contact frame.
        mu: (…) friction coefficients.
    """
    tangential = np.hypot(f[..., F_T1], f[..., F_T2])  # N
    normal = f[..., F_N]  # N
    steep = 1.0 / np.hypot(1.0, mu)  # cosine of the friction angle
    along = np.maximum(steep * normal + mu * steep * tangential, 0.0)  # N, along the mantle
    inside = tangential <= mu * normal
    shrink = np.divide(mu * steep * along, tangential, out=np.zeros_like(tangential), where=tangential > 0)
    mantle = np.stack([shrink * f[..., F_T1], shrink * f[..., F_T2], steep * along], axis=-1)
    return np.asarray(np.where(inside[..., None], f, mantle))


def pyramid_friction(mu: Array, facets: int, side: str) -> Array:
    """The coefficient that a pyramid's facets use: μ cos(π/m) for the inner pyramid, μ for the outer one."""
    return np.asarray(mu * np.cos(np.pi / facets)) if side == "inner" else np.asarray(mu)


def pyramid_facets(facets: int, side: str, gamma: float) -> Array:
    """The rows a of a pyramid's linear law a·(f_t1/μ', f_t2/μ', m_n/γ) ≤ f_n, with facet normals at 2πk/m from t₁.

    Without torsion the m rows are (cos 2πk/m, sin 2πk/m, 0). With it the inner pyramid is the linear law
    ‖f_t‖/μ + |m_n|/γ ≤ f_n of Prattichizzo and Trinkle (inside the elliptic cone); the outer one bounds tangential force
    and moment apart.

    Args:
        facets: m, the number of facets about the normal.
        side: "inner" or "outer".
        gamma: torsional friction length, m; zero for no torsion.

    Returns:
        (rows, 3) coefficients of (f_t1/μ', f_t2/μ', m_n/γ).
    """
    angle = 2.0 * np.pi * np.arange(facets) / facets  # rad
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(facets)])
    if gamma == 0.0:
        return ring
    twist = np.array([[0.0, 0.0, 1.0]])
    if side == "inner":
        return np.vstack([ring + twist, ring - twist])
    return np.vstack([ring, twist, -twist])


def pyramid_margin(f: Array, mu: float, gamma: float, facets: int, side: str) -> float:
    """The friction that a pyramid leaves, μ' f_n − max a·(f_t1, f_t2, μ' m_n/γ), in N; at least −‖f_t‖ where μ = 0.

    Args:
        f: (4,) padded contact force, N and N·m, contact frame.
        mu: friction coefficient.
        gamma: torsional friction length, m.
        facets: m, the number of facets about the normal.
        side: "inner" or "outer".
    """
    mu_facet = float(pyramid_friction(np.asarray(mu), facets, side))
    lever = mu_facet / gamma if gamma > 0 else 0.0  # 1/m
    borne = pyramid_facets(facets, side, gamma) @ np.array([f[F_T1], f[F_T2], lever * f[M_N]])  # N
    return mu_facet * float(f[F_N]) - float(borne.max())


def pyramid_rays(facets: int, side: str, mu: float, gamma: float) -> Array:
    """The edges of a pyramid, as forces with f_n = 1: the pyramid is their cone, and z is in its dual if zᵀr ≥ 0 for each.

    Args:
        facets: m, the number of facets about the normal.
        side: "inner" or "outer".
        mu: friction coefficient.
        gamma: torsional friction length, m.

    Returns:
        (rays, 4) padded forces.
    """
    angle = 2.0 * np.pi * (np.arange(facets) + 0.5) / facets  # rad: where two facets meet
    radius = mu if side == "inner" else mu / np.cos(np.pi / facets)
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.ones(facets), np.zeros(facets)])
    if gamma == 0.0:
        return ring
    twist = np.array([[0.0, 0.0, 0.0, gamma]])
    if side == "inner":
        apex = np.array([[0.0, 0.0, 1.0, 0.0]])
        return np.vstack([ring, apex + twist, apex - twist])
    return np.vstack([ring + twist, ring - twist])

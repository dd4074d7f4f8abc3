"""What a set of contacts can do to an object, whatever hand makes them: G, internal forces, force closure, quality.

The grasp matrix G depends on where O stands and on the unit of length. Rank, closure and quality must not, so they are decided
on the normalised grasp matrix, whose moments are about the contacts' centroid and divided by the characteristic length L:

    G̃ = diag(1, 1/L) [1 0; −S(c) 1] G diag(1, L),        the last factor on moment components only: they become m_n/L, in N.

Sources: 001 (5)–(11), mended; Murray, Li and Sastry, A Mathematical Introduction to Robotic Manipulation (1994), chapter 5;
Prattichizzo and Trinkle, Grasping, in the Springer Handbook of Robotics (2008), chapter 28.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array

# A singular value below this part of the largest is zero. Two reasons: a contact placed far from O (10⁶ times the grasp's size)
# has lost all digits of its lever arm beyond 10⁻¹⁰, and an arm below 10⁻⁹ of the grasp's size bears no real load.
RANK_TOLERANCE = 1e-9

# A force closes a grasp when it stays inside every cone by this part of the sum of normal forces. The linear programs are
# solved to 10⁻¹⁰, so what is above is real, and a grasp that is closed by less is lost to any error in its friction.
CLOSURE_TOLERANCE = 1e-8

_MAX_CUTTING_ROUNDS = 100  # of cutting planes


def grasp_matrix(contacts: ContactSet) -> Array:
    """G (6, k): the wrench on the object about O's origin, in O, linear first, is w = G f. 001 (3)–(7), with p × f.

    A column is [R e; p × R e] for a force component e of a contact at p, and [0; n] for a moment about the normal.
    """
    return arrays.freeze(contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1)[:, contacts.columns])


def characteristic_length(contacts: ContactSet) -> float:
    """L, m: the root mean square distance of the contacts from their centroid, L² = Σ‖p − c‖²/N.

    It makes forces of moments without choosing a unit. Where all contacts coincide (to 1e-12 of their distance from O) it is
    their distance from O, and 1 m where that is zero too.
    """
    from_origin = _rms(contacts.p_OC)  # m
    spread = _rms(contacts.p_OC - contacts.centroid)  # m
    return (spread if spread > 1e-12 * from_origin else from_origin) or 1.0


def grasp_matrix_rank(contacts: ContactSet) -> int:
    """The number of independent wrenches that the force components can make: rank G, whatever the friction coefficients.

    Singular values of G̃ count when they exceed `RANK_TOLERANCE` times the largest.
    """
    return _rank(_normalised_grasp_matrix(contacts)[:, contacts.columns])


def internal_forces(contacts: ContactSet) -> Array:
    """N (k, k − rank G), orthonormal: the forces that cancel on the object, G N = 0.

    Every f that supplies w is f = Gᵀ(GGᵀ)⁻¹ w + N λ where rank G = 6: 001 (9), mended.
    """
    columns = contacts.columns
    unit = np.where(columns % 4 == friction.M_N, characteristic_length(contacts), 1.0)  # N·m for a newton of m_n/L
    return arrays.freeze(np.linalg.qr(unit[:, None] * _null_space(_normalised_grasp_matrix(contacts)[:, columns]))[0])


def is_force_closed(contacts: ContactSet) -> bool:
    """Whether every wrench can be supplied, with large enough normal forces, inside the exact cones. Motors and limits on f_n
    are ignored.

    It holds just when the components that friction can bear have rank 6 and a force strictly inside every cone cancels: when

        s* = max s   subject to   G f = 0,   √(‖f_t‖²/μ² + m_n²/γ²) ≤ f_n − s at every contact,   Σ f_n ≤ 1

    is positive. Such a force has a neighbourhood inside the cones, which G maps onto a neighbourhood of zero: every wrench, to
    scale. A component whose coefficient is zero is absent, so contacts without friction may close a grasp by their form.

    s* is found by cutting planes: linear programs over outer pyramids, each sharpened where the last force left a cone. A
    program whose optimum is not above `CLOSURE_TOLERANCE` proves the grasp open, a force above it in the exact cones proves
    it closed.
    A grasp on the boundary, such as two soft fingers tilted by the very angle of friction, is not closed, nor is one that stays
    undecided for 100 rounds. Prattichizzo and Trinkle (2008); Kelley, The cutting-plane method (1960).
    """
    F = _scaled_internal_forces(contacts)
    if F is None:
        return False
    u, normal = F[:, [friction.F_T1, friction.F_T2, friction.M_N]], F[:, friction.F_N]
    facets = [friction.pyramid_facets(8, "outer", gamma) for gamma in contacts.gamma.tolist()]
    cuts = np.vstack([a @ u[i] - normal[i] for i, a in enumerate(facets)])  # cut @ λ ≤ −s
    for _ in range(_MAX_CUTTING_ROUNDS):
        lam = _maximise_margin(cuts, normal.sum(axis=0))
        used, pressing = u @ lam, normal @ lam
        reach = np.linalg.norm(used, axis=1)
        widest = float(-(cuts @ lam).max())  # of the pyramids: not below s*
        margin = float((pressing - reach).min())  # of the exact cones: not above s*
        if margin > CLOSURE_TOLERANCE or widest <= CLOSURE_TOLERANCE:
            return margin > CLOSURE_TOLERANCE
        outside = np.flatnonzero((pressing - reach < widest) & (reach > 0.0))
        tangent = used[outside] / reach[outside, None]
        cuts = np.vstack([cuts, np.einsum("ij,ijk->ik", tangent, u[outside]) - normal[outside]])
    return False


def smallest_singular_value(contacts: ContactSet) -> float:
    """σ_min(G̃), N/N: the wrench that a unit of force makes in the worst direction; zero when rank G < 6. Li and Sastry (1988).

    Moments are about the contacts' centroid and divided by L, so neither O nor the unit of length matters.
    """
    G = _normalised_grasp_matrix(contacts)[:, contacts.columns]
    return float(np.linalg.svd(G, compute_uv=False)[5]) if _rank(G) == 6 else 0.0


def ferrari_canny(contacts: ContactSet, facets: int = 16) -> float:
    """ε: the largest wrench, in N, that contacts with Σ f_n ≤ 1 N supply in every direction. Ferrari and Canny (1992).

    It is the largest ball about the origin in the hull of the wrenches of each cone's edges at f_n = 1, with inner pyramids for
    the cones: not above the exact value, and nearer to it with more facets. Zero when the grasp is not force closed. Moments
    are about the contacts' centroid and divided by L.

    Args:
        contacts: the grasp.
        facets: of each pyramid, 3 to 256.

    Raises:
        InvalidInput: another number of facets.
    """
    fields.check_integer(facets, "facets", minimum=3, maximum=256)
    bases = _normalised_grasp_matrix(contacts).reshape(6, -1, 4)
    per_length = np.array([1.0, 1.0, 1.0, 1.0 / characteristic_length(contacts)])
    rays = [friction.pyramid_rays(facets, "inner", mu, gamma) * per_length for mu, gamma in _coefficients(contacts)]
    return max(inscribed_ball_radius(np.vstack([edges @ bases[:, i].T for i, edges in enumerate(rays)])), 0.0)


def inscribed_ball_radius(wrenches: Any) -> float:
    """The radius of the largest ball about the origin in the convex hull of some wrenches: the least distance to a facet.

    Negative when the origin is outside, by how far the plane of the worst facet is beyond it; zero when the wrenches do not
    span six dimensions (singular values below `RANK_TOLERANCE` of the largest do not count).

    Args:
        wrenches: (m, 6), in one unit: N and N, with moments divided by a length.
    """
    from scipy.spatial import ConvexHull, QhullError  # here: it takes long to import, and solving does without

    w = arrays.check_array(wrenches, "wrenches", (None, 6))
    largest = float(np.abs(w).max(initial=0.0))
    if largest == 0.0 or _rank((w - w.mean(axis=0)) / largest) < 6:
        return 0.0
    try:
        hull = ConvexHull(w / largest)
    except QhullError:  # flat to Qhull's own precision
        return 0.0
    return float(largest * -hull.equations[:, 6].max())


def _rms(vectors: Array) -> float:
    """√(mean ‖v‖²) of (N, 3) vectors, without overflow or underflow."""
    largest = float(np.abs(vectors).max())
    return largest * float(np.sqrt(np.mean(np.sum((vectors / largest) ** 2, axis=1)))) if largest > 0.0 else 0.0


def _normalised_grasp_matrix(contacts: ContactSet) -> Array:
    """G̃ (6, 4N) for padded forces: moments about the centroid and over L, in N, and so the components m_n/L."""
    L = characteristic_length(contacts)
    about_centroid = replace(contacts, p_OC=(contacts.p_OC - contacts.centroid) / L)
    return np.asarray(about_centroid.wrench_bases().transpose(1, 0, 2).reshape(6, -1))


def _rank(G: Array) -> int:
    sigma = np.linalg.svd(G, compute_uv=False)
    return int(np.count_nonzero(sigma > RANK_TOLERANCE * sigma[0]))


def _null_space(G: Array) -> Array:
    return np.asarray(np.linalg.svd(G)[2][_rank(G) :].T)


def _coefficients(contacts: ContactSet) -> list[tuple[float, float]]:
    """(μ, γ) of each contact."""
    return list(zip(contacts.mu.tolist(), contacts.gamma.tolist(), strict=True))


def _scaled_internal_forces(contacts: ContactSet) -> Array | None:
    """F (N, 4, d): all forces that cancel are F λ, as (f_t1/μ, f_t2/μ, f_n, m_n/γ), in which every cone is a unit cone.

    None where there are none, or where the components that friction can bear have a rank below 6.
    """
    L = characteristic_length(contacts)
    bears = np.array([(mu, mu, 1.0, gamma / L) for mu, gamma in _coefficients(contacts)]).ravel()
    G = (_normalised_grasp_matrix(contacts) * bears)[:, bears > 0.0]
    if _rank(G) < 6 or G.shape[1] == 6:
        return None
    F = np.zeros((len(bears), G.shape[1] - 6))
    F[bears > 0.0] = _null_space(G)
    return F.reshape(len(contacts), 4, -1)


def _maximise_margin(cuts: Array, total: Array) -> Array:
    """λ of max s subject to cuts @ λ ≤ −s and total @ λ ≤ 1. It has an optimum: λ = 0 is feasible, and s is at most 1/N."""
    from scipy.optimize import linprog  # here: it takes long to import, and solving does without

    d = len(total)
    program = linprog(
        c=np.append(np.zeros(d), -1.0),
        A_ub=np.vstack([np.column_stack([cuts, np.ones(len(cuts))]), np.append(total, 0.0)]),
        b_ub=np.append(np.zeros(len(cuts)), 1.0),
        bounds=(None, None),
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    return np.zeros(d) if program.x is None else np.asarray(program.x[:d])

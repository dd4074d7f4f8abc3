"""Force closure: whether contacts can resist every wrench."""

from __future__ import annotations

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import characteristic_length, normalised_grasp_matrix, null_space, numerical_rank
from graspforce.core.arrays import Array

# Smallest closure margin, relative to the sum of the normal forces. The linear programs are solved to 10⁻¹⁰, so a larger
# margin is not rounding; a grasp that is closed by less opens with any error of its friction coefficients.
CLOSURE_TOLERANCE = 1e-8

_MAX_CUTTING_ROUNDS = 100  # of cutting planes


def is_force_closed(contacts: ContactSet) -> bool:
    """Return whether the contacts can supply every wrench from inside the exact friction cones.

    Motors and limits of f_n are ignored. A grasp is force closed if and only if the components that friction can transmit
    have rank 6 and an internal force exists strictly inside all cones: if the closure margin s* is positive,

        s* = max s   subject to   G f = 0,   √(‖f_t‖²/μ² + m_n²/γ²) ≤ f_n − s at every contact,   Σ f_n ≤ 1.

    G maps a neighbourhood of such a force onto a neighbourhood of zero, and scaling gives every wrench. A component whose
    coefficient is zero is absent, so contacts without friction can close a grasp by their form.

    s* is computed by cutting planes: linear programs over outer pyramids, refined where a force leaves its cone. An optimum of
    at most `CLOSURE_TOLERANCE` proves that the grasp is open. A larger margin in the exact cones proves that it is closed. A
    grasp on the boundary counts as open, such as two soft fingers tilted by the friction angle, and so does a grasp that stays
    undecided after 100 rounds. Sources: Prattichizzo and Trinkle (2008); Kelley (1960).

    Args:
        contacts: the contacts.
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
        needed = np.linalg.norm(used, axis=1)
        upper = float(-(cuts @ lam).max())  # margin in the pyramids ≥ s*
        lower = float((pressing - needed).min())  # margin in the exact cones ≤ s*
        if lower > CLOSURE_TOLERANCE or upper <= CLOSURE_TOLERANCE:
            return lower > CLOSURE_TOLERANCE
        outside = np.flatnonzero((pressing - needed < upper) & (needed > 0.0))
        direction = used[outside] / needed[outside, None]
        cuts = np.vstack([cuts, np.einsum("ij,ijk->ik", direction, u[outside]) - normal[outside]])
    return False


def _scaled_internal_forces(contacts: ContactSet) -> Array | None:
    """Return F (N, 4, d): F λ are all internal forces as (f_t1/μ, f_t2/μ, f_n, m_n/γ), for which all cones are unit cones.

    Return None if there are no internal forces, or if the components that friction can transmit have a rank below 6.
    """
    L = characteristic_length(contacts)
    coefficients = zip(contacts.mu.tolist(), contacts.gamma.tolist(), strict=True)
    scale = np.array([(mu, mu, 1.0, gamma / L) for mu, gamma in coefficients]).ravel()
    G = (normalised_grasp_matrix(contacts) * scale)[:, scale > 0.0]
    if numerical_rank(G) < 6 or G.shape[1] == 6:
        return None
    F = np.zeros((len(scale), G.shape[1] - 6))
    F[scale > 0.0] = null_space(G)
    return F.reshape(len(contacts), 4, -1)


def _maximise_margin(cuts: Array, total: Array) -> Array:
    """Return λ of max s subject to cuts @ λ ≤ −s and total @ λ ≤ 1.

    The program has an optimum: λ = 0 is feasible, and s is at most 1/N.
    """
    from scipy.optimize import linprog  # imported here because it is slow to import, and solving does not need it

    d = len(total)
    program = linprog(
        c=np.append(np.zeros(d), -1.0),
        A_ub=np.vstack([np.column_stack([cuts, np.ones(len(cuts))]), np.append(total, 0.0)]),
        b_ub=np.append(np.zeros(len(cuts)), 1.0),
        bounds=(None, None),
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    return np.zeros(d) if program.x is None else np.asarray(program.x[:d])

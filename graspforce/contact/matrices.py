"""The grasp matrix G, the contact Jacobian J, rank and internal forces.

G depends on the position of O and on the unit of length. Rank, closure and quality must not. They are computed from the
normalised grasp matrix, with moments about the contacts' centroid c and divided by the characteristic length L:

    G̃ = diag(1, 1/L) [1 0; −S(c) 1] G diag(1, L),

where the last factor applies to moment components only: they become m_n/L, in N.

Sources: Al-Gallaf (undated), eq. (5)–(11), corrected; Murray, Li and Sastry (1994), chapter 5; Prattichizzo and Trinkle (2008).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet, wrench_bases
from graspforce.core import arrays
from graspforce.core.arrays import Array

# Singular values below this fraction of the largest count as zero. A contact that is 10⁶ grasp sizes away from O has lost all
# digits of its lever arm beyond 10⁻¹⁰, and a lever arm below 10⁻⁹ of the grasp size transmits no real load.
RANK_TOLERANCE = 1e-9


def grasp_matrix(contacts: ContactSet) -> Array:
    """Return the grasp matrix G: w = G f is the wrench of contact forces on the object, about O's origin, in O.

    A column is [R e; p × R e] for a force component along axis e of a contact at p, and [0; n] for a moment about the normal.
    Source: Al-Gallaf (undated), eq. (3)–(7), with p × f.

    Args:
        contacts: the contacts.

    Returns:
        (6, k), read-only; linear rows first, 1 and m.
    """
    return arrays.freeze(contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1)[:, contacts.columns])


def grasp_matrices(contacts: ContactSet, p_OC: Array, R_OC: Array) -> Array:
    """Return the grasp matrices of contacts that move over the object, as `grasp_matrix` for each instant.

    Args:
        contacts: the contacts; their positions and frames are not used.
        p_OC: (M, N, 3) positions in O, m.
        R_OC: (M, N, 3, 3) contact frames in O.

    Returns:
        (M, 6, k).
    """
    bases = wrench_bases(p_OC, R_OC)
    return np.asarray(bases.swapaxes(1, 2).reshape(len(bases), 6, -1)[:, :, contacts.columns])


def contact_jacobians(contacts: ContactSet, twists: Array, R_HO: Array, R_OC: Array) -> Array:
    """Return contact Jacobians J at M instants: tau = Jᵀ f, in the rows of f.

    Args:
        contacts: the contacts; their positions and frames are not used.
        twists: (M, N, 6, n) Jacobians of the hand's material points at the contacts, in H, linear rows first, m/rad and 1.
        R_HO: (M, 3, 3) orientations of the object in H.
        R_OC: (M, N, 3, 3) contact frames in O, or (N, 3, 3) for the same frames at all instants.

    Returns:
        (M, k, n).
    """
    R_CH = (R_HO[:, None] @ R_OC).swapaxes(-1, -2)
    M, N, _, n = twists.shape
    padded = np.empty((M, N, 4, n))
    padded[:, :, :3], padded[:, :, 3:] = R_CH @ twists[:, :, :3], R_CH[:, :, 2:] @ twists[:, :, 3:]
    return np.asarray(padded.reshape(M, 4 * N, n)[:, contacts.columns])


def characteristic_length(contacts: ContactSet) -> float:
    """Return L, the root mean square distance of the contacts from their centroid c: L² = Σ‖p − c‖²/N.

    It converts moments to forces without a choice of unit. If all contacts coincide (to 1e-12 of their distance from O), L is
    their distance from O, or 1 m if that is zero.

    Args:
        contacts: the contacts.

    Returns:
        L, m.
    """
    from_origin = _rms(contacts.p_OC)  # m
    spread = _rms(contacts.p_OC - contacts.centroid)  # m
    return (spread if spread > 1e-12 * from_origin else from_origin) or 1.0


def grasp_matrix_rank(contacts: ContactSet) -> int:
    """Return rank G, the dimension of the space of wrenches that the contacts transmit, for any friction coefficients.

    Singular values of G̃ count if they exceed `RANK_TOLERANCE` times the largest.

    Args:
        contacts: the contacts.
    """
    return numerical_rank(normalised_grasp_matrix(contacts)[:, contacts.columns])


def internal_forces(contacts: ContactSet) -> Array:
    """Return an orthonormal basis N of the internal forces, G N = 0.

    If rank G = 6, all contact forces that supply a wrench w are f = Gᵀ(GGᵀ)⁻¹ w + N λ. Source: Al-Gallaf (undated), eq. (9),
    corrected.

    Args:
        contacts: the contacts.

    Returns:
        (k, k − rank G), read-only.
    """
    columns = contacts.columns
    unit = np.where(columns % 4 == friction.M_N, characteristic_length(contacts), 1.0)  # N·m for each newton of m_n/L
    return arrays.freeze(np.linalg.qr(unit[:, None] * null_space(normalised_grasp_matrix(contacts)[:, columns]))[0])


def normalised_grasp_matrix(contacts: ContactSet) -> Array:
    """Return G̃ for padded forces: moments about the centroid and divided by L, and components m_n/L.

    Args:
        contacts: the contacts.

    Returns:
        (6, 4N), dimensionless.
    """
    L = characteristic_length(contacts)
    about_centroid = replace(contacts, p_OC=(contacts.p_OC - contacts.centroid) / L)
    return np.asarray(about_centroid.wrench_bases().transpose(1, 0, 2).reshape(6, -1))


def numerical_rank(G: Array) -> int:
    """Return the number of singular values above `RANK_TOLERANCE` times the largest.

    Args:
        G: (m, n) matrix.
    """
    sigma = np.linalg.svd(G, compute_uv=False)
    return int(np.count_nonzero(sigma > RANK_TOLERANCE * sigma[0]))


def null_space(G: Array) -> Array:
    """Return an orthonormal basis of the null space, by the rank of `numerical_rank`.

    Args:
        G: (m, n) matrix.

    Returns:
        (n, n − rank).
    """
    return np.asarray(np.linalg.svd(G)[2][numerical_rank(G) :].T)


def _rms(vectors: Array) -> float:
    """Return √(mean ‖v‖²) of (N, 3) vectors, without overflow or underflow."""
    largest = float(np.abs(vectors).max())
    return largest * float(np.sqrt(np.mean(np.sum((vectors / largest) ** 2, axis=1)))) if largest > 0.0 else 0.0

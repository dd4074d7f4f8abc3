"""Forces that neither motors nor load determine: they occur if contacts are on inner links and on the palm.

Forces f with Jᵀ f = 0 and G f = 0 change no torque and no wrench on the object. In a rigid hand they could have any size, and a
force problem may choose them freely: it can count on a squeeze that no motor makes. Contacts of equal stiffness, which carry
the torques tau and the load w from rest, take the forces of least norm,

    Jᵀ f = tau − tau_u,   G f = w,   Pᵀ f = 0,

with the columns of P a basis of these forces. So the planned forces keep Pᵀ f = 0: the motors make every squeeze that is
planned. A moment counts as a force at the characteristic length of the contacts.

Source: Bicchi (1994), with equal stiffness of all contacts and rigid joints under torque control.
"""

from __future__ import annotations

import numpy as np

from graspforce.contact import friction
from graspforce.contact.matrices import characteristic_length, grasp_matrix
from graspforce.core.arrays import Array, freeze
from graspforce.grasp.grasp import Grasp
from graspforce.hand.contact_tips import has_contact_tips

_RANK_TOLERANCE = 1e-3  # relative: a lever arm of 0.1 mm on links of 100 mm counts as none


def structural_forces(grasp: Grasp) -> Array:
    """Return P, (k, m): planned forces keep Pᵀ f = 0.

    It has no columns for a grasp of fingertips only. There, forces of least torque contain little that no motor makes.

    Args:
        grasp: hand, object and contacts.
    """
    contacts = grasp.contacts
    if not has_contact_tips(grasp.hand, grasp.fingers):
        return freeze(np.zeros((contacts.size, 0)))
    length = characteristic_length(contacts)
    unit = np.where(contacts.columns % 4 == friction.M_N, length, 1.0)  # m, of a moment per newton
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, contacts, grasp.p_HO, grasp.R_HO) * unit[:, None]
    G = grasp_matrix(contacts) * unit / np.repeat([1.0, length], 3)[:, None]
    rows = np.vstack([J.T / max(np.linalg.norm(J, 2), np.finfo(float).tiny), G / np.linalg.norm(G, 2)])
    _, sizes, basis = np.linalg.svd(rows)
    rank = int(np.count_nonzero(sizes > _RANK_TOLERANCE))
    return freeze(basis[rank:].T / unit[:, None])

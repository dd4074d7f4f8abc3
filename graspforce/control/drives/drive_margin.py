"""The slip margin that remains when the drives' torques are in error.

Errors δtau of the joint torques change the contact forces at once, while the contacts neither slip nor separate. With the
constraint A q̈ = B a + β of the contacts (`graspforce.control.contacts.mobility`), the hand's mass matrix M and the object's
M_o,

    (A M⁻¹ Aᵀ + B M_o⁻¹ Bᵀ) δf = A M⁻¹ δtau.

For |δtau| ≤ e, the margin μ f_n − ‖f_t‖ of contact i falls by at most Σ_j (μ |δf_n,ij| + ‖δf_t,ij‖) e_j, where δf_ij is the
force that one newton metre at joint j causes. The object accelerates by M_o⁻¹ Bᵀ δf.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.core.arrays import Array

_RANK_TOLERANCE = 1e-9  # of the compliance of the contacts; its null space holds forces that no torque changes


class TorqueSensitivity(NamedTuple):
    """Effects of an error of each joint's torque, while the contacts neither slip nor separate.

    Attributes:
        margin: (N, n) largest loss of each contact's slip margin, N per N·m.
        acceleration: (6, n) acceleration of the object in O, m/s² and rad/s² per N·m.
    """

    margin: Array
    acceleration: Array


def torque_sensitivity(
    A: Array, B: Array, M: Array, M_object: Array, constraints: ContactConstraints, contacts: ContactSet
) -> TorqueSensitivity:
    """Return the effects of torque errors on slip margins and on the object.

    Args:
        A: (r, n) map from joint rates to constrained velocities, m/rad.
        B: (r, 6) map from the object's twist in O to them.
        M: (n, n) mass matrix of the hand, kg·m².
        M_object: (6, 6) mass matrix of the object about O, in O.
        constraints: of the contacts.
        contacts: the contacts, with their friction.
    """
    joint_effect = np.linalg.solve(M, A.T)  # (n, r) M⁻¹ Aᵀ
    compliance = A @ joint_effect + B @ np.linalg.solve(M_object, B.T)
    influence = np.linalg.pinv(compliance, _RANK_TOLERANCE, hermitian=True) @ joint_effect.T  # (r, n) force per torque
    padded = np.zeros((4 * len(contacts), influence.shape[1]))
    padded[constraints.padded_rows] = influence * constraints.row_units[:, None]
    forces = padded.reshape(len(contacts), 4, -1)
    tangential = np.hypot(forces[:, 0], forces[:, 1])
    lever = np.divide(contacts.mu, contacts.gamma, out=np.zeros(len(contacts)), where=contacts.gamma > 0.0)  # 1/m
    tangential = np.hypot(tangential, lever[:, None] * forces[:, friction.M_N])
    loss = contacts.mu[:, None] * np.abs(forces[:, friction.F_N]) + tangential
    return TorqueSensitivity(loss, np.linalg.solve(M_object, B.T @ influence))

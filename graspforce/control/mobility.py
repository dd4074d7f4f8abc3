"""Which motions of the object the fingers can make, and the joint accelerations that make them.

Contacts stay when A q̈ = B a + β (`rolling`). Fingers that can move their contacts every way (A of full row rank) allow every
acceleration a of the object. Where A has a left null space Q, QᵀA = 0, no joint motion changes Qᵀ(B a + β), so it must vanish:
a is then the one nearest to what was commanded, in the metric of the object's inertia, among those that can be (Gauss's
principle: so would the object move if the structure bore exactly what the motors cannot).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack, solve_triangular

from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput
from graspforce.grasp.body import Body

_RANK = 1e-6  # of the largest: singular values of constraints on the object, in its inertia's metric
NO_TWISTS = freeze(np.zeros((0, 6)))  # rows of twists that cannot be made


@dataclass(frozen=True, eq=False, slots=True)
class MassFactor:
    """L of a body's mass matrix L Lᵀ, and L⁻¹.

    The inverse is made once: LAPACK's triangular solutions wait for threads, on a busy machine for tens of milliseconds.

    Attributes:
        factor, inverse: (6, 6) lower triangular.
    """

    factor: Array
    inverse: Array

    @classmethod
    def from_body(cls, body: Body) -> MassFactor:
        """Of a body, about O, in O's axes."""
        L = body.mass_matrix_factor()
        return cls(L, freeze(solve_triangular(L, np.eye(6), lower=True, check_finite=False)))


@dataclass(frozen=True, eq=False, slots=True)
class Accelerations:
    """What object and joints do together.

    Attributes:
        object: (6,) the object's acceleration in O's axes, the nearest to the command that the fingers can make.
        joints: (n,) joint accelerations that keep the contacts, rad/s².
        uncontrollable: (m, 6) orthonormal rows in O's axes: a twist can be made exactly when all rows times it are zero.
        Q: (r, d) orthonormal contact forces that load no motor; None where there are none.
        able: (6, 6) an acceleration in O's axes to the nearest that the fingers can make; None where they can make all.
    """

    object: Array
    joints: Array
    uncontrollable: Array
    Q: Array | None
    feasible_projection: Array | None


def compute_accelerations(
    A: Array, B: Array, beta: Array, object_acceleration: Array, posture: Array, M_factor: MassFactor, least_lever: float
) -> Accelerations:
    """Joint accelerations nearest to ``posture`` with which the contacts stay on an object that accelerates as wanted.

    q̈ = posture + A⁺ (B a + β − A posture): what the contacts leave free of the posture's wish stays.

    Args:
        A: (r, n) joint rates to contact velocities, m/rad.
        B: (r, 6) the object's twist to contact velocities.
        beta: (r,) m/s².
        wanted: (6,) the object's commanded acceleration, in the axes of B.
        posture: (n,) what the joints would do without contacts, rad/s².
        M_factor: of the object's mass matrix, in the same axes.
        least_lever: singular values of A below this part of the largest count as zero.

    Raises:
        InvalidInput: the numbers that A, or the mass matrix, was made of were so large that it is not finite.
    """
    if native is not None:
        joints = np.empty(len(posture))  # rad/s²
        A, B = np.ascontiguousarray(A), np.ascontiguousarray(B)
        if native.keep_contacts(A, B, beta, object_acceleration, posture, least_lever, joints):
            return Accelerations(object_acceleration, joints, NO_TWISTS, None, None)
    return compute_accelerations_reference(A, B, beta, object_acceleration, posture, M_factor, least_lever)


def compute_accelerations_reference(
    A: Array, B: Array, beta: Array, object_acceleration: Array, posture: Array, M_factor: MassFactor, least_lever: float
) -> Accelerations:
    """`compute_accelerations` as the equations stand, in every case."""
    residual = B @ object_acceleration + beta - A @ posture  # m/s²
    K = A @ A.T
    U, broken = lapack.dpotrf(K)  # K = Uᵀ U; NumPy's preparations take longer than the work, and potri waits for threads
    if not broken:
        V, broken = lapack.dtrtri(U)
        # ‖V‖² = tr K⁻¹ ≥ 1/σ_min² and tr K ≥ σ_max²: enough to know that every direction can be moved.
        if not broken and K.trace() * np.vdot(V, V) < least_lever**-2:
            return Accelerations(object_acceleration, posture + (V @ (residual @ V)) @ A, NO_TWISTS, None, None)

    if not np.isfinite(A).all():
        raise InvalidInput("state", "its numbers", "of a size from which finite torques follow")
    U, sigma, Vt = np.linalg.svd(A, full_matrices=True)
    rank = int(np.count_nonzero(sigma > least_lever * sigma[0]))
    if rank < len(A):
        Q = U[:, rank:]
        C = Q.T @ B @ M_factor.inverse.T  # Qᵀ B L⁻ᵀ, of Lᵀ a
        if not np.isfinite(C).all():
            raise InvalidInput("body", "its mass, inertia and centre", "of sizes from which finite accelerations follow")
        left, size, rows = np.linalg.svd(C, full_matrices=False)
        tied = int(np.count_nonzero(size > _RANK * size[0])) if size[0] > 0.0 else 0
        violation = Q.T @ (B @ object_acceleration + beta)  # m/s²
        change = -rows[:tied].T @ ((left[:, :tied].T @ violation) / size[:tied])
        object_acceleration = object_acceleration + M_factor.inverse.T @ change
        residual = B @ object_acceleration + beta - A @ posture
        constraints = M_factor.factor @ rows[:tied].T  # (6, tied): constraintsᵀ a is what cannot be chosen
        uncontrollable = np.linalg.qr(constraints)[0].T
        feasible_projection = np.eye(6) - M_factor.inverse.T @ rows[:tied].T @ constraints.T
    else:
        Q, uncontrollable, feasible_projection = None, NO_TWISTS, None
    joints = posture + Vt[:rank].T @ ((U[:, :rank].T @ residual) / sigma[:rank])
    return Accelerations(object_acceleration, joints, uncontrollable, Q, feasible_projection)

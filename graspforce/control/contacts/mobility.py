"""Accelerations of object and joints that keep the contacts.

The contacts are kept when A q̈ = B a + β (`graspforce.contact.kinematics`), with the joint accelerations q̈ and the object's
acceleration a. If A has full row rank, every a is feasible. Otherwise A has a left null space Q, QᵀA = 0. No joint motion
changes Qᵀ(B a + β), so it must vanish.

Among the feasible accelerations the nearest to the commanded one is used, in the metric of the object's inertia. By Gauss's
principle the object would move so if the hand's structure carried the forces that the motors cannot apply.

Spin rows may be damped near a loss of rank: q̈ = posture + Aᵀ (A Aᵀ + λ² S)⁻¹ (B a + β − A posture), where S is 1 on the
diagonal for these rows and 0 for the others, which stay exact. With σ² = 1/tr (A Aᵀ)⁻¹, at most the square of the least
singular value, λ = λ₀ (1 − σ²/σ₀²) if σ < σ₀, otherwise 0. The pads then twist or slide a little about their normals where
the fingers cannot follow a spin, and the object stays controllable.

Pads that spin creep along their tangential forces, and friction has no moment left against a further spin. Where that matters
more than the motion of the object, the object yields instead, gradually, as it does where the rank is lost. Among all
accelerations that keep the contacts, those are used that minimise

    (a − a_d)ᵀ M (a − a_d)/m + ℓ² ‖q̈ − posture‖²

for the commanded a_d and the object's mass matrix M and mass m. With N = √m L⁻ᵀ, M = L Lᵀ and Y = B N they are

    ν = (A Aᵀ + ℓ² Y Yᵀ)⁻¹ (B a_d + β − A posture),   q̈ = posture + Aᵀ ν,   a = a_d − ℓ² N Yᵀ ν,

with ℓ = ℓ₀ (1 − σ²/σ₁²) if σ < σ₁, otherwise 0.

Source: Nakamura and Hanafusa (1986) damp all rows in this way, but let no object yield.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack, solve_triangular

from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput
from graspforce.grasp.body import Body

_CONSTRAINT_RANK_TOLERANCE = 1e-6  # relative to the largest singular value, of the constraints on the object
SPIN_DAMPING_START = 0.00225  # m/rad: σ₀
SPIN_COMPLIANCE_START = 0.006  # m/rad: σ₁
_COMPLIANT_TOLERANCE = 0.1  # of the rank tolerance: where the object yields, it bounds the joint accelerations
# Relative: accelerations and pose errors ignore weaker constraints. These give way to slip of micrometres, so feedback and
# integral act along them. Their violation by the noise of measurements would be divided by their size.
_WEAK_CONSTRAINT = 0.01
_RATE_DAMPING = 1e-4  # relative to the mean squared singular value of A
NO_TWISTS = freeze(np.zeros((0, 6)))  # rows of uncontrollable twists if every twist is feasible


@dataclass(frozen=True, eq=False, slots=True)
class MassFactor:
    """Cholesky factor L of a body's mass matrix L Lᵀ, and its inverse.

    The inverse is computed once: LAPACK's triangular solvers wait for threads, which takes milliseconds on a loaded computer.

    Attributes:
        factor, inverse: (6, 6) lower triangular matrices L and L⁻¹.
    """

    factor: Array
    inverse: Array

    @property
    def mobility(self) -> Array:
        """(6, 6) N = √m L⁻ᵀ, where m is the mass; see the module."""
        return np.asarray(self.factor[0, 0] * self.inverse.T)

    @classmethod
    def from_body(cls, body: Body) -> MassFactor:
        """Return the factor of a body's mass matrix about O, in O's axes.

        Args:
            body: the object.
        """
        L = body.mass_matrix_factor()
        return cls(L, freeze(solve_triangular(L, np.eye(6), lower=True, check_finite=False)))


@dataclass(frozen=True, eq=False, slots=True)
class ObjectCompliance:
    """How far an object yields to soft pads near a loss of rank; see the module.

    Attributes:
        mobility: (6, 6) N = √m L⁻ᵀ of the object.
        largest: ℓ₀, m/rad.
    """

    mobility: Array
    largest: float

    def at(self, A: Array) -> float:
        """Return ℓ, m/rad; 0 far from a loss of rank.

        Args:
            A: (r, n) map from joint rates to constrained velocities, m/rad.
        """
        return self.largest * max(1.0 - _least_squared(A) / SPIN_COMPLIANCE_START**2, 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Accelerations:
    """Accelerations of object and joints that keep the contacts.

    Attributes:
        object_acceleration: (6,) feasible acceleration of the object nearest to the commanded one, in O, m/s² and rad/s².
        joint_acceleration: (n,) joint accelerations, rad/s².
        uncontrollable: (m, 6) orthonormal rows u in O. The fingers can make a twist exactly if u · twist = 0 for all rows.
        Q: (r, d) orthonormal constraint forces that load no motor; None if there are none.
        feasible_projection: (6, 6) map from an acceleration in O to the nearest one that is feasible up to slip of micrometres.
            None if all are feasible.
    """

    object_acceleration: Array
    joint_acceleration: Array
    uncontrollable: Array
    Q: Array | None
    feasible_projection: Array | None


def compute_accelerations(
    A: Array, B: Array, beta: Array, object_acceleration: Array, posture: Array, M_factor: MassFactor, rank_tolerance: float
) -> Accelerations:
    """Compute the joint accelerations nearest to the posture's that keep the contacts.

        q̈ = posture + A⁺ (B a + β − A posture)

    The posture's acceleration stays in the null space of A.

    Args:
        A: (r, n) map from joint rates to constrained velocities, m/rad.
        B: (r, 6) map from the object's twist to constrained velocities.
        beta: (r,) velocity-dependent part of the constraints, m/s².
        object_acceleration: (6,) commanded acceleration of the object, in the axes of B, m/s² and rad/s².
        posture: (n,) joint accelerations without contacts, rad/s².
        M_factor: factor of the object's mass matrix, in the axes of B.
        rank_tolerance: singular values of A below this fraction of the largest count as zero.

    Raises:
        InvalidInput: the state or the body has numbers so large that the results are not finite.
    """
    if native is not None:
        joint_acceleration = np.empty(len(posture))  # rad/s²
        A, B = np.ascontiguousarray(A), np.ascontiguousarray(B)
        if native.joint_accelerations(
            A=A,
            B=B,
            beta=beta,
            object_acceleration=object_acceleration,
            posture=posture,
            rank_tolerance=rank_tolerance,
            joint_acceleration=joint_acceleration,
        ):
            return Accelerations(object_acceleration, joint_acceleration, NO_TWISTS, None, None)
    return compute_accelerations_reference(A, B, beta, object_acceleration, posture, M_factor, rank_tolerance)


def compute_accelerations_reference(
    A: Array, B: Array, beta: Array, object_acceleration: Array, posture: Array, M_factor: MassFactor, rank_tolerance: float
) -> Accelerations:
    """Compute the same as `compute_accelerations` in Python, for every A. The C code is tested against it.

    Args:
        A: as in `compute_accelerations`.
        B: as in `compute_accelerations`.
        beta: as in `compute_accelerations`.
        object_acceleration: as in `compute_accelerations`.
        posture: as in `compute_accelerations`.
        M_factor: as in `compute_accelerations`.
        rank_tolerance: as in `compute_accelerations`.

    Raises:
        InvalidInput: as in `compute_accelerations`.
    """
    residual = B @ object_acceleration + beta - A @ posture  # m/s²
    if (inverse := _inverse_factor(A, rank_tolerance)) is not None:
        joint_acceleration = posture + (inverse @ (residual @ inverse)) @ A
        return Accelerations(object_acceleration, joint_acceleration, NO_TWISTS, None, None)

    if not np.isfinite(A).all():
        raise InvalidInput("state", "its numbers", "small enough for finite torques")
    U, sigma, Vt = np.linalg.svd(A, full_matrices=True)
    rank = int(np.count_nonzero(sigma > rank_tolerance * sigma[0]))
    if rank < len(A):
        Q = U[:, rank:]
        C = Q.T @ B @ M_factor.inverse.T  # Qᵀ B L⁻ᵀ acts on Lᵀ a
        if not np.isfinite(C).all():
            raise InvalidInput("body", "its mass, inertia and centre of mass", "of a size that gives finite accelerations")
        left, size, rows = np.linalg.svd(C, full_matrices=False)
        constrained = int(np.count_nonzero(size > _CONSTRAINT_RANK_TOLERANCE * size[0])) if size[0] > 0.0 else 0
        rows = rows[:constrained]
        violation = Q.T @ (B @ object_acceleration + beta)  # m/s²
        firm = int(np.count_nonzero(size[:constrained] > _WEAK_CONSTRAINT * size[0])) if constrained else 0
        change = -rows[:firm].T @ ((left[:, :firm].T @ violation) / size[:firm])
        object_acceleration = object_acceleration + M_factor.inverse.T @ change
        residual = B @ object_acceleration + beta - A @ posture
        constraints = M_factor.factor @ rows.T  # (6, constrained): constraintsᵀ a is fixed by the structure
        uncontrollable = np.linalg.qr(constraints)[0].T
        feasible_projection = np.eye(6) - M_factor.inverse.T @ rows[:firm].T @ constraints[:, :firm].T
    else:
        Q, uncontrollable, feasible_projection = None, NO_TWISTS, None
    joint_acceleration = posture + Vt[:rank].T @ ((U[:, :rank].T @ residual) / sigma[:rank])
    return Accelerations(object_acceleration, joint_acceleration, uncontrollable, Q, feasible_projection)


def compute_damped_accelerations(
    A: Array, B: Array, beta: Array, object_acceleration: Array, posture: Array, damping: Array, rank_tolerance: float
) -> Accelerations | None:
    """Compute accelerations with rows that are damped near a loss of rank; None if the rows may lack it in spite of that.

    Args:
        A: as in `compute_accelerations`.
        B: as in `compute_accelerations`.
        beta: as in `compute_accelerations`.
        object_acceleration: as in `compute_accelerations`.
        posture: as in `compute_accelerations`.
        damping: (r,) λ₀ of each row, in the unit of A; zero for rows that stay exact.
        rank_tolerance: as in `compute_accelerations`.
    """
    share = max(1.0 - _least_squared(A) / SPIN_DAMPING_START**2, 0.0)
    inverse = _inverse_factor(A, rank_tolerance, np.diag((share * damping) ** 2))
    if inverse is None:
        return None
    residual = B @ object_acceleration + beta - A @ posture  # m/s²
    joint_acceleration = posture + (inverse @ (residual @ inverse)) @ A
    return Accelerations(object_acceleration, joint_acceleration, NO_TWISTS, None, None)


def compute_compliant_accelerations(
    A: Array,
    B: Array,
    beta: Array,
    object_acceleration: Array,
    posture: Array,
    compliance: ObjectCompliance,
    rank_tolerance: float,
) -> Accelerations | None:
    """Compute accelerations with an object that yields near a loss of rank; None if the rank may be lacking in spite of that.

    Args:
        A: as in `compute_accelerations`.
        B: as in `compute_accelerations`.
        beta: as in `compute_accelerations`.
        object_acceleration: as in `compute_accelerations`.
        posture: as in `compute_accelerations`.
        compliance: of the object.
        rank_tolerance: as in `compute_accelerations`.
    """
    size = compliance.at(A)
    yielding = size * (B @ compliance.mobility)
    tolerance = rank_tolerance * (_COMPLIANT_TOLERANCE if size > 0.0 else 1.0)
    inverse = _inverse_factor(A, tolerance, yielding @ yielding.T)
    if inverse is None:
        return None
    residual = B @ object_acceleration + beta - A @ posture  # m/s²
    multipliers = inverse @ (residual @ inverse)
    object_acceleration = object_acceleration - size * (compliance.mobility @ (multipliers @ yielding))
    return Accelerations(object_acceleration, posture + multipliers @ A, NO_TWISTS, None, None)


def has_full_rank(A: Array, rank_tolerance: float) -> bool:
    """Return whether every acceleration of the object is feasible with these rows.

    Args:
        A: as in `compute_accelerations`.
        rank_tolerance: as in `compute_accelerations`.
    """
    sigma = np.linalg.svd(A, compute_uv=False)
    return len(sigma) == len(A) and bool(sigma[-1] > rank_tolerance * sigma[0])


def planned_rates(A: Array, B: Array, twist: Array, v: Array | None = None) -> Array:
    """Return the joint rates with which rolling contacts follow a twist of the object, v + A⁺(B V − A v), (n,), rad/s.

    Least squares with damping: contacts that the joints cannot follow get no rate instead of a large one.

    Args:
        A: (r, n) contact velocities per joint rate.
        B: (r, 6) contact velocities per twist of the object, in O.
        twist: (6,) V, twist of the object in O, m/s and rad/s.
        v: (n,) rates of the joints' motion that does not move the contacts, rad/s. Default: zeros.
    """
    K = A @ A.T
    K.flat[:: len(K) + 1] += _RATE_DAMPING * K.trace() / len(K)
    if v is None:
        return np.asarray(np.linalg.solve(K, B @ twist) @ A)
    return np.asarray(v + np.linalg.solve(K, B @ twist - A @ v) @ A)


def _least_squared(A: Array) -> float:
    """Return σ² = 1/tr (A Aᵀ)⁻¹, at most the square of the least singular value; 0 without full row rank."""
    sigma = np.linalg.svd(A, compute_uv=False)
    with np.errstate(divide="ignore"):
        return 1.0 / float(np.sum(sigma**-2.0)) if len(sigma) == len(A) else 0.0


def _inverse_factor(A: Array, rank_tolerance: float, more: Array | None = None) -> Array | None:
    """Return V with V Vᵀ = (A Aᵀ + more)⁻¹, or None if the sum may lack full rank."""
    K = A @ A.T
    if more is not None:
        K += more
    U, failed = lapack.dpotrf(K)  # K = Uᵀ U; lower overhead than NumPy, and no threads unlike potri
    if failed:
        return None
    V, failed = lapack.dtrtri(U)
    # ‖V‖² = tr K⁻¹ ≥ 1/σ_min² and tr K ≥ σ_max², so this bounds the condition of A.
    return V if not failed and K.trace() * np.vdot(V, V) < rank_tolerance**-2 else None

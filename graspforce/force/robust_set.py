"""The forces of a fixed squeeze when the data of its problem are in error: shifts that are exact, and bounds on the rest.

In the scaled variables x of `conic_program`, a squeeze x₀ becomes

    x = x₀ + β + E u + R (m + g) + Q δ + (R' − R) (…),      ‖u‖ ≤ 1,

with R = G⁺. β = R Δw runs over the vertices of the exact part of the set: mass, centre of mass and further wrenches. E u is
the ellipsoid of wrenches, m the moment of displaced contacts, |m| ≤ Σ r_i ‖x_i‖/L, Q δ the effect of torque errors,
|δ_l| ≤ e_l |tau_l|, and R' the reaction of the true contacts, ‖R' − R‖ ≤ √2 ‖ΔG‖ ‖R‖ ‖R'‖ (Wedin 1973). Every
linear function of x changes by at most the sum of the bounds of these terms, its reserve, which is linear in ‖x_i‖ and |tau_l|.

Friction and normals need no terms: `error_vertices.least_friction` covers them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from graspforce.contact import friction
from graspforce.contact.contact import ContactModel
from graspforce.contact.matrices import RANK_TOLERANCE
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.cone_program import ConicProgram, conic_program
from graspforce.force.error_vertices import least_friction, wrench_vertices
from graspforce.force.problem import ForceProblem
from graspforce.force.uncertainty import Uncertainty

_UNSUPPLIED = 1e-9  # force units: a part of a wrench above it, which the contacts cannot transmit, makes the set infeasible
_NEGLIGIBLE = 1e-24  # square of a ratio: a smaller part of a bound is added as it is


@dataclass(frozen=True, eq=False, slots=True)
class Reserve:
    """Largest change of scaled functions: constant + by_contact ‖x_i‖ + by_motor |tau_l|.

    Args:
        constant: (r,) in force units.
        by_contact: (r, N) for each ‖x_i‖.
        by_motor: (r, n) for each |tau_l|, 1/(N·m).
    """

    constant: Array
    by_contact: Array
    by_motor: Array

    def at(self, sizes: Array, torques: Array) -> Array:
        """Return (r,) the reserves for sizes of the contact forces and torques.

        Args:
            sizes: (N,) ‖x_i‖.
            torques: (n,) |tau_l|, N·m.
        """
        return np.asarray(self.constant + self.by_contact @ sizes + self.by_motor @ torques)


class RobustSet:
    """The set of forces that one squeeze may become.

    Args:
        problem: a force problem with an uncertainty.

    Raises:
        InvalidInput: contact errors so large, or contacts so few, that the reaction is not defined.
    """

    def __init__(self, problem: ForceProblem) -> None:
        assert problem.uncertainty is not None  # the caller's duty
        self.problem, self.uncertainty = problem, problem.uncertainty
        self.nominal = ForceProblem(
            least_friction(problem.contacts, self.uncertainty), problem.w, problem.actuation, problem.cone, problem.objective
        )
        self.program: ConicProgram = conic_program(self.nominal)
        self.columns = len(self.program.component_indices)
        self._G = self.program.A[:6, : self.columns]
        self._R = np.linalg.pinv(self._G, RANK_TOLERANCE)
        self._eta, self._second = self._contact_errors()

    @cached_property
    def is_exact(self) -> bool:
        """Whether the robust problem is one cone program with the same optimum; otherwise its cost is bounded from both sides.

        Ellipsoids of wrenches, errors of places and torques, and tilted soft contacts are not exact.
        """
        u = self.uncertainty
        return not (u.wrench_ellipsoid.any() or self.torque_fractions.any() or self.displacement.any())

    @cached_property
    def exact_errors(self) -> Uncertainty:
        """The errors that are exact: a subset of all."""
        u = self.uncertainty
        tilt = np.broadcast_to(u.normal_error, len(self.problem.contacts))
        soft = [model is ContactModel.SOFT for model in self.problem.contacts.models]
        return Uncertainty(
            friction_error=u.friction_error,
            mass_error=u.mass_error,
            centre_of_mass_error=u.centre_of_mass_error,
            wrenches=u.wrenches,
            normal_error=np.where(soft, 0.0, tilt),
            slip_margin=u.slip_margin,
        )

    @cached_property
    def owners(self) -> npt.NDArray[np.intp]:
        """(m,) the contact of each scaled variable."""
        return np.asarray(self.problem.contacts.columns[self.program.component_indices] // 4)

    @cached_property
    def rubbing(self) -> npt.NDArray[np.intp]:
        """(c,) the contacts with friction and a normal force."""
        return np.intersect1d(np.flatnonzero(self.nominal.contacts.mu > 0.0), self.owners)

    @cached_property
    def friction_rows(self) -> tuple[Array, Array]:
        """(c, m) rows h of x_n and (c, 3, m) rows T of the forces that friction bears, of `rubbing`: ‖T x‖ ≤ μ h·x."""
        contacts = self.nominal.contacts
        heads, tails = np.zeros((len(self.rubbing), self.columns)), np.zeros((len(self.rubbing), 3, self.columns))
        place = {int(contact): row for row, contact in enumerate(self.rubbing)}
        for column, (contact, index) in enumerate(zip(self.owners.tolist(), self.program.component_indices, strict=True)):
            component = int(contacts.columns[index]) % 4
            if contact not in place:
                continue
            if component == friction.F_N:
                heads[place[contact], column] = 1.0
                continue
            lever = 1.0
            if component == friction.M_N:
                lever = self.problem.length * contacts.mu[contact] / contacts.gamma[contact]
            tails[place[contact], min(component, 2), column] = lever
        return heads, tails

    @cached_property
    def wrench_changes(self) -> Array:
        """(V, 6) scaled vertices of the wrench's errors but for the ellipsoid; zero is in their convex hull."""
        changes = wrench_vertices(self.problem.w, self.uncertainty)
        changes[:, 3:] -= np.cross(self.problem.contacts.centroid, changes[:, :3])
        return np.asarray(changes / self.program.wrench_units)

    @cached_property
    def shifts(self) -> Array:
        """(V, m) β of each vertex."""
        return np.asarray(self.wrench_changes @ self._R.T)

    @cached_property
    def ellipsoid(self) -> Array:
        """(m, d) image of the ellipsoid of wrenches."""
        return np.asarray(self._R @ self._scaled_ellipsoid)

    @cached_property
    def unsupplied(self) -> Array:
        """(6,) the largest scaled part of a wrench of the set that the contacts cannot transmit; rounding if there is none."""
        columns = np.hstack([self.wrench_changes.T, self._scaled_ellipsoid])
        missed = columns - self._G @ (self._R @ columns)
        return np.asarray(missed[:, int(np.abs(missed).max(axis=0).argmax())])

    @property
    def is_supplied(self) -> bool:
        """Whether the contacts transmit all wrenches of the set, regardless of limits."""
        return float(np.abs(self.unsupplied).max()) <= _UNSUPPLIED

    @cached_property
    def lever(self) -> Array:
        """(m, n) Jᵀ in scaled variables: torques per force unit, N·m."""
        actuation, kept = self.problem.actuation, self.program.component_indices
        if actuation is None:
            return np.zeros((self.columns, 0))
        return np.asarray(actuation.J[kept] * self.program.units[kept, None])

    @cached_property
    def torque_effect(self) -> Array:
        """(m, n) the change of the forces at the fingers by a torque, before the reaction, 1/(N·m)."""
        return np.linalg.pinv(self.lever.T, RANK_TOLERANCE)

    @cached_property
    def torque_fractions(self) -> Array:
        """(n,) the errors of the torques, as fractions."""
        return np.broadcast_to(self.uncertainty.torque_error, self.lever.shape[1])

    @cached_property
    def displacement(self) -> Array:
        """(N,) moment of each contact's errors per force unit of its force, in scaled moments."""
        count, contacts = len(self.problem.contacts), self.problem.contacts
        soft = np.array([model is ContactModel.SOFT for model in contacts.models])
        tilt = 2.0 * np.sin(0.5 * np.broadcast_to(self.uncertainty.normal_error, count))
        return np.broadcast_to(self.uncertainty.position_error, count) / self.problem.length + np.where(soft, tilt, 0.0)

    def reserve(self, heads: Array, tails: Array | None = None) -> Reserve:
        """Return the reserves of functions d·(T x) − h·x for all unit vectors d; of h·x without tails.

        Args:
            heads: (r, m) rows h.
            tails: (r, c, m) rows T.
        """
        if self.is_exact:
            count, n = len(self.problem.contacts), self.lever.shape[1]
            return Reserve(np.zeros(len(heads)), np.zeros((len(heads), count)), np.zeros((len(heads), n)))
        R, Q = self._R, self._torque_change
        rows = np.zeros((len(heads), 0, self.columns)) if tails is None else tails
        constant = np.array(
            [_largest_on_ball(T @ self.ellipsoid, h @ self.ellipsoid) for T, h in zip(rows, heads, strict=True)]
        )
        moment = _spectral(rows @ R[:, 3:]) + np.linalg.norm(heads @ R[:, 3:], axis=1)
        motor = np.linalg.norm(rows @ Q, axis=1) + np.abs(heads @ Q)
        second = self._second * (_spectral(rows) + np.linalg.norm(heads, axis=1))
        wrench = float(np.linalg.norm(self.wrench_changes, axis=1).max()) + _spectral(self._scaled_ellipsoid[None])[0]
        through = self.torque_fractions * np.linalg.norm(self._G @ self.torque_effect, axis=0)
        displaced = self.torque_fractions * (self.displacement @ self._effect_by_contact)
        arm = moment + second  # both grow with the moment of displaced contacts
        return Reserve(
            constant=constant + second * wrench,
            by_contact=arm[:, None] * self.displacement,
            by_motor=motor * self.torque_fractions + np.outer(second, through) + np.outer(arm, displaced),
        )

    def member(self, row: Array, shift: Array, x: Array) -> tuple[Array, Array]:
        """Return the map x → M x + b of a member of the set whose errors increase row·x most, to first order.

        Args:
            row: (m,) a linear function of the forces.
            shift: (m,) β of the vertex.
            x: (m,) the squeeze at which the errors are chosen.
        """
        program, u = self.program, self.uncertainty
        spread = self.ellipsoid.T @ row
        size = float(np.linalg.norm(spread))
        wrench = self._G @ shift
        wrench += self._scaled_ellipsoid @ (spread / size) if size > 0.0 else 0.0
        price = row @ self._R[:, 3:]  # of a moment
        G = self._G.copy()
        place = np.broadcast_to(u.position_error, len(self.problem.contacts)) / self.problem.length
        for i in np.flatnonzero(place > 0.0):
            own = self.owners == i
            force = G[:3, own]
            along = np.cross(force @ x[own], price)  # −δ × F, so that the reaction is the worst
            size = float(np.linalg.norm(along))
            delta = -place[i] * along / size if size > 0.0 else np.zeros(3)
            G[3:, own] += np.cross(delta, force, axisb=0, axisc=0)
        bias = np.zeros(0) if self.problem.actuation is None else self.problem.actuation.tau_u
        sign = np.sign((row @ self._torque_change) * (bias + self.lever.T @ x[: self.columns]))
        errors = self.torque_effect * (sign * self.torque_fractions)  # of the torques, as forces
        M, q = np.eye(self.columns) + errors @ self.lever.T, errors @ bias
        R = np.linalg.pinv(G, RANK_TOLERANCE)
        load = program.b[:6] + wrench
        free = np.eye(self.columns) - R @ G
        return free @ M, free @ q + R @ load

    def worst_members(self, x: Array) -> list[tuple[Array, Array]]:
        """Return maps x → M x + b of members of the set, one for each contact with friction, near the worst ones.

        Their errors are those that push the contact's force most towards the side on which it slips.

        Args:
            x: (m,) the squeeze.
        """
        heads, tails = self.friction_rows
        mu = self.nominal.contacts.mu[self.rubbing]
        members = []
        for head, tail, friction_coefficient in zip(heads, tails, mu, strict=True):
            every = x + self.shifts
            margins = friction_coefficient * (every @ head) - np.linalg.norm(every @ tail.T, axis=1)
            shift = self.shifts[int(margins.argmin())]
            across = tail @ (x + shift)
            size = float(np.linalg.norm(across))
            direction = across / size if size > 0.0 else np.eye(len(across))[0]
            members.append(self.member(direction @ tail - friction_coefficient * head, shift, x))
        return members

    def sizes(self, x: Array) -> Array:
        """Return (N,) ‖x_i‖ of every contact.

        Args:
            x: (m,) scaled forces.
        """
        return np.sqrt(np.bincount(self.owners, x[: self.columns] ** 2, len(self.problem.contacts)))

    @cached_property
    def reaction(self) -> Array:
        """(k, 6) R in SI units: the forces of least norm of a wrench about O."""
        R = np.zeros((self.problem.size, 6))
        R[self.program.component_indices] = self._R * self.program.units[self.program.component_indices, None]
        R /= self.program.wrench_units
        R[:, :3] -= np.cross(R[:, 3:], self.problem.contacts.centroid)
        return R

    @property
    def _scaled_ellipsoid(self) -> Array:
        """(6, d) the ellipsoid of wrenches about the contacts' centroid, scaled."""
        E = self.uncertainty.wrench_ellipsoid.copy()
        E[3:] -= np.cross(self.problem.contacts.centroid, E[:3], axisb=0, axisc=0)
        return np.asarray(E / self.program.wrench_units[:, None])

    @property
    def _torque_change(self) -> Array:
        """(m, n) the change of the contact forces by a torque, with the reaction: Q = (1 − R G) J⁺ᵀ."""
        return np.asarray(self.torque_effect - self._R @ (self._G @ self.torque_effect))

    @property
    def _effect_by_contact(self) -> Array:
        """(N, n) norm of the change of each contact's force by a torque, before the reaction."""
        squares = np.zeros((len(self.problem.contacts), self.lever.shape[1]))
        np.add.at(squares, self.owners, self.torque_effect**2)
        return np.sqrt(squares)

    def _contact_errors(self) -> tuple[float, float]:
        """Return ‖ΔG‖ and the bound on ‖R' − R‖.

        Raises:
            InvalidInput: the true contacts may not transmit all wrenches.
        """
        eta = float(np.linalg.norm(self.displacement))
        if eta == 0.0:
            return 0.0, 0.0
        sigma = np.linalg.svd(self._G, compute_uv=False)
        least = float(sigma[5]) if len(sigma) == 6 and sigma[5] > RANK_TOLERANCE * sigma[0] else 0.0
        if least <= eta:
            largest = least * self.problem.length  # m
            allowed = f"0 or less than {largest:.3g} m in root sum of squares: larger errors may leave no reaction"
            raise InvalidInput("uncertainty.position_error", self.uncertainty.position_error.tolist(), allowed)
        return eta, float(np.sqrt(2.0)) * eta / (least * (least - eta))


def _spectral(matrices: Array) -> Array:
    """Return the largest singular value of each matrix of a stack; 0 for empty ones."""
    return np.zeros(len(matrices)) if 0 in matrices.shape else np.asarray(np.linalg.norm(matrices, 2, axis=(1, 2)))


def _largest_on_ball(M: Array, b: Array) -> float:
    """Return an upper bound on max ‖Mᵀ d − b‖ over unit vectors d, exact but for the accuracy of the dual (trust region).

    By weak duality every λ ≥ λ_max(M Mᵀ) gives the bound ‖b‖² + λ + (M b)ᵀ (λ − M Mᵀ)⁻¹ (M b); the least one is the maximum.
    """
    if M.size == 0:
        return float(np.linalg.norm(b))
    eigenvalues, vectors = np.linalg.eigh(M @ M.T)
    if not eigenvalues[-1] > _NEGLIGIBLE * float(b @ b):
        return float(np.linalg.norm(b) + np.linalg.norm(M))
    squares = (vectors.T @ (M @ b)) ** 2
    top = float(eigenvalues[-1])
    low, high = 1e-12 * top, top + float(np.sqrt(squares.sum()))

    def bound(excess: float) -> float:
        return top + excess + float((squares / (excess + top - eigenvalues)).sum())

    for _ in range(80):  # golden section: the bound is convex in λ
        a, c = low + 0.381966 * (high - low), low + 0.618034 * (high - low)
        low, high = (low, c) if bound(a) < bound(c) else (a, high)
    return float(np.sqrt(b @ b + min(bound(low), bound(high))))

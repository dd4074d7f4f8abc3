"""The solution of a force problem: status, forces, torques, slip margins, multipliers and certificate."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from graspforce.contact import friction
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord
from graspforce.core.lazy import plot_with
from graspforce.core.text_table import Table
from graspforce.force.certificate import Certificate, certify_infeasibility
from graspforce.force.infeasibility import Infeasibility, describe_infeasibility
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.robust_limits import RobustCertificate
from graspforce.force.scale import scale
from graspforce.force.status import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "graspforce/solution/1"
_DIVERGED_FORCE = 1e100  # N: a larger force comes from a diverged solver, and its square would overflow
_NO_FORCES = arrays.freeze([])
_MAX_PRINTED_TORQUES = 16


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of a force problem. Quantities that follow from the forces are computed on first access.

    Args:
        status: optimal, inaccurate, infeasible or failed. Without a certificate it is only the solver's claim.
        problem: the problem; None for a solution that came over the wire.
        f: (k,) stacked contact forces in the contact frames, N and N·m; empty without forces.
        certificate: the verified proof; None before verification and for failed solutions.
        infeasibility: why the problem is infeasible; None if it is not.
        backend: name of the solver.
        iterations: iterations of the solver.
        seconds: time of the solver, s, without certificate and record.
        multipliers: of the optimum or of the proof of infeasibility; None over the wire.
        cost_bound: with an uncertainty, lower bound on the objective of all forces that hold for it; None otherwise.
        timed_out: the deadline passed without a certified answer. With a `Solver`, forces, certificate and problem are those
            of its last certified solve; otherwise, or without one, the status is failed.
    """

    status: Status
    problem: ForceProblem | None
    f: Array
    certificate: Certificate | None
    infeasibility: Infeasibility | None
    backend: str
    iterations: int
    seconds: float
    multipliers: Multipliers | None = None
    cost_bound: float | None = None
    timed_out: bool = False

    def __repr__(self) -> str:
        return f"<Solution: {self._summary()}>"

    def __str__(self) -> str:
        return "\n".join([str(self._table()) if self.forces else self._summary(), *self._notes()])

    def _repr_html_(self) -> str:
        table = self._table().to_html() if self.forces else f"<p>{escape(self._summary())}</p>"
        return table + "".join(f"<p>{escape(note)}</p>" for note in self._notes())

    def with_verdict(self, status: Status, certificate: Certificate | None) -> Solution:
        """Return the solution with a status and a certificate. A failed solution has no forces.

        Args:
            status: the verified status.
            certificate: the proof, if there is one.
        """
        f = _NO_FORCES if status is Status.FAILED else self.f
        return dataclasses.replace(self, status=status, certificate=certificate, f=f)

    def with_certificate(self, certificate: Certificate) -> Solution:
        """Return the solution with a certificate of optimality, and the status that it proves.

        Args:
            certificate: verified or not.
        """
        if not certificate.verified:
            return self.with_verdict(Status.FAILED, certificate)
        return self.with_verdict(Status.OPTIMAL if certificate.is_tight else Status.INACCURATE, certificate)

    @property
    def found(self) -> bool:
        """Whether the solution has certified forces."""
        return self.status in (Status.OPTIMAL, Status.INACCURATE)

    @property
    def is_final(self) -> bool:
        """Whether the solution is certified optimal or certified infeasible."""
        return self.certificate is not None and self.status in (Status.OPTIMAL, Status.INFEASIBLE)

    @cached_property
    def objective(self) -> float | None:
        """The value of the objective at the forces (for "margin", s); None without forces."""
        return self.original_problem.cost(self.f) if len(self.f) else None

    @cached_property
    def objective_gap(self) -> float | None:
        """Bound on the decrease of the objective that remains possible, relative to the objective itself.

        The certificate's residuals are relative to the problem's unit of cost. An objective far below that unit has fewer
        accurate digits, which this number states. None without certified forces, or if the objective is 0.
        """
        if not self.found or self.certificate is None or not self.objective:
            return None
        size = abs(self.objective)
        with np.errstate(all="ignore"):  # numbers that overflow
            ratio = (float(scale(self.original_problem).cost) + size) / size
        gap = (self.certificate.gap + self.certificate.dual_residual) * ratio
        return gap if np.isfinite(gap) else None

    @cached_property
    def robust(self) -> RobustCertificate | None:
        """What the forces hold over the uncertainty of the problem; None without one, or without forces."""
        if self.problem is None or self.cost_bound is None or not self.found:
            return None
        return RobustCertificate(self.problem, self.f, self.cost_bound)

    @cached_property
    def forces(self) -> tuple[Array, ...]:
        """The components of each contact's force in its contact frame, N and N·m; empty without forces."""
        return self.original_problem.contacts.split(self.f) if len(self.f) else ()

    @cached_property
    def forces_object(self) -> Array:
        """The (N, 3) contact forces in O, N."""
        R_OC = self.original_problem.contacts.R_OC[: len(self._padded)]
        return arrays.freeze(np.einsum("nij,nj->ni", R_OC, self._padded[:, :3]))

    @cached_property
    def torques(self) -> Array:
        """The (n,) motor torques tau = tau_u + Jᵀ f, N·m."""
        return arrays.freeze(self.original_problem.torques(self.f) if len(self.f) else [])

    @cached_property
    def slip_margin(self) -> Array:
        """The (N,) slip margins μ f_n − ‖f_t‖, N; negative if the contact slips, 0 without friction.

        For a soft contact, μ f_n − √(‖f_t‖² + (μ m_n/γ)²): the moment uses up tangential force.
        """
        return arrays.freeze(friction.slip_margin(self._padded, *self._friction))

    @cached_property
    def friction_used(self) -> Array:
        """The (N,) used shares of friction, ‖f_t‖/(μ f_n); 0 without friction or without normal force."""
        required = friction.required_friction(self._padded, *self._friction)  # N
        available = self._friction[0] * self._padded[:, friction.F_N]  # N
        with np.errstate(over="ignore"):
            used = np.divide(required, available, out=np.zeros(len(required)), where=available > 0)
        return arrays.freeze(np.minimum(used, np.finfo(float).max))  # JSON has no infinity

    @property
    def original_problem(self) -> ForceProblem:
        """The problem.

        Raises:
            AttributeError: the solution came over the wire, without its problem.
        """
        if self.problem is None:
            raise AttributeError("a solution that came over the wire has no problem; only the fields of its record exist")
        return self.problem

    @property
    def _padded(self) -> Array:
        """The (N, 4) forces as (f_t1, f_t2, f_n, m_n), N and N·m."""
        return self.original_problem.contacts.pad(self.f) if len(self.f) else np.zeros((0, 4))

    @property
    def _friction(self) -> tuple[Array, Array]:
        """The (N,) friction coefficients, and (N,) torsional friction coefficients, m."""
        count = len(self._padded)
        return self.original_problem.contacts.mu[:count], self.original_problem.contacts.gamma[:count]

    def plot(self) -> Figure:
        """Return a figure of forces, friction use and torques.

        Raises:
            InvalidInput: the solution has no forces.
        """
        figure: Figure = plot_with("plot_solution", self)
        return figure

    def _summary(self) -> str:
        """Return the status, the objective and the solver in one line."""
        value = f", objective {self.objective:.6g}" if self.found and self.objective is not None else ""
        return f"{self.status.value}{value}, {self.backend}, {self.iterations} iterations, {1e3 * self.seconds:.3g} ms"

    def _table(self) -> Table:
        """Return the table of contact forces, with the summary as its title."""
        header = ("contact", "normal (N)", "tangential (N)", "slip margin (N)", "friction used (%)")
        has_moment = any(len(force) == 4 for force in self.forces)
        smallest = 1e-7 * float(np.abs(self.f).max(initial=0.0))  # N: smaller values are printed as 0
        rows = []
        for i, (force, margin, used) in enumerate(zip(self.forces, self.slip_margin, self.friction_used, strict=True)):
            normal, tangential = (force[0], 0.0) if len(force) == 1 else (force[2], float(np.hypot(*force[:2])))
            values = [x if abs(x) > smallest else 0.0 for x in (normal, tangential, margin)]
            row = [str(i), *(f"{x:.4g}" for x in values), f"{100.0 * used:.3g}"]
            rows.append((*row, f"{force[3]:.4g}" if len(force) == 4 else "") if has_moment else tuple(row))
        return Table((*header, "moment (N·m)") if has_moment else header, tuple(rows), self._summary())

    def _notes(self) -> list[str]:
        """Return the lines below the table: why the problem is infeasible, and a few torques."""
        notes = [] if self.infeasibility is None else [self.infeasibility.explanation]
        if 0 < len(self.torques) <= _MAX_PRINTED_TORQUES:
            notes.append("torques (N·m): " + ", ".join(f"{tau:.4g}" for tau in self.torques))
        return notes

    def to_dict(self) -> JsonRecord:
        """Return the record of a solution (`SCHEMA`).

        Only problems with an uncertainty have the field ``robust``, and only late solutions ``timed_out``.
        """
        pairs = zip(self.slip_margin.tolist(), self.friction_used.tolist(), strict=True)
        robust = {} if self.robust is None else {"robust": self.robust.to_dict()}
        late = {"timed_out": True} if self.timed_out else {}
        return {
            **robust,
            **late,
            "schema": SCHEMA,
            "status": self.status.value,
            "objective": self.objective,
            "objective_gap": self.objective_gap,
            "forces": [force.tolist() for force in self.forces],
            "forces_object": self.forces_object.tolist(),
            "torques": self.torques.tolist(),
            "contacts": [{"slip_margin": margin, "friction_used": used} for margin, used in pairs],
            "certificate": None if self.certificate is None else self.certificate.to_dict(),
            "infeasibility": None if self.infeasibility is None else self.infeasibility.to_dict(),
            "solver": {"backend": self.backend, "iterations": self.iterations, "seconds": self.seconds},
        }

    @classmethod
    def from_dict(cls, record: object) -> Solution:
        """Return the solution of a record. It has no problem and no multipliers. Names of joints are not kept.

        Args:
            record: as `to_dict` returns it.

        Raises:
            InvalidInput: a field is missing, unknown or has a value that is not allowed.
        """
        names = ["schema", "status", "objective", "forces", "forces_object", "torques", "contacts"]
        values = fields.check_record(
            record,
            "",
            required=[*names, "certificate", "infeasibility", "solver"],
            optional=["joints", "objective_gap", "robust", "timed_out"],
        )
        fields.check_choice(values["schema"], "schema", (SCHEMA,))
        margins = [fields.check_record(c, "contacts", required=["slip_margin", "friction_used"]) for c in values["contacts"]]
        solver = fields.check_record(values["solver"], "solver", required=["backend", "iterations", "seconds"])
        forces_object = np.reshape(np.asarray(values["forces_object"], dtype=np.float64), (-1, 3))
        certificate, infeasibility = values["certificate"], values["infeasibility"]
        forces = tuple(arrays.check_array(force, f"forces[{i}]", (None,)) for i, force in enumerate(values["forces"]))
        solution = cls(
            status=Status(fields.check_choice(values["status"], "status", [status.value for status in Status])),
            problem=None,
            f=arrays.freeze(np.concatenate(forces) if forces else []),
            certificate=None if certificate is None else Certificate.from_dict(certificate),
            infeasibility=None if infeasibility is None else Infeasibility.from_dict(infeasibility),
            timed_out=fields.check_boolean(values.get("timed_out", False), "timed_out"),
            **solver,
        )
        vars(solution).update(  # the values of cached properties, which would need the problem
            objective=values["objective"],
            objective_gap=values.get("objective_gap"),
            robust=None if values.get("robust") is None else RobustCertificate.from_dict(values["robust"]),
            forces=forces,
            forces_object=arrays.check_array(forces_object, "forces_object", (None, 3)),
            torques=arrays.check_array(values["torques"], "torques", (None,)),
            slip_margin=arrays.freeze([c["slip_margin"] for c in margins]),
            friction_used=arrays.freeze([c["friction_used"] for c in margins]),
        )
        return solution


class SolutionData(Protocol):
    """The numbers of a certified optimum, or of a proof of infeasibility, as a backend returns them, decoded on demand."""

    def problem(self) -> ForceProblem:
        """Return the problem that was solved."""

    def forces(self) -> Array:
        """Return (k,) the stacked contact forces, N and N·m."""

    def torques(self) -> Array:
        """Return (n,) the motor torques, N·m."""

    def multipliers(self) -> Multipliers:
        """Return the multipliers of the optimum or of the proof."""

    def certificate(self) -> Certificate:
        """Return the certificate of the optimum."""

    def infeasibility_certificate(self) -> Certificate:
        """Return the certificate of infeasibility."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LazySolution(Solution):
    """A certified optimum whose fields are decoded on first access.

    A control loop reads few of the fields, and decoding all of them would take longer than the solver. Backends set only
    ``data``, ``backend``, ``iterations`` and ``seconds``.

    Args:
        data: the numbers of the optimum.
    """

    data: SolutionData = dataclasses.field(repr=False)
    status = Status.OPTIMAL
    infeasibility = None
    is_final = True
    problem = cached_property(lambda self: self.data.problem())
    f = cached_property(lambda self: self.data.forces())
    torques = cached_property(lambda self: self.data.torques())
    multipliers = cached_property(lambda self: self.data.multipliers())
    certificate = cached_property(lambda self: self.data.certificate())

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a plain `Solution` for copies and other processes."""
        return Solution, tuple(getattr(self, field.name) for field in dataclasses.fields(Solution))


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LazyInfeasibleSolution(Solution):
    """A certified infeasible problem whose fields are decoded on first access, as in `LazySolution`.

    Args:
        data: the numbers of the proof.
    """

    data: SolutionData = dataclasses.field(repr=False)
    status = Status.INFEASIBLE
    f = _NO_FORCES
    problem = cached_property(lambda self: self.data.problem())
    multipliers = cached_property(lambda self: self.data.multipliers())
    certificate = cached_property(lambda self: self.data.infeasibility_certificate())

    infeasibility = cached_property(lambda self: _describe_proof(self.data.problem(), self.data.multipliers()))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a plain `Solution` for copies and other processes."""
        return Solution, tuple(getattr(self, field.name) for field in dataclasses.fields(Solution))


def _describe_proof(problem: ForceProblem, multipliers: Multipliers) -> Infeasibility:
    """Return why a problem is infeasible, from a verified proof."""
    return describe_infeasibility(problem, certify_infeasibility(problem, multipliers))


def uncertified_solution(
    problem: ForceProblem,
    status: Status,
    f: Array | None,
    multipliers: Multipliers | None,
    *,
    backend: str,
    iterations: int,
    seconds: float,
) -> Solution:
    """Return a solver's result as a solution without certificate.

    Args:
        problem: the problem.
        status: the solver's claim; replaced by failed if the forces diverged.
        f: (k,) stacked forces, N and N·m; None without forces.
        multipliers: of the optimum, or of the proof of infeasibility.
        backend: name of the solver.
        iterations: iterations of the solver.
        seconds: time of the solver, s.
    """
    if f is not None and not np.abs(f).max() < _DIVERGED_FORCE:
        status, f = Status.FAILED, None
    f = _NO_FORCES if f is None else f
    f.setflags(write=False)
    return Solution(status, problem, f, None, None, backend, iterations, seconds, multipliers)

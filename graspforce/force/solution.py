"""The answer to a force problem: statuses that are sentences, forces, torques, multipliers, margins, proof.

A backend makes a `Solution` with `uncertified_solution`; nothing in it is proven until the certificate stands in it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from graspforce.contact import friction
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem

SCHEMA = "graspforce/solution/1"
TIGHT_TOLERANCE = (
    1e-8  # ten times what a converged interior-point method leaves in double precision, far below what a sensor resolves
)
LOOSE_TOLERANCE = 1e-5  # where a controller may still act on an answer; it says so
_DIVERGED_FORCE = 1e100  # N: a solver that diverged; squares of larger numbers would overflow


class Status(str, Enum):
    """What an answer is worth. The value is the word on the wire, `sentence` says what it means."""

    OPTIMAL = "optimal"
    INACCURATE = "inaccurate"
    INFEASIBLE = "infeasible"
    FAILED = "failed"

    @property
    def sentence(self) -> str:
        """What the status means, for people."""
        return _SENTENCES[self]


_SENTENCES = {
    Status.OPTIMAL: "These forces hold the object inside every limit, and no others cost less.",
    Status.INACCURATE: "These forces are the best ones only to the looser tolerance that the certificate states.",
    Status.INFEASIBLE: "No forces hold the object inside every limit: the multipliers prove it.",
    Status.FAILED: "No solver found forces, or a proof that there are none.",
}


@dataclass(frozen=True, eq=False, slots=True)
class Multipliers:
    """What each constraint's limit costs. The cones' multipliers follow from stationarity, so nobody states them.

    Stationarity:  z = ∇cost − Gᵀ y − E (normal_lower − normal_upper) − J (torque_lower − torque_upper),  z in K*,
    E placing each contact's value at its normal force. All but y are ≥ 0.

    Args:
        y: (6,) of equilibrium G f = w, cost per N and N·m.
        normal_lower: (N,) of f_n ≥ min, cost per N.
        normal_upper: (N,) of f_n ≤ max, cost per N.
        torque_lower: (n,) of tau ≥ lower, cost per N·m.
        torque_upper: (n,) of tau ≤ upper, cost per N·m.
        level: (N,) of f_n ≤ t in the objective "max_normal", summing to 1; zeros otherwise.
    """

    y: Array
    normal_lower: Array
    normal_upper: Array
    torque_lower: Array
    torque_upper: Array
    level: Array

    def to_dict(self) -> dict[str, Any]:
        """As plain lists."""
        return {name.name: getattr(self, name.name).tolist() for name in dataclasses.fields(self)}

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], field: str) -> Multipliers:
        """From plain lists."""
        names = [name.name for name in dataclasses.fields(cls)]
        values = fields.check_record(record, field, required=names)
        return cls(*(arrays.check_array(values[name], f"{field}.{name}", (None,)) for name in names))


@dataclass(frozen=True, slots=True)
class Certificate:
    """The proof's figures, relative to the problem's own scale; `certificate.py` says which and why.

    Args:
        verified: the proof stands.
        primal_residual: the largest violation of equilibrium, cones and limits; 0 where there are no forces.
        dual_residual: the largest violation of the multipliers' signs and cones.
        gap: how much the cost could still fall. In a proof that there is no answer: by how much the constraints contradict
            each other, which must be positive.
        tolerance: what the figures were held against; in a proof that there is no answer, the ratio dual_residual/gap.
    """

    verified: bool
    primal_residual: float
    dual_residual: float
    gap: float
    tolerance: float

    @classmethod
    def from_residuals(cls, primal: float, dual: float, gap: float) -> Certificate:
        """The certificate of residuals that were measured: verified at `TIGHT_TOLERANCE`, else at `LOOSE_TOLERANCE`, else not.

        Args:
            primal: largest violation of equilibrium, cones and limits, relative.
            dual: largest violation of the multipliers' signs and cones, relative.
            gap: how much the cost could still fall, relative.
        """
        worst = max(primal, dual, gap)
        return cls(
            worst <= LOOSE_TOLERANCE, primal, dual, gap, TIGHT_TOLERANCE if worst <= TIGHT_TOLERANCE else LOOSE_TOLERANCE
        )


@dataclass(frozen=True, eq=False, slots=True)
class InfeasibilityProof:
    """A proof that no forces exist.

    Args:
        certificate: whether it stands, and its figures.
        multipliers: the proof, mended in sign, its largest term scaled to 1.
        z: (k,) the cones' multipliers that follow.
    """

    certificate: Certificate
    multipliers: Multipliers
    z: Array


@dataclass(frozen=True, eq=False, slots=True)
class Infeasibility:
    """Why there is no answer.

    Args:
        verified: the multipliers prove that no forces exist.
        multipliers: the proof.
        contacts: indices of the contacts that carry it.
        joints: indices of the joints whose torque limits carry it.
        wrench: (6,) unit direction of the wrench that cannot be supplied, in O, N and N·m.
        explanation: the same in plain words.
        friction_factor: the smallest factor on all friction coefficients with which there is an answer; None: not computed,
            or no factor helps.
        torque_factor: likewise on all torque limits.
        nearest_wrench: (6,) the nearest wrench that can be held, N and N·m; None: not computed, or no wrench can be held.
    """

    verified: bool
    multipliers: Multipliers
    contacts: tuple[int, ...]
    joints: tuple[int, ...]
    wrench: Array
    explanation: str
    friction_factor: float | None = None
    torque_factor: float | None = None
    nearest_wrench: Array | None = None

    def to_dict(self) -> dict[str, Any]:
        """The ``infeasibility`` record of an answer."""
        return {
            "verified": self.verified,
            "explanation": self.explanation,
            "contacts": list(self.contacts),
            "joints": list(self.joints),
            "wrench": self.wrench.tolist(),
            "multipliers": self.multipliers.to_dict(),
            "friction_factor": self.friction_factor,
            "torque_factor": self.torque_factor,
            "nearest_wrench": None if self.nearest_wrench is None else self.nearest_wrench.tolist(),
        }

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], field: str) -> Infeasibility:
        """From the ``infeasibility`` record of an answer."""
        values = fields.check_record(record, field, required=[name.name for name in dataclasses.fields(cls)])
        nearest = values["nearest_wrench"]
        return cls(
            verified=bool(values["verified"]),
            multipliers=Multipliers.from_dict(values["multipliers"], f"{field}.multipliers"),
            contacts=tuple(values["contacts"]),
            joints=tuple(values["joints"]),
            wrench=arrays.check_array(values["wrench"], f"{field}.wrench", (6,)),
            explanation=values["explanation"],
            friction_factor=values["friction_factor"],
            torque_factor=values["torque_factor"],
            nearest_wrench=None if nearest is None else arrays.check_array(nearest, f"{field}.nearest_wrench", (6,)),
        )


@dataclass(frozen=True, eq=False)
class Solution:
    """The answer to a force problem. What follows from the forces is worked out when it is first asked for.

    Args:
        status: what the answer is worth.
        problem: the problem; None for an answer that came over the wire.
        f: (k,) the stacked contact forces, contact frames, N and N·m; empty without an answer.
        certificate: the proof; None until somebody checked.
        infeasibility: why there is no answer; None where there is one.
        backend: which solver found it.
        iterations: how many steps it took.
        seconds: how long it took, s, without certificate and record.
        multipliers: what each limit costs, or the proof that there is no answer; not on the wire.
        restart: what the backend wants to see again with the next problem, to start warm; nobody else's business.
        measured: primal and dual residual and gap, where a certificate that is not the solver's own has been computed already.
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
    warm_start: object = dataclasses.field(default=None, repr=False)
    residuals: tuple[float, float, float] | None = None

    def with_verdict(self, status: Status, certificate: Certificate | None) -> Solution:
        """The same answer with a verdict on it; forces that nobody should press with are not handed on."""
        answer = object.__new__(type(self))  # dataclasses.replace takes longer than some answers do
        vars(answer).update(vars(self), status=status, certificate=certificate)
        if status is Status.FAILED:
            vars(answer).update(f=_NO_FORCES)
        return answer

    @property
    def found(self) -> bool:
        """Whether there are forces that a certificate stands behind."""
        return self.status in (Status.OPTIMAL, Status.INACCURATE)

    @cached_property
    def objective(self) -> float | None:
        """The objective's value at these forces (for "margin", s); None without forces."""
        return self.original_problem.cost(self.f) if len(self.f) else None

    @cached_property
    def forces(self) -> tuple[Array, ...]:
        """One array a contact with its model's components, contact frame, N and N·m; empty without an answer."""
        return self.original_problem.contacts.split(self.f) if len(self.f) else ()

    @cached_property
    def forces_object(self) -> Array:
        """(N, 3) the force vectors in O, N."""
        return arrays.freeze(
            np.einsum("nij,nj->ni", self.original_problem.contacts.R_OC[: len(self._padded)], self._padded[:, :3])
        )

    @cached_property
    def torques(self) -> Array:
        """(n,) the motor torques tau = tau_u + Jᵀ f, N·m."""
        return arrays.freeze(self.original_problem.torques(self.f) if len(self.f) else [])

    @cached_property
    def slip_margin(self) -> Array:
        """(N,) μ f_n − ‖f_t‖, N, negative where the contact slips; zero where frictionless.

        A soft contact's moment counts as the tangential force that it displaces: μ f_n − √(‖f_t‖² + (μ m_n/γ)²).
        """
        return arrays.freeze(friction.slip_margin(self._padded, *self._friction))

    @cached_property
    def friction_used(self) -> Array:
        """(N,) the same as a share, ‖f_t‖/(μ f_n); zero where frictionless or without force."""
        required_friction, available = (
            friction.required_friction(self._padded, *self._friction),
            self._friction[0] * self._padded[:, friction.F_N],
        )  # N
        with np.errstate(over="ignore"):
            used = np.divide(required_friction, available, out=np.zeros(len(required_friction)), where=available > 0)
        return arrays.freeze(np.minimum(used, np.finfo(float).max))  # a number that every record can carry

    @property
    def original_problem(self) -> ForceProblem:
        """The problem.

        Raises:
            AttributeError: the answer came over the wire.
        """
        if self.problem is None:
            raise AttributeError("an answer that came over the wire holds what the wire brought, and no more")
        return self.problem

    @property
    def _padded(self) -> Array:
        return self.original_problem.contacts.pad(self.f) if len(self.f) else np.zeros((0, 4))

    @property
    def _friction(self) -> tuple[Array, Array]:
        count = len(self._padded)
        return self.original_problem.contacts.mu[:count], self.original_problem.contacts.gamma[:count]

    def to_dict(self) -> dict[str, Any]:
        """The record of an answer (`SCHEMA`)."""
        pairs = zip(self.slip_margin.tolist(), self.friction_used.tolist(), strict=True)
        return {
            "schema": SCHEMA,
            "status": self.status.value,
            "objective": self.objective,
            "forces": [force.tolist() for force in self.forces],
            "forces_object": self.forces_object.tolist(),
            "torques": self.torques.tolist(),
            "contacts": [{"slip_margin": margin, "friction_used": used} for margin, used in pairs],
            "certificate": None if self.certificate is None else dataclasses.asdict(self.certificate),
            "infeasibility": None if self.infeasibility is None else self.infeasibility.to_dict(),
            "solver": {"backend": self.backend, "iterations": self.iterations, "seconds": self.seconds},
        }

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> Solution:
        """From the record of an answer.

        Raises:
            InvalidInput: not such a record.
        """
        names = ["schema", "status", "objective", "forces", "forces_object", "torques", "contacts"]
        values = fields.check_record(record, "", required=[*names, "certificate", "infeasibility", "solver"])
        fields.check_choice(values["schema"], "schema", (SCHEMA,))
        margins = [fields.check_record(c, "contacts", required=["slip_margin", "friction_used"]) for c in values["contacts"]]
        solver = fields.check_record(values["solver"], "solver", required=["backend", "iterations", "seconds"])
        forces_object = np.reshape(np.asarray(values["forces_object"], dtype=np.float64), (-1, 3))
        certificate, infeasibility = values["certificate"], values["infeasibility"]
        forces = tuple(arrays.check_array(force, f"forces[{i}]", (None,)) for i, force in enumerate(values["forces"]))
        answer = cls(
            status=Status(fields.check_choice(values["status"], "status", [status.value for status in Status])),
            problem=None,
            f=arrays.freeze(np.concatenate(forces) if forces else []),
            certificate=None if certificate is None else Certificate(**certificate),
            infeasibility=None if infeasibility is None else Infeasibility.from_dict(infeasibility, "infeasibility"),
            **solver,
        )
        vars(answer).update(  # what a problem would be needed for came along
            objective=values["objective"],
            forces=forces,
            forces_object=arrays.check_array(forces_object, "forces_object", (None, 3)),
            torques=arrays.check_array(values["torques"], "torques", (None,)),
            slip_margin=arrays.freeze([c["slip_margin"] for c in margins]),
            friction_used=arrays.freeze([c["friction_used"] for c in margins]),
        )
        return answer


def uncertified_solution(
    problem: ForceProblem,
    status: Status,
    f: Array | None,
    multipliers: Multipliers | None,
    *,
    backend: str,
    iterations: int,
    seconds: float,
    warm_start: object = None,
) -> Solution:
    """What a solver says of a problem, as an answer that nobody has checked yet.

    Args:
        problem: the problem.
        status: what the solver claims; failed instead where its forces went astray.
        f: (k,) stacked forces, N and N·m; None without any.
        multipliers: of the optimum, or of the proof that there is none.
        backend: the solver's name.
        iterations: its steps.
        seconds: its time, s.
        restart: what the solver wants to see again to start warm.
    """
    if f is not None and not np.abs(f).max() < _DIVERGED_FORCE:
        status, f = Status.FAILED, None
    f = _NO_FORCES if f is None else f
    f.setflags(write=False)
    return Solution(status, problem, f, None, None, backend, iterations, seconds, multipliers, warm_start)


_NO_FORCES = arrays.freeze([])

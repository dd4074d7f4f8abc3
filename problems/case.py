"""Cases: force problems with proven answers, and their files.

A case file is a problem file (schema graspforce/problem/1) with one more record, ``expected``, in one of two forms:

    {"status": "optimal", "objective": 0.49, "tolerance": 1e-7, "normals": [...]}
    {"status": "infeasible", "proof": {"y": [...], "torque_upper": [...]}, "tolerance": 1e-7, "friction_factor": 1.25}

``normals`` (normal forces, if they are unique), ``no_interior``, ``friction_factor``, ``torque_factor`` and ``verified_by`` are
optional.
``verified_by`` names the solvers whose certified solutions agree to the tolerance; "proof" means that the proof was checked
without a solver. If it is missing, the answer is derived, and ``source`` contains the derivation. ``proof`` holds the non-zero
multipliers of `graspforce.Multipliers`; `graspforce.force.certificate` defines the check.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, MissingField
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.status import Status


@dataclass(frozen=True, eq=False, slots=True)
class ExpectedOptimum:
    """Proven optimum of a feasible problem.

    Args:
        objective: minimum of the objective (for "margin", the maximum of s), in the objective's unit.
        tolerance: accuracy of ``objective`` and ``normals``, relative to the objective and to the largest normal force.
        normals: (N,) normal forces, N; None if unknown or not unique.
        verified_by: solvers whose certified solutions agree; empty if the answer is derived.
        no_interior: (6,) y about O's origin with yᵀ G f ≤ 0 for all forces in the cones and yᵀ w = 0, which proves that no
            forces exist strictly inside all cones; None if such forces exist, or if that is unknown.
    """

    status: ClassVar[Status] = Status.OPTIMAL
    objective: float
    tolerance: float
    normals: Array | None = None
    verified_by: tuple[str, ...] = ()
    no_interior: Array | None = None


@dataclass(frozen=True, eq=False, slots=True)
class ExpectedInfeasibility:
    """Proof that a problem is infeasible.

    Args:
        proof: multipliers of the proof.
        tolerance: relative accuracy of the factors.
        friction_factor: smallest factor on all friction coefficients that makes the problem feasible; None if unknown, or if
            no factor does.
        torque_factor: smallest factor on all torque limits that makes the problem feasible; None if unknown, or if no factor
            does.
        verified_by: "proof" if the proof was checked without a solver; empty if the answer is derived.
    """

    status: ClassVar[Status] = Status.INFEASIBLE
    proof: Multipliers
    tolerance: float
    friction_factor: float | None = None
    torque_factor: float | None = None
    verified_by: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """A force problem and its proven answer.

    Args:
        problem: the problem; its ``source`` states the origin of the problem and of the answer.
        expected: the optimum, or the infeasibility proof.
    """

    problem: ForceProblem
    expected: ExpectedOptimum | ExpectedInfeasibility

    @property
    def name(self) -> str:
        """Name of the problem."""
        return self.problem.name

    @property
    def source(self) -> str:
        """Origin of the problem, and derivation of the answer."""
        return self.problem.source

    @classmethod
    def from_dict(cls, record: object) -> Case:
        """Return a case from the record of a case file.

        Raises:
            InvalidInput: a field is missing, unknown, or has a value that is not allowed; the error names its path.
        """
        problem = ForceProblem.from_dict(record)
        if not isinstance(record, Mapping) or "expected" not in record:
            raise MissingField("expected", "a case needs its known solution")
        return cls(problem, _expected(record["expected"], problem))

    def to_dict(self) -> dict[str, Any]:
        """Return the record of a case file."""
        known = self.expected
        record: dict[str, Any] = {"status": known.status.value}
        if isinstance(known, ExpectedOptimum):
            record |= {"objective": known.objective, "tolerance": known.tolerance}
            if known.normals is not None:
                record["normals"] = known.normals.tolist()
            if known.no_interior is not None:
                record["no_interior"] = known.no_interior.tolist()
        else:
            record["proof"] = {name: values for name, values in known.proof.to_dict().items() if np.any(values)}
            record["tolerance"] = known.tolerance
            factors = {"friction_factor": known.friction_factor, "torque_factor": known.torque_factor}
            record |= {name: factor for name, factor in factors.items() if factor is not None}
        if known.verified_by:
            record["verified_by"] = list(known.verified_by)
        return {**self.problem.to_dict(), "expected": record}


def _expected(record: Any, problem: ForceProblem) -> ExpectedOptimum | ExpectedInfeasibility:
    if not isinstance(record, Mapping):
        raise InvalidInput("expected", record, "a record (a JSON object)")
    status = fields.check_choice(record.get("status"), "expected.status", (Status.OPTIMAL.value, Status.INFEASIBLE.value))
    if status == Status.OPTIMAL.value:
        optional = ["normals", "verified_by", "no_interior"]
        values = fields.check_record(record, "expected", required=["status", "objective", "tolerance"], optional=optional)
        normals, y = values.get("normals"), values.get("no_interior")
        return ExpectedOptimum(
            arrays.check_number(values["objective"], "expected.objective"),
            arrays.check_number(values["tolerance"], "expected.tolerance", above=0.0),
            None if normals is None else arrays.check_array(normals, "expected.normals", (len(problem.contacts),)),
            _verifiers(values),
            None if y is None else arrays.check_array(y, "expected.no_interior", (6,)),
        )
    factors = ["friction_factor", "torque_factor"]
    optional = [*factors, "verified_by"]
    values = fields.check_record(record, "expected", required=["status", "proof", "tolerance"], optional=optional)
    known = {name: arrays.check_number(values[name], f"expected.{name}", minimum=1.0) for name in factors if name in values}
    proof = _proof(values["proof"], problem)
    tolerance = arrays.check_number(values["tolerance"], "expected.tolerance", above=0.0)
    return ExpectedInfeasibility(proof, tolerance, **known, verified_by=_verifiers(values))


def _verifiers(values: Mapping[str, Any]) -> tuple[str, ...]:
    listed = fields.check_sequence(values.get("verified_by", []), "expected.verified_by", at_least=0)
    return tuple(fields.check_text(name, f"expected.verified_by[{i}]") for i, name in enumerate(listed))


def _proof(record: Any, problem: ForceProblem) -> Multipliers:
    """Return the multipliers of a proof; missing ones are zero."""
    contacts, joints = len(problem.contacts), 0 if problem.actuation is None else len(problem.actuation.tau_u)
    sizes = {"y": 6, "normal_lower": contacts, "normal_upper": contacts, "torque_lower": joints, "torque_upper": joints}
    given = fields.check_record(record, "expected.proof", optional=list(sizes))
    values = {
        name: arrays.check_array(given.get(name, np.zeros(size)), f"expected.proof.{name}", (size,))
        for name, size in sizes.items()
    }
    return Multipliers(**values, level=arrays.freeze(np.zeros(contacts)))

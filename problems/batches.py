"""Batches: ten thousand small problems with the same contacts and hand and other loads, each with its proven answer.

>>> from graspforce import problems
>>> batch = problems.load_batch("force")
>>> batch.wrenches.shape, batch.case(7).name
((10000, 6), 'batch/force-007')
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources

import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.problems.case import Case, ExpectedInfeasibility, ExpectedOptimum
from graspforce.problems.generators.batch import KINDS, UNITS
from graspforce.problems.library import load
from graspforce.problems.sequences import step_name

TOLERANCE = 1e-6  # of the optima, relative
PROOF_FIELDS = ("y", "normal_lower", "normal_upper", "torque_lower", "torque_upper")  # of `Multipliers`, in the rows of proofs


@dataclass(frozen=True, eq=False, slots=True)
class Batch:
    """Problems that differ in their wrench, and their answers.

    Args:
        name: ``batch/kind``.
        problem: the problem of the first member.
        wrenches: (B, 6) wrenches that the contacts must supply, N and N·m.
        objectives: (B,) proven minima, accurate to `TOLERANCE`; NaN for infeasible members.
        proofs: (B, 6 + 2N + 2n) multipliers in the order of `PROOF_FIELDS` that prove infeasibility; zero for feasible members.
    """

    name: str
    problem: ForceProblem
    wrenches: Array
    objectives: Array
    proofs: Array

    def __len__(self) -> int:
        return len(self.wrenches)

    def case(self, index: int) -> Case:
        """Return a member as a case.

        Args:
            index: index of the member, from 0.

        Raises:
            InvalidInput: there is no such member.
        """
        if not 0 <= index < len(self):
            raise InvalidInput("index", index, f"0 to {len(self) - 1}")
        problem = ForceProblem.from_dict(
            {**self.problem.to_dict(), "name": step_name(self.name, index), "wrench": self.wrenches[index].tolist()}
        )
        objective = float(self.objectives[index])
        if np.isfinite(objective):
            return Case(problem, ExpectedOptimum(objective, TOLERANCE, verified_by=("two solvers",)))
        return Case(problem, ExpectedInfeasibility(self._proof(index), TOLERANCE, verified_by=("proof",)))

    def _proof(self, index: int) -> Multipliers:
        """Return the proof of an infeasible member."""
        contacts = len(self.problem.contacts)
        joints = 0 if self.problem.actuation is None else len(self.problem.actuation.tau_u)
        ends = np.cumsum([6, contacts, contacts, joints])
        values = dict(zip(PROOF_FIELDS, np.split(self.proofs[index], ends), strict=True))
        return Multipliers(**values, level=np.zeros(contacts))


def load_batch(kind: str) -> Batch:
    """Return a batch.

    Args:
        kind: "force", "torque", "pyramid" or "limits".

    Raises:
        UnknownName: another kind.
    """
    if kind not in KINDS:
        raise UnknownName("batch", kind, KINDS)
    with (resources.files("graspforce.problems") / "batch" / f"{kind}.npz").open("rb") as file, np.load(file) as stored:
        loads, objectives, infeasible, rows = (stored[name] for name in ("loads", "objectives", "infeasible", "proofs"))
    proofs = np.zeros((len(objectives), rows.shape[1]))
    proofs[infeasible] = rows
    return Batch(f"batch/{kind}", load(step_name(f"batch/{kind}", 0)).problem, loads * UNITS, objectives, proofs)

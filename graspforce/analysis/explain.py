"""Explain a force problem in words and numbers: what limits its forces and by how much, or why there are none."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import numpy.typing as npt

from graspforce.analysis.largest_wrench import LargestWrench, largest_wrench
from graspforce.contact import friction
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.lazy import plot_with
from graspforce.force.backends import registry
from graspforce.force.infeasibility import (
    DeadlinePassed,
    smallest_friction_factor,
    smallest_torque_factor,
    solver_with_deadline,
)
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solution import Solution
from graspforce.force.solver import solve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "graspforce/explanation/1"
_NAMED_LIMITS = 3  # limits that the first sentence names
_NEGLIGIBLE_USE = 0.005  # a limit that prints as 0 %

_TIMED_OUT = "The time was over before forces or a proof of infeasibility were found."

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class LimitUse:
    """How much of a limit the forces use.

    Args:
        name: name of the contact or joint.
        kind: "friction", "normal force" or "torque".
        used: fraction of the limit; 1 at the limit.
        value: the friction needed ‖f_t‖/f_n, the normal force in N, or the torque in N·m.
        limit: the friction coefficient, the limit in N, or the nearer torque limit in N·m.
        margin: slip margin μ f_n − ‖f_t‖ in N, or what remains to the limit in N or N·m.
    """

    name: str
    kind: str
    used: float
    value: float
    limit: float
    margin: float

    def __str__(self) -> str:
        share = f"{100.0 * self.used:.0f} %"
        if self.kind == "friction":
            return f"{self.name} uses {share} of its friction"
        return f"{self.name} is at {share} of its {self.kind} limit"

    def to_dict(self) -> JsonRecord:
        """Return the record."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, eq=False, slots=True)
class Explanation:
    """What limits the forces of a problem, or why there are none. Numbers that were not found by the deadline are None.

    Args:
        solution: the solution of least cost, with its certificate, or the proof of infeasibility.
        limits: use of every limit by the forces of least cost, the fullest first; empty without forces.
        slip_margin: largest slip margin that all contacts can keep at once, N; None also if no limit bounds it, or infeasible.
        friction_factor: smallest factor on all friction coefficients with which forces exist; None also if no factor helps.
        torque_factor: likewise on all torque limits; None also without torque limits.
        wrench_fraction: largest λ for which λ times the wrench can be supplied; inf without a bound, None also for no λ.
        payload: largest wrench along the direction asked for, in addition to the wrench; None also if infeasible.
        nearest_wrench: (6,) feasible wrench nearest to an infeasible one, about O, in O, N and N·m.
    """

    solution: Solution
    limits: tuple[LimitUse, ...]
    slip_margin: float | None
    friction_factor: float | None
    torque_factor: float | None
    wrench_fraction: float | None
    payload: LargestWrench | None
    nearest_wrench: Array | None

    @property
    def sentences(self) -> tuple[str, ...]:
        """The explanation in words."""
        status = self.solution.status
        sentences = [_TIMED_OUT if self.solution.timed_out else status.sentence]
        if self.solution.found:
            named = [str(limit) for limit in self.limits[:_NAMED_LIMITS] if limit.used > _NEGLIGIBLE_USE]
            sentences.append(f"Closest limits: {', '.join(named)}." if named else "No limit is close.")
        elif self.solution.infeasibility is not None:
            sentences.append(self.solution.infeasibility.explanation)
        changes = self._factor_sentences()
        return (*sentences, *changes)

    def _factor_sentences(self) -> list[str]:
        """Return the sentences on factors and the largest wrench."""
        found, result = self.solution.found, []
        if self.slip_margin is not None and found:
            result.append(f"All contacts can keep a slip margin of {self.slip_margin:.3g} N at once.")
        if self.friction_factor is not None:
            verb = "Forces exist down to" if found else "Forces would exist with"
            result.append(f"{verb} {self.friction_factor:.4g} times the friction.")
        if self.torque_factor is not None:
            verb = "Forces exist down to" if found else "Forces would exist with"
            result.append(f"{verb} {self.torque_factor:.4g} times the torque limits.")
        if self.wrench_fraction is not None and np.isfinite(self.wrench_fraction):
            result.append(f"At most {100.0 * self.wrench_fraction:.4g} % of the wrench can be supplied.")
        if self.payload is not None and np.isfinite(self.payload.amount):
            result.append(f"Along the direction, {self.payload.amount:.4g} times its wrench can be added.")
        return result

    def __str__(self) -> str:
        return "\n".join(self.sentences)

    def plot(self) -> Figure:
        """Return a bar chart of the limits that the forces use most.

        Raises:
            InvalidInput: the problem has no forces.
        """
        figure: Figure = plot_with("plot_limits", self)
        return figure

    def to_dict(self) -> JsonRecord:
        """Return the record of `SCHEMA`; amounts without bound are null."""
        fraction = self.wrench_fraction
        return {
            "schema": SCHEMA,
            "status": self.solution.status.value,
            "sentences": list(self.sentences),
            "limits": [limit.to_dict() for limit in self.limits],
            "slip_margin": self.slip_margin,
            "friction_factor": self.friction_factor,
            "torque_factor": self.torque_factor,
            "wrench_fraction": fraction if fraction is not None and np.isfinite(fraction) else None,
            "payload": None if self.payload is None else self.payload.to_dict(),
            "nearest_wrench": None if self.nearest_wrench is None else self.nearest_wrench.tolist(),
            "solution": self.solution.to_dict(),
        }


def explain(
    problem: ForceProblem,
    direction: npt.ArrayLike | None = None,
    *,
    seconds: float | None = None,
    contact_names: Sequence[str] | None = None,
    joint_names: Sequence[str] | None = None,
) -> Explanation:
    """Return what limits the forces of a problem and by how much, or why there are none.

    Args:
        problem: the force problem.
        direction: (6,) direction of the payload about O, in O, N and N·m; by default none is computed.
        seconds: time limit of everything, s; by default none. Solvers stop then, and numbers that were not found are None.
            Without a certified answer by then, the solution is failed, with `Solution.timed_out`.
        contact_names: name of each contact; by default "contact 0", …
        joint_names: name of each joint; by default "joint 0", …

    Raises:
        InvalidInput: a direction of zero, another number of names, or negative seconds.
    """
    limit = np.inf if seconds is None else arrays.check_number(seconds, "seconds", minimum=0.0)
    deadline = time.perf_counter() + limit
    if direction is not None and not np.any(arrays.check_array(direction, "direction", (6,))):
        raise InvalidInput("direction", direction, "not zero")
    n = 0 if problem.actuation is None else len(problem.actuation.tau_u)
    contacts = _names(contact_names, "contact", len(problem.contacts))
    joints = _names(joint_names, "joint", n)
    solution = solve(problem, deadline=_rest(deadline))

    def before_deadline(number: Callable[[], Result]) -> Result | None:
        if time.perf_counter() >= deadline:
            return None
        try:
            return number()
        except DeadlinePassed:
            return None

    fraction = before_deadline(lambda: _wrench_fraction(problem, deadline))
    payload = None if direction is None else before_deadline(lambda: largest_wrench(problem, direction, deadline=deadline))
    why = solution.infeasibility
    solver = solver_with_deadline(registry.general_backend().solve_program, deadline)
    return Explanation(
        solution=solution,
        limits=tuple(sorted(_limit_uses(problem, solution, contacts, joints), key=lambda limit: -limit.used)),
        slip_margin=before_deadline(lambda: _largest_margin(problem, deadline)) if solution.found else None,
        torque_factor=before_deadline(lambda: smallest_torque_factor(problem, solver)) if why is None else why.torque_factor,
        friction_factor=(
            before_deadline(lambda: smallest_friction_factor(problem, solver)) if why is None else why.friction_factor
        ),
        wrench_fraction=fraction,
        payload=payload,
        nearest_wrench=None if why is None else why.nearest_wrench,
    )


def _names(names: Sequence[str] | None, kind: str, count: int) -> list[str]:
    """Return the names of contacts or joints."""
    if names is None:
        return [f"{kind} {i}" for i in range(count)]
    if len(names) != count:
        raise InvalidInput(f"{kind}_names", list(names), f"{count} names")
    return [fields.check_text(name, f"{kind}_names[{i}]") for i, name in enumerate(names)]


def _limit_uses(problem: ForceProblem, solution: Solution, contacts: list[str], joints: list[str]) -> list[LimitUse]:
    """Return the use of friction, of the largest normal forces and of the torque limits."""
    if not solution.found:
        return []
    result, c = [], problem.contacts
    padded = c.pad(solution.f)
    needed = friction.required_friction(padded, c.mu, c.gamma)  # N
    for i, name in enumerate(contacts):
        normal = float(padded[i, friction.F_N])
        if c.mu[i] > 0.0 and normal > 0.0:
            mu = float(needed[i]) / normal
            result.append(LimitUse(name, "friction", mu / float(c.mu[i]), mu, float(c.mu[i]), float(solution.slip_margin[i])))
        if 0.0 < c.max_normal[i] < np.inf:
            most = float(c.max_normal[i])
            result.append(LimitUse(name, "normal force", normal / most, normal, most, most - normal))
    if problem.actuation is not None:
        limits = (problem.actuation.lower.tolist(), problem.actuation.upper.tolist())
        for name, tau, lower, upper in zip(joints, solution.torques.tolist(), *limits, strict=True):
            bound = upper if tau >= 0.0 else lower
            if np.isfinite(bound) and bound * tau >= 0.0 and bound != 0.0:
                result.append(LimitUse(name, "torque", tau / bound, tau, bound, abs(bound - tau)))
    return result


def _rest(deadline: float) -> float | None:
    """Return the time until a deadline, s; None without a deadline."""
    return max(deadline - time.perf_counter(), 0.0) if np.isfinite(deadline) else None


def _largest_margin(problem: ForceProblem, deadline: float) -> float | None:
    """Return the largest common slip margin, N; None without friction, if no limit bounds it, or after the deadline."""
    try:
        margin = ForceProblem(problem.contacts, problem.w, problem.actuation, problem.cone, Objective("margin"))
        return solve(margin, explain=False, deadline=_rest(deadline)).objective
    except InvalidInput:
        return None


def _wrench_fraction(problem: ForceProblem, deadline: float) -> float | None:
    """Return the largest λ for which λ w is feasible; None for a wrench of zero, or if no λ is."""
    if not problem.w.any():
        return None
    largest = largest_wrench(problem, problem.w, base=np.zeros(6), deadline=deadline)
    return None if largest is None else largest.amount

"""Our own kernel: exact cones, torque limits and their proof in tens of microseconds (`structured.h`, `certify.h`).

It takes problems whose fingers share few joints, with the objectives that are quadratic or linear in the forces. The compiled
module may be absent, where there was no compiler: `available` tells.
"""

from __future__ import annotations

import contextlib
import importlib
import time
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce import friction
from graspforce.arrays import Array
from graspforce.contact import ContactModel
from graspforce.errors import BackendError
from graspforce.problem import ForceProblem, Objective
from graspforce.solution import Certificate, Multipliers, Solution, Status

Kernel: Any = None
_fingers: Any = None
with contextlib.suppress(ImportError):  # it was not built: there was no compiler
    _structured = importlib.import_module("graspforce.backends._structured")
    Kernel, _fingers = _structured.Kernel, _structured.fingers

_TOLERANCE = 1e-9  # of scaled residuals: a tenth of what the certificate asks
_MOST_ITERATIONS = 60
_LARGEST_BLOCK = 48  # force components that share joints; beyond, dense blocks cost more than a sparse solver
_OBJECTIVES = ("torque", "force", "sum_normal")
_STATUS = (Status.OPTIMAL, Status.INACCURATE, Status.INFEASIBLE, Status.FAILED)
_COMPONENTS = {model: len(model.columns) for model in ContactModel}
_NONE = np.zeros(0)
_NO_FACETS = (np.zeros((0, 4)), np.zeros(0, dtype=np.intc))
_REPORT = 8  # status, iterations, primal, dual and gap as solved; primal, dual and gap as certified

Indices = npt.NDArray[np.intc]


def available() -> bool:
    """Whether the kernel was built when this package was installed."""
    return Kernel is not None


def solve(problem: ForceProblem, previous: Solution | None = None) -> Solution:
    """The answer by the structured kernel, on exact cones and on pyramids.

    Args:
        problem: a problem with the objective "torque", "force" or "sum_normal" whose fingers share few joints.
        previous: this backend's answer to a problem of the same shape, to start from.

    Raises:
        BackendError: another objective, too many fingers on shared joints, or the kernel was not built.
    """
    start = time.perf_counter()
    known = None if previous is None else bound(previous)
    return (known if known is not None and known.load(problem) else Bound(problem)).answer(start)


def bound(answer: Solution) -> Bound | None:
    """The kernel that an answer is from; None where it is another solver's."""
    return answer.restart.bound if isinstance(answer.restart, Taken) else None


class Bound:
    """A kernel bound to a problem and then to others of its shape; each time it starts from its last answer."""

    def __init__(self, problem: ForceProblem) -> None:
        structure = _structure(problem)
        self._units, self._answer = np.zeros(3 + _joints(problem)), np.zeros(_answer_width(problem))
        self._report = np.zeros(_REPORT)
        self._kernel = Kernel(*structure, *_inputs(problem), self._units, self._answer, self._report)
        self._problem = problem

    def load(self, problem: ForceProblem) -> bool:
        """Put another problem in the place of this one; False where its shape is another."""
        old = self._problem
        if problem.contacts.models != old.contacts.models or problem.cone != old.cone or problem.cone.type == "pyramid":
            return False
        if problem.objective != old.objective or _joints(problem) != _joints(old):
            return False
        self._kernel.load(*_inputs(problem))
        self._problem = problem
        return True

    def answer(self, start: float) -> Solution:
        """The answer to the problem that was loaded last, timed from ``start``."""
        answer = self.follow(start)
        assert answer is not None  # nothing was given that could be wrong
        return answer

    def follow(
        self, start: float, w: Any = None, J: Any = None, tau_u: Any = None, p: Any = None, R: Any = None
    ) -> Solution | None:
        """The answer with what is given in the place of what was, timed from ``start``.

        None, and nothing has changed, where something is given that is not an array of finite float64 in the one right shape:
        `ForceProblem.replace` then converts it, or says what is wrong.
        """
        taken = self._kernel.step(_TOLERANCE, _MOST_ITERATIONS, True, w, J, tau_u, p, R)
        if taken is None:
            return None
        number, iterations, measured, numbers, held = taken
        answer = object.__new__(_Answer)
        vars(answer).update(
            status=_STATUS[number],
            iterations=iterations,
            seconds=time.perf_counter() - start,
            restart=tuple.__new__(Taken, (self, self._problem, number, numbers, held)),  # in half the time of Taken(…)
            measured=measured,
        )
        return answer


class Taken(NamedTuple):
    """What an answer is taken from: the kernel, the problem that was loaded, the kernel's status and its numbers, and the w, J,
    tau_u, p and R that it solved, which nobody writes to."""

    bound: Bound
    loaded: ForceProblem
    number: int
    numbers: bytes
    held: tuple[Any, ...]

    def part(self, first: int, count: int) -> Array:
        """Some of the kernel's numbers."""
        return np.frombuffer(self.numbers)[first : first + count]


def _problem(answer: Solution) -> ForceProblem:
    """The problem that was loaded, with what has changed since."""
    taken = _taken(answer)
    loaded, held = taken.loaded, dict(zip(("w", "J", "tau_u", "p", "R"), taken.held, strict=True))
    before = {"w": loaded.w, "p": loaded.contacts.p_OC, "R": loaded.contacts.R_OC}
    if loaded.hand is not None:
        before.update(J=loaded.hand.J, tau_u=loaded.hand.tau_u)
    changed = {name: np.frombuffer(held[name]).reshape(x.shape) for name, x in before.items() if held[name] is not x}
    return loaded.replace(**changed) if changed else loaded


def _forces(answer: Solution) -> Array:
    """(k,), none where the kernel found none."""
    taken = _taken(answer)
    return taken.part(0, taken.loaded.size if taken.number <= 1 else 0)


def _multipliers(answer: Solution) -> Multipliers | None:
    """Of the optimum, or of the proof that there is none."""
    taken = _taken(answer)
    if _STATUS[taken.number] is Status.FAILED:
        return None
    k, N, n = taken.loaded.size, len(taken.loaded.contacts), _joints(taken.loaded)
    nu, torque, part = 2 * k + 6, 2 * k + 6 + 2 * N, taken.part
    with np.errstate(all="ignore"):  # what overflows is not certified
        y = answer.posed.multipliers_about_O(part(k, 6))
    return Multipliers(y, part(nu, N), part(nu + N, N), part(torque, n), part(torque + n, n), np.zeros(N))


def _certificate(answer: Solution) -> Certificate | None:
    """What the certificate in C measured; None where it was not asked."""
    return Certificate.judging(*answer.measured) if answer.measured else None


def _taken(answer: Solution) -> Taken:
    assert isinstance(answer.restart, Taken)  # as `Bound.follow` makes it
    return answer.restart


def _later(part: Callable[[Solution], Any]) -> Any:
    """A field that is worked out when it is first asked for."""
    return cached_property(part)


@dataclass(frozen=True, eq=False)
class _Answer(Solution):
    """The kernel's answer. A controller asks for few of its parts, and making all of them takes longer than the answer."""

    infeasibility = None
    backend = "structured"
    problem = _later(_problem)
    certificate = _later(_certificate)
    f = _later(_forces)
    multipliers = _later(_multipliers)


def solve_rows(problem: ForceProblem, rows: Mapping[str, Array], count: int) -> tuple[Array, Array]:
    """Problems that differ from one in some arrays, solved and certified one after another, without Python between.

    Args:
        problem: what all share; exact cones.
        rows: "w", "J", "tau_u": arrays whose first axis is the problem's number.
        count: M, how many there are.

    Returns:
        (M, k + n) forces and torques, and (M, 8) reports: status, iterations, the kernel's own residuals, and the
        certificate's.

    Raises:
        BackendError: as `solve`.
    """
    structure, n = _structure(problem), _joints(problem)
    inputs = _inputs(problem, **{name: np.ascontiguousarray(row) for name, row in rows.items()})
    units, answer, report = (np.zeros((count, width)) for width in (3 + n, _answer_width(problem), _REPORT))
    kernel = Kernel(*structure, *inputs, units, answer, report)
    kernel.solve(0, count, _TOLERANCE, _MOST_ITERATIONS, False)
    kernel.certify(0, count)
    return np.hstack([answer[:, : problem.size], answer[:, answer.shape[1] - n :]]), report


def _structure(problem: ForceProblem) -> tuple[array[int], array[int], array[int], Indices]:
    """Components and block of each contact, block of each joint, contact of each facet.

    Raises:
        BackendError: the kernel does not take such a problem, or was not built.
    """
    if Kernel is None:
        raise BackendError("structured was not built when graspforce was installed: there was no C compiler")
    if problem.objective.type not in _OBJECTIVES:
        raise BackendError(f"structured takes the objectives {', '.join(_OBJECTIVES)}, not {problem.objective.type}")
    contacts = problem.contacts
    components = array("i", [_COMPONENTS[model] for model in contacts.models])
    J = np.zeros((problem.size, 0)) if problem.hand is None else problem.hand.J
    contact_block, joint_block = array("i", bytes(4 * len(components))), array("i", bytes(4 * J.shape[1]))
    largest = _fingers(components, J, contact_block, joint_block)
    if largest > _LARGEST_BLOCK:
        raise BackendError(f"structured takes at most {_LARGEST_BLOCK} force components that share joints, not {largest}")
    return components, contact_block, joint_block, _facets(problem)[1]


def _inputs(problem: ForceProblem, w: Array | None = None, J: Array | None = None, tau_u: Array | None = None) -> list[Any]:
    """The arrays that the kernel reads, in its order; w, J and tau_u the problem's own or others in their place."""
    contacts, hand, objective = problem.contacts, problem.hand, problem.objective
    motors = [_NONE] * 5
    if hand is not None:
        weight = hand.weight if objective.type == "torque" else np.zeros(len(hand.weight))
        moved = hand.J if J is None else J, hand.tau_u if tau_u is None else tau_u
        motors = [*moved, hand.lower, hand.upper, weight]
    placed = map(np.ascontiguousarray, (contacts.p_OC, contacts.R_OC))  # nobody has checked how they lie in memory
    limits = map(np.ascontiguousarray, (contacts.mu, contacts.gamma, contacts.min_normal, contacts.max_normal))
    cost = None
    if objective.type == "sum_normal":
        cost = np.zeros(problem.size)
        cost[contacts.normal_rows] = 1.0
    force_weight = array("d", [_force_weight(objective)])
    return [*placed, None, problem.w if w is None else w, *limits, *motors, _facets(problem)[0], cost, force_weight]


def _joints(problem: ForceProblem) -> int:
    """n, how many motors there are."""
    return 0 if problem.hand is None else problem.hand.J.shape[1]


def _answer_width(problem: ForceProblem) -> int:
    """f, y, z, the normal forces' multipliers, the torques' multipliers, and the torques."""
    return 2 * problem.size + 6 + 2 * len(problem.contacts) + 3 * _joints(problem)


def _force_weight(objective: Objective) -> float:
    """ρ of ½ρ‖f‖²."""
    return objective.force_weight if objective.type == "torque" else float(objective.type == "force")


def _facets(problem: ForceProblem) -> tuple[Array, Indices]:
    """The rows aᵀ(f_t1, f_t2, f_n, m_n) ≤ 0 of pyramids, and whose they are; none for exact cones and without friction."""
    contacts, cone = problem.contacts, problem.cone
    if cone.type == "exact":
        return _NO_FACETS
    rows, owners = [_NO_FACETS[0]], [_NO_FACETS[1]]
    mu = friction.pyramid_friction(contacts.mu, cone.facets, cone.side)
    for i in np.flatnonzero(contacts.mu > 0):
        gamma = float(contacts.gamma[i])
        a = friction.pyramid_facets(cone.facets, cone.side, gamma)
        with np.errstate(over="ignore", invalid="ignore"):  # the kernel refuses what is not finite
            twist = a[:, 2] * (mu[i] / gamma if gamma else 0.0)
        rows.append(np.column_stack([a[:, 0], a[:, 1], np.full(len(a), -mu[i]), twist]))
        owners.append(np.full(len(a), i, dtype=np.intc))
    return np.vstack(rows), np.concatenate(owners)

"""Our own kernel: exact cones, torque limits and their proof in tens of microseconds (`structured.h`, `certify.h`).

It takes problems whose fingers share few joints, with the objectives that are quadratic or linear in the forces. The compiled
module may be absent, where there was no compiler: `is_available` tells.
"""

from __future__ import annotations

import contextlib
import importlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.contact import friction
from graspforce.contact.contact import ContactModel
from graspforce.core.arrays import Array
from graspforce.core.errors import BackendError
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Certificate, Multipliers, Solution, Status

Kernel: Any = None
IncrementalKernel: Any = None
_fingers: Any = None
_record: Any = None
_report_type: Any = None  # of the reports of a Kernel
with contextlib.suppress(ImportError):  # it was not built: there was no compiler
    _structured = importlib.import_module("graspforce.force.backends._structured")
    Kernel, IncrementalKernel = _structured.Kernel, _structured.IncrementalKernel
    _fingers, _record = _structured.find_fingers, _structured.make_record
    _report_type = np.dtype(list(_structured.report_fields))

_TOLERANCE = 1e-9  # of scaled residuals: a tenth of what the certificate asks
_MAX_ITERATIONS = 60
_LARGEST_BLOCK = 48  # force components that share joints; beyond, dense blocks cost more than a sparse solver
_OBJECTIVES = ("torque", "force", "sum_normal")
_STATUS = (Status.OPTIMAL, Status.INACCURATE, Status.INFEASIBLE, Status.FAILED)
_COMPONENTS = {model: len(model.columns) for model in ContactModel}
_EMPTY = np.zeros(0)
_NO_FACETS = (np.zeros((0, 4)), np.zeros(0, dtype=np.intc))
_EAGER_FIELDS = ("status", "iterations", "seconds", "warm_start", "residuals")  # of an answer; the others are worked out later
_CHANGEABLE = ("w", "J", "tau_u", "p", "R")  # what a step may change
_INPUT_NAMES = (*_CHANGEABLE, "mu", "gamma", "min_normal", "max_normal", "lower", "upper", "weight", "facet", "cost")

Indices = npt.NDArray[np.intc]


def is_available() -> bool:
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
    known = None if previous is None else session(previous)
    return (known if known is not None and known.load(problem) else KernelSession(problem)).answer(start)


def session(answer: Solution) -> KernelSession | None:
    """The kernel that an answer is from; None where it is another solver's."""
    return _raw_answer(answer).session if isinstance(answer, _Answer) else None


class KernelSession:
    """A kernel bound to a problem and then to others of its shape; each time it starts from its last answer."""

    def __init__(self, problem: ForceProblem) -> None:
        _check_supported(problem)
        facets, owners = (None, None) if problem.cone.type == "exact" else _facets(problem)
        try:
            self._kernel = IncrementalKernel(_LARGEST_BLOCK, problem.contacts.columns, owners, *_kernel_inputs(problem, facets))
        except OverflowError as error:
            raise BackendError(f"structured takes {error}") from None
        self._problem = problem
        self.layout: dict[str, tuple[int, int]] = self._kernel.solution_layout()

    def load(self, problem: ForceProblem) -> bool:
        """Put another problem in the place of this one; False where its shape or its fingers are others."""
        old = self._problem
        if problem.contacts.models != old.contacts.models or problem.cone != old.cone or problem.cone.type == "pyramid":
            return False
        if problem.objective != old.objective or _joint_count(problem) != _joint_count(old):
            return False
        if not self._kernel.load(*_kernel_inputs(problem)):
            return False
        self._problem = problem
        return True

    def answer(self, start: float) -> Solution:
        """The answer to the problem that was loaded last, timed from ``start``."""
        answer = self.solve_changed(start)
        assert answer is not None  # nothing was given that could be wrong
        return answer

    def solve_changed(
        self, start: float, w: Any = None, J: Any = None, tau_u: Any = None, p: Any = None, R: Any = None
    ) -> Solution | None:
        """The answer with what is given in the place of what was, timed from ``start``.

        None, and nothing has changed, where something is given that is not an array of finite float64 in the one right shape,
        or a J whose fingers share other joints: `ForceProblem.replace` then converts it, or says what is wrong.

        Raises:
            BackendError: another thread waits for an answer of the same kernel.
        """
        try:
            raw = self._kernel.step(_TOLERANCE, _MAX_ITERATIONS, True, w, J, tau_u, p, R)
        except RuntimeError as busy:
            raise BackendError(f"structured: {busy}; each thread needs a Solver of its own") from None
        if raw is None:
            return None
        number, iterations, residuals, numbers, changed = raw
        warm_start = (self, self._problem, number, numbers, changed)  # a Taken: making one here takes longer
        seconds = time.perf_counter() - start
        answer: Solution = _record(_Answer, _EAGER_FIELDS, _STATUS[number], iterations, seconds, warm_start, residuals)
        return answer

    def finger_mask(self) -> npt.NDArray[np.bool_]:
        """(k, n) which numbers of J the kernel keeps, row after row: those within the fingers."""
        spans = np.frombuffer(self._kernel.spans(), dtype=np.intc).reshape(-1, 2)
        columns = np.arange(_joint_count(self._problem))
        return np.asarray((columns >= spans[:, :1]) & (columns < spans[:, 1:]))


class RawAnswer(NamedTuple):
    """What an answer is taken from: the kernel, the problem that was loaded, the kernel's status, its numbers and then those of
    w, J, tau_u, p and R that had changed since, and which of these had, as bits."""

    session: KernelSession
    loaded: ForceProblem
    number: int
    numbers: bytes
    changed: int

    def part(self, name: str) -> Array:
        """Return a part of the kernel's solution, read-only."""
        first, last = self.session.layout[name]
        return np.frombuffer(self.numbers)[first:last]


def _problem(answer: Solution) -> ForceProblem:
    """The problem that was loaded, with what has changed since."""
    raw = _raw_answer(answer)
    loaded, changed, at = raw.loaded, {}, raw.session.layout["tau"][1]  # the changed arrays follow the solution
    for bit, (name, old) in enumerate(zip(_CHANGEABLE, _kernel_inputs(loaded), strict=False)):
        if raw.changed >> bit & 1:
            kept = raw.session.finger_mask() if name == "J" else np.ones(old.shape, dtype=bool)
            count = int(np.count_nonzero(kept))
            changed[name] = np.zeros(old.shape)
            changed[name][kept] = np.frombuffer(raw.numbers)[at : at + count]
            at += count
    return loaded.replace(**changed)


def _forces(answer: Solution) -> Array:
    """(k,), none where the kernel found none."""
    raw = _raw_answer(answer)
    return raw.part("f") if raw.number <= 1 else np.frombuffer(raw.numbers, count=0)


def _multipliers(answer: Solution) -> Multipliers | None:
    """Of the optimum, or of the proof that there is none."""
    raw = _raw_answer(answer)
    if _STATUS[raw.number] is Status.FAILED:
        return None
    with np.errstate(all="ignore"):  # what overflows is not certified
        y = answer.original_problem.multipliers_about_O(raw.part("y"))
    nu_lower, nu_upper, lambda_lower, lambda_upper = map(raw.part, ("nu_lower", "nu_upper", "lambda_lower", "lambda_upper"))
    return Multipliers(y, nu_lower, nu_upper, lambda_lower, lambda_upper, np.zeros(len(raw.loaded.contacts)))


def _certificate(answer: Solution) -> Certificate | None:
    """What the certificate in C measured; None where it was not asked."""
    return Certificate.from_residuals(*answer.residuals) if answer.residuals else None


def _raw_answer(answer: Solution) -> RawAnswer:
    assert isinstance(answer.warm_start, tuple)  # as `KernelSession.solve_changed` makes it
    return RawAnswer._make(answer.warm_start)


def _lazy_field(part: Callable[[Solution], Any]) -> Any:
    """A field that is worked out when it is first asked for."""
    return cached_property(part)


@dataclass(frozen=True, eq=False)
class _Answer(Solution):
    """The kernel's answer. A controller asks for few of its parts, and making all of them takes longer than the answer."""

    infeasibility = None
    backend = "structured"
    problem = _lazy_field(_problem)
    certificate = _lazy_field(_certificate)
    f = _lazy_field(_forces)
    multipliers = _lazy_field(_multipliers)

    def __reduce__(self) -> tuple[Any, ...]:
        """What leaves the process, or is copied, is the answer alone: the kernel stays with its solver."""
        return Solution, tuple(None if each.name == "warm_start" else getattr(self, each.name) for each in fields(Solution))


def solve_stacked(problem: ForceProblem, rows: Mapping[str, Array], count: int) -> tuple[Array, Array, npt.NDArray[np.void]]:
    """Problems that differ from one in some arrays, solved and certified one after another, without Python between.

    Args:
        problem: what all share; exact cones.
        rows: "w", "J", "tau_u": arrays whose first axis is the problem's number.
        count: M, how many there are.

    Returns:
        (M, k) forces, (M, n) torques, and (M,) reports with the fields status, iterations, primal, dual and gap as solved,
        and certified_primal, certified_dual and certified_gap.

    Raises:
        BackendError: as `solve`.
    """
    arrays = kernel_arrays(problem, count)
    kernel = Kernel(**{**arrays, **{name: np.ascontiguousarray(row) for name, row in rows.items()}})
    kernel.solve(0, count, _TOLERANCE, _MAX_ITERATIONS, False)
    kernel.certify(0, count)
    return arrays["f"], arrays["tau"], arrays["report"]


def kernel_arrays(problem: ForceProblem, count: int = 1) -> dict[str, Any]:
    """The arguments of a `Kernel` that solves the problem, with room for some answers.

    Raises:
        BackendError: as `solve`.
    """
    _check_supported(problem)
    facets, owners = _facets(problem)
    *numbers, force_weight = _kernel_inputs(problem, facets)
    arrays = {name: None if x is None else np.ascontiguousarray(x) for name, x in zip(_INPUT_NAMES, numbers, strict=True)}
    n = _joint_count(problem)
    if problem.actuation is None:
        arrays.update(J=np.zeros((problem.size, 0)), tau_u=_EMPTY, lower=_EMPTY, upper=_EMPTY)
    if arrays["weight"] is None:
        arrays["weight"] = np.zeros(n)
    components = np.array([_COMPONENTS[model] for model in problem.contacts.models], dtype=np.intc)
    contact_block, joint_block = np.zeros(len(components), dtype=np.intc), np.zeros(n, dtype=np.intc)
    largest = _fingers(components, arrays["J"], contact_block, joint_block)
    if largest > _LARGEST_BLOCK:
        raise BackendError(f"structured takes at most {_LARGEST_BLOCK} force components that share joints, not {largest}")
    structure = {"components": components, "contact_block": contact_block, "joint_block": joint_block}
    k, N = problem.size, len(components)
    units = {"force_unit": 1, "length_unit": 1, "cost_unit": 1, "torque_unit": n}
    limits = {"nu_lower": N, "nu_upper": N, "lambda_lower": n, "lambda_upper": n}
    outputs = {**units, "f": k, "y": 6, "z": k, **limits, "tau": n}
    return {
        **structure,
        **arrays,
        **{name: np.zeros((count, width)) for name, width in outputs.items()},
        "report": np.zeros(count, dtype=_report_type),
        "G": None,
        "facet_contact": owners,
        "force_weight": np.array([force_weight]),
    }


def _check_supported(problem: ForceProblem) -> None:
    """Refuse what the kernel does not take."""
    if Kernel is None:
        raise BackendError("structured was not built when graspforce was installed: there was no C compiler")
    if problem.objective.type not in _OBJECTIVES:
        raise BackendError(f"structured takes the objectives {', '.join(_OBJECTIVES)}, not {problem.objective.type}")


def _kernel_inputs(problem: ForceProblem, facets: Array | None = None) -> tuple[Any, ...]:
    """What `IncrementalKernel` copies of a problem: `_INPUT_NAMES`, then ρ of ½ρ‖f‖²; ``facets`` are a pyramid's."""
    contacts, actuation, objective = problem.contacts, problem.actuation, problem.objective
    J = tau_u = lower = upper = weight = cost = None
    force_weight = float(objective.type == "force")
    if actuation is not None:
        J, tau_u, lower, upper = actuation.J, actuation.tau_u, actuation.lower, actuation.upper
    if objective.type == "torque":
        assert actuation is not None  # as `ForceProblem` has made sure
        weight, force_weight = actuation.weight, objective.force_weight
    if objective.type == "sum_normal":
        cost = np.zeros(problem.size)
        cost[contacts.normal_rows] = 1.0
    limits = contacts.mu, contacts.gamma, contacts.min_normal, contacts.max_normal
    return (problem.w, J, tau_u, contacts.p_OC, contacts.R_OC, *limits, lower, upper, weight, facets, cost, force_weight)


def _joint_count(problem: ForceProblem) -> int:
    """n, how many motors there are."""
    return 0 if problem.actuation is None else problem.actuation.J.shape[1]


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
            moment = a[:, 2] * (mu[i] / gamma if gamma else 0.0)
        rows.append(np.column_stack([a[:, 0], a[:, 1], np.full(len(a), -mu[i]), moment]))
        owners.append(np.full(len(a), i, dtype=np.intc))
    return np.vstack(rows), np.concatenate(owners)

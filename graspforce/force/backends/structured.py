"""The structured kernel: exact cones and torque limits, solved and certified in C in tens of microseconds.

The kernel supports hands whose fingers share few joints, and objectives that are quadratic or linear in the forces. Its C
interface is ``csrc/include/graspforce/solve.h`` and ``certify.h``. Without a C compiler at installation the compiled module is
missing; `KernelBackend.unavailable_reason` states it.
"""

from __future__ import annotations

import contextlib
import importlib
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.contact import friction
from graspforce.contact.contact import ContactModel
from graspforce.core.arrays import Array
from graspforce.core.errors import BackendError, UnsupportedProblem
from graspforce.force.backends.protocol import Backend, SolverSettings
from graspforce.force.certificate import TIGHT_TOLERANCE, Certificate
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import LazySolution, Solution, uncertified_solution
from graspforce.force.status import Status

Kernel: Any = None
IncrementalKernel: Any = None
_fingers: Any = None
_record: Any = None
_report_type: Any = None  # type of a Kernel's reports
with contextlib.suppress(ImportError):  # not built: no C compiler
    _structured = importlib.import_module("graspforce.force.backends._structured")
    Kernel, IncrementalKernel = _structured.Kernel, _structured.IncrementalKernel
    _fingers, _record = _structured.find_fingers, _structured.make_record
    _report_type = np.dtype(list(_structured.report_fields))

_TOLERANCE = 1e-9  # on scaled residuals: a tenth of the certificate's tolerance
_MAX_ITERATIONS = 60
_LARGEST_BLOCK = 48  # force components that share joints; larger dense blocks are slower than a sparse solver
_OBJECTIVES = ("torque", "force", "sum_normal")
_STATUS = (Status.OPTIMAL, Status.INACCURATE, Status.INFEASIBLE, Status.FAILED)
_COMPONENTS = {model: len(model.columns) for model in ContactModel}
_EMPTY = np.zeros(0)
_NO_FACETS = (np.zeros((0, 4)), np.zeros(0, dtype=np.intc))
_CHANGEABLE = ("w", "J", "tau_u", "p", "R")  # the arrays that a step can change
_INPUT_NAMES = (*_CHANGEABLE, "mu", "gamma", "min_normal", "max_normal", "lower", "upper", "weight", "facet", "cost")
_NOT_BUILT = "graspforce was installed without a C compiler"

Indices = npt.NDArray[np.intc]


class KernelBackend:
    """The structured kernel as a backend."""

    name = "structured"

    @property
    def unavailable_reason(self) -> str:
        """Why the kernel is not available; empty if it is."""
        return _NOT_BUILT if Kernel is None else ""

    def solve(self, problem: ForceProblem, settings: SolverSettings, guess: Solution | None = None) -> Solution:
        """Return the solution of a problem, as `Backend.solve`. Only a session starts warm."""
        start = time.perf_counter()
        solution = KernelSession(problem, settings).solve_arrays(start)
        assert solution is not None  # without changes the kernel refuses nothing
        return solution

    def start_session(self, problem: ForceProblem, settings: SolverSettings) -> KernelSession:
        """Return a session that starts each solve from the kernel's last iterate."""
        return KernelSession(problem, settings)


BACKENDS: tuple[Backend, ...] = (KernelBackend(),)


def is_available() -> bool:
    """Return whether the kernel was built when graspforce was installed."""
    return Kernel is not None


class KernelResult:
    """The numbers of one solve, decoded on demand: `SolutionData` of a certified optimum.

    `KernelSession` makes it, in C.

    Args:
        loaded: the problem that was loaded last.
        spans: for each row of J the first and last column of its finger, as C integers.
        numbers: the solution, then the changed arrays, as float64.
        changed: bit i is set if array i of `_CHANGEABLE` differs from the loaded problem.
        residuals: primal residual, dual residual and gap of the certificate in C; None if it was not computed.
    """

    __slots__ = ("changed", "loaded", "numbers", "residuals", "spans")
    loaded: ForceProblem
    spans: bytes
    numbers: bytes
    changed: int
    residuals: tuple[float, float, float] | None

    def problem(self) -> ForceProblem:
        """Return the loaded problem with the changed arrays."""
        changed, first = {}, _layout(self.loaded)["tau"][1]  # the changed arrays follow the solution
        for bit, (name, old) in enumerate(zip(_CHANGEABLE, _kernel_inputs(self.loaded), strict=False)):
            if self.changed >> bit & 1:
                stored = self.finger_mask() if name == "J" else np.ones(old.shape, dtype=bool)
                count = int(np.count_nonzero(stored))
                changed[name] = np.zeros(old.shape)
                changed[name][stored] = np.frombuffer(self.numbers)[first : first + count]
                first += count
        return self.loaded.replace(**changed)

    def forces(self) -> Array:
        """Return (k,) the stacked contact forces, N and N·m."""
        return self._part("f")

    def torques(self) -> Array:
        """Return (n,) the motor torques, N·m."""
        return self._part("tau")

    def multipliers(self) -> Multipliers:
        """Return the multipliers of the optimum or of the proof of infeasibility."""
        contacts = self.problem().contacts
        return Multipliers(
            y=self._part("y"),
            normal_lower=self._part("nu_lower"),
            normal_upper=self._part("nu_upper"),
            torque_lower=self._part("lambda_lower"),
            torque_upper=self._part("lambda_upper"),
            level=np.zeros(len(contacts)),
            point=contacts.centroid,
        )

    def certificate(self) -> Certificate | None:
        """Return the certificate computed in C; None if it was not computed."""
        return None if self.residuals is None else Certificate.from_residuals(*self.residuals)

    def finger_mask(self) -> npt.NDArray[np.bool_]:
        """Return (k, n) which entries of J the kernel stores: those within the fingers."""
        spans = np.frombuffer(self.spans, dtype=np.intc).reshape(-1, 2)
        columns = np.arange(_joint_count(self.loaded))
        return np.asarray((columns >= spans[:, :1]) & (columns < spans[:, 1:]))

    def _part(self, name: str) -> Array:
        """Return a part of the solution, read-only."""
        first, last = _layout(self.loaded)[name]
        return np.frombuffer(self.numbers)[first:last]


_RESULT_FIELDS = ("loaded", "spans", "numbers", "changed", "residuals")
_SOLUTION_FIELDS = ("backend", "iterations", "seconds", "data")


class KernelSession:
    """A kernel bound to a problem. Each solve starts from the last iterate; use one session per thread.

    Args:
        problem: the first problem.
        settings: tolerance and limit on iterations of every solve.

    Raises:
        UnsupportedProblem: another objective, or too many fingers on shared joints.
        BackendError: the kernel was not built.
    """

    _kernel: Any
    _loaded: ForceProblem
    _spans: bytes
    _result: KernelResult | None  # of the last solve, unless a problem was loaded since

    def __init__(self, problem: ForceProblem, settings: SolverSettings) -> None:
        self._tolerance = settings.tolerance or _TOLERANCE
        self._max_iterations = settings.max_iterations or _MAX_ITERATIONS
        self._bind(problem)

    @property
    def problem(self) -> ForceProblem:
        """The problem as the last solve left it."""
        return self._loaded if self._result is None else self._result.problem()

    def solve(
        self,
        w: npt.ArrayLike | None = None,
        J: npt.ArrayLike | None = None,
        tau_u: npt.ArrayLike | None = None,
        mu: npt.ArrayLike | None = None,
        p: npt.ArrayLike | None = None,
        R: npt.ArrayLike | None = None,
    ) -> Solution:
        """Return the solution for changed values, as `Session.solve`. Fastest for float64 arrays, and without mu."""
        start = time.perf_counter()
        solution = None if mu is not None else self.solve_arrays(start, w, J, tau_u, p, R)
        if solution is None:
            problem = self.problem.replace(w=w, J=J, tau_u=tau_u, mu=mu, p=p, R=R)
            if not self.load(problem):
                self._bind(problem)
            solution = self.solve_arrays(start)
            assert solution is not None  # without changes the kernel refuses nothing
        return solution

    def solve_arrays(
        self,
        start: float,
        w: object = None,
        J: object = None,
        tau_u: object = None,
        p: object = None,
        R: object = None,
    ) -> Solution | None:
        """Return the solution for changed arrays, checked and copied in C.

        Args:
            start: start of the solver's time, on the clock `time.perf_counter`, s.
            w, J, tau_u, p, R: as in `solve`.

        Returns:
            The solution. None, and nothing changes, if a value is not a float64 array of the right shape with finite numbers,
            or if J couples other fingers: `ForceProblem.replace` then converts the value or states the error.

        Raises:
            BackendError: another thread uses the session.
        """
        try:
            raw = self._kernel.step(self._tolerance, self._max_iterations, True, w, J, tau_u, p, R)
        except RuntimeError as busy:
            raise BackendError(f"structured: {busy}; each thread needs a Solver of its own") from None
        if raw is None:
            return None
        number, iterations, residuals, numbers, changed = raw
        result = _record(KernelResult, _RESULT_FIELDS, self._loaded, self._spans, numbers, changed, residuals)
        self._result = result
        seconds = time.perf_counter() - start
        if residuals is not None and max(residuals) <= TIGHT_TOLERANCE:
            certified: Solution = _record(LazySolution, _SOLUTION_FIELDS, "structured", iterations, seconds, result)
            return certified
        return _uncertified(result, _STATUS[number], iterations, seconds)

    def load(self, problem: ForceProblem) -> bool:
        """Replace the problem by another one; return False if it has another structure or other fingers.

        Args:
            problem: the new problem.
        """
        old = self._loaded
        if problem.contacts.models != old.contacts.models or problem.cone != old.cone or problem.cone.type == "pyramid":
            return False
        if problem.objective != old.objective or _joint_count(problem) != _joint_count(old):
            return False
        if not self._kernel.load(*_kernel_inputs(problem)):
            return False
        self._loaded, self._result = problem, None
        return True

    def solution_layout(self) -> dict[str, tuple[int, int]]:
        """Return the first and last place of each part of a solution in the kernel's numbers."""
        layout: dict[str, tuple[int, int]] = self._kernel.solution_layout()
        return layout

    def _bind(self, problem: ForceProblem) -> None:
        """Make a kernel for a problem; the session stays as it was if the kernel does not support it."""
        _check_supported(problem)
        facets, owners = (None, None) if problem.cone.type == "exact" else _facets(problem)
        inputs = _kernel_inputs(problem, facets)
        try:
            self._kernel = IncrementalKernel(_LARGEST_BLOCK, problem.contacts.columns, owners, *inputs)
        except OverflowError as error:
            raise UnsupportedProblem(f"structured supports {error}") from None
        self._loaded, self._result = problem, None
        self._spans = self._kernel.spans()


_layouts: dict[tuple[int, int, int], dict[str, tuple[int, int]]] = {}  # by k, N and n


def _layout(problem: ForceProblem) -> dict[str, tuple[int, int]]:
    """Return the first and last place of each part of a solution in the numbers of a `KernelResult`."""
    sizes = (problem.size, len(problem.contacts), _joint_count(problem))
    if sizes not in _layouts:
        _layouts[sizes] = KernelSession(problem, SolverSettings()).solution_layout()
    return _layouts[sizes]


def _uncertified(result: KernelResult, status: Status, iterations: int, seconds: float) -> Solution:
    """Return a solution that the certificate in C does not prove optimal, with all fields."""
    found = status in (Status.OPTIMAL, Status.INACCURATE)
    solution = uncertified_solution(
        result.problem(),
        status,
        result.forces() if found else None,
        None if status is Status.FAILED else result.multipliers(),
        backend=KernelBackend.name,
        iterations=iterations,
        seconds=seconds,
    )
    certificate = result.certificate()
    return solution if certificate is None else solution.with_certificate(certificate)


def solve_stacked(problem: ForceProblem, rows: Mapping[str, Array], count: int) -> tuple[Array, Array, npt.NDArray[np.void]]:
    """Solve and certify M problems that differ in some arrays, in one call of the kernel.

    Args:
        problem: the common values, with exact cones.
        rows: "w", "J" and "tau_u": arrays whose first axis is the index of the problem.
        count: M.

    Returns:
        (M, k) forces, (M, n) torques, and (M,) reports with the fields status and iterations; primal, dual and gap of the
        solver; certified_primal, certified_dual and certified_gap.

    Raises:
        UnsupportedProblem: as `KernelSession`.
        BackendError: the kernel was not built.
    """
    arrays = kernel_arrays(problem, count)
    kernel = Kernel(**{**arrays, **{name: np.ascontiguousarray(row) for name, row in rows.items()}})
    kernel.solve(0, count, _TOLERANCE, _MAX_ITERATIONS, False)
    kernel.certify(0, count)
    return arrays["f"], arrays["tau"], arrays["report"]


def kernel_arrays(problem: ForceProblem, count: int = 1) -> dict[str, Any]:
    """Return the arguments of a `Kernel` for a problem, with buffers for the results.

    Args:
        problem: the force problem.
        count: number of results.

    Raises:
        UnsupportedProblem: as `KernelSession`.
        BackendError: the kernel was not built.
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
        allowed = f"at most {_LARGEST_BLOCK} force components that share joints, not {largest}"
        raise UnsupportedProblem(f"structured supports {allowed}")
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
    """Raise an error if the kernel is missing or does not support the objective."""
    if Kernel is None:
        raise BackendError(f"structured is not available: {_NOT_BUILT}")
    if problem.objective.type not in _OBJECTIVES:
        allowed = ", ".join(_OBJECTIVES)
        raise UnsupportedProblem(f"structured supports the objectives {allowed}, not {problem.objective.type}")


def _kernel_inputs(problem: ForceProblem, facets: Array | None = None) -> tuple[Any, ...]:
    """Return the inputs of `IncrementalKernel` in the order of `_INPUT_NAMES`, then ρ of ½ρ‖f‖²."""
    contacts, actuation, objective = problem.contacts, problem.actuation, problem.objective
    J = tau_u = lower = upper = weight = cost = None
    force_weight = float(objective.type == "force")
    if actuation is not None:
        J, tau_u, lower, upper = actuation.J, actuation.tau_u, actuation.lower, actuation.upper
    if objective.type == "torque":
        assert actuation is not None  # validated by ForceProblem
        weight, force_weight = actuation.weight, objective.force_weight
    if objective.type == "sum_normal":
        cost = np.zeros(problem.size)
        cost[contacts.normal_rows] = 1.0
    limits = contacts.mu, contacts.gamma, contacts.min_normal, contacts.max_normal
    return (problem.w, J, tau_u, contacts.p_OC, contacts.R_OC, *limits, lower, upper, weight, facets, cost, force_weight)


def _joint_count(problem: ForceProblem) -> int:
    """Return n, the number of motors."""
    return 0 if problem.actuation is None else problem.actuation.J.shape[1]


def _facets(problem: ForceProblem) -> tuple[Array, Indices]:
    """Return the rows aᵀ(f_t1, f_t2, f_n, m_n) ≤ 0 of all pyramids, and the contact of each; none for exact cones."""
    contacts, cone = problem.contacts, problem.cone
    if cone.type == "exact":
        return _NO_FACETS
    rows, owners = [_NO_FACETS[0]], [_NO_FACETS[1]]
    mu = friction.pyramid_friction(contacts.mu, cone.facets, cone.side)
    for i in np.flatnonzero(contacts.mu > 0):
        gamma = float(contacts.gamma[i])
        a = friction.pyramid_facets(cone.facets, cone.side, gamma)
        with np.errstate(over="ignore", invalid="ignore"):  # the kernel rejects values that overflow
            moment = a[:, 2] * (mu[i] / gamma if gamma else 0.0)
        rows.append(np.column_stack([a[:, 0], a[:, 1], np.full(len(a), -mu[i]), moment]))
        owners.append(np.full(len(a), i, dtype=np.intc))
    return np.vstack(rows), np.concatenate(owners)

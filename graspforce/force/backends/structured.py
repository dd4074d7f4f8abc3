"""The structured kernel: exact cones and torque limits, solved and certified in C in tens of microseconds.

The kernel supports every force problem. It is fastest for hands whose fingers share few joints. Its C interface is
``csrc/include/graspforce/solve.h`` and ``certify.h``. Without a C compiler at installation the compiled module is missing;
`KernelBackend.unavailable_reason` states it.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.core.errors import BackendError
from graspforce.force.backends.compiled_kernel import (
    CHANGEABLE,
    MAX_ITERATIONS,
    NOT_BUILT,
    SHORT_STEP_REDUCTION,
    TOLERANCE,
    IncrementalKernel,
    check_available,
    facet_rows,
    is_available,
    joint_count,
    kernel_inputs,
    level_of,
    make_record,
)
from graspforce.force.backends.protocol import MAX_SHORT_STEPS, Backend, SolverSettings
from graspforce.force.certificate import INFEASIBILITY_TOLERANCE, TIGHT_TOLERANCE, Certificate
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import LazyInfeasibleSolution, LazySolution, Solution, uncertified_solution
from graspforce.force.status import Status

_STATUS = (Status.OPTIMAL, Status.INACCURATE, Status.INFEASIBLE, Status.FAILED)
_INFEASIBLE = _STATUS.index(Status.INFEASIBLE)
_ANY_SIZE = 2**31 - 1  # of a block of force components that share joints


class KernelBackend:
    """The structured kernel as a backend."""

    name = "structured"

    @property
    def unavailable_reason(self) -> str:
        """Why the kernel is not available; empty if it is."""
        return "" if is_available() else NOT_BUILT

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


class KernelResult:
    """The numbers of one solve, decoded on demand: `SolutionData` of a certified optimum.

    `KernelSession` makes it, in C.

    Args:
        loaded: the problem that was loaded last.
        spans: for each row of J the first and last column of its finger, as C integers.
        numbers: the solution, then the changed arrays, as float64.
        changed: bit i is set if array i of `CHANGEABLE` differs from the loaded problem.
        residuals: primal residual, dual residual and gap of the certificate in C; None if it was not computed. For a proof of
            infeasibility: 0, the residual of the proof and its value.
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
        for bit, (name, old) in enumerate(zip(CHANGEABLE, kernel_inputs(self.loaded), strict=False)):
            if self.changed >> bit & 1:
                stored = self.finger_mask() if name == "J" else np.ones(old.shape, dtype=bool)
                count = int(np.count_nonzero(stored))
                changed[name] = np.zeros(old.shape)
                changed[name][stored] = np.frombuffer(self.numbers)[first : first + count]
                first += count
        if "min_normal" in changed or "max_normal" in changed:
            contacts = self.loaded.contacts
            limits = changed.pop("min_normal", contacts.min_normal), changed.pop("max_normal", contacts.max_normal)
            changed["normal_limits"] = np.array(limits)
        if "gamma" in changed:
            changed["mu"] = np.array([changed.get("mu", self.loaded.contacts.mu), changed.pop("gamma")])
        return self.loaded.replace(**changed)

    def forces(self) -> Array:
        """Return (k,) the stacked contact forces, N and N·m."""
        return self.part("f")

    def torques(self) -> Array:
        """Return (n,) the motor torques, N·m."""
        return self.part("tau")

    def multipliers(self) -> Multipliers:
        """Return the multipliers of the optimum or of the proof of infeasibility."""
        contacts = self.problem().contacts
        return Multipliers(
            y=self.part("y"),
            normal_lower=self.part("nu_lower"),
            normal_upper=self.part("nu_upper"),
            torque_lower=self.part("lambda_lower"),
            torque_upper=self.part("lambda_upper"),
            level=self.part("level"),
            point=contacts.centroid,
        )

    def certificate(self) -> Certificate | None:
        """Return the certificate of an optimum computed in C; None if it was not computed."""
        return None if self.residuals is None else Certificate.from_residuals(*self.residuals)

    def infeasibility_certificate(self) -> Certificate:
        """Return the certificate of infeasibility, which was verified in C."""
        assert self.residuals is not None  # there is a proof
        return Certificate(True, *self.residuals, INFEASIBILITY_TOLERANCE)

    def finger_mask(self) -> npt.NDArray[np.bool_]:
        """Return (k, n) which entries of J the kernel stores: those within the fingers."""
        spans = np.frombuffer(self.spans, dtype=np.intc).reshape(-1, 2)
        columns = np.arange(joint_count(self.loaded))
        return np.asarray((columns >= spans[:, :1]) & (columns < spans[:, 1:]))

    def part(self, name: str) -> Array:
        """Return a part of the solution, read-only.

        Args:
            name: a name of `KernelSession.solution_layout`.
        """
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
        BackendError: the kernel was not built.
    """

    _kernel: Any
    _loaded: ForceProblem
    _spans: bytes
    _result: KernelResult | None  # of the last solve, unless a problem was loaded since

    def __init__(self, problem: ForceProblem, settings: SolverSettings) -> None:
        self._tolerance = settings.tolerance or TOLERANCE
        self._max_iterations = settings.max_iterations or MAX_ITERATIONS
        self._time_limit = settings.time_limit or 0.0
        self._short_steps = 0 if settings.short_steps is None and settings.max_iterations is not None else settings.short_steps
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
        normal_limits: npt.ArrayLike | None = None,
    ) -> Solution:
        """Return the solution for changed values, as `Session.solve`. Fastest for float64 arrays."""
        start = time.perf_counter()
        solution = None
        if mu is None and normal_limits is None:
            solution = self.solve_arrays(start, w, J, tau_u, p, R)
        elif (contact_values := _split_rows(mu, normal_limits)) is not None:
            solution = self.solve_arrays(start, w, J, tau_u, p, R, *contact_values)
        if solution is None:
            problem = self.problem.replace(w=w, J=J, tau_u=tau_u, mu=mu, p=p, R=R, normal_limits=normal_limits)
            if not self.load(problem):
                self._bind(problem)
            solution = self.solve_arrays(start)
            assert solution is not None  # without changes the kernel refuses nothing
        return solution

    def solve_arrays(self, start: float, *changes: object) -> Solution | None:
        """Return the solution for changed arrays, checked and copied in C.

        Args:
            start: start of the solver's time, on the clock `time.perf_counter`, s.
            changes: arrays of `CHANGEABLE` in order, each None if it stays; the last ones may be omitted.

        Returns:
            The solution. None, and nothing changes, if a value is not a float64 array of the right shape with allowed numbers,
            or if J couples other fingers: `ForceProblem.replace` then converts the value or states the error.

        Raises:
            BackendError: another thread uses the session.
        """
        try:
            raw = self._kernel.step(self._tolerance, self._max_iterations, True, *changes)
        except RuntimeError as busy:
            raise BackendError(f"structured: {busy}; each thread needs a Solver of its own") from None
        if raw is None:
            return None
        number, iterations, residuals, numbers, changed = raw
        result = make_record(KernelResult, _RESULT_FIELDS, self._loaded, self._spans, numbers, changed, residuals)
        self._result = result
        seconds = time.perf_counter() - start
        kind: type[Solution] | None = None
        if residuals is not None:
            if number == _INFEASIBLE:
                kind = LazyInfeasibleSolution
            elif max(residuals) <= TIGHT_TOLERANCE:
                kind = LazySolution
        if kind is not None:
            certified: Solution = make_record(kind, _SOLUTION_FIELDS, "structured", iterations, seconds, result)
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
        if problem.objective != old.objective or joint_count(problem) != joint_count(old):
            return False
        if not self._kernel.load(*kernel_inputs(problem)):
            return False
        self._loaded, self._result = problem, None
        return True

    def short_step_bound(self, reduction: float) -> int:
        """Return the number of short steps that reduce all residuals and the mean complementarity by a factor.

        It holds for every problem of this structure, in exact arithmetic: ``docs/concepts/iteration_bound.md``.

        Args:
            reduction: the factor, above 0 and at most 1.
        """
        return int(self._kernel.short_step_bound(reduction))

    def solution_layout(self) -> dict[str, tuple[int, int]]:
        """Return the first and last place of each part of a solution in the kernel's numbers."""
        layout: dict[str, tuple[int, int]] = self._kernel.solution_layout()
        return layout

    def _bind(self, problem: ForceProblem) -> None:
        """Make a kernel for a problem."""
        check_available()
        facets, owners = (None, None) if problem.cone.type == "exact" else facet_rows(problem)
        inputs = kernel_inputs(problem, facets)
        self._kernel = IncrementalKernel(_ANY_SIZE, problem.contacts.columns, owners, level_of(problem), *inputs)
        self._kernel.limit_time(self._time_limit)
        steps = self._short_steps
        if steps is None:
            steps = min(self.short_step_bound(SHORT_STEP_REDUCTION), MAX_SHORT_STEPS)
        self._kernel.limit_short_steps(steps)
        self._loaded, self._result = problem, None
        self._spans = self._kernel.spans()


def _split_rows(mu: object, normal_limits: object) -> tuple[object, object, object, object] | None:
    """Return μ, the smallest and largest normal forces, and γ, as in `ForceProblem.replace`; None unless they are arrays."""
    gamma = lower = upper = None
    if isinstance(mu, np.ndarray) and mu.ndim == 2 and len(mu) == 2:
        mu, gamma = mu
    if normal_limits is not None:
        if not (isinstance(normal_limits, np.ndarray) and normal_limits.ndim == 2 and len(normal_limits) == 2):
            return None
        lower, upper = normal_limits
    return mu, lower, upper, gamma


_layouts: dict[tuple[int, int, int], dict[str, tuple[int, int]]] = {}  # by k, N and n


def _layout(problem: ForceProblem) -> dict[str, tuple[int, int]]:
    """Return the first and last place of each part of a solution in the numbers of a `KernelResult`."""
    sizes = (problem.size, len(problem.contacts), joint_count(problem))
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

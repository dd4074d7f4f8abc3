"""Stacks of force problems that share a structure: solved, certified and differentiated in C, on all cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnknownName, UnsupportedProblem
from graspforce.force.backends.compiled_kernel import StackedKernel
from graspforce.force.certificate import TIGHT_TOLERANCE
from graspforce.force.degeneracy import outcome_reason
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_data import change_problem, check_rows, data_shapes
from graspforce.force.solution import Solution
from graspforce.force.solver import solve
from graspforce.force.status import Status

CHUNK = 256  # largest number of problems in one task of a thread pool; amortises the cost of a task
_SEEDS = ("f", "tau", "objective")

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False, slots=True)
class StackedGradients:
    """Gradients of a function of M optima with respect to their data; rows without a gradient are NaN.

    Each gradient keeps all other data, so that moved contacts keep their J. The data of motors are empty without a hand.

    Args:
        degenerate: (M) the reason why a gradient does not exist, or the status of a problem without forces; empty if it exists.
        w: (M, 6) of the wrench about O.
        mu: (M, N) of the friction coefficients.
        p: (M, N, 3) of the contact positions in O.
        rotation: (M, N, 3) of rotation vectors of the contact frames in O, which turn the normal by φ × n.
        tau_u: (M, n) of the motor torques without contact.
        torque_lower: (M, n) of the lower torque limits.
        torque_upper: (M, n) of the upper torque limits.
        J: (M, k, n) of the hand Jacobian.
    """

    degenerate: tuple[str, ...]
    w: Array
    mu: Array
    p: Array
    rotation: Array
    tau_u: Array
    torque_lower: Array
    torque_upper: Array
    J: Array


@dataclass(frozen=True, eq=False, slots=True)
class StackedSolutions:
    """The solutions of M stacked problems, as arrays; rows without forces are NaN.

    Args:
        status: (M) one status per problem.
        f: (M, k) stacked contact forces in the contact frames, N and N·m.
        torques: (M, n) motor torques, N·m.
        objective: (M,) values of the objective.
        residuals: (M, 3) primal residual, dual residual and gap of the certificates, relative.
        gradients: gradients of the function that `adjoint` gives; None if none is given.
    """

    status: tuple[Status, ...]
    f: Array
    torques: Array
    objective: Array
    residuals: Array
    gradients: StackedGradients | None = None


def solve_stack(
    problem: ForceProblem,
    *,
    adjoint: Mapping[str, npt.ArrayLike] | None = None,
    threads: int | None = None,
    **data: npt.ArrayLike,
) -> StackedSolutions:
    """Return the solutions of M problems that differ only in the given arrays, by the structured kernel.

    Problems that the kernel does not certify at `TIGHT_TOLERANCE` are solved again by `solve`.

    Args:
        problem: the common values, with exact cones.
        adjoint: derivatives of a function φ of the optimum, to compute its gradient with respect to all data: "f" (k,) or
            (M, k), "tau" (n,) or (M, n), "objective" a number or (M,). Others are zero.
        threads: number of threads; by default one per core.
        data: `w` (M, 6), `mu` (M, N), `p` (M, N, 3), `R` (M, N, 3, 3), and with a hand `tau_u`, `torque_lower`, `torque_upper`
            (M, n) and `J` (M, k, n), in the units of `ForceProblem`. At least one.

    Raises:
        InvalidInput: no arrays, wrong shapes, values that are not allowed, or a problem with pyramids or with an uncertainty.
        UnsupportedProblem: the structured kernel does not support the problem.
        BackendError: the structured kernel was not built.
    """
    stack = ProblemStack(problem, check_rows(problem, data), threads)
    seeds = None if adjoint is None else stack.check_seeds(adjoint)
    return stack.solve(seeds)


class ProblemStack:
    """M problems in the kernel's arrays. Solve them once, then compute gradients any number of times.

    Args:
        problem: the common values, with exact cones.
        rows: stacked data of `check_rows`.
        threads: number of threads; by default one per core.

    Raises:
        InvalidInput: pyramids, or an uncertainty.
        UnsupportedProblem: the structured kernel does not support the problem.
        BackendError: the structured kernel was not built.
    """

    def __init__(self, problem: ForceProblem, rows: Mapping[str, Array], threads: int | None = None) -> None:
        if problem.uncertainty is not None:
            raise InvalidInput("uncertainty", "given", "absent: stacked problems have exact data")
        if problem.cone.type != "exact":
            raise InvalidInput("cone.type", problem.cone.type, "exact: stacked problems are certified with exact cones only")
        self.problem, self.rows = problem, rows
        self.count = len(next(iter(rows.values())))
        self._threads = threads or core_count()
        chunks = [slice(first, min(first + CHUNK, self.count)) for first in range(0, self.count, CHUNK)]
        self._chunks = [(chunk, StackedKernel(problem, {name: row[chunk] for name, row in rows.items()})) for chunk in chunks]
        self._status: tuple[Status, ...] = ()

    def solve(self, seeds: Mapping[str, Array] | None = None) -> StackedSolutions:
        """Solve and certify all problems, and compute gradients if there are seeds.

        Args:
            seeds: derivatives of `check_seeds`.
        """
        self._each_chunk(lambda _, kernel: kernel.solve())
        f, torques, residuals, optimal = (
            np.concatenate(parts) for parts in zip(*(kernel.solutions() for _, kernel in self._chunks), strict=True)
        )
        status = [Status.OPTIMAL] * self.count
        for i in np.flatnonzero(~optimal | (residuals.max(axis=1) > TIGHT_TOLERANCE)):
            answer = solve(change_problem(self.problem, {name: row[i] for name, row in self.rows.items()}), explain=False)
            status[i] = answer.status
            f[i], torques[i] = (answer.f, answer.torques) if answer.found else (np.nan, np.nan)
            known = answer.certificate
            residuals[i] = np.nan if known is None else (known.primal_residual, known.dual_residual, known.gap)
            self._store(int(i), answer)
        self._status = tuple(status)
        return StackedSolutions(
            self._status,
            arrays.freeze(f),
            arrays.freeze(torques),
            arrays.freeze(self._objective(f, torques)),
            arrays.freeze(residuals),
            None if seeds is None else self.gradients(seeds),
        )

    def check_seeds(self, given: Mapping[str, npt.ArrayLike]) -> dict[str, Array]:
        """Return derivatives of a function of the optimum, one row for each problem, checked.

        Args:
            given: derivatives by name, of each problem or the same for all.

        Raises:
            InvalidInput: an unknown name, or a wrong shape.
            UnsupportedProblem: an objective without gradients.
        """
        if self.problem.objective.type not in ("torque", "force", "sum_normal"):
            raise UnsupportedProblem(f"gradients support torque, force and sum_normal, not {self.problem.objective.type}")
        for name in given:
            if name not in _SEEDS:
                raise UnknownName("adjoint", name, _SEEDS)
        n = data_shapes(self.problem).get("tau_u", (0,))[0]
        seeds = {}
        for name, size in (("f", (self.problem.size,)), ("tau", (n,)), ("objective", ())):
            value = given.get(name, np.zeros(size))
            shape = (self.count, *size) if np.ndim(value) > len(size) else size
            seeds[name] = np.broadcast_to(arrays.check_array(value, f"adjoint.{name}", shape), (self.count, *size))
        return seeds

    def gradients(self, seeds: Mapping[str, Array]) -> StackedGradients:
        """Return the gradients of a function of the optima that `solve` found.

        Args:
            seeds: derivatives of `check_seeds`.
        """
        parts = self._each_chunk(lambda rows, kernel: kernel.adjoint({name: seed[rows] for name, seed in seeds.items()}))
        result = {name: np.concatenate([gradient[name] for gradient, _ in parts]) for name in parts[0][0]}
        outcomes = np.concatenate([outcome for _, outcome in parts]).tolist()
        reasons = [
            outcome_reason(*outcome) if status in (Status.OPTIMAL, Status.INACCURATE) else status.sentence
            for outcome, status in zip(outcomes, self._status, strict=True)
        ]
        missing = np.array([bool(reason) for reason in reasons])
        for gradient in result.values():
            gradient[missing] = np.nan
        return StackedGradients(tuple(reasons), **{name: arrays.freeze(array) for name, array in result.items()})

    def _each_chunk(self, work: Callable[[slice, StackedKernel], Result]) -> list[Result]:
        """Return the results of a function of each chunk's rows and kernel, computed by threads."""
        with ThreadPoolExecutor(self._threads) as pool:
            return list(pool.map(lambda chunk: work(*chunk), self._chunks))

    def _store(self, i: int, answer: Solution) -> None:
        """Replace the kernel's solution of problem i by another one, from which gradients are computed."""
        if answer.found and answer.multipliers is not None:
            multipliers = answer.multipliers.about(answer.original_problem.contacts.centroid)
            self._chunks[i // CHUNK][1].store(i % CHUNK, answer.f, multipliers)

    def _objective(self, f: Array, torques: Array) -> Array:
        """Return (M,) the objective of forces (M, k) and torques (M, n)."""
        problem, a = self.problem, self.problem.actuation
        if problem.objective.type == "sum_normal":
            return np.asarray(f[:, problem.contacts.normal_rows].sum(axis=1))
        squares = 0.5 * (f * f) @ problem.force_weights
        if problem.objective.type == "force":
            return np.asarray(squares)
        assert a is not None  # the objective has torques
        return np.asarray(0.5 * (torques * torques) @ a.weight + problem.objective.force_weight * squares)


def core_count() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

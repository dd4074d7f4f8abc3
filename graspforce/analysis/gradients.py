"""Forces as a differentiable function of the data of a force problem: the part that the adapters of PyTorch and JAX share.

The data are the named arrays of `graspforce.force.problem_data`. The gradient with respect to a contact frame R follows from
that of its rotation vector φ: R̄ = ½ φ̄ × R, so that ⟨R̄, φ × R⟩ = φ̄·φ.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from graspforce.analysis.sensitivity import DegenerateOptima, Sensitivities, sensitivities
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_data import change_problem, check_names, check_rows, data_shapes
from graspforce.force.solver import solve
from graspforce.force.stack import ProblemStack

_LARGEST_SKEW = 1e-3  # of RᵀR − 1: frames in single precision are rounded to rotations, others are refused
_NO_FORCES = "one with forces: there is no gradient without forces"


class OptimalForces(NamedTuple):
    """An optimum as tensors of PyTorch or arrays of JAX; of M problems with one axis more in front.

    Args:
        f: (k,) stacked contact forces in the contact frames, N and N·m.
        tau: (n,) motor torques, N·m; empty without a hand.
        objective: value of the objective.
        degenerate: reasons why derivatives do not exist; empty if they do, and always in JAX, which passes arrays only.
    """

    f: Any
    tau: Any
    objective: Any
    degenerate: tuple[str, ...] = ()


def round_frames(problem: ForceProblem, data: Mapping[str, npt.ArrayLike]) -> dict[str, npt.ArrayLike]:
    """Return data whose contact frames are rounded to the nearest rotations.

    Args:
        problem: the force problem.
        data: arrays by name; ``R`` (N, 3, 3) or (M, N, 3, 3).

    Raises:
        InvalidInput: a frame that is no rotation to 1e-3.
    """
    result = dict(data)
    if "R" in result:
        shape = data_shapes(problem)["R"]
        R = arrays.check_array(result["R"], "R", (None, *shape) if np.ndim(result["R"]) > 3 else shape)
        skew = np.abs(np.swapaxes(R, -2, -1) @ R - np.eye(3)).max(axis=(-2, -1))
        for index in np.argwhere(skew > _LARGEST_SKEW):
            place = "".join(f"[{i}]" for i in index)
            raise InvalidInput(f"R{place}", R[tuple(index)], "a rotation matrix, its third column the inward normal")
        left, _, right = np.linalg.svd(R)
        result["R"] = left @ right
    return result


def solve_with_data(
    problem: ForceProblem, data: Mapping[str, npt.ArrayLike], degenerate: DegenerateOptima = "error"
) -> Sensitivities:
    """Return the derivatives of the optimum for other data.

    Args:
        problem: the force problem.
        data: arrays by name, as in `change_problem`; contact frames are rounded to rotations.
        degenerate: as in `sensitivities`.

    Raises:
        InvalidInput: no forces exist, or the optimum is degenerate and that is an error.
        UnsupportedProblem: an objective or a cone without derivatives.
    """
    _check_choice(degenerate)
    solution = solve(change_problem(problem, round_frames(problem, data)), explain=False)
    if not solution.found:
        raise InvalidInput("problem", solution.status.value, _NO_FORCES)
    answer = sensitivities(solution, degenerate=degenerate)
    answer.check_regular()
    return answer


def optimum_values(answer: Sensitivities) -> tuple[Array, Array, Array]:
    """Return the forces, the torques and the objective of an optimum.

    Args:
        answer: derivatives of the optimum.
    """
    optimum = answer.optimum
    return optimum.f, optimum.problem.torques(optimum.f), np.array(optimum.problem.cost(optimum.f))


def data_gradient(answer: Sensitivities, f: Array, tau: Array, objective: float) -> dict[str, Array]:
    """Return the gradient of a function of the optimum with respect to all data, by name.

    Args:
        answer: derivatives of the optimum.
        f: (k,) gradient of the function with respect to the forces.
        tau: (n,) gradient with respect to the motor torques.
        objective: derivative with respect to the objective.
    """
    return _with_frames(answer.adjoint(f, tau, objective), answer.optimum.problem.contacts.R_OC)


def is_batch(problem: ForceProblem, data: Mapping[str, npt.ArrayLike]) -> bool:
    """Return whether an array has one axis more than the data of one problem.

    Args:
        problem: the force problem.
        data: arrays by name.
    """
    shapes = data_shapes(problem)
    return any(np.ndim(value) > len(shapes[name]) for name, value in data.items() if name in shapes)


class OptimumBatch:
    """The optima of M problems, solved by the compiled kernel on all cores, and their gradients.

    Args:
        problem: the force problem.
        data: arrays by name; those with one axis more than the data of one problem differ between the problems.
        degenerate: as in `sensitivities`.

    Raises:
        InvalidInput: a problem has no forces, or an optimum is degenerate and that is an error.
        UnsupportedProblem: an objective or a cone without derivatives.
        BackendError: the structured kernel was not built.
    """

    def __init__(
        self, problem: ForceProblem, data: Mapping[str, npt.ArrayLike], degenerate: DegenerateOptima = "error"
    ) -> None:
        _check_choice(degenerate)
        check_names(problem, data)
        rounded = round_frames(problem, data)
        stacked = {name: value for name, value in rounded.items() if is_batch(problem, {name: value})}
        self._problem = change_problem(problem, {name: value for name, value in rounded.items() if name not in stacked})
        self._rows = check_rows(self._problem, stacked)
        self._stack = ProblemStack(self._problem, self._rows)
        regular = self._stack.check_seeds({})
        self.solutions = self._stack.solve()
        for i, status in enumerate(self.solutions.status):
            if not np.isfinite(self.solutions.objective[i]):
                raise InvalidInput(f"problem {i}", status.value, _NO_FORCES)
        reasons = enumerate(self._stack.gradients(regular).degenerate)
        self._degenerate = {i: reason for i, reason in reasons if reason}
        if self._degenerate and degenerate == "error":
            i, reason = next(iter(self._degenerate.items()))
            raise InvalidInput(f"problem {i}", reason, "a regular optimum: its derivatives do not exist")

    @property
    def degenerate(self) -> tuple[str, ...]:
        """The problems whose derivatives do not exist, with the reasons."""
        return tuple(f"problem {i}: {reason}" for i, reason in self._degenerate.items())

    def gradient(self, f: Array, tau: Array, objective: Array) -> dict[str, Array]:
        """Return the gradient of a function of the optima with respect to the data of each problem, by name.

        Args:
            f: (M, k) gradient of the function with respect to the forces.
            tau: (M, n) gradient with respect to the motor torques.
            objective: (M,) derivatives with respect to the objectives.
        """
        seeds = self._stack.check_seeds({"f": f, "tau": tau, "objective": objective})
        found = self._stack.gradients(seeds)
        frames = self._rows.get("R", self._problem.contacts.R_OC)
        names = [name for name in data_shapes(self._problem) if name != "R"]
        result = _with_frames({name: getattr(found, name) for name in (*names, "rotation")}, frames)
        result = {name: np.array(value) for name, value in result.items()}
        for i in self._degenerate:  # only with least squares
            answer = solve_with_data(self._problem, {name: row[i] for name, row in self._rows.items()}, "least_squares")
            for name, value in data_gradient(answer, f[i], tau[i], float(objective[i])).items():
                result[name][i] = value
        return result


def _with_frames(gradient: Mapping[str, Array], frames: Array) -> dict[str, Array]:
    """Return a gradient with that of contact frames in the place of that of rotation vectors."""
    result = {name: value for name, value in gradient.items() if name != "rotation"}
    result["R"] = 0.5 * np.cross(gradient["rotation"][..., :, None], frames, axis=-2)
    return result


def _check_choice(degenerate: str) -> None:
    """Raise an error for an unknown treatment of degenerate optima."""
    if degenerate not in get_args(DegenerateOptima):
        raise UnknownName("degenerate", degenerate, get_args(DegenerateOptima))

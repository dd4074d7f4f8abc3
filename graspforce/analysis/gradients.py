"""Forces as a differentiable function of the data of a force problem: the part that the adapters of PyTorch and JAX share.

The data are named arrays: ``w``, ``mu``, ``p``, ``R``, ``tau_u``, ``J``, ``torque_lower`` and ``torque_upper``. The gradient
with respect to a contact frame R follows from that of its rotation vector φ: R̄ = ½ φ̄ × R, so that ⟨R̄, φ × R⟩ = φ̄·φ.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import get_args

import numpy as np
import numpy.typing as npt

from graspforce.analysis.sensitivity import DegenerateOptima, Sensitivities, sensitivities
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.force.problem import ForceProblem
from graspforce.force.solver import solve
from graspforce.hand.actuation import Actuation

_CONTACT_DATA = ("w", "mu", "p", "R")
_MOTOR_DATA = ("tau_u", "torque_lower", "torque_upper", "J")
_LARGEST_SKEW = 1e-3  # of RᵀR − 1: frames in single precision are rounded to rotations, others are refused


def data_shapes(problem: ForceProblem) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the data that a problem has, by name.

    Args:
        problem: the force problem.
    """
    count = len(problem.contacts)
    shapes: dict[str, tuple[int, ...]] = {"w": (6,), "mu": (count,), "p": (count, 3), "R": (count, 3, 3)}
    if problem.actuation is not None:
        n = len(problem.actuation.tau_u)
        shapes |= {"tau_u": (n,), "torque_lower": (n,), "torque_upper": (n,), "J": (problem.size, n)}
    return shapes


def change_problem(problem: ForceProblem, data: Mapping[str, npt.ArrayLike]) -> ForceProblem:
    """Return the problem with other data; contact frames are rounded to rotations.

    Args:
        problem: the force problem.
        data: arrays by name. Torque limits may be infinite.

    Raises:
        InvalidInput: an unknown name, another shape, or a value that is not allowed.
    """
    shapes = data_shapes(problem)
    for name in data:
        if name in _MOTOR_DATA and name not in shapes:
            raise InvalidInput(name, data[name], "absent: the problem has no hand")
        if name not in shapes:
            raise UnknownName("data", name, shapes)
    values = {name: value for name, value in data.items() if name in _CONTACT_DATA}
    if "R" in values:
        values["R"] = _nearest_rotations(arrays.check_array(values["R"], "R", shapes["R"]))
    changed = problem.replace(**values)
    motors = {name: value for name, value in data.items() if name in _MOTOR_DATA}
    if not motors:
        return changed
    a = problem.actuation
    assert a is not None  # the shapes have the motors' data
    actuation = Actuation(
        motors.get("J", a.J),
        motors.get("tau_u", a.tau_u),
        _limits(motors.get("torque_lower", a.lower)),
        _limits(motors.get("torque_upper", a.upper)),
        a.weight,
    )
    return ForceProblem(
        changed.contacts,
        changed.w,
        actuation,
        problem.cone,
        problem.objective,
        problem.name,
        problem.source,
        problem.uncertainty,
    )


def solve_with_data(
    problem: ForceProblem, data: Mapping[str, npt.ArrayLike], degenerate: DegenerateOptima = "error"
) -> Sensitivities:
    """Return the derivatives of the optimum for other data.

    Args:
        problem: the force problem.
        data: arrays by name, as in `change_problem`.
        degenerate: as in `sensitivities`.

    Raises:
        InvalidInput: no forces exist, or the optimum is degenerate and that is an error.
        UnsupportedProblem: an objective or a cone without derivatives.
    """
    if degenerate not in get_args(DegenerateOptima):
        raise UnknownName("degenerate", degenerate, get_args(DegenerateOptima))
    solution = solve(change_problem(problem, data), explain=False)
    if not solution.found:
        raise InvalidInput("problem", solution.status.value, "one with forces: there is no gradient without forces")
    answer = sensitivities(solution, degenerate=degenerate)
    answer.check_regular()
    return answer


def data_gradient(answer: Sensitivities, f: Array, tau: Array, objective: float) -> dict[str, Array]:
    """Return the gradient of a function of the optimum with respect to all data, by name.

    Args:
        answer: derivatives of the optimum.
        f: (k,) gradient of the function with respect to the forces.
        tau: (n,) gradient with respect to the motor torques.
        objective: derivative with respect to the objective.
    """
    gradient = answer.adjoint(f, tau, objective)
    turn, frames = gradient.pop("rotation"), answer.optimum.problem.contacts.R_OC
    gradient["R"] = 0.5 * np.cross(turn[:, :, None], frames, axis=1)
    return gradient


def _nearest_rotations(R: Array) -> Array:
    """Return the rotations nearest to (N, 3, 3) matrices; raise an error for matrices that are no rotations."""
    for i, skew in enumerate(np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2)).tolist()):
        if skew > _LARGEST_SKEW:
            raise InvalidInput(f"R[{i}]", R[i], "a rotation matrix, its third column the inward normal")
    left, _, right = np.linalg.svd(R)
    return np.asarray(left @ right)


def _limits(values: npt.ArrayLike) -> list[float | None]:
    """Return torque limits with None in the place of infinite ones."""
    return [float(value) if np.isfinite(value) else None for value in np.asarray(values, dtype=float).ravel()]

"""The data of a force problem as named arrays, of one problem or stacked for many.

The names are ``w``, ``mu``, ``p`` and ``R``, and with a hand ``tau_u``, ``torque_lower``, ``torque_upper`` and ``J``.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactModel
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.force.problem import ForceProblem
from graspforce.hand.actuation import Actuation

CONTACT_DATA = ("w", "mu", "p", "R")
MOTOR_DATA = ("tau_u", "torque_lower", "torque_upper", "J")
_LARGEST_SKEW = 1e-9  # of RᵀR − 1, as in `ForceProblem.replace`


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
    """Return the problem with other data.

    Args:
        problem: the force problem.
        data: arrays by name. Torque limits may be infinite.

    Raises:
        InvalidInput: an unknown name, another shape, or a value that is not allowed.
    """
    check_names(problem, data)
    changed = problem.replace(**{name: value for name, value in data.items() if name in CONTACT_DATA})
    motors = {name: value for name, value in data.items() if name in MOTOR_DATA}
    if not motors:
        return changed
    a = problem.actuation
    assert a is not None  # the names have the motors' data
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


def check_names(problem: ForceProblem, data: Mapping[str, object]) -> None:
    """Raise an error for data that a problem does not have.

    Args:
        problem: the force problem.
        data: values by name.

    Raises:
        InvalidInput: data of motors, and the problem has no hand.
        UnknownName: another name.
    """
    shapes = data_shapes(problem)
    for name in data:
        if name in MOTOR_DATA and name not in shapes:
            raise InvalidInput(name, data[name], "absent: the problem has no hand")
        if name not in shapes:
            raise UnknownName("data", name, shapes)


def check_rows(problem: ForceProblem, data: Mapping[str, npt.ArrayLike]) -> dict[str, Array]:
    """Return stacked data, checked: one row for each problem, all of one length.

    Args:
        problem: the common values.
        data: arrays by name, each with an axis more than that of one problem. Torque limits may be infinite.

    Raises:
        InvalidInput: no data, an unknown name, a wrong shape, different lengths, or a value that is not allowed.
    """
    check_names(problem, data)
    if not data:
        raise InvalidInput("w", None, "given, or other data of stacked problems")
    rows = {name: _check_stack(value, name, (None, *data_shapes(problem)[name])) for name, value in data.items()}
    lengths = {name: len(array) for name, array in rows.items()}
    if len(set(lengths.values())) > 1 or not min(lengths.values()):
        raise InvalidInput(", ".join(rows), list(lengths.values()), "of one length, at least 1")
    if "mu" in rows:
        smooth = [model is ContactModel.FRICTIONLESS for model in problem.contacts.models]
        rows["mu"] = arrays.freeze(np.where(smooth, 0.0, rows["mu"]))
    if "R" in rows:
        _check_rotations(rows["R"])
    if "torque_lower" in rows or "torque_upper" in rows:
        _check_torque_limits(problem, rows)
    return rows


def _check_stack(value: npt.ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """Return stacked arrays of a shape; torque limits may be infinite on their own side."""
    if name not in ("torque_lower", "torque_upper"):
        return arrays.check_array(value, name, shape, minimum=0.0 if name == "mu" else None)
    given = np.asarray(value, dtype=float)
    absent = given == (-np.inf if name == "torque_lower" else np.inf)
    checked = arrays.check_array(np.where(absent, 0.0, given), name, shape)
    return arrays.freeze(np.where(absent, given, checked))


def _check_rotations(R: Array) -> None:
    """Raise an error for the first of (M, N, 3, 3) matrices that is no rotation."""
    skewed = np.abs(np.swapaxes(R, 2, 3) @ R - np.eye(3)).max(axis=(2, 3)) > _LARGEST_SKEW
    for row, contact in np.argwhere(skewed | (np.linalg.det(R) < 0.0)):
        raise InvalidInput(f"R[{row}][{contact}]", R[row, contact], "a rotation matrix, its third column the inward normal")


def _check_torque_limits(problem: ForceProblem, rows: Mapping[str, Array]) -> None:
    """Raise an error for the first lower torque limit above the upper one."""
    a = problem.actuation
    assert a is not None  # the names have the motors' data
    lower, upper = np.broadcast_arrays(rows.get("torque_lower", a.lower), rows.get("torque_upper", a.upper))
    for row, joint in np.argwhere(lower > upper):
        allowed = f"at most torque_upper[{row}][{joint}], which is {upper[row, joint]:g}"
        raise InvalidInput(f"torque_lower[{row}][{joint}]", float(lower[row, joint]), allowed)


def _limits(values: npt.ArrayLike) -> list[float | None]:
    """Return torque limits with None in the place of infinite ones."""
    return [float(value) if np.isfinite(value) else None for value in np.asarray(values, dtype=float).ravel()]

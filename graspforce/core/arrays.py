"""Checks of numbers: shape, finiteness and range. Each returns a float or a read-only float64 array."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from graspforce.core.errors import InvalidInput

Array = npt.NDArray[np.float64]

_FALSE_BYTE = b"\0"  # NumPy's False in memory
_ROTATION_TOLERANCE = 1e-6  # largest |RᵀR − 1| of a rotation matrix; six digits typed by hand are enough


def freeze(array: npt.ArrayLike) -> Array:
    """Return a read-only float64 copy of an array.

    Args:
        array: numbers of any shape.
    """
    result = np.array(array, dtype=np.float64, order="C")
    result.setflags(write=False)
    return result


def check_array(
    value: object,
    field: str,
    shape: tuple[int | None, ...],
    *,
    minimum: float | None = None,
    above: float | None = None,
    limit: float | None = None,
) -> Array:
    """Return a read-only float64 copy of an array of finite numbers.

    Args:
        value: the value to check; texts and booleans are not numbers.
        field: its path for error messages.
        shape: the required shape; None stands for any length.
        minimum: smallest allowed number, if any.
        above: the value that all numbers must exceed, if any.
        limit: largest allowed magnitude, if any.

    Raises:
        InvalidInput: not numbers, another shape, NaN or infinity, or a number outside the range; names the first one.
    """
    result = _as_float_array(value, field, shape)
    finite = np.isfinite(result)
    if _FALSE_BYTE in finite.tobytes():  # faster than finite.all() for small arrays
        raise _invalid_number(result, field, ~finite, "a finite number")
    if minimum is not None and (result < minimum).any():
        raise _invalid_number(result, field, result < minimum, f"at least {minimum:g}")
    if above is not None and (result <= above).any():
        raise _invalid_number(result, field, result <= above, f"greater than {above:g}")
    if limit is not None and any(abs(x) > limit for x in result.ravel().tolist()):  # faster than NumPy for small arrays
        raise _invalid_number(result, field, np.abs(result) > limit, f"from {-limit:g} to {limit:g}")
    result.setflags(write=False)
    return result


def check_rotation(value: object, field: str) -> Array:
    """Return a rotation matrix R as a read-only (3, 3) array: |RᵀR − 1| ≤ 1e-6 and det R > 0.

    Args:
        value: the value to check.
        field: its path for error messages.

    Raises:
        InvalidInput: not nine finite numbers, columns that are not orthonormal, or a reflection.
    """
    R = check_array(value, field, (3, 3))
    error, det = _orthonormality_error(R.ravel().tolist())
    if error > _ROTATION_TOLERANCE or det < 0.0:
        raise InvalidInput(field, value, f"a rotation matrix, RᵀR = 1 and det R = +1; |RᵀR − 1| is {error:.1g}")
    return R


def check_rotations(value: object, field: str, count: int) -> Array:
    """Return rotation matrices as a read-only (count, 3, 3) array, each as in `check_rotation`.

    Args:
        value: the value to check.
        field: its path for error messages.
        count: the number of matrices.

    Raises:
        InvalidInput: another shape, a number that is not finite, or a matrix that is not a rotation; names the first one.
    """
    matrices = check_array(value, field, (count, 3, 3))
    for i, R in enumerate(matrices):
        check_rotation(R, f"{field}[{i}]")
    return matrices


def check_times(value: object, field: str) -> Array:
    """Return the times of knots as a read-only array (K,), two or more that increase from 0.

    Args:
        value: the value to check.
        field: its path for error messages.

    Raises:
        InvalidInput: another shape, a number that is not finite, or times that do not increase from 0.
    """
    t = check_array(value, field, (None,))
    if len(t) < 2 or t[0] != 0.0 or (np.diff(t) <= 0.0).any():
        raise InvalidInput(field, value, "two or more times that increase from 0")
    return t


def is_rotation(R: Sequence[float]) -> bool:
    """Return whether nine finite numbers, row by row, are a rotation matrix: |RᵀR − 1| ≤ 1e-6 and det R > 0.

    Args:
        R: nine numbers.
    """
    error, det = _orthonormality_error(R)
    return error <= _ROTATION_TOLERANCE and det >= 0.0


def check_limits(value: object, field: str, length: int, no_limit: float) -> Array:
    """Return a read-only vector of limits.

    Args:
        value: None for no limits, or a sequence of numbers in which None stands for no limit.
        field: its path for error messages.
        length: the number of limits.
        no_limit: the value that stands for no limit in the result, ``inf`` or ``-inf``; also accepted as input.

    Raises:
        InvalidInput: not numbers, another length, NaN, or infinity of the wrong sign.
    """
    if value is None:
        return freeze(np.full(length, no_limit))
    if isinstance(value, list | tuple):
        value = [no_limit if item is None else item for item in value]
    result = _as_float_array(value, field, (length,))
    for i in np.flatnonzero(~(np.isfinite(result) | (result == no_limit))):
        raise InvalidInput(f"{field}[{i}]", float(result[i]), "a finite number, or null for no limit")
    result.setflags(write=False)
    return result


def check_number(
    value: object, field: str, *, minimum: float | None = None, above: float | None = None, maximum: float | None = None
) -> float:
    """Return a finite number as a float.

    Args:
        value: the value to check; a boolean is not a number.
        field: its path for error messages.
        minimum: smallest allowed value, if any.
        above: the value that it must exceed, if any.
        maximum: largest allowed value, if any.

    Raises:
        InvalidInput: not a finite number, or outside the range.
    """
    result = _as_finite_float(value)
    if result is None:
        raise InvalidInput(field, value, ", ".join(["a finite number", *_bounds(minimum, above, maximum)]))
    is_low = (minimum is not None and result < minimum) or (above is not None and result <= above)
    if is_low or (maximum is not None and result > maximum):
        raise InvalidInput(field, value, " and ".join(_bounds(minimum, above, maximum)))
    return result


def _bounds(minimum: float | None, above: float | None, maximum: float | None) -> list[str]:
    """Return the words for the bounds of a number."""
    words = (("at least", minimum), ("greater than", above), ("at most", maximum))
    return [f"{word} {bound:g}" for word, bound in words if bound is not None]


def _invalid_number(array: Array, field: str, is_invalid: npt.NDArray[np.bool_], allowed: str) -> InvalidInput:
    """Return the error for the first invalid number of an array."""
    where = tuple(int(i) for i in np.argwhere(is_invalid)[0])
    return InvalidInput(field + "".join(f"[{i}]" for i in where), float(array[where]), allowed)


def _as_finite_float(value: object) -> float | None:
    """Return a number as a float, or None if it is not a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return None
    try:
        result = float(value)
    except OverflowError:  # an int beyond the largest float
        return None
    return result if math.isfinite(result) else None


def _orthonormality_error(R: Sequence[float]) -> tuple[float, float]:
    """Return max |RᵀR − 1| and det R of nine numbers, row by row.

    Scalar arithmetic: the control loop checks several poses a period, and NumPy's overhead dominates for 3 × 3 matrices.
    """
    xx, yx, zx, xy, yy, zy, xz, yz, zz = R
    error = max(
        abs(xx * xx + xy * xy + xz * xz - 1.0),
        abs(yx * yx + yy * yy + yz * yz - 1.0),
        abs(zx * zx + zy * zy + zz * zz - 1.0),
        abs(xx * yx + xy * yy + xz * yz),
        abs(yx * zx + yy * zy + yz * zz),
        abs(zx * xx + zy * xy + zz * xz),
    )
    det = xx * (yy * zz - yz * zy) - yx * (xy * zz - xz * zy) + zx * (xy * yz - xz * yy)
    return error, det


def _as_float_array(value: object, field: str, shape: tuple[int | None, ...]) -> Array:
    """Return a writable float64 copy of an array of numbers of the given shape."""
    if type(value) is np.ndarray and value.dtype == np.float64 and value.shape == shape:
        return np.array(value, order="C")
    try:
        raw = np.asarray(value)
    except (ValueError, TypeError, OverflowError):  # ragged lists
        raise InvalidInput(field, value, _describe_shape(shape)) from None
    if raw.size == 0 and raw.ndim == len(shape):
        raw = raw.astype(np.float64)
    if raw.dtype.kind not in "iuf" or _contains_boolean(value):
        raise InvalidInput(field, value, _describe_shape(shape))
    if raw.ndim != len(shape) or any(n is not None and n != got for n, got in zip(shape, raw.shape, strict=True)):
        got = " × ".join(map(str, raw.shape)) or "a single number"
        raise InvalidInput(field, value, f"{_describe_shape(shape)}, not {got}")
    return np.array(raw, dtype=np.float64, order="C")


def _contains_boolean(value: object) -> bool:
    """Return whether a nested list contains a boolean, which NumPy would read as 0 or 1."""
    if isinstance(value, list | tuple):
        return any(_contains_boolean(item) for item in value)
    return isinstance(value, bool | np.bool_)


def _describe_shape(shape: tuple[int | None, ...]) -> str:
    """Return the words for an array of a shape, such as "a list of 3 numbers"."""
    if len(shape) == 1:
        return "a list of numbers" if shape[0] is None else f"a list of {shape[0]} numbers"
    return f"an array of {' × '.join('n' if n is None else str(n) for n in shape)} numbers"

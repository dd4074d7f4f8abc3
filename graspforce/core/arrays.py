"""Shape, finiteness and range checks. Each returns what it checked: a float, or a read-only float64 array."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.core.errors import InvalidInput

Array = npt.NDArray[np.float64]

_FALSE_BYTE = b"\0"  # as NumPy stores it
_ROTATION_TOLERANCE = 1e-6  # largest |RᵀR − 1| of a rotation matrix: written by hand to six digits


def freeze(array: npt.ArrayLike) -> Array:
    """A float64 copy of ``array`` that cannot be written to."""
    result = np.array(array, dtype=np.float64, order="C")
    result.setflags(write=False)
    return result


def check_array(value: Any, field: str, shape: tuple[int | None, ...]) -> Array:
    """A finite array of the given shape; ``None`` in the shape stands for any length.

    Raises:
        InvalidInput: not numbers (text and booleans are not), another shape, or NaN or infinity inside.
    """
    result = _as_float_array(value, field, shape)
    finite = np.isfinite(result)
    if _FALSE_BYTE in finite.tobytes():  # a fifth of the time of finite.all()
        where = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise InvalidInput(field + "".join(f"[{i}]" for i in where), float(result[where]), "a finite number")
    result.setflags(write=False)
    return result


def check_rotation(value: Any, field: str) -> Array:
    """A rotation matrix that is one to within rounding.

    Raises:
        InvalidInput: not nine finite numbers, columns that are not orthonormal, or a mirror.
    """
    R = check_array(value, field, (3, 3))
    off, det = _orthonormality_error(R.ravel().tolist())
    if off > _ROTATION_TOLERANCE or det < 0.0:
        raise InvalidInput(field, value, f"a rotation: RᵀR = 1 (it is off by {off:.1g}) and det R = +1")
    return R


def check_rotations(value: Any, field: str, count: int) -> Array:
    """Return (count, 3, 3) rotation matrices, each within rounding.

    Raises:
        InvalidInput: another shape, a number that is not finite, or a matrix that is not a rotation; names which one.
    """
    matrices = check_array(value, field, (count, 3, 3))
    for i, R in enumerate(matrices):
        check_rotation(R, f"{field}[{i}]")
    return matrices


def is_rotation(R: Sequence[float]) -> bool:
    """Whether nine finite numbers, by rows, are a rotation to within rounding."""
    off, det = _orthonormality_error(R)
    return off <= _ROTATION_TOLERANCE and det >= 0.0


def check_limits(value: Any, field: str, length: int, no_limit: float) -> Array:
    """A vector of limits in which ``None`` (and ``missing`` itself) stands for no limit.

    Args:
        value: None, or a sequence of ``length`` numbers and Nones.
        field: the path to name in an error.
        length: how many limits there must be.
        missing: what no limit is written as, ``inf`` or ``-inf``.
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


def check_number(value: Any, field: str, *, minimum: float | None = None, above: float | None = None) -> float:
    """A finite number, at least ``minimum`` and greater than ``above`` where these are given."""
    allowed = "a finite number"
    if minimum is not None:
        allowed += f" ≥ {minimum:g}"
    if above is not None:
        allowed += f" > {above:g}"
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise InvalidInput(field, value, allowed)
    try:
        result = float(value)
    except OverflowError:
        raise InvalidInput(field, value, allowed) from None
    if not np.isfinite(result) or (minimum is not None and result < minimum) or (above is not None and result <= above):
        raise InvalidInput(field, value, allowed)
    return result


def _orthonormality_error(R: Sequence[float]) -> tuple[float, float]:
    """How far RᵀR is off 1, and det R, of nine numbers by rows.

    Number by number: a controller checks several a millisecond, and NumPy takes five times as long for matrices so small.
    """
    xx, yx, zx, xy, yy, zy, xz, yz, zz = R
    off = max(
        abs(xx * xx + xy * xy + xz * xz - 1.0),
        abs(yx * yx + yy * yy + yz * yz - 1.0),
        abs(zx * zx + zy * zy + zz * zz - 1.0),
        abs(xx * yx + xy * yy + xz * yz),
        abs(yx * zx + yy * zy + yz * zz),
        abs(zx * xx + zy * xy + zz * xz),
    )
    det = xx * (yy * zz - yz * zy) - yx * (xy * zz - xz * zy) + zx * (xy * yz - xz * yy)
    return off, det


def _as_float_array(value: Any, field: str, shape: tuple[int | None, ...]) -> Array:
    """A writable float64 copy of ``value``, which must hold numbers in the given shape."""
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
    if raw.ndim != len(shape) or any(want is not None and want != got for want, got in zip(shape, raw.shape, strict=True)):
        got = " × ".join(map(str, raw.shape)) or "a single number"
        raise InvalidInput(field, value, f"{_describe_shape(shape)}, not {got}")
    return np.array(raw, dtype=np.float64, order="C")


def _contains_boolean(value: Any) -> bool:
    """Whether true or false stands among the numbers of a list, where NumPy would read 1 or 0."""
    if isinstance(value, list | tuple):
        return any(_contains_boolean(item) for item in value)
    return isinstance(value, bool | np.bool_)


def _describe_shape(shape: tuple[int | None, ...]) -> str:
    if len(shape) == 1:
        return "a list of numbers" if shape[0] is None else f"a list of {shape[0]} numbers"
    return f"an array of {' × '.join('n' if n is None else str(n) for n in shape)} numbers"

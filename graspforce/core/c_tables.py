"""Constant tables of C programs: arrays of numbers as C source. The text is the same for the same numbers on every machine."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from graspforce.core.errors import InvalidInput

_LINE = 120  # characters
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def check_identifier(name: str, field: str) -> str:
    """Return a name that C accepts.

    Args:
        name: the name.
        field: name of the argument, for errors.

    Raises:
        InvalidInput: the name is no C identifier.
    """
    if not _IDENTIFIER.fullmatch(name):
        raise InvalidInput(field, name, "letters, digits and underscores, beginning with a letter")
    return name


def c_number(value: float) -> str:
    """Return a number as a C constant that reads back exactly.

    Args:
        value: finite or infinite.
    """
    if math.isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    return repr(float(value))


def c_list(values: npt.ArrayLike | Iterable[float]) -> str:
    """Return numbers as a C initialiser in braces; integers stay integers.

    Args:
        values: array of any shape, in the order of its rows.
    """
    flat = np.asarray(values).ravel()
    is_integer = flat.dtype.kind in "iub"
    return "{" + ", ".join(str(int(value)) if is_integer else c_number(value) for value in flat) + "}"


def c_array(name: str, values: npt.ArrayLike, kind: str = "gf_real") -> str:
    """Return the definition of a constant array, in lines of at most 120 characters where its numbers allow it.

    Args:
        name: name of the array.
        values: array of any shape, in the order of its rows; an empty one becomes one zero, because C has no empty arrays.
        kind: C type of the numbers; `gf_real` of the library by default.
    """
    flat = np.asarray(values)
    numbers = c_list(flat if flat.size else np.zeros(1, dtype=flat.dtype))[1:-1].split(", ")
    lines, line = [], "   "
    for number in numbers:
        if len(line) + len(number) + 2 > _LINE:
            lines.append(line)
            line = "   "
        line += f" {number},"
    return f"static const {kind} {name}[] = {{\n" + "\n".join([*lines, line]) + "\n};\n"

"""Generated C code of solvers: the compiler, a folder for each process, and arrays as arguments."""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

_KEPT: list[Any] = []  # folders, which their objects delete at the end of the process


def find_compiler(solver: str) -> str:
    """Return the path of the C compiler.

    Args:
        solver: name of the solver that needs it.

    Raises:
        ImportError: there is none; the solver then counts as not installed.
    """
    compiler = shutil.which("cc")
    if compiler is None:
        raise ImportError(f"{solver} needs a C compiler, cc")
    return compiler


@cache
def code_folder(solver: str) -> Path:
    """Return a folder for the code of a solver in this process, deleted at its end.

    Args:
        solver: name of the solver.
    """
    folder = tempfile.TemporaryDirectory(prefix=f"graspforce-{solver}-")
    _KEPT.append(folder)
    return Path(folder.name)


def as_pointer(values: np.ndarray) -> Any:
    """Return a pointer to the numbers of an array, an argument of a C function.

    Args:
        values: contiguous numbers in double precision.
    """
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))

"""The compiled module ``graspforce.core._native`` (C sources in ``csrc/``), or None if it was not built.

Contact kinematics and control steps run in C if the module exists. Without it the reference implementations in Python run, with
equal results, which the tests compare.
"""

from __future__ import annotations

import contextlib
import importlib
from typing import Any

import numpy as np
import numpy.typing as npt

Block = npt.NDArray[np.void]  # one record of named arrays, which the C code writes

whole_step: Any = None  # the module graspforce.core._whole_step, whole control steps with their force problem
with contextlib.suppress(ImportError):
    whole_step = importlib.import_module("graspforce.core._whole_step")
native: Any = None
with contextlib.suppress(ImportError):  # built without a C compiler
    native = importlib.import_module("graspforce.core._native")


def new_block(dtype: np.dtype[np.void]) -> Block:
    """Return a writable block of zeros. It takes a fraction of the time of `np.empty`, which treats every field by itself.

    Args:
        dtype: the layout, such as `ControlStep.targets_layout`.
    """
    block: Block = np.ndarray((), dtype, bytearray(dtype.itemsize))
    return block

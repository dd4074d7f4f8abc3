"""The compiled module ``graspforce.core._native`` (C sources in ``csrc/``), or None if it was not built.

The rolling kinematics and the control laws run in C where the module exists. Without it, their Python forms run: slower,
with the same results, which the tests compare.
"""

from __future__ import annotations

import contextlib
import importlib
from typing import Any

native: Any = None
with contextlib.suppress(ImportError):  # built without a C compiler
    native = importlib.import_module("graspforce.core._native")

"""The compiled module ``graspforce.core._native`` (C sources in ``csrc/``), or None if it was not built.

Contact kinematics and control steps run in C if the module exists. Without it the reference implementations in Python run, with
equal results, which the tests compare.
"""

from __future__ import annotations

import contextlib
import importlib
from typing import Any

native: Any = None
with contextlib.suppress(ImportError):  # built without a C compiler
    native = importlib.import_module("graspforce.core._native")

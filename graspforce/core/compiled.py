"""The laws' arithmetic in C (`csrc/control/`): a step of the controller is some hundred operations on arrays of a few
numbers each.

The compiled module may be absent, where there was no compiler: each law then runs as it stands in its own Python file, which
the tests hold against the compiled one.
"""

from __future__ import annotations

import contextlib
import importlib
from typing import Any

native: Any = None
with contextlib.suppress(ImportError):  # it was not built: there was no compiler
    native = importlib.import_module("graspforce.core._native")

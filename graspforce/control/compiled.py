"""The laws' arithmetic in C (`_laws.c`): a step of the controller is some hundred operations on arrays of a few numbers each.

The compiled module may be absent, where there was no compiler: each law then runs as it stands in its own Python file, which
the tests hold against the compiled one.
"""

from __future__ import annotations

import contextlib
import importlib
from typing import Any

laws: Any = None
with contextlib.suppress(ImportError):  # it was not built: there was no compiler
    laws = importlib.import_module("graspforce.control._laws")

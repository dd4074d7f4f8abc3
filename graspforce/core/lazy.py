"""Lazy exports of a package (PEP 562): a public name imports its module at first use.

Packages whose modules import large libraries export their names this way, so that `import graspforce` stays fast.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from typing import Any

from graspforce.core.optional_libraries import optional_imports


def lazy_exports(package: str, homes: Mapping[str, str]) -> Callable[[str], object]:
    """Return a module-level `__getattr__` that imports each public name from its module at first use.

    Args:
        package: name of the package, `__name__` in its `__init__`.
        homes: for each public name, the dotted name of the module that defines it.

    The function raises `MissingLibrary` if the module needs an optional library that is not installed.
    """

    def __getattr__(name: str) -> object:
        """Return the public object of that name."""
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        with optional_imports():
            value = getattr(importlib.import_module(homes[name]), name)
        setattr(sys.modules[package], name, value)  # later look-ups do not come here
        return value

    return __getattr__


def plot_with(name: str, subject: object) -> Any:
    """Return the figure that a function of `graspforce.view` draws of a record.

    Records offer `plot()` although `view` is above them; the import happens at the call.

    Args:
        name: name of the function in `graspforce.view`.
        subject: the record.
    """
    with optional_imports():
        view = importlib.import_module("graspforce.view")
    return getattr(view, name)(subject)

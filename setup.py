"""Build the modules in C at the same time, and make an editable installation that type checkers can follow.

service/ and problems/ stand beside graspforce/ in a checkout and are installed inside it. Setuptools maps them by an import
hook, which mypy and pyright cannot read. This adds a folder of links laid out as the installed package, and a .pth to it.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

from setuptools import setup
from setuptools.command.build_ext import build_ext
from setuptools.command.editable_wheel import editable_wheel

ROOT = Path(__file__).parent.resolve()
INSTALLED_INSIDE = ("service", "problems")


def link_tree() -> Path:
    """Return a folder whose `graspforce` is laid out as the installed package, every entry a link into the checkout."""
    tree = ROOT / "build" / "editable"
    shutil.rmtree(tree, ignore_errors=True)
    package = tree / "graspforce"
    package.mkdir(parents=True)
    for entry in (*(ROOT / "graspforce").iterdir(), *(ROOT / name for name in INSTALLED_INSIDE)):
        if entry.name != "__pycache__":
            (package / entry.name).symlink_to(entry, target_is_directory=entry.is_dir())
    return tree


class BuildModules(build_ext):
    """Setuptools' build of extension modules, with a compiler for each processor."""

    def finalize_options(self) -> None:
        """Set the options that are not given."""
        super().finalize_options()
        self.parallel = self.parallel or os.cpu_count()


class EditableWheel(editable_wheel):
    """Setuptools' editable wheel with one more .pth file."""

    def _select_strategy(self, *arguments: Any, **keywords: Any) -> Any:
        strategy = super()._select_strategy(*arguments, **keywords)
        write = type(strategy).__call__

        def with_links(self: Any, wheel: Any, *rest: Any) -> None:
            write(self, wheel, *rest)
            try:
                wheel.writestr("graspforce_checkout.pth", f"{link_tree()}\n")
            except OSError:
                return  # no links on this file system: the package works, type checkers do not see it

        strategy.__class__ = type("WithLinks", (type(strategy),), {"__call__": with_links})
        return strategy


setup(cmdclass={"build_ext": BuildModules, "editable_wheel": EditableWheel})

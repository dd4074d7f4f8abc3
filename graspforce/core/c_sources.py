"""Places of the C headers and the CMake package of the kernel, for C and C++ programs."""

from __future__ import annotations

from pathlib import Path

_SOURCES = Path(__file__).resolve().parents[1] / "csrc"


def get_include() -> str:
    """Return the folder of the C headers, for `#include "graspforce/solve.h"`."""
    return str(_SOURCES / "include")


def get_cmake_dir() -> str:
    """Return the folder of the CMake package, for `find_package(graspforce)` with `-Dgraspforce_DIR=...`.

    The package builds the C library from its sources as a part of the calling project.
    """
    return str(_SOURCES / "cmake")

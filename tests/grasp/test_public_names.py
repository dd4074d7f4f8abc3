"""Public names of graspforce.hand and graspforce.grasp, and the libraries that importing them loads."""

from __future__ import annotations

import subprocess
import sys

import pytest

import graspforce.grasp
import graspforce.hand

LARGE_LIBRARIES = ("pinocchio", "scipy", "clarabel", "casadi", "mujoco", "zenoh", "matplotlib")


def loaded_after(statement: str, *modules: str) -> list[str]:
    """Return which of the modules a new interpreter has loaded after a statement."""
    code = f"import sys\n{statement}\nprint(*[name for name in {modules!r} if name in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return run.stdout.split()


@pytest.mark.parametrize("package", [graspforce.hand, graspforce.grasp], ids=["hand", "grasp"])
def test_every_public_name_exists(package):
    for name in package.__all__:
        assert getattr(package, name) is not None
    with pytest.raises(AttributeError, match=f"module '{package.__name__}' has no attribute 'Claw'"):
        package.Claw  # noqa: B018


@pytest.mark.parametrize("statement", ["import graspforce.hand", "import graspforce.grasp"])
def test_importing_the_package_loads_no_large_library(statement):
    assert loaded_after(statement, *LARGE_LIBRARIES) == loaded_after("import graspforce", *LARGE_LIBRARIES)


def test_importing_grasp_and_body_loads_no_solver():
    statement = "from graspforce.grasp import Body, Grasp"
    assert loaded_after(statement, "graspforce.grasp.search", "scipy.optimize", "casadi", "mujoco", "zenoh") == []

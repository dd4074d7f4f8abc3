"""The public names are those that are listed, and importing the package loads only NumPy."""

from __future__ import annotations

import subprocess
import sys

import pytest

import graspforce as gf

NAMES = [
    "Actuation", "Body", "Certificate", "Cone", "Contact", "ContactModel", "ContactSet", "Explanation", "ForceProblem",
    "Grasp", "GraspForceError", "Hand", "Infeasibility", "InvalidInput", "Multipliers", "ObjectController", "Objective",
    "Quality", "Sensitivities", "Solution", "Solver", "SolverSettings", "StackedGradients", "StackedSolutions", "Status",
    "Uncertainty", "available_backends", "control", "explain", "find_grasp", "get_cmake_dir", "get_include", "load", "planning",
    "problems", "quality", "sensitivities", "service", "simulation", "solve", "solve_batch", "solve_many", "solve_stack",
    "view",
]  # fmt: skip


def modules_loaded_by(code: str) -> set[str]:
    """Third-party packages that a fresh process has loaded after some code."""
    script = f"import sys; before = set(sys.modules); {code}; print(*(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    names = {name.split(".")[0] for name in done.stdout.split()}
    return {name for name in names - set(sys.stdlib_module_names) - {"graspforce"} if not name.startswith("_")}


def test_the_public_names_are_these():
    assert gf.__all__ == NAMES
    assert set(NAMES) <= set(dir(gf))
    for name in NAMES:
        assert getattr(gf, name) is not None
    with pytest.raises(AttributeError, match="has no attribute 'Hands'"):
        gf.Hands  # noqa: B018  # the look-up is what is tested


def test_a_lazy_name_is_looked_up_once():
    assert gf.solve is vars(gf)["solve"]


def test_importing_the_package_loads_numpy_at_most():
    assert modules_loaded_by("import graspforce") <= {"numpy"}


def test_solving_loads_neither_hands_nor_network_nor_plots():
    code = "import graspforce as gf; gf.solve(gf.problems.load('ring/3-force').problem)"
    assert not modules_loaded_by(code) & {"pinocchio", "zenoh", "casadi", "matplotlib", "mujoco"}

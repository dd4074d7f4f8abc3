"""The public names are those that are listed, and the README's Python runs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import graspforce as gf

ROOT = Path(__file__).parents[2]
NAMES = [
    "Actuation", "Certificate", "Cone", "Contact", "ContactModel", "ContactSet", "ForceProblem", "GraspForceError", "Hand",
    "Infeasibility", "InvalidInput", "Multipliers", "Objective", "Solution", "Solver", "StackedSolutions", "Status",
    "available_backends", "control",
    "load", "problems", "service", "solve", "solve_batch", "solve_stack",
]  # fmt: skip


def test_the_public_names_are_these():
    assert gf.__all__ == NAMES
    for name in NAMES:
        assert getattr(gf, name) is not None
    with pytest.raises(AttributeError, match="has no attribute 'Hands'"):
        gf.Hands  # noqa: B018  # the look-up is what is tested


def test_solving_needs_neither_pinocchio_nor_zenoh():
    code = "import graspforce, sys; print([m for m in ('pinocchio', 'zenoh', 'casadi', 'matplotlib') if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def test_the_examples_of_the_readme_run_in_their_order(capsys):
    """Those that need no server, one after another as a reader would type them."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.S)
    here: dict[str, object] = {}
    for block in blocks:
        if "zenoh" in block or "Client" in block:
            continue
        exec(compile(block, "README.md", "exec"), here)
    said = capsys.readouterr().out
    assert gf.Status.OPTIMAL.sentence in said
    assert "30 is wanted and at most 20 can be supplied" in said
    assert "1.5000" in said
    assert "verified=True" in said

"""Completion in shells: the scripts, and the words that they offer."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from graspforce import problems
from graspforce.hand.descriptions.description import shipped_hands

SHELLS = ("bash", "zsh", "fish")


def ask(**environment: str) -> str:
    """Return what the command prints for a request of a shell."""
    run = subprocess.run(
        [sys.executable, "-c", "from graspforce.cli import main; main([])"],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in run.stderr, run.stderr
    return run.stdout


def offered(words: str) -> set[str]:
    """Return the words that bash gets for the last word of a line."""
    count = len(words.split(" ")) - 1
    return set(ask(_GRASPFORCE_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(count)).split("\n")) - {""}


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts_are_valid(shell: str) -> None:
    """Each names the variable by which it asks the command. Shells that are installed parse it."""
    script = ask(_GRASPFORCE_COMPLETE=f"source_{shell}")
    assert "_GRASPFORCE_COMPLETE" in script
    if shutil.which(shell):
        assert subprocess.run([shell, "-n"], input=script, text=True, check=False).returncode == 0


def test_commands_options_and_names_are_offered() -> None:
    assert {"simulate", "solve", "serve"} <= offered("graspforce s")
    assert "--duration" in offered("graspforce simulate --dur")
    assert offered("graspforce simulate --hand all") == {name for name in shipped_hands() if name.startswith("all")}
    assert "sphere:" in offered("graspforce plan --object sp")
    assert "clarabel" in offered("graspforce solve --backend cl")
    assert offered("graspforce hands show dlr") == {"dlr_hit2"}
    case = problems.names()[0]
    assert case in offered(f"graspforce problems show {case[:-1]}")
    assert offered("graspforce bench --collection soft") == {"soft"}

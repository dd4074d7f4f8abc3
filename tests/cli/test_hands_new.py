"""``graspforce hands new``: from a URDF to a hand that loads, in words."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.hands import load

from graspforce.cli import main
from graspforce.hand.hand import Hand


def test_new_writes_a_description_and_names_what_to_fill_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "own.json"
    assert main(["hands", "new", str(load("dlr_hit2").urdf_path), "-o", str(target)]) == 0
    out = capsys.readouterr().out
    for part in ("Written:", "motors[0].rotor_inertia", "hands lint", "simulate --hand", "is not filled in"):
        assert part in out
    record = json.loads(target.read_text())
    for motor in record["motors"]:
        assert motor["rotor_inertia"] is None
        assert "FILL IN" in motor["source"]
        motor["rotor_inertia"] = 1e-7
    target.write_text(json.dumps(record))
    assert len(Hand.load(target).fingers) == 5


def test_reports_off_a_terminal_have_no_padding(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Lines end with their text: other programs read them, and a line may be as long as its text."""
    target = str(tmp_path / "own.json")
    for arguments in (("new", str(load("dlr_hit2").urdf_path), "-o", target), ("lint", target)):
        main(["hands", *arguments])
        lines = capsys.readouterr().out.splitlines()
        assert any(line.startswith("    Remedy: ") for line in lines)
        assert all(line == line.rstrip() for line in lines)


def test_new_says_in_words_why_it_cannot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = str(load("four_finger").urdf_path)
    (tmp_path / "own.json").write_text("{}")
    for arguments, words in (
        (("hands", "new", source, "-o", str(tmp_path / "own.json")), "--force"),
        (("hands", "new", source, "-o", str(tmp_path / "new.json"), "--base", "elbow"), "elbow"),
        (("hands", "new", str(tmp_path / "none.urdf")), "none.urdf"),
        (("hands", "show", str(tmp_path / "own.json")), "own.json"),
    ):
        assert main(arguments) == 1
        err = capsys.readouterr().err
        assert words in err.replace("\n", "")
        assert "Traceback" not in err

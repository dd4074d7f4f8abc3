"""Odd inputs end with one line on standard error and exit code 1, 2 or 3, never with a traceback."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from graspforce.cli import main

VALID = {
    "schema": "graspforce/problem/1",
    "contacts": [{"position": [0, -0.03, 0], "normal": [0, 1, 0], "friction": 0.5}],
    "wrench": [0, 0, 1, 0, 0, 0],
}


def changed(**fields: object) -> bytes:
    """Return a problem file with some fields replaced."""
    return json.dumps({**VALID, **fields}).encode()


def contact(**fields: object) -> bytes:
    """Return a problem file with some fields of its contact replaced."""
    return changed(contacts=[{"position": [0, -0.03, 0], "normal": [0, 1, 0], "friction": 0.5, **fields}])


CONTENTS = {
    "empty": b"",
    "blank": b" \n\t\n",
    "binary": bytes(range(256)) * 8,
    "utf16": '{"schema": 1}'.encode("utf-16"),
    "byte order mark": b"\xef\xbb\xbf" + json.dumps(VALID).encode(),
    "cut": json.dumps(VALID).encode()[:-20],
    "deep list": b"[" * 50_000,
    "deep record": b'{"a":' * 2_000,
    "list": b"[1, 2, 3]",
    "null": b"null",
    "text": b'"graspforce/problem/1"',
    "number": b"1e400",
    "xml": b"<?xml version='1.0'?><robot name='x'/>",
    "python": b"{'schema': 1}",
    "repeated key": b'{"schema": "graspforce/problem/1", "schema": 7}',
    "comment": b"// problem\n{}",
    "wrong schema": changed(schema="graspforce/problem/99"),
    "schema null": changed(schema=None),
    "no contacts": changed(contacts=[]),
    "contacts text": changed(contacts="two"),
    "contacts record": changed(contacts={}),
    "contact null": changed(contacts=[None]),
    "wrench short": changed(wrench=[0, 0, 1]),
    "wrench nested": changed(wrench=[[0, 0, 1, 0, 0, 0]]),
    "wrench text": changed(wrench="up"),
    "wrench NaN": changed(wrench=[float("nan")] * 6),
    "wrench infinite": changed(wrench=[float("inf"), 0, 0, 0, 0, 0]),
    "wrench boolean": changed(wrench=[True, False, 0, 0, 0, 0]),
    "unknown field": changed(frictoin=0.5),
    "control characters": changed(**{"\x1b[31mred": 1}),
    "cone": changed(cone={"type": "round"}),
    "objective": changed(objective={"type": "beauty"}),
    "hand": changed(hand={"J": [[1]]}),
    "hand text": changed(hand="allegro"),
    "friction negative": contact(friction=-0.5),
    "friction text": contact(friction="rubber"),
    "friction null": contact(friction=None),
    "normal zero": contact(normal=[0, 0, 0]),
    "normal short": contact(normal=[0, 1]),
    "position huge": contact(position=[1e308, 1e308, 1e308], normal=[float("nan")] * 3),
    "model": contact(model="sticky"),
    "contact unknown field": contact(colour="red"),
    "integer beyond floats": changed(wrench=[10**400, 0, 0, 0, 0, 0]),
}
COMMANDS = [
    [],
    ["sovle"],
    ["solve"],
    ["solve", "--cone", "inner"],
    ["solve", "missing.json"],
    ["solve", "."],
    ["solve", "a\x00b.json"],
    ["solve", "x" * 5000],
    ["solve", "problem.json", "--cone", "inner:2"],
    ["solve", "problem.json", "--cone", "inner:many"],
    ["solve", "problem.json", "--backend", "magic"],
    ["solve", "problem.json", "more.json"],
    ["quality", "problem.json", "--direction", "1,2,3"],
    ["quality", "problem.json", "--direction", "up"],
    ["quality", "problem.json", "--budget", "soon"],
    ["explain", "problem.json", "--direction", "0,0,0,0,0,0"],
    ["problems", "show", "ring"],
    ["problems", "show", "ring/3-force/more"],
    ["problems", "show", "../../etc/passwd"],
    ["problems", "--dir", "missing"],
    ["bench", "--solver", "magic", "--max-cases", "1"],
    ["bench", "--collection", "magic"],
    ["bench", "--settings", "best"],
    ["bench", "--time-limit", "-1", "--collection", "ring"],
    ["hands", "show", "octopus"],
    ["hands", "lint", "octopus"],
    ["hands", "lint", "problem.json"],
    ["hands", "new", "missing.urdf"],
    ["hands", "codegen", "octopus", "--out", "code"],
    ["hands", "reach", "four_finger", "--samples", "-1"],
    ["hands", "identify", "missing.csv"],
    ["grasp", "--hand", "octopus"],
    ["grasp", "--hand", "four_finger", "--object", "sphere"],
    ["grasp", "--hand", "four_finger", "--object", "sphere:-1"],
    ["grasp", "--hand", "four_finger", "--object", "mesh:missing.stl"],
    ["grasp", "--hand", "four_finger", "--fingers", "toe"],
    ["grasp", "--hand", "four_finger", "--class", "magic"],
    ["plan", "--hand", "four_finger"],
    ["plan", "--hand", "four_finger", "--to", "0,0"],
    ["plan", "--hand", "four_finger", "--to", "0,0,0.01", "--method", "magic"],
    ["simulate", "--hand", "four_finger", "--duration", "-1"],
    ["simulate", "--hand", "four_finger", "--noise", "encoder"],
    ["simulate", "--hand", "four_finger", "--push", "1,2,3"],
    ["simulate", "--hand", "four_finger", "--world", "imaginary"],
    ["cycle", "--hand", "four_finger", "--pose-error", "big"],
    ["regrasp", "--hand", "four_finger", "--axis", "0,0,0"],
    ["replay", "missing.mcap"],
    ["replay", "problem.json"],
    ["serve", "--record", "problem.json"],
    ["watch", "problem.json"],
    ["watch", "problem.json", "--window", "-1"],
    ["view", "missing.npz"],
    ["view", "problem.json"],
    ["serve", "--limit", "streams"],
    ["serve", "--listen", "nowhere"],
    ["serve", "--config", "problem.json", "--hand", "octopus"],
    ["ask", "status", "missing.json"],
    ["top", "--secure", "missing", "--once"],
    ["secure", "add", "missing", "arm", "--role", "king"],
    ["glove", "calibrate", "missing.csv"],
    ["quality", "problem.json", "--budget", "nan"],
    ["bench", "--time-limit", "nan", "--collection", "ring"],
    ["grasp", "--hand", "four_finger", "--object", "mesh:empty.stl"],
    ["cycle", "--hand", "four_finger", "--standoff", "-1"],
    ["simulate", "--hand", "four_finger", "--plots", "problem.json"],
    ["simulate", "--hand", "four_finger", "--connect", "nowhere"],
    ["serve", "--config", "empty.stl"],
    ["serve", "--grasp", "problem.json"],
    ["serve", "--ros2-setting", "rate=500"],
    ["serve", "--record", "problem.json/x.mcap"],
    ["learn", "synergies", "words.csv"],
    ["hands", "identify", "four_finger", "words.csv"],
    ["glove", "calibrate", "words.csv", "words.csv"],
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Enter and return a working directory with one valid problem file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "problem.json").write_bytes(json.dumps(VALID).encode())
    (tmp_path / "empty.stl").write_text("solid x\nendsolid x\n")
    (tmp_path / "words.csv").write_text("t,q_0\n0,1\n\n1,word\n")
    return tmp_path


def test_errors_of_tables_name_file_line_and_column(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["learn", "synergies", "words.csv"]) == 1
    assert capsys.readouterr().err == "Error: words.csv: line 4, column q_0 = 'word': must be a number\n"


def test_errors_of_options_name_the_option(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command, start in (
        (["quality", "problem.json", "--budget", "-5"], "--budget = -5.0: "),
        (["bench", "--time-limit", "0", "--collection", "ring"], "--time-limit = 0.0: "),
        (["cycle", "--hand", "four_finger", "--touch-force", "-1"], "--touch-force = -1.0: "),
        (["simulate", "--plots", "problem.json"], "--plots = 'problem.json': must be in a directory; "),
    ):
        assert main(command) == 1
        assert capsys.readouterr().err.startswith(f"Error: {start}")


def check_one_line(code: int, err: str) -> None:
    assert code in (1, 2, 3)
    lines = err.splitlines()
    assert lines, "no message"
    assert lines[-1].startswith("Error: ")
    assert len(lines) == 1
    assert not any(ord(character) < 32 for character in lines[0])


@pytest.mark.parametrize("content", CONTENTS.values(), ids=CONTENTS)
@pytest.mark.parametrize("command", ["solve", "hands lint"])
def test_odd_files(folder: Path, capsys: pytest.CaptureFixture[str], command: str, content: bytes) -> None:
    (folder / "odd.json").write_bytes(content)
    code = main([*command.split(), "odd.json"])
    captured = capsys.readouterr()
    if content.startswith(b"\xef\xbb\xbf") and command == "solve":  # Python's reader of JSON accepts a byte order mark
        assert code == 3
        assert "Infeasible" in captured.out
        return
    check_one_line(code, captured.err)
    assert "odd.json" in captured.err


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: " ".join(command)[:60].replace("\x00", "NUL"))
def test_odd_command_lines(folder: Path, capsys: pytest.CaptureFixture[str], command: list[str]) -> None:
    code = main(command)
    captured = capsys.readouterr()
    if not command:
        assert code == 0
        assert "Usage" in captured.out
        return
    check_one_line(code, captured.err)

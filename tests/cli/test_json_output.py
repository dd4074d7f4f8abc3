"""Every command prints its result as JSON with --json, and nothing else on standard output."""

from __future__ import annotations

import json

import pytest
import typer
from support.servers import ANY_LOCAL_PORT

from graspforce import problems
from graspforce.cli import app, main
from graspforce.cli.console import ERROR, INFEASIBLE, SUCCESS
from graspforce.service import Server

NOT_A_RESULT = {"problems show", "hands schema", "ask"}  # these print JSON without the option
SHORT = ["--duration", "0.02"]


def commands():
    """Return every command of the command line with its Click command."""

    def walk(group, path):
        for name, command in group.commands.items():
            if hasattr(command, "commands"):
                if command.params:
                    yield " ".join([*path, name]), command
                yield from walk(command, [*path, name])
            else:
                yield " ".join([*path, name]), command

    return dict(walk(typer.main.get_command(app), []))


def test_every_command_has_the_option():
    for name, command in commands().items():
        if name not in NOT_A_RESULT:
            assert any("--json" in parameter.opts for parameter in command.params), name


CASES = [
    (["solve", "{problem}"], "objective", SUCCESS),
    (["explain", "{problem}"], "sentences", SUCCESS),
    (["quality", "{problem}"], "force_closed", SUCCESS),
    (["solve", "{infeasible}"], "infeasibility", INFEASIBLE),
    (["backends"], "backends", SUCCESS),
    (["problems"], "collections", SUCCESS),
    (["problems", "list", "opposed"], "cases", SUCCESS),
    (["problems", "verify", "opposed"], "collections", SUCCESS),
    (["bench", "--collection", "opposed", "--solver", "clarabel", "--max-cases", "2"], "outcomes", SUCCESS),
    (["hands"], "hands", SUCCESS),
    (["hands", "show", "four_finger"], "joints", SUCCESS),
    (["hands", "lint", "four_finger", "--samples", "0"], "findings", SUCCESS),
    (["hands", "reach", "four_finger", "--samples", "20"], "fingers", SUCCESS),
    (["hands", "codegen", "four_finger", "--out", "{folder}/code"], "files", SUCCESS),
    (["grasp", "--hand", "four_finger"], "grasps", SUCCESS),
    (["simulate", *SHORT], "metrics", SUCCESS),
    (["simulate", "--joint-friction", "0.05", *SHORT], "outcome", SUCCESS),
    (["simulate", "--free", *SHORT], "responses", ERROR),
    (["simulate", "--campaign", "1", "--compare", "never", *SHORT], "trials", None),
    (["plan", "--hand", "four_finger", "--to=0,0,0.002", "--intervals", "20"], "duration", SUCCESS),
    (["plan", "--hand", "four_finger", "--to=0,0.03,0.3"], "reason", INFEASIBLE),
    (["demo", "--steps", "5", "--plot", "{folder}/carry.png"], "certified_fraction", SUCCESS),
    (["secure", "init", "{folder}/keys"], "directory", SUCCESS),
]


@pytest.mark.parametrize(
    ("arguments", "field", "code"), CASES, ids=lambda value: "_".join(value) if isinstance(value, list) else ""
)
def test_results_are_one_record(arguments, field, code, tmp_path, capsys):
    for name, case in (("problem", "ring/3-force"), ("infeasible", "opposed/point-moment")):
        (tmp_path / f"{name}.json").write_text(problems.text(case))
    names = {"problem": tmp_path / "problem.json", "infeasible": tmp_path / "infeasible.json", "folder": tmp_path}
    ended = main([*(word.format(**names) for word in arguments), "--json"])
    record = json.loads(capsys.readouterr().out)
    assert field in record
    if code is not None:
        assert ended == code


def test_readings_of_a_server_are_one_record(capsys):
    with Server(listen=ANY_LOCAL_PORT) as server:
        for command in (["top", "--json"], ["ask", "status"]):
            assert main([*command, "--connect", server.addresses[0]]) == SUCCESS
            assert json.loads(capsys.readouterr().out)["server"] == server.id


def test_help_lists_the_exit_codes(capsys):
    assert main(["--help"]) == SUCCESS
    assert "2 wrong command line, 3 proven infeasible" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["simulate", *SHORT], "--save"),
        (["simulate", *SHORT], "--record"),
        (["simulate", "--free", *SHORT], "--save"),
        (["grasp", "--hand", "four_finger"], "--save"),
        (["plan", "--hand", "four_finger", "--to=0,0,0.002", "--intervals", "20"], "--save"),
        (["solve", "{problem}"], "--proof"),
        (["quality", "{problem}"], "--plot"),
        (["explain", "{problem}"], "--plot"),
        (["cycle"], "--video"),
        (["regrasp"], "--video"),
    ],
)
def test_existing_files_are_replaced_only_with_force(arguments, option, tmp_path, capsys):
    (tmp_path / "problem.json").write_text(problems.text("ring/3-force"))
    suffix = (
        "png"
        if option == "--plot"
        else "json"
        if arguments[0] in ("plan", "grasp")
        else "npz"
        if option == "--save"
        else "mcap"
    )
    file = tmp_path / f"out.{suffix}"
    file.write_text("mine")
    words = [word.format(problem=tmp_path / "problem.json") for word in arguments]
    assert main([*words, option, str(file)]) == ERROR
    assert "--force" in capsys.readouterr().err
    assert file.read_text() == "mine"
    if arguments[0] not in ("cycle", "regrasp"):  # long runs
        main([*words, option, str(file), "--force"])
        assert file.read_bytes() != b"mine"

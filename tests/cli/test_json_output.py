"""Every command prints its result as JSON with --json, and nothing else on standard output."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.hands import load
from support.servers import ANY_LOCAL_PORT
from support.simulated_runs import start_of

from graspforce import ObjectController, problems
from graspforce.cli import app, main
from graspforce.cli.console import ERROR, INFEASIBLE, SUCCESS
from graspforce.service import Server
from graspforce.simulation import Plant, build_scene, constant_reference, simulate

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
    (["problems", "export", "{folder}/package", "--collection", "opposed"], "folder", SUCCESS),
    (["hands", "new", "{urdf}", "-o", "{folder}/own.json"], "file", SUCCESS),
    (["secure", "init", "{folder}/keys"], "directory", SUCCESS),
]


@pytest.mark.parametrize(
    ("arguments", "field", "code"), CASES, ids=lambda value: "_".join(value) if isinstance(value, list) else ""
)
def test_results_are_one_record(arguments, field, code, tmp_path, capsys):
    for name, case in (("problem", "ring/3-force"), ("infeasible", "opposed/point-moment")):
        (tmp_path / f"{name}.json").write_text(problems.text(case))
    names = {"problem": tmp_path / "problem.json", "infeasible": tmp_path / "infeasible.json", "folder": tmp_path}
    names["urdf"] = load("dlr_hit2").urdf_path
    ended = main([*(word.format(**names) for word in arguments), "--json"])
    record = json.loads(capsys.readouterr().out)
    assert field in record
    if code is not None:
        assert ended == code


def test_changes_of_certificates_are_one_record(tmp_path, capsys):
    folder = str(tmp_path / "keys")
    assert main(["secure", "init", folder]) == SUCCESS
    capsys.readouterr()
    for command in (["add", folder, "arm"], ["renew", folder], ["rotate", folder]):
        assert main(["secure", *command, "--json"]) == SUCCESS
        assert json.loads(capsys.readouterr().out), command


@pytest.fixture
def interruptible():
    """Let child processes react to Ctrl-C also where a shell's background job ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_addresses_of_a_server_and_a_view_are_one_record(tmp_path):
    """Both run until a signal; the record is complete as soon as they serve."""
    grasp = three_finger_grasp()
    motion = constant_reference(start_of(grasp))
    simulate(Plant(build_scene(grasp, gravity_H=PALM_UP)), ObjectController(grasp), motion, 0.02).save(tmp_path / "run.npz")
    for command, field in ((["serve", "--listen", ANY_LOCAL_PORT], "addresses"), (["view", str(tmp_path / "run.npz")], "url")):
        words = [sys.executable, "-u", "-m", "graspforce", *command, "--json"]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
            try:
                text = ""
                while not text.rstrip().endswith("}"):
                    line = process.stdout.readline()
                    assert line, (command, text)
                    text += line
                process.send_signal(signal.SIGINT)
                assert process.wait(60.0) == SUCCESS, command
            finally:
                process.kill()
        assert field in json.loads(text)


ELSEWHERE = {
    "cycle": "cli/test_run_cycle.py",
    "glove calibrate": "cli/test_glove.py",
    "glove postures": "cli/test_glove.py",
    "glove stream": "cli/test_glove.py",
    "hands identify": "cli/test_commands.py",
    "learn collect": "cli/test_learn.py",
    "learn label": "cli/test_learn.py",
    "learn similar": "cli/test_learn.py",
    "learn synergies": "cli/test_learn.py",
    "regrasp": "cli/test_run_regrasp.py",
    "replay": "service/test_recording.py",
    "watch": "service/test_watch.py",
}  # files of tests that parse the output of a command
HERE = {"top", "serve", "view", "secure add", "secure renew", "secure rotate"}  # tests above without `CASES`


def test_the_output_of_every_command_is_parsed():
    tested = {name for name in commands() for arguments, *_ in CASES if arguments[: len(name.split())] == name.split()}
    for name, file in ELSEWHERE.items():
        text = (Path(__file__).parents[1] / file).read_text()
        assert '"--json"' in text, file
        assert "json.loads" in text, file
        assert name.split()[-1] in text, file
    assert set(commands()) - NOT_A_RESULT == tested | HERE | set(ELSEWHERE)


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

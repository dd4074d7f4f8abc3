"""The command line: what it prints, where, and with which exit code. In the words of the Python exceptions."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.friction_recordings import friction_recording

import graspforce as gf
from graspforce import problems, service
from graspforce.cli import main
from graspforce.hand.descriptions.description import shipped_hands
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.hand.hand import Hand
from graspforce.hand.lint.findings import Finding
from graspforce.problems import Case, ExpectedOptimum

WIDTHS = ("80", "120")


@pytest.fixture(autouse=True)
def plain_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Output as on a terminal of 80 columns without colours."""
    monkeypatch.setattr("graspforce.cli.console.is_terminal", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.delenv("FORCE_COLOR", raising=False)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run the command with text on its standard input: exit code, stdout, stderr."""

    def call(*arguments: str, stdin: str = "") -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(stdin.encode())))
        code = main(arguments)
        out, err = capsys.readouterr()
        return code, out, err

    return call


def _file(tmp_path: Path, name: str, **change: Any) -> Path:
    path = tmp_path / "problem.json"
    path.write_text(json.dumps({**json.loads(problems.text(name)), **change}), encoding="utf-8")
    return path


def _without_time(record: dict[str, Any]) -> dict[str, Any]:
    return {**record, "solver": {**record["solver"], "seconds": None}}


# ── solve ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("name", "code"),
    [("ring/3-torque", 0), ("opposed/soft-moment", 0), ("nose-cone/5-inner-8", 0), ("opposed/torque-limit", 3)],
)
def test_json_output_equals_the_python_record(name: str, code: int, run: Any, tmp_path: Path) -> None:
    path = _file(tmp_path, name)
    got, out, err = run("solve", str(path), "--json")
    assert (got, err) == (code, "")
    assert _without_time(json.loads(out)) == _without_time(gf.solve(gf.load(path)).to_dict())


def test_dash_reads_standard_input(run: Any, tmp_path: Path) -> None:
    text = problems.text("ring/4-margin")
    code, out, err = run("solve", "-", "--json", stdin=text)
    _, from_file, _ = run("solve", str(_file(tmp_path, "ring/4-margin")), "--json")
    assert (code, err) == (0, "")
    assert _without_time(json.loads(out)) == _without_time(json.loads(from_file))


def test_table_shows_forces_torques_limits_certificate_and_solver(run: Any, tmp_path: Path) -> None:
    """ring/3-torque by hand: f_n = W/(nμ) = 2/3 N, f_t = 1/3 N, all friction used, tau = 0.04 m · f_n."""
    hand = {**json.loads(problems.text("ring/3-torque"))["hand"], "torque_upper": [0.03, None, 0.04]}
    code, out, _ = run("solve", str(_file(tmp_path, "ring/3-torque", hand=hand)))
    assert code == 0
    lines = [line.split() for line in out.splitlines()]
    assert ["0", "-0.333333", "0.000000", "0.666667", "0.000000", "100", "%"] in lines
    assert ["0", "0.0266667", "…", "0.03", "88.9", "%"] in lines
    assert ["1", "0.0266667", "–", "–"] in lines
    assert ["2", "0.0266667", "…", "0.04", "66.7", "%"] in lines
    assert "Wrench to supply: force (0, 0, 1) N, moment (0, 0, 0) N·m" in out
    assert re.search(r"Objective: ½‖tau‖² \+ ½·1e-05·‖f‖² = 0\.001075\d* \(N·m\)²", out)
    assert "Verified: primal residual" in out
    assert re.search(r"Solver: structured, \d+ iterations, [\d.]+ ms\.", out)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("opposed/force", "½‖f‖² = 2525 N²"),
        ("opposed/max-normal", "largest normal force = 50 N"),
        ("opposed/sum-normal", "sum of normal forces = 100 N"),
        ("opposed/margin", "common slip margin s = 1 N"),
        ("opposed/torque-weight", "½ tauᵀ W tau = 0.4"),
    ],
)
def test_objective_is_printed_with_law_and_unit(name: str, words: str, run: Any) -> None:
    def rounded(text: str) -> str:
        return re.sub(r"= ([\d.e+-]+)", lambda match: f"= {float(match[1]):.6g}", text)

    _, out, _ = run("solve", "-", stdin=problems.text(name))
    assert f"Objective: {words}\n" in rounded(out)


def test_table_shows_only_components_of_each_contact_model(run: Any) -> None:
    _, out, _ = run("solve", "-", stdin=problems.text("opposed/soft-moment"))
    assert "m_n (N·m)" in out
    _, out, _ = run("solve", "-", stdin=problems.text("fixture/table"))
    assert ["0", "–", "–", "5.71429", "–", "–"] in [line.split() for line in out.splitlines()]
    assert "m_n" not in out
    _, out, _ = run("solve", "-", stdin=problems.text("fixture/clamped"))
    assert "7 contacts without friction" in out


def test_infeasibility_is_explained_with_three_numbers(run: Any) -> None:
    """opposed/torque-limit: N = 40 N of the 50 N that the load needs; with them the motors hold 8 of the 10 N."""
    code, out, err = run("solve", "-", stdin=problems.text("opposed/torque-limit"))
    assert (code, err) == (3, "")
    assert "Infeasible: No forces satisfy every limit" in out
    text = " ".join(out.split())
    assert "10 is required and at most" in text
    assert "joints 0 (upper), 1 (upper)" in text
    assert "friction: all friction coefficients × 1.25" in text
    assert "motors: all torque limits × 1.25" in text
    assert "force (0, 0, 8) N, moment (0, 0, 0) N·m" in text
    assert "Verified: the limits contradict each other by" in text


def test_infeasibility_names_factors_that_do_not_help(run: Any) -> None:
    _, out, _ = run("solve", "-", stdin=problems.text("opposed/point-moment"))
    assert "friction: no factor on all friction coefficients found" in out
    assert "motors:" not in out
    _, out, _ = run("solve", "-", stdin=problems.text("fixture/unclamped"))
    assert "friction:" not in out


@pytest.mark.parametrize("cone", ["inner:8", "outer:8", "exact"])
def test_cone_option_overrides_the_file(cone: str, run: Any) -> None:
    """opposed/force has its load square to a facet: inner 8, outer 8 and exact are cases of their own."""
    own = "opposed/force" if cone == "exact" else f"opposed/force-{cone.replace(':', '-')}"
    start = "opposed/force-inner-4"
    _, out, _ = run("solve", "-", "--cone", cone, "--json", stdin=problems.text(start))
    assert json.loads(out)["objective"] == pytest.approx(problems.load(own).expected.objective, rel=1e-7)


def test_backend_option_is_used(run: Any) -> None:
    _, out, _ = run("solve", "-", "--backend", "quadprog", "--json", stdin=problems.text("opposed/force-inner-8"))
    assert json.loads(out)["solver"]["backend"] == "quadprog"


def _raised(call: Any) -> str:
    with pytest.raises(gf.GraspForceError) as caught:
        call()
    return str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        {"wrench": [0, 0, 1]},
        {"wrench": [0, 0, "1", 0, 0, 0]},
        {"contacts": []},
        {"contacts": [{"position": [0, 0, 0], "normal": [0, 0, 0], "friction": 0.5}]},
        {"colour": "red"},
        {"objective": {"type": "torque"}},
        {"cone": {"type": "pyramid", "facets": 2}},
        {"schema": "graspforce/problem/9"},
    ],
)
def test_bad_files_print_the_exception_text(change: dict[str, Any], run: Any, tmp_path: Path) -> None:
    path = _file(tmp_path, "opposed/force", **change)
    code, out, err = run("solve", str(path))
    assert (code, out) == (1, "")
    assert err == f"Error: {_raised(lambda: gf.load(path))}\n"


def test_bad_option_values_print_the_exception_text(run: Any, tmp_path: Path) -> None:
    path, problem = str(_file(tmp_path, "opposed/force")), problems.load("opposed/force").problem
    missing = str(tmp_path / "missing.json")
    for arguments, call in (
        (("solve", missing), lambda: gf.load(missing)),
        (("solve", path, "--backend", "simplex"), lambda: gf.solve(problem, "simplex")),
        (("solve", path, "--backend", "proxqp"), lambda: gf.solve(problem, "proxqp")),
        (("problems", "show", "ring"), lambda: problems.load("ring")),
        (("hands", "show", "claw"), lambda: Hand.load("claw")),
        (("hands", "lint", "claw"), lambda: Hand.load("claw")),
    ):
        assert run(*arguments) == (1, "", f"Error: {_raised(call)}\n")


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", "\x00", '{"schema": NaN}'])
def test_invalid_input_is_one_line_of_error(text: str, run: Any) -> None:
    code, out, err = run("solve", "-", stdin=text)
    assert (code, out) == (1, "")
    assert re.fullmatch(r"Error: .+\n", err)


@pytest.mark.parametrize(
    ("cone", "message"),
    [
        ("round", "cone = 'round': must be exact, inner:FACETS or outer:FACETS"),
        ("inner", "cone = 'inner': must be exact"),
        ("inner:x", "cone = 'inner:x': must be exact"),
        ("inner:-8", "cone = 'inner:-8': must be exact"),
        ("outer:2", "cone.facets = 2: must be an integer from 3 to 1024"),
    ],
)
def test_bad_cones_are_named_in_the_error(cone: str, message: str, run: Any) -> None:
    code, _, err = run("solve", "-", "--cone", cone, stdin=problems.text("opposed/force"))
    assert code == 1
    assert err.startswith(f"Error: {message}")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("solve",), "Missing argument 'FILE'"),
        (("solve", "a", "b"), "unexpected extra argument"),
        (("solve", "--cone"), "requires an argument"),
        (("sovle", "a"), "No such command 'sovle'"),
        (("problems", "shwo", "a"), "No such command 'shwo'"),
        (("--loud",), "No such option: --loud"),
    ],
)
def test_wrong_command_line_exits_with_2(arguments: tuple[str, ...], message: str, run: Any) -> None:
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert re.fullmatch(r"Error: .+ \(see graspforce --help\)\n", err)
    assert message in err


def _answer(status: gf.Status) -> gf.Solution:
    """Return a solution with a status that no problem produces reliably."""
    record = gf.solve(problems.load("opposed/force").problem).to_dict()
    return gf.Solution.from_dict({**record, "status": status.value})


def test_inaccurate_solution_exits_with_0_and_warns(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = _answer(gf.Status.INACCURATE)
    monkeypatch.setattr(gf, "solve", lambda problem, backend: answer)
    code, out, err = run("solve", "-", stdin=problems.text("opposed/force"))
    assert code == 0
    assert err == f"Warning: {gf.Status.INACCURATE.sentence}\n"
    assert "Inaccurate: " in out


def test_failed_solve_exits_with_1(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    record = {**_answer(gf.Status.FAILED).to_dict(), "objective": None, "certificate": None}
    answer = gf.Solution.from_dict({**record, "forces": [], "forces_object": [], "torques": [], "contacts": []})
    monkeypatch.setattr(gf, "solve", lambda problem, backend: answer)
    code, out, err = run("solve", "-", stdin=problems.text("opposed/force"))
    assert code == 1
    assert err == f"Error: {gf.Status.FAILED.sentence}\n"
    assert "Failed: " in out
    assert "f_n" not in out


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", problems.names("textbook"))
def test_reports_fit_the_terminal_width(name: str, width: str, run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", width)
    case = problems.load(name)
    _, out, _ = run("solve", "-", stdin=problems.text(name))
    lines = out.splitlines()
    assert max(map(len, lines)) <= int(width)
    if case.expected.status is gf.Status.OPTIMAL:
        head = next(i for i, line in enumerate(lines) if line.startswith("contact "))
        rows = lines[head + 1 : head + 1 + len(case.problem.contacts)]
        assert [row.split()[0] for row in rows] == [str(i) for i in range(len(rows))]
        assert lines[head + 1 + len(rows)] == ""


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", "-"),
        ("problems", "list", "textbook"),
        ("problems",),
        ("hands", "show", "dlr_hit2"),
        ("hands",),
        ("backends",),
        ("explain", "-"),
        ("quality", "-"),
        ("hands", "lint", "four_finger", "--samples", "0"),
        ("grasp", "--hand", "four_finger"),
        ("simulate", "--duration", "0.02"),
        ("plan", "--hand", "four_finger", "--to=0,0,0.002", "--intervals", "20"),
        ("hands", "reach", "four_finger", "--samples", "20"),
    ],
)
def test_output_off_a_terminal_does_not_depend_on_its_width(
    arguments: tuple[str, ...], run: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("graspforce.cli.console.is_terminal", lambda: False)
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)  # reports show the time of a solve
    texts = []
    for width in ("40", "200"):
        monkeypatch.setenv("COLUMNS", width)
        lines = run(*arguments, stdin=problems.text("soft/slender-margin-3"))[1].splitlines(keepends=True)
        texts.append("".join(line for line in lines if "planning time" not in line))
    assert texts[0] == texts[1]
    assert max(map(len, texts[0].splitlines())) > 40 or arguments[:2] == ("hands", "lint")  # one line of text
    assert "…" not in texts[0].replace(" … ", "")


# ── problems, hands, backends, serve ───────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("width", WIDTHS)
def test_problems_lists_every_case(width: str, run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", width)
    code, out, err = run("problems", "list", "textbook")
    assert (code, err) == (0, "")
    assert [line.split()[0] for line in out.splitlines()[1::2]] == list(problems.names("textbook"))
    assert max(map(len, out.splitlines())) <= int(width)
    assert "nose-cone/5-inner-8                5         force       inner 8   0.346168" in out
    assert "opposed/point-moment               2         force       exact     infeasible" in out


@pytest.mark.parametrize("width", WIDTHS)
def test_problems_names_every_collection(width: str, run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", width)
    code, out, err = run("problems")
    assert (code, err) == (0, "")
    listed = [line.split() for line in out.splitlines()[1:]]
    for collection in problems.collections():
        (line,) = (words for words in listed if words[:1] == [collection])
        assert str(len(problems.names(collection))) in line
    assert max(map(len, out.splitlines())) <= int(width)
    code, out, _ = run("problems", "list", "scaling")
    assert [line.split()[0] for line in out.splitlines()[1::2]] == list(problems.names("scaling"))
    assert max(map(len, out.splitlines())) <= int(width)


@pytest.mark.parametrize("name", ["ring/64-force", "soft/slender-margin-3"])
def test_show_prints_a_case_file(name: str, run: Any) -> None:
    assert run("problems", "show", name) == (0, problems.text(name), "")


def test_verify_counts_verified_and_failed_cases(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    code, out, _ = run("problems", "verify", "opposed", "ring")
    assert code == 0
    assert "43 of 43 cases verified" in out
    load = problems.load

    def wrong(name: str) -> Case:
        case = load(name)
        known = case.expected
        better = name == "opposed/force" and isinstance(known, ExpectedOptimum)
        return Case(case.problem, ExpectedOptimum(known.objective * 0.99, known.tolerance)) if better else case

    monkeypatch.setattr(problems, "load", wrong)
    code, out, _ = run("problems", "verify", "opposed")
    assert code == 1
    assert "opposed/force: verification failed" in out
    assert "17 of 18 cases verified" in out


def test_hands_lists_and_shows_shipped_hands(run: Any) -> None:
    code, out, err = run("hands")
    assert (code, err) == (0, "")
    assert [line.split()[0] for line in out.splitlines()] == list(shipped_hands())
    code, out, _ = run("hands", "show", "dlr_hit2")
    assert code == 0
    record = Hand.load("dlr_hit2").describe()
    for joint in record["joints"]:
        assert joint["name"] in out
    assert f"{record['couplings'][0]['follower']} follows {record['couplings'][0]['leader']}" in out
    assert f"Licence: {record['license']}" in out
    assert json.loads(run("hands", "show", "dlr_hit2", "--json")[1]) == record


def test_lint_of_a_sound_hand_prints_only_the_count(run: Any) -> None:
    assert run("hands", "lint", "four_finger", "--samples", "0") == (0, "0 errors, 0 warnings.\n", "")


def test_lint_notes_postures_with_collisions_without_an_error(run: Any) -> None:
    code, out, _ = run("hands", "lint", "four_finger", "--samples", "40")
    assert code == 0
    assert "Note" in out
    assert "of 40 random postures" in " ".join(out.split())


def test_lint_exits_with_1_on_errors(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    warning = Finding("warning", "joint a", "it is [bold]", "little", "none")
    error = Finding("error", "link b", "it weighs −1 kg", "every torque is wrong", "weigh it")
    monkeypatch.setattr("graspforce.hand.lint.lint_hand.lint_hand", lambda file: (error, error, warning))
    code, out, _ = run("hands", "lint", "x.urdf")
    assert code == 1
    assert [line.strip() for line in out.splitlines()] == [
        "Error",
        "link b: it weighs −1 kg",
        "link b: it weighs −1 kg",
        "Consequence: every torque is wrong",
        "Remedy: weigh it",
        "",
        "Warning",
        "joint a: it is [bold]",
        "Consequence: little",
        "Remedy: none",
        "",
        "2 errors, 1 warning.",
    ]
    monkeypatch.setattr("graspforce.hand.lint.lint_hand.lint_hand", lambda file: (warning,))
    assert run("hands", "lint", "x.urdf")[0] == 0


def test_identify_prints_the_friction_of_a_recording_or_a_stream(run: Any, tmp_path: Path) -> None:
    hand = Hand.load("four_finger")
    recording = friction_recording(hand, JointFriction(np.full(12, 0.06), viscous=np.full(12, 0.003)))
    np.savez(tmp_path / "motion.npz", t=recording.t, q=recording.q, tau=recording.tau)
    code, out, err = run("hands", "identify", "four_finger", str(tmp_path / "motion.npz"))
    assert (code, err) == (0, "")
    entries = json.loads(out[out.index('"friction": ') + len('"friction": ') :])
    assert [entry["joints"] for entry in entries] == [[joint.name] for joint in hand.joints]
    assert all(abs(entry["coulomb"] - 0.06) < 0.003 for entry in entries)

    names = [f"{quantity}_{i}" for quantity in ("q", "tau") for i in range(12)]
    rows = np.column_stack([recording.t, recording.q, recording.tau])
    lines = [",".join(["t", *names]), *(",".join(map(repr, row)) for row in rows.tolist())]
    code, out, _ = run("hands", "identify", "four_finger", "-", "--json", stdin="\n".join(lines))
    assert code == 0
    np.testing.assert_allclose(json.loads(out)["coulomb"], 0.06, atol=0.003)

    np.savez(tmp_path / "still.npz", t=recording.t, q=np.zeros_like(recording.q), tau=recording.tau)
    assert run("hands", "identify", "four_finger", str(tmp_path / "still.npz"))[0] == 1


def test_text_from_files_is_not_interpreted_as_markup(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    record = Hand.load("four_finger").describe()
    record["joints"][0]["name"] = "[red]:smile:[/]"
    monkeypatch.setattr(Hand, "describe", lambda self: record)
    assert "[red]:smile:[/]" in run("hands", "show", "four_finger")[1]
    text = json.dumps({**json.loads(problems.text("opposed/force")), "name": "[bold]:smile:[/nothing]"})
    assert run("solve", "-", stdin=text)[1].startswith("[bold]:smile:[/nothing]: 2 contacts")


def test_backends_lists_solvers_and_supported_cones(run: Any) -> None:
    code, out, _ = run("backends")
    assert code == 0
    rows = {line.split()[0]: line for line in out.splitlines()[1:]}
    assert tuple(rows) == gf.available_backends()
    assert rows["clarabel"].count("yes, verified") == 2
    assert re.fullmatch(r"quadprog +no +yes, verified *", rows["quadprog"])


def test_serve_passes_its_options_on(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def make_server(hands: Any, **named: Any) -> SimpleNamespace:
        asked.update(named, hands=hands)
        return SimpleNamespace(addresses=("tcp/127.0.0.1:7000", "tcp/[::1]:7000"))

    def run_server(server: Any, options: Any) -> None:
        asked.update(metrics=options.metrics, end_process=options.end_process, watch=options.watch)
        options.on_ready(server)

    monkeypatch.setattr(service, "run_server", run_server, raising=False)
    monkeypatch.setattr(service, "Server", make_server, raising=False)
    arguments = ("serve", "--hand", "four_finger", "--hand", "mine.json", "--listen", "tcp/127.0.0.1:0", "--config", "z.json5")
    options = ("--workers", "3", "--limit", "streams=8", "--limit", "idle_timeout=2.5", "--metrics", "9464")
    options += ("--connect", "tcp/127.0.0.1:7447", "--large-workers", "2", "--lease", "0.25", "--watch", "--record", "day.mcap")
    options += ("--realtime", "7")
    code, out, err = run(*arguments, *options)
    assert (code, err) == (0, "")
    assert out == (
        "Serving on tcp/127.0.0.1:7000, tcp/[::1]:7000, and at the router tcp/127.0.0.1:7447; "
        "hands: four_finger, mine.json. Ctrl-C stops.\n"
    )
    assert (asked.pop("end_process"), asked.pop("metrics"), asked.pop("solver_threads")) == (True, "9464", 3)
    assert asked.pop("limits") == service.ServerLimits(streams=8, idle_timeout=2.5)
    assert (asked.pop("insecure"), asked.pop("secure"), asked.pop("large_threads")) == (False, None, 2)
    assert (asked.pop("connect"), asked.pop("worker_processes")) == (["tcp/127.0.0.1:7447"], True)
    assert (asked.pop("lease"), asked.pop("watch")) == (0.25, ["four_finger", "mine.json"])
    assert (asked.pop("record"), asked.pop("realtime")) == (Path("day.mcap"), 7)
    assert asked == {"hands": ["four_finger", "mine.json"], "config": Path("z.json5"), "listen": "tcp/127.0.0.1:0"}
    for wrong, message in (("stream=8", "streams"), ("streams=x", "whole number"), ("streams=0", "greater than 0")):
        code, _, err = run("serve", "--limit", wrong)
        assert code == 1
        assert message in err


def test_version_and_help(run: Any) -> None:
    assert run("--version") == (0, f"graspforce {gf.__version__}\n", "")
    for arguments in ((), ("--help",), ("-h",)):
        code, out, err = run(*arguments)
        assert (code, err) == (0, "")
        assert "graspforce problems show ring/3-force | graspforce solve -" in out


@pytest.mark.parametrize(
    "command",
    [
        "solve",
        "backends",
        "problems",
        "problems list",
        "problems show",
        "problems verify",
        "bench",
        "hands",
        "hands show",
        "hands lint",
        "hands new",
        "hands schema",
        "hands identify",
        "serve",
    ],
)
def test_help_of_every_command_has_an_example(command: str, run: Any) -> None:
    code, out, _ = run(*command.split(), "--help")
    assert code == 0
    assert f"Example: graspforce {command}" in out


def test_the_installed_command_pipes_and_returns_its_code() -> None:
    """The whole way, once: interpreter, entry point, pipe, exit code; and no heavy room imported for a solve."""
    script = (
        "import sys; from graspforce.cli import main; code = main(sys.argv[1:]);"
        "assert not {'pinocchio', 'zenoh', 'matplotlib', 'casadi'} & set(sys.modules), 'heavy'; sys.exit(code)"
    )
    text = problems.text("opposed/capped").encode()
    done = subprocess.run(
        [sys.executable, "-c", script, "solve", "-"], input=text, capture_output=True, timeout=60, check=False
    )
    assert done.returncode == 3
    assert done.stderr == b""
    assert "Infeasible" in done.stdout.decode()

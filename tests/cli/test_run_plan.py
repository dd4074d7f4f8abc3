"""The command `graspforce plan`: what it says, what it leaves behind, what it refuses; and what limits a plan where."""

from __future__ import annotations

import csv
import errno
import io
import json
import os
import re
import signal
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image
from PIL import Image as PillowImage
from rich.console import Console
from support.planning_cases import FRICTION, MASS, MAX_NORMAL, A, block, straight_move
from support.servers import ANY_LOCAL_PORT
from support.tracked_moves import MOVES, find_move_grasp

from graspforce import InvalidInput
from graspforce.cli import execute_plan, main, run_plan
from graspforce.cli.console import ERROR, INFEASIBLE, SUCCESS
from graspforce.cli.options import GraspOptions
from graspforce.hand.hand import Hand
from graspforce.planning import AccelerationLimits, FingerTask, JointPath, Plan, Progress, load, plan_along, plan_fingers_along
from graspforce.planning import limit_usage as usage
from graspforce.planning.failure import UNSOLVED, PlanFailure
from graspforce.planning.limit_usage import limit_usage
from graspforce.planning.settings import PlanSettings
from graspforce.service import Server
from graspforce.simulation.rendering.film import ANIMATION_RATE
from graspforce.simulation.rendering.overlay import STRIP
from graspforce.view import plan_plots

HAND = "allegro_right"
OPTIONS = ["plan", "--hand", HAND, "--fingers", "index,ring,thumb", "--intervals", "60"]
PLAN_OPTIONS = run_plan.PlanOptions(
    grasp=GraspOptions(HAND, "sphere:0.03", None, None, "index,ring,thumb", "0,0,-9.81", 0),
    to=MOVES[HAND][0], turn=MOVES[HAND][1], method="path", intervals=60, budget=20.0, slip_margin=1.0, reserve=0.1,
)  # fmt: skip
NOTHING = run_plan.PlanOutput(save=None, plots=None, execute=False)


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the grasp search, which takes as long as the rest, by a known grasp."""
    monkeypatch.setattr("graspforce.cli.options.find_grasp", lambda *_, **__: find_move_grasp(HAND))


def options(move: tuple[tuple[float, ...], tuple[float, ...]]) -> list[str]:
    return [f"--{name}={','.join(map(str, numbers))}" for name, numbers in zip(("to", "turn"), move, strict=True)]


def test_command_plans_executes_and_writes_all_outputs(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    out = ["--save", str(tmp_path / "new" / "plan.csv"), "--plots", str(tmp_path / "plots"), "--execute"]
    assert main([*OPTIONS, *options(MOVES[HAND]), *out]) == SUCCESS
    said = capsys.readouterr().out
    for words in ("duration", "active limits", "busiest motor", "90 % of its limit", "violation between knots"):
        assert words in said
    assert "trackable with rolling contacts;" in said
    assert "Final error: 0.0" in said
    with (tmp_path / "new" / "plan.csv").open() as file:
        rows = list(csv.DictReader(file))
    first, last = ([float(row[f"p_HO {axis} [m]"]) for axis in "xyz"] for row in (rows[0], rows[-1]))
    assert np.subtract(last, first) == pytest.approx(MOVES[HAND][0], abs=1e-12)
    assert float(rows[1]["time [s]"]) == 1e-3
    for name in ("speed", "torques", "cones", "executed/error", "executed/forces", "executed/torques"):
        assert image.imread(tmp_path / "plots" / f"{name}.png").std() > 0.02


def test_film_shows_the_executed_plan_in_slow_motion(at_once, tmp_path, monkeypatch):
    """A move of a fraction of a second lasts about half a second on the screen, and the object is not where it was."""
    monkeypatch.setattr(execute_plan, "_FILM_TIME", 0.5)
    heard = io.StringIO()
    film = replace(NOTHING, execute=True, video=tmp_path / "new" / "move.gif")
    assert run_plan.run(PLAN_OPTIONS, film, Console(file=heard, width=150)) == SUCCESS
    with PillowImage.open(tmp_path / "new" / "move.gif") as pictures:
        assert pictures.n_frames == pytest.approx(0.5 * ANIMATION_RATE, abs=2.5)
        first = np.asarray(pictures.convert("RGB"), dtype=float)
        pictures.seek(pictures.n_frames - 1)
        last = np.asarray(pictures.convert("RGB"), dtype=float)
    hand = slice(int(0.25 * first.shape[0]), int((1.0 - STRIP) * first.shape[0]) - 1)  # between captions and strip
    assert np.abs(first[hand] - last[hand]).mean() > 0.1


def test_film_without_execution_is_rejected(capsys, monkeypatch):
    monkeypatch.setattr("graspforce.cli.options.find_grasp", None)
    for option in ("--video=move.mp4", "--frames=frames"):
        assert main([*OPTIONS, *options(MOVES[HAND]), option]) == 1
        assert f"{option.partition('=')[0]} = " in capsys.readouterr().err


def test_infeasible_move_exits_with_2_and_names_place_and_joint(at_once, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert main([*OPTIONS, "--to=0,0.03,0.3"]) == INFEASIBLE
    said = capsys.readouterr().out
    assert "Move infeasible: At s = 0." in said
    assert any(words in said for words in (" joint joint_", " finger ", " the contact of "))


def test_free_move_is_not_slower_and_arrives(at_once):
    """By its own table's duration, beside the straight line's with as many knots."""
    heard = io.StringIO()
    free = replace(PLAN_OPTIONS, method="free", intervals=24)
    assert run_plan.run(free, replace(NOTHING, execute=True), Console(file=heard, width=150)) == SUCCESS
    assert run_plan.run(replace(free, method="path"), NOTHING, Console(file=heard, width=150)) == SUCCESS
    durations = [float(ms) for ms in re.findall(r"duration +│ ([0-9.]+) ms", heard.getvalue())]
    assert len(durations) == 2
    assert durations[0] <= durations[1]


def test_missing_plan_without_proof_exits_with_1(at_once, monkeypatch):
    unsolved = PlanFailure(UNSOLVED, "The solver found no motion.")
    monkeypatch.setattr(run_plan.PathMove, "plan", lambda self, **_: unsolved)
    heard = io.StringIO()
    assert run_plan.run(PLAN_OPTIONS, NOTHING, Console(file=heard)) == ERROR
    assert "No plan: The solver found no motion." in heard.getvalue()


def test_exceeded_budget_exits_with_1_and_names_the_budget(at_once, capsys):
    for method in ("path", "free"):
        assert main([*OPTIONS, *options(MOVES[HAND]), "--method", method, "--budget", "0"]) == ERROR
        assert "No plan: The budget of 0 s ended before there was a first plan." in capsys.readouterr().out


def test_stopped_search_shows_the_straight_plan_as_best(at_once, monkeypatch):
    plan = run_plan.FreeMove.plan

    def until_the_first(self, *, budget, callback):
        return plan(self, budget=budget, callback=lambda now: callback(now) and now.best is None)

    monkeypatch.setattr(run_plan.FreeMove, "plan", until_the_first)
    heard = io.StringIO()
    free = replace(PLAN_OPTIONS, method="free", intervals=24)
    assert run_plan.run(free, NOTHING, Console(file=heard, width=150)) == SUCCESS
    assert "ms (best when stopped)" in heard.getvalue()


def test_service_plans_if_connected(at_once, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "150")
    monkeypatch.setattr(run_plan.PathMove, "plan", None)  # nothing is planned here
    with Server([HAND], listen=ANY_LOCAL_PORT) as server:
        asked = [*OPTIONS, *options(MOVES[HAND]), "--connect", server.addresses[0]]
        assert main(asked) == SUCCESS
        assert "trackable with rolling contacts;" in capsys.readouterr().out
        assert main([*OPTIONS, "--to=0,0.03,0.3", *asked[-2:]]) == INFEASIBLE
        assert "Move infeasible: At s = 0." in capsys.readouterr().out
    assert main(asked) == 1
    assert "no server" in capsys.readouterr().err


def test_first_ctrl_c_stops_the_search_second_ends_the_command():
    """The first is taken for the watch's answer, and what was before comes back."""

    class Interrupted:
        """A move during whose planning Ctrl-C is pressed so many times."""

        def __init__(self, times: int) -> None:
            self.times = times

        def plan(self, *, budget: float, callback) -> PlanFailure:  # type: ignore[no-untyped-def]
            now = Progress("search", 0.5, 3, 0.04, 1.0)
            assert callback(now)
            for _ in range(self.times):
                signal.raise_signal(signal.SIGINT)
                assert not callback(now)
            return PlanFailure(UNSOLVED, "")

    before = signal.getsignal(signal.SIGINT)
    console = Console(file=io.StringIO())
    assert run_plan._make_plan(Interrupted(1), 1.0, None, console).kind == UNSOLVED
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(KeyboardInterrupt):
        run_plan._make_plan(Interrupted(2), 1.0, None, console)
    assert signal.getsignal(signal.SIGINT) is before


def test_move_through_a_via_pose_passes_it_and_lasts_longer(at_once, tmp_path):
    """There and back through a pose off the line: the goal is the start, and the pose is on the way."""
    pose = tuple(0.5 * x for x in MOVES[HAND][0])
    there_and_back = replace(PLAN_OPTIONS, to=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), via=((*pose, 0.0, 0.0, 0.0),))
    file = tmp_path / "plan.json"
    assert run_plan.run(there_and_back, replace(NOTHING, save=file), Console(file=io.StringIO())) == SUCCESS
    plan = load(file)
    assert isinstance(plan, Plan)
    way = plan.at_even_times(2000).p_HO - find_move_grasp(HAND).p_HO
    assert np.linalg.norm(way[[0, -1]], axis=1) == pytest.approx([0.0, 0.0], abs=1e-9)
    assert np.linalg.norm(way - pose, axis=1).min() < 2e-5


def test_obstacle_on_the_way_is_refused_by_name(at_once):
    grasp = find_move_grasp(HAND)
    x, y, z = grasp.p_HO + np.array([0.0, 0.0, 0.036])
    move = replace(PLAN_OPTIONS, to=(0.0, 0.0, 0.004), turn=(0.0, 0.0, 0.0))
    assert run_plan.run(move, NOTHING, Console(file=io.StringIO())) == SUCCESS
    heard = io.StringIO()
    blocked = replace(move, obstacles=(f"box:0.01,0.01,0.01@{x},{y},{z}",), clearance=0.001)
    assert run_plan.run(blocked, NOTHING, Console(file=heard, width=300)) == INFEASIBLE
    assert "the object and obstacles[0]" in heard.getvalue() or "obstacles[0] and the object" in heard.getvalue()


def test_fingertips_pass_the_given_places(tmp_path, capsys):
    hand = Hand.load(HAND)
    places = [hand.tip_pose(hand.neutral, "index")[0] + offset for offset in ([0.004, 0.0, 0.008], [0.0, 0.004, 0.016])]
    tips = [f"--fingertips=index={','.join(map(str, place))}" for place in places]
    file = tmp_path / "plan.json"
    assert main(["plan", "--hand", HAND, *tips, "--clearance", "0.0005", "--save", str(file)]) == SUCCESS
    assert "violation between knots" in capsys.readouterr().out
    plan = load(file, hand)
    reached = np.array([hand.tip_pose(q, "index")[0] for q in plan.at_even_times(400).q])
    for place in places:
        assert np.linalg.norm(reached - place, axis=1).min() < 3e-4  # m, between two instants
    for wrong in (["--fingertips=index"], ["--fingertips=index=1,1,1"], ["--fingertips=sixth=0,0,0"], [*tips, "--execute"]):
        assert main(["plan", "--hand", HAND, *wrong]) == ERROR


def test_acceleration_limit_is_shown_as_active(at_once):
    heard = io.StringIO()
    limits = run_plan.parse_limits("1,50", None)
    assert run_plan.run(replace(PLAN_OPTIONS, limits=limits), NOTHING, Console(file=heard, width=150)) == SUCCESS
    assert "acceleration of the object (" in heard.getvalue()


def test_limits_of_jerk_are_parsed_and_slow_the_move(at_once):
    limits = run_plan.parse_limits(None, 40.0, "100,2000", 1e4)
    assert limits == AccelerationLimits(joints=40.0, linear_jerk=100.0, angular_jerk=2000.0, joint_jerk=1e4)
    with pytest.raises(InvalidInput, match="joint-jerk"):
        run_plan.parse_limits(None, None, None, -1.0)
    heard = io.StringIO()
    slow = replace(PLAN_OPTIONS, limits=run_plan.parse_limits(None, None, "20"))
    assert run_plan.run(slow, NOTHING, Console(file=heard, width=150)) == SUCCESS
    fastest = float(re.findall(r"fastest move, ([0-9.]+) ms", heard.getvalue())[0])
    assert fastest > 1e3 * np.cbrt(32.0 * np.linalg.norm(MOVES[HAND][0]) / 20.0)  # of the jerk alone


def test_untrackable_plan_is_shown_and_not_executed(at_once, monkeypatch):
    why = PlanFailure(
        "unreachable", "With contacts that roll, after 40 % of the move joint_14.0 comes to the end of its range."
    )
    monkeypatch.setattr("graspforce.planning.tracking.time_scale_plan", lambda *_: why)
    heard = io.StringIO()
    assert run_plan.run(PLAN_OPTIONS, NOTHING, Console(file=heard, width=150)) == SUCCESS
    assert "not trackable: With contacts that roll" in heard.getvalue()
    assert run_plan.run(PLAN_OPTIONS, replace(NOTHING, execute=True), Console(file=heard, width=150)) == INFEASIBLE


@pytest.mark.parametrize("option", ["--save", "--plots", "--video", "--frames"])
def test_unwritable_output_is_rejected_before_the_search(option, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("graspforce.cli.options.find_grasp", None)
    (tmp_path / "taken").write_text("a file")
    place = tmp_path / "taken" / "below" / "plan.json"
    assert main([*OPTIONS, *options(MOVES[HAND]), "--execute", option, str(place)]) == 1
    assert f"Error: {option} = " in capsys.readouterr().err
    (tmp_path / "plan.json").mkdir()
    assert main([*OPTIONS, *options(MOVES[HAND]), "--save", str(tmp_path / "plan.json")]) == 1
    assert "must be a file, not a directory" in capsys.readouterr().err


def test_full_disk_is_one_line_of_error(at_once, capsys, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "plan.json")

    monkeypatch.setattr(run_plan, "run", full)
    assert main([*OPTIONS, *options(MOVES[HAND])]) == 1
    assert capsys.readouterr().err == "Error: plan.json: No space left on device\n"


def test_invalid_options_are_rejected(at_once, capsys, monkeypatch):
    assert main([*OPTIONS, "--to", "0,0,0"]) == 1
    assert "to = " in capsys.readouterr().err
    assert main([*OPTIONS, "--to", "up"]) == 1
    assert "to = 'up': must be 3 numbers" in capsys.readouterr().err
    with pytest.raises(InvalidInput, match="method"):
        replace(PLAN_OPTIONS, method="magic")
    monkeypatch.setattr("graspforce.cli.options.find_grasp", None)  # nor is a hold looked for, or a plan made, in vain
    assert main([*OPTIONS, *options(MOVES[HAND]), "--save", "plan.txt"]) == 1
    assert "one of .json, .csv, .npz" in capsys.readouterr().err
    numbers = (
        "--turn=0,0,7",
        "--turn=inf,0,0",
        "--to=nan,0,0",
        "--budget=-1",
        "--slip-margin=-1",
        "--reserve=1",
        "--object=box:1,1,-1",
        "--via=1,2",
        "--via=0,0,0.001,0,0,4",
        "--acceleration=0",
        "--acceleration=1,2,3",
        "--joint-acceleration=-1",
    )
    for asked in numbers:  # a turn of 7 rad would be planned as one of 0.72 rad
        assert main([*OPTIONS, *options(MOVES[HAND]), asked]) == 1
        assert f"Error: {asked[2:].partition('=')[0]}" in capsys.readouterr().err
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main([*OPTIONS, *options(MOVES[HAND]), "--execute"]) == 1
    assert 'pip install "graspforce[sim]"' in capsys.readouterr().err


# ── what limits ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_lift_is_limited_by_normal_force_and_friction_throughout():
    """Closed form: up with A − g, down with A + g, both with all the friction that both normal forces' limits allow."""
    plan = plan_along(block(), straight_move(0.0, 0.0, 1.0))
    assert isinstance(plan, Plan)
    times = np.linspace(0.0, plan.duration, 101)
    found = limit_usage(plan, times)
    both = {f"{kind} at contact {i}" for kind in ("friction", "normal force") for i in (0, 1)}
    assert {str(limit) for limit in found} == both
    switch = plan.duration * (A + 9.81) / (2.0 * A)  # s: equal speeds there, (A − g) t = (A + g)(T − t)
    away = np.abs(times - switch) > 0.03 * plan.duration  # between the two, forces pass through others
    for limit in found:
        assert limit.used[away] == pytest.approx(1.0, abs=1e-3)
        assert limit.used.max() < 1.001
        assert limit.spans(times)[0][0] == 0.0
        assert limit.spans(times)[-1][1] == plan.duration


def test_limit_usage_counts_the_slip_margin_as_used():
    """At rest, by hand: N, μ and margin s leave the load μN − s, which is what is used with s."""
    plan = plan_along(block(slip_margin=0.5), straight_move(0.0, 0.0, 1.0))
    assert isinstance(plan, Plan)
    friction = next(limit for limit in limit_usage(plan, np.zeros(1)) if limit.kind == usage.FRICTION)
    load = FRICTION * MAX_NORMAL - 0.5  # N
    assert plan.knots.acceleration[0, 2] == pytest.approx(2.0 * load / MASS - 9.81, rel=1e-4)
    assert friction.used[0] == pytest.approx(1.0, abs=1e-5)


def test_plan_of_fingers_shows_motors_and_speeds_without_cones(tmp_path):
    hand = Hand.load("allegro_right")
    plan = plan_fingers_along(
        FingerTask(hand), JointPath.through([hand.neutral, hand.neutral + 0.05]), settings=PlanSettings(intervals=40)
    )
    assert isinstance(plan, Plan)
    found = limit_usage(plan, np.linspace(0.0, plan.duration, 50))
    assert len(found) == 2 * hand.n
    assert {limit.kind for limit in found} == {usage.MOTOR, usage.SPEED}
    assert found[0].active.mean() == max(limit.active.mean() for limit in found) > 0.3
    assert [path.name for path in plan_plots.save_plots(plan, tmp_path)] == ["speed.png", "torques.png"]
    for path in tmp_path.iterdir():
        assert image.imread(path).std() > 0.02


def test_saved_plan_names_its_columns(at_once, tmp_path):
    file = tmp_path / "plan.json"
    assert run_plan.run(PLAN_OPTIONS, replace(NOTHING, save=file), Console(file=io.StringIO())) == SUCCESS
    record = json.loads(file.read_text())
    assert record["hand"] == HAND
    assert record["check"]["verified"] is True
    assert record["fingers"] == list(find_move_grasp(HAND).fingers)

"""Plans as files: contents, and exact round trips."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from support.plan_requests import moves
from support.planning_cases import AXES, FINGERS, block, disc, screw_move, star_grasp, straight_move
from support.tracked_moves import MOVES, SETTINGS, find_move_grasp, straight_path

from graspforce import Hand, InvalidInput, planning
from graspforce.core.arrays import Array
from graspforce.core.errors import UnknownName
from graspforce.planning import (
    FingerTask,
    GraspTask,
    IdealTask,
    Plan,
    PlanSettings,
    StraightPath,
    plan_along,
    plan_free,
    tracking,
)
from graspforce.planning.plan_files import csv_columns, load, save

QUICK = PlanSettings(intervals=10)
ABSENT = object()  # stands for a field that is left out


def planned(planner: Callable[..., object], *arguments: object, **options: object) -> Plan:
    """Return the plan of a planner."""
    plan = planner(*arguments, **options)
    assert isinstance(plan, Plan)
    return plan


def tracked_plan() -> Plan:
    """Return a plan whose hand has the limits that leave the controller its reserves."""
    grasp = find_move_grasp("dlr_hit2")
    path = straight_path(grasp, *map(np.array, MOVES["dlr_hit2"]))
    return planned(plan_along, tracking.object_task(grasp, SETTINGS), path, grasp.q, settings=QUICK)


PLANS: dict[str, Callable[[], Plan]] = {
    "path": lambda: planned(plan_along, *screw_move("allegro_right"), settings=QUICK),
    "path with the controller's reserves": tracked_plan,
    "free": lambda: planned(moves()["free"].plan),
    "ideal fingers": lambda: planned(plan_along, *disc(), settings=QUICK),
    "free, ideal fingers": lambda: planned(plan_free, block(), [[0, 0, 0], [0, 0, 0.1]], [AXES, AXES], settings=QUICK),
    "fingers": lambda: planned(moves()["fingers"].plan),
    "fingers along a path": lambda: planned(moves()["postures"].plan),
}


@pytest.fixture(scope="module", params=FINGERS)
def plan(request: pytest.FixtureRequest) -> Plan:
    return planned(plan_along, *screw_move(request.param))


def assert_equal_arrays(one: object, other: object) -> None:
    """Check that all fields of two records that are arrays or numbers are equal."""
    for each in fields(one):  # type: ignore[arg-type]
        mine, theirs = getattr(one, each.name), getattr(other, each.name)
        if isinstance(mine, np.ndarray | float | int | tuple | str):
            np.testing.assert_array_equal(mine, theirs, err_msg=each.name)


def assert_same_task(one: planning.Task, other: planning.Task) -> None:
    """Check that two tasks are equal in all numbers."""
    assert type(one) is type(other)
    assert_equal_arrays(one, other)
    if isinstance(one, GraspTask | IdealTask):
        assert_equal_arrays(one.body, other.body)
        assert_equal_arrays(one.contacts, other.contacts)
    if isinstance(one, GraspTask | FingerTask):
        assert one.hand.name == other.hand.name
        for name in ("q_lower", "q_upper", "velocity_limit", "torque_lower", "torque_upper"):
            np.testing.assert_array_equal(getattr(one.hand, name), getattr(other.hand, name))


@pytest.mark.parametrize("step", [None, 2e-3])
@pytest.mark.parametrize("suffix", [".json", ".npz"])
@pytest.mark.parametrize("kind", PLANS)
def test_load_returns_the_saved_plan_exactly(kind: str, suffix: str, step: float | None, tmp_path: Path) -> None:
    plan = PLANS[kind]()
    save(plan, tmp_path / f"plan{suffix}", step)
    loaded = load(tmp_path / f"plan{suffix}")
    assert_same_task(plan.task, loaded.task)
    assert_equal_arrays(plan, loaded)
    assert_equal_arrays(plan.knots, loaded.knots)
    assert loaded.check == plan.check or loaded.check.to_dict() == plan.check.to_dict()
    assert loaded.statistics == plan.statistics
    assert loaded.to_dict() == plan.to_dict()
    times = np.linspace(0.0, plan.duration, 23)
    assert_equal_arrays(plan.at(times), loaded.at(times))


def test_load_takes_a_hand_that_does_not_ship(tmp_path: Path) -> None:
    hand = replace(Hand.load("dlr_hit2"), name="my_hand")
    task, middle, q = star_grasp(replace(hand, name="dlr_hit2"))
    mine = replace(task, hand=hand)
    path = StraightPath(middle, AXES, middle + np.array([-0.003, 0.002, 0.003]), AXES)
    plan = planned(plan_along, mine, path, q, settings=QUICK)
    save(plan, tmp_path / "plan.json")
    with pytest.raises(UnknownName, match="my_hand"):
        load(tmp_path / "plan.json")
    with pytest.raises(InvalidInput, match=r"hand = 'dlr_hit2'.*my_hand, the hand of the plan"):
        load(tmp_path / "plan.json", Hand.load("dlr_hit2"))
    loaded = load(tmp_path / "plan.json", hand)
    assert loaded.task.hand is hand
    assert_equal_arrays(plan.knots, loaded.knots)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"schema": "graspforce/grasp/1"}, "schema"),
        ({"task": ABSENT}, "task"),
        ({"task": {"body": {"mass": 1.0}}}, "task.contacts"),
        ({"knots": {}}, "knots.times"),
        ({"check": {}}, "check.verified"),
        ({"stopped": 1}, "stopped"),
        ({"joints": ["elbow"]}, "joints"),
        ({"s": [0.0]}, "s"),
        ({"hand": 7}, "hand"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_load_names_the_damaged_field(change: dict[str, object], field: str, tmp_path: Path) -> None:
    plan = planned(plan_along, block(), straight_move(0.0, 0.0, 1.0), settings=QUICK)
    save(plan, tmp_path / "plan.json")
    record = json.loads((tmp_path / "plan.json").read_text())
    damaged = {name: value for name, value in {**record, **change}.items() if value is not ABSENT}
    (tmp_path / "plan.json").write_text(json.dumps(damaged))
    with pytest.raises(InvalidInput) as caught:
        load(tmp_path / "plan.json")
    assert caught.value.field == field


def test_files_of_another_kind_are_rejected(tmp_path: Path) -> None:
    plan = planned(plan_along, block(), straight_move(0.0, 0.0, 1.0), settings=QUICK)
    with pytest.raises(InvalidInput, match=r"suffix of path.*one of .json, .csv, .npz"):
        save(plan, tmp_path / "plan.txt")
    save(plan, tmp_path / "plan.csv")
    with pytest.raises(InvalidInput, match=r"a .json or .npz file; CSV files lack the task and the check"):
        load(tmp_path / "plan.csv")
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(InvalidInput, match=r"a file that `planning.save` wrote"):
        load(tmp_path / "other.npz")
    with pytest.raises(InvalidInput, match="suffix of path"):
        load(tmp_path / "plan.txt")


def test_files_contain_the_plan(plan: Plan, tmp_path: Path) -> None:
    step = 1e-3  # s
    save(plan, tmp_path / "plan.json", step)
    record = json.loads((tmp_path / "plan.json").read_text())
    assert record["schema"] == "graspforce/plan/1"
    assert record["duration"] == plan.duration
    assert record["check"]["verified"] is True
    assert np.array(record["knots"]["f"]) == pytest.approx(plan.knots.f, abs=0.0)
    save(plan, tmp_path / "plan.npz", step)
    with np.load(tmp_path / "plan.npz") as arrays:
        times = arrays["times"]
        assert np.diff(times[:-1]) == pytest.approx(step, rel=1e-9)
        assert times[-1] == plan.duration
        assert arrays["p_HO"] == pytest.approx(plan.at(times).p_HO, abs=0.0)
        assert np.array(record["samples"]["q"]) == pytest.approx(arrays["q"], abs=0.0)
        assert arrays["joints"].tolist() == [joint.name for joint in plan.task.hand.joints]
    head, numbers = read_table(plan, tmp_path / "plan.csv")
    assert head == csv_columns(plan)
    assert numbers[:, 0] == pytest.approx(plan.knots.times, abs=0.0)
    column = head.index(f"tau {plan.task.hand.joints[1].name} [N·m]")
    assert numbers[:, column] == pytest.approx(plan.knots.tau[:, 1], abs=0.0)
    assert numbers[:, head.index("p_HO z [m]")] == pytest.approx(plan.knots.p_HO[:, 2], abs=0.0)


def test_files_contain_the_moving_contacts(tmp_path: Path) -> None:
    plan = tracked_plan()
    assert np.ptp(plan.knots.p_OC, axis=0).max() > 1e-4  # m: contacts roll
    save(plan, tmp_path / "plan.json")
    record = json.loads((tmp_path / "plan.json").read_text())
    assert np.array(record["knots"]["p_OC"]) == pytest.approx(plan.knots.p_OC, abs=0.0)
    save(plan, tmp_path / "plan.npz")
    with np.load(tmp_path / "plan.npz") as arrays:
        assert arrays["R_OC"] == pytest.approx(plan.knots.R_OC, abs=0.0)
    head, numbers = read_table(plan, tmp_path / "plan.csv")
    for i, name in enumerate(plan.task.fingers):
        assert numbers[:, head.index(f"p_OC {name} y [m]")] == pytest.approx(plan.knots.p_OC[:, i, 1], abs=0.0)
        assert numbers[:, head.index(f"R_OC {name} xn")] == pytest.approx(plan.knots.R_OC[:, i, 0, 2], abs=0.0)


def read_table(plan: Plan, path: Path) -> tuple[list[str], Array]:
    """Save a plan as CSV, and return the names of the columns and the numbers."""
    save(plan, path)
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    return head, np.array(rows, dtype=float)

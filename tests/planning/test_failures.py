"""Infeasible moves with every planner: the reason as a sentence, before any search begins."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.hands import load
from support.planning_cases import AXES, FINGERS, block, star_grasp

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Sphere
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.planning import search
from graspforce.planning.failure import OVERLOADED, SINGULAR, UNHOLDABLE, UNREACHABLE, UNSOLVED, PlanFailure
from graspforce.planning.fingers.plan_fingers import plan_fingers
from graspforce.planning.free.plan_free import plan_free
from graspforce.planning.nlp.optimisers import optimise
from graspforce.planning.path.paths import JointPath, StraightPath
from graspforce.planning.path.plan_along import plan_along, plan_fingers_along
from graspforce.planning.task import FingerTask, GraspTask, HandTask, ObjectTask, Task

HANDS = list(FINGERS)
METHODS = ["path", "free"]
SOLVER_WORDS = r"(?i)_|infeasib|optimal|status|iteration|ipopt|fatrop|clarabel|exception|nan\b"


@pytest.fixture(autouse=True)
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail if a search begins: an infeasible nonlinear program takes seconds to fail."""

    def fail(*_: object, **__: object) -> None:
        raise AssertionError("a search began")

    monkeypatch.setattr(search, "optimise", fail)


def planned_failure(
    method: str, task: ObjectTask, start: Array, R_start: Array, goal: Array, R_goal: Array, q: Array | None = None
) -> PlanFailure:
    """Return the failure of a move along the straight path or a free move."""
    if method == "path":
        answer = plan_along(task, StraightPath(start, R_start, goal, R_goal), q)
    else:
        answer = plan_free(task, [start, goal], [R_start, R_goal], q)
    assert isinstance(answer, PlanFailure)
    assert_plain_reason(answer, task)
    return answer


def assert_plain_reason(failure: PlanFailure, task: Task) -> None:
    """Check that the reason is a sentence without words of a solver; only names may have underscores."""
    words = failure.reason
    if isinstance(task, HandTask):
        for name in (
            [joint.name for joint in task.hand.joints]
            + [finger.name for finger in task.hand.fingers]
            + list(task.hand.urdf.links)
        ):
            words = words.replace(name, "")
    assert not re.search(SOLVER_WORDS, words), words
    assert failure.reason[0].isupper()
    assert failure.reason.endswith(".")
    assert failure.s is None or 0.0 <= failure.s <= 1.0


TILTED = Rotation.from_rotvec([0.0, 0.499 * np.pi, 0.0]).as_matrix()  # one finger is above the object, the other below
ORIGIN, UP = np.zeros(3), 0.01 * AXES[2]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("task", "R_start", "R_goal", "s", "words"),
    [
        (block(mass=0.6), AXES, AXES, 0.0, "At the start the object cannot be held still.* 1.177 times the friction"),
        (block(mass=0.45, friction=0.7, largest=3.5), AXES, TILTED, 1.0, "At the goal the object cannot be held still"),
        (block(mass=0.45, friction=0.7, largest=3.5), TILTED, AXES, 0.0, "At the start the object cannot be held still"),
        (
            block(slip_margin=2.1),
            AXES,
            AXES,
            0.0,
            "the slip margin is at most 2.009 N, less than the required 2.1 N",
        ),
    ],
    ids=["too heavy", "goal", "start", "margin"],
)
def test_object_that_contacts_cannot_hold_still(
    method: str, task: ObjectTask, R_start: Array, R_goal: Array, s: float, words: str
) -> None:
    failure = planned_failure(method, task, ORIGIN, R_start, UP, R_goal)
    assert (failure.kind, failure.s) == (UNHOLDABLE, s)
    assert re.search(words, failure.reason)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", HANDS)
def test_object_too_heavy_for_the_motors_names_a_joint(method: str, name: str) -> None:
    task, middle, q = star_grasp(load(name))
    heavy = replace(task, body=replace(task.body, mass=50.0, inertia=1e3 * task.body.inertia))
    failure = planned_failure(method, heavy, middle, AXES, middle + 0.5 * UP, AXES, q)
    assert (failure.kind, failure.s) == (UNHOLDABLE, 0.0)
    assert failure.joint is not None
    assert failure.infeasibility is not None
    assert failure.infeasibility.verified


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", HANDS)
def test_start_or_goal_out_of_reach_is_located(method: str, name: str) -> None:
    """Along a path the failure names the place where the path ends, on a free move the goal."""
    task, middle, q = star_grasp(load(name))
    far = middle + np.array([0.0, 0.0, 0.3])
    start = planned_failure(method, task, far, AXES, middle, AXES, q)
    assert (start.kind, start.s) == (UNREACHABLE, 0.0)
    assert re.match(r"At the start, the contact of \w+ must be within reach of \w+: .* [0-9.]+ mm away", start.reason)
    goal = planned_failure(method, task, middle, AXES, far, AXES, q)
    assert goal.kind in ((UNREACHABLE, SINGULAR) if method == "path" else (UNREACHABLE,))
    assert goal.s is not None
    assert goal.s > 0.0
    assert (goal.s == 1.0) == (method == "free")


def test_goal_at_the_limit_of_reach_is_singular() -> None:
    """The goal is a micrometre below the limit of reach, which bisection along a vertical line finds."""
    task, middle, q = star_grasp(load("four_finger"))
    task = replace(task, rolling=False)
    near, far = 0.0, 0.1  # m
    for _ in range(17):
        height = (near + far) / 2.0
        near, far = (height, far) if is_reachable(task, middle + height * AXES[2]) else (near, height)
    for method in METHODS:
        failure = planned_failure(method, task, middle, AXES, middle + near * AXES[2], AXES, q)
        assert failure.kind == SINGULAR
        assert "is singular" in failure.reason


def is_reachable(task: GraspTask, p_HO: Array) -> bool:
    """Return whether all fingers can touch the object at a position, with its axes along H's."""
    try:
        task.hand.grasp_posture(task.fingers, task.contacts, p_HO, AXES)
    except InvalidInput:
        return False
    return True


# ── fingers alone ─────────────────────────────────────────────────────────────────────────────────────────────────────────────


def sideways_move() -> tuple[FingerTask, Array, Array, Array, Array]:
    """Return a move of one finger sideways: the task, both postures, and the positions of its tip in them.

    Obstacles block its tip only: the task has no collision checks of links.
    """
    hand = load("four_finger")
    q_start, q_goal = hand.neutral.copy(), hand.neutral.copy()
    q_goal[hand.finger("finger_1").joints[0]] += 0.4
    task = FingerTask(hand, collisions=None)
    return task, q_start, q_goal, hand.tip_pose(q_start, "finger_1")[0], hand.tip_pose(q_goal, "finger_1")[0]


def fingers_failure(*question: object, **options: object) -> PlanFailure:
    """Return the failure of a move of fingers alone."""
    answer = plan_fingers(*question, **options)  # type: ignore[arg-type]
    assert isinstance(answer, PlanFailure)
    assert_plain_reason(answer, question[0])  # type: ignore[arg-type]
    return answer


def test_clearance_missing_at_an_end_is_located() -> None:
    task, q_start, q_goal, at_start, _ = sideways_move()
    ball = Obstacle(Sphere(0.01), at_start)
    for ends, where in (((q_start, q_goal), "start"), ((q_goal, q_start), "goal")):
        failure = fingers_failure(task, *ends, obstacles=[ball])
        assert (failure.kind, failure.s) == (UNREACHABLE, float(where == "goal"))
        assert failure.reason.startswith(
            f"At the {where}, the clearance between the tip of finger_1 and obstacles[0] is too small by 18 mm"
        )
    wide = fingers_failure(task, q_start, q_goal, clearance=0.08)
    assert (wide.kind, wide.s) == (UNREACHABLE, 0.0)
    assert "between the tips of finger_1 and finger_2 is too small by" in wide.reason


def test_posture_beyond_a_joint_limit_and_too_weak_a_motor_name_the_joint() -> None:
    task, q, _, _, _ = sideways_move()
    beyond = q.copy()
    beyond[1] = task.hand.q_upper[1] + 0.2
    for ends in ((q, beyond), (beyond, q)):
        failure = plan_fingers_along(task, JointPath.through(ends))
        assert isinstance(failure, PlanFailure)
        assert (failure.kind, failure.joint) == (UNREACHABLE, "finger_1_joint_2")
        assert "needs the position" in failure.reason
    weak = fingers_failure(replace(task, gravity_H=np.array([0.0, 0.0, -2000.0])), q, q + 0.05)
    assert (weak.kind, weak.s) == (OVERLOADED, 0.0)
    assert f"joint {weak.joint} needs" in weak.reason


def test_finger_behind_a_wall_is_unsolved_after_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing proves that there is no path round the wall, so the search runs."""
    monkeypatch.setattr(search, "optimise", optimise)
    task, q_start, q_goal, at_start, at_goal = sideways_move()
    wall = Obstacle(Box([0.5, 1e-4, 0.5]), (at_start + at_goal) / 2.0)
    failure = fingers_failure(task, q_start, q_goal, obstacles=[wall])
    assert failure.kind == UNSOLVED

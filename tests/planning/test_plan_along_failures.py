"""Failures of planning along a path: the place, the joint and the reason."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.hands import load
from support.planning_cases import AXES, block, screw_move, star_grasp, straight_move

from graspforce import InvalidInput
from graspforce.core.arrays import Array
from graspforce.hand.descriptions.description import MODELS_FOLDER
from graspforce.hand.hand import Hand
from graspforce.planning.failure import OVERLOADED, SINGULAR, UNHOLDABLE, UNREACHABLE, PlanFailure
from graspforce.planning.path.paths import JointPath, PosePoints, StraightPath
from graspforce.planning.path.plan_along import plan_along, plan_fingers_along
from graspforce.planning.plan import Plan
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import FingerTask


def failure_of(*question: object, **options: object) -> PlanFailure:
    """Return the failure of planning along a path of the object, or of fingers alone."""
    planner = plan_fingers_along if isinstance(question[0], FingerTask) else plan_along
    failure = planner(*question, **options)  # type: ignore[arg-type]
    assert isinstance(failure, PlanFailure)
    assert not failure.found
    return failure


def test_place_out_of_reach_is_located_to_a_thousandth() -> None:
    task, path, q = screw_move("dlr_hit2")
    at = path.points(np.array([0.0]))
    far = failure_of(task, StraightPath(at.p[0] + [0, 0, 0.3], AXES, at.p[0], AXES), q)
    assert (far.kind, far.s) == (UNREACHABLE, 0.0)
    assert far.reason.startswith("At the start, the contact of thumb must be within reach of thumb")
    across = StraightPath(at.p[0], AXES, at.p[0] + [0, 0.04, 0], AXES)
    rolling, task = failure_of(task, across, q), replace(task, rolling=False)
    assert rolling.kind == UNREACHABLE
    assert f"joint {rolling.joint} needs the position" in rolling.reason
    sideways = failure_of(task, across, q)
    assert sideways.kind == UNREACHABLE
    assert sideways.joint is not None
    assert f"joint {sideways.joint} needs the position" in sideways.reason
    assert 0.0 < sideways.s < 1.0
    assert f"At s = {sideways.s:.3f}" in sideways.reason
    for s, reached in ((sideways.s - 2e-3, True), (sideways.s + 2e-3, False)):
        p_HO = at.p[0] + [0, 0.04 * s, 0]
        if reached:
            task.hand.grasp_posture(task.fingers, task.contacts, p_HO, AXES, q)
        else:
            with pytest.raises(InvalidInput, match="within reach"):
                task.hand.grasp_posture(task.fingers, task.contacts, p_HO, AXES, q)


def test_singular_finger_names_its_joint() -> None:
    task, middle, q = star_grasp(load("four_finger"))
    singular = failure_of(task, StraightPath(middle, AXES, middle + 0.08 * AXES[2], AXES), q)
    assert singular.kind == SINGULAR
    assert singular.joint is not None
    assert singular.joint.endswith("_joint_3")
    assert "is singular: its tip cannot move along" in singular.reason


def test_object_too_heavy_for_friction_gives_the_friction_factor() -> None:
    """2 μ N = 5 N holds 0.51 kg; 0.6 kg needs 1.177 times the friction."""
    heavy = failure_of(block(mass=0.6), straight_move(0, 0, 1))
    assert (heavy.kind, heavy.s) == (UNHOLDABLE, 0.0)
    assert heavy.infeasibility is not None
    assert heavy.infeasibility.verified
    assert heavy.infeasibility.friction_factor == pytest.approx(0.6 * 9.81 / 5.0, rel=1e-6)
    assert "At the start the object cannot be held still." in heavy.reason
    assert "5.886 is required and at most 5 can be supplied" in heavy.reason
    assert "1.177 times the friction" in heavy.reason


def test_object_too_heavy_for_the_motors_names_their_joints() -> None:
    """Friction and normal forces suffice, torques do not."""
    task, path, q = screw_move("allegro_right", mass=3.0, friction=1.5, largest=60.0)
    failure = failure_of(task, path, q)
    assert failure.kind == UNHOLDABLE
    assert failure.joint is not None
    assert "torque limits of joint" in failure.reason


def test_too_large_a_slip_margin_gives_the_largest_one() -> None:
    """Two fingers can keep at most μN − mg/2 = 2.0095 N."""
    wide = failure_of(block(slip_margin=2.1), straight_move(0, 0, 1))
    assert wide.kind == UNHOLDABLE
    assert "the slip margin is at most 2.009 N, less than the required 2.1 N" in wide.reason


def test_unholdable_place_on_the_path_is_found() -> None:
    """Halfway through a rotation about a horizontal axis both fingers press vertically."""
    half = Rotation.from_rotvec([0.0, np.pi * 0.999, 0.0]).as_matrix()
    failure = failure_of(block(mass=0.52, friction=0.98, largest=4.0), StraightPath([0, 0, 0], AXES, [0, 0, 0.01], half))
    assert failure.kind == UNHOLDABLE
    assert failure.s is not None
    assert 0.0 < failure.s < 1.0
    assert f"At s = {failure.s:.3f} the object cannot be held still" in failure.reason


def test_motor_too_weak_for_its_finger_is_named() -> None:
    hand = load("dlr_hit2")
    heavy = FingerTask(hand, gravity_H=(0.0, 0.0, -2000.0))
    failure = failure_of(heavy, JointPath.through([hand.neutral, hand.neutral + 0.1]))
    assert (failure.kind, failure.s) == (OVERLOADED, 0.0)
    assert f"joint {failure.joint} needs" in failure.reason


def test_joint_path_beyond_a_limit_names_the_joint() -> None:
    hand = load("dlr_hit2")
    goal = np.array(hand.neutral)
    goal[4] = 1.7
    failure = failure_of(FingerTask(hand), JointPath.through([hand.neutral, goal]))
    assert (failure.kind, failure.joint) == (UNREACHABLE, "index_joint_2")
    assert "outside its limits [0, 1.571] rad" in failure.reason


def flat_hand(folder: Path) -> Hand:
    """Return the four-finger hand with locked first joints: each fingertip moves in a plane."""
    described = json.loads((MODELS_FOLDER / "four_finger.json").read_text())
    described["urdf"] = "four_finger.urdf"
    described["locked"] = [{"joint": f"finger_{i}_joint_1", "source": "test"} for i in range(1, 5)]
    for motor in described["motors"]:
        motor["joints"] = [name for name in motor["joints"] if "joint_1" not in name]
    (folder / "flat.json").write_text(json.dumps(described))
    (folder / "four_finger.urdf").write_text((MODELS_FOLDER / "four_finger.urdf").read_text())
    return Hand.load(folder / "flat.json")


def test_fingers_with_two_joints_move_in_their_plane_only(tmp_path: Path) -> None:
    hand = flat_hand(tmp_path)
    task, middle, q = star_grasp(hand)
    plan = plan_along(task, StraightPath(middle, AXES, middle + 0.006 * AXES[2], AXES), q)
    assert isinstance(plan, Plan)
    assert plan.check.verified
    sideways = failure_of(task, StraightPath(middle, AXES, middle + 0.004 * AXES[1], AXES), q)
    assert (sideways.kind, sideways.s) == (SINGULAR, 0.0)
    assert "has 2 joints and cannot move its tip along (0.00, 1.00, 0.00)" in sideways.reason


class InvalidPath:
    """A path of a user with some wrong arrays."""

    def __init__(self, **arrays: Array) -> None:
        self._arrays = arrays

    def points(self, s: Array) -> PosePoints:
        return replace(straight_move(0, 0, 1).points(s), **self._arrays)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(screw_move("dlr_hit2")[0], fingers=("thumb",)), "fingers.*3 different finger names"),
        (lambda: replace(screw_move("dlr_hit2")[0], fingers="thumb"), "fingers.*a list of finger names"),
        (lambda: replace(screw_move("dlr_hit2")[0], fingers=("thumb", "index", "toe")), "toe"),
        (lambda: replace(screw_move("dlr_hit2")[0], slip_margin=-1.0), "slip_margin"),
        (lambda: replace(block(), slip_margin=-1.0), "slip_margin"),
        (lambda: plan_along(block(), JointPath.through([[0.0], [1.0]])), "plan_fingers_along takes a path of the joints"),
        (lambda: plan_along(block(), StraightPath([0, 0, 0], AXES, [0, 0, 0], AXES)), "a path along which something moves"),
        (lambda: plan_along(block(largest=None), straight_move(0, 0, 1)), "nothing else limits the forces"),
        (lambda: plan_along(block(), straight_move(0, 0, 1), settings=PlanSettings(intervals=1)), "intervals = 1"),
        (lambda: plan_along(block(), InvalidPath(p=np.zeros((5, 2)))), "path.points.p "),
        (lambda: plan_along(block(), InvalidPath(omega=np.full((5, 3), np.nan))), r"path.points.omega\[0\]\[0\] = nan"),
        (lambda: plan_along(block(), InvalidPath(R=2.0 * np.tile(AXES, (5, 1, 1)))), "path.points.R.*rotation matrices"),
    ],
)
def test_invalid_input_names_its_field(make, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        make()

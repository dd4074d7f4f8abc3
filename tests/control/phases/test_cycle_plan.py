"""Records of cycle plans and of the settings of the phases."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import Hand
from tests.support.table_scenes import ball_scene


def plan() -> CyclePlan:
    """Return a plan with a short approach."""
    scene = ball_scene()
    q = scene.grasp.q
    approach = JointTrajectory.between(q + 0.2, q + 0.1, 0.8)
    return CyclePlan(scene.grasp, scene.gravity_H, q + 0.1, [0.02, 0.02, 0.015], approach, [0.0, 0.0, 0.05])


def test_plan_survives_json():
    sent = plan()
    again = CyclePlan.from_dict(json.loads(json.dumps(sent.to_dict())), sent.grasp.hand)
    assert again.to_dict() == sent.to_dict()
    np.testing.assert_array_equal(again.q_start, sent.approach.q[0])


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"gravity": [0.0, 0.0, 0.0]}, "plan.gravity"),
        ({"gravity": [0.0, 0.0]}, "plan.gravity"),
        ({"standoff": [0.02, 0.02]}, "plan.standoff"),
        ({"standoff": [0.02, 0.0, 0.02]}, "plan.standoff[1]"),
        ({"pregrasp": [0.0] * 3}, "plan.pregrasp"),
        ({"lift": "high"}, "plan.lift"),
        ({"approach": {}}, "plan.approach.times"),
        ({"hold": {}}, "plan.hold.body"),
        ({"start": [0.0] * 16}, "plan.start"),
    ],
)
def test_invalid_plans_are_named(change, field):
    sent = plan()
    with pytest.raises(InvalidInput) as caught:
        CyclePlan.from_dict({**sent.to_dict(), **change}, sent.grasp.hand)
    assert caught.value.field == field


def test_settings_survive_json_and_name_invalid_fields():
    settings = PhaseSettings(close_speed=0.03, touch_force=0.5)
    assert PhaseSettings.from_dict(json.loads(json.dumps(settings.to_dict()))) == settings
    with pytest.raises(InvalidInput, match="close_speed"):
        PhaseSettings.from_dict({"close_speed": -1.0})


def test_plan_needs_a_surface_and_fingertips_off_it():
    made = plan()
    grasp = replace(made.grasp, body=replace(made.grasp.body, shape=None))
    with pytest.raises(InvalidInput, match=r"grasp\.body\.shape"):
        replace(made, grasp=grasp)
    for distance in (0.0, -0.01):
        with pytest.raises(InvalidInput, match="standoff"):
            replace(made, standoff=[0.02, distance, 0.02])
    record = made.to_dict()
    body = record["hold"]["body"]
    record["hold"] = {**record["hold"], "body": {name: body[name] for name in body if name != "shape"}}
    with pytest.raises(InvalidInput, match=r"plan\.hold\.body\.shape"):
        CyclePlan.from_dict(record, made.grasp.hand)


def test_posture_tolerance_of_sliding_joints_is_a_millimetre():
    settings = PhaseSettings(posture_tolerance=0.05)
    assert settings.posture_tolerances(Hand.load("parallel_jaws")).tolist() == [1e-3] * Hand.load("parallel_jaws").n
    assert settings.posture_tolerances(plan().grasp.hand).tolist() == [0.05] * 16

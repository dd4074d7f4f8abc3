"""Grasp cycles of hands unlike those with fingers of three or four joints: shared motors, coupled joints, a wrist."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce.control.phases.tip_motion import opened_posture
from graspforce.control.settings import ControlSettings
from graspforce.geometry import Box, Shape, Sphere
from graspforce.grasp.body import Body
from graspforce.hand.hand import Hand
from graspforce.simulation.cycle.cycle_outcome import judge_cycle
from graspforce.simulation.cycle.episode import PoseError, run_episode
from graspforce.simulation.cycle.plan_cycle import CycleMotion, find_cycle
from graspforce.simulation.worlds.world import World

BOX, BALL = Box((0.04, 0.04, 0.08)), Sphere(0.04)
CASES = [("parallel_jaws", BOX), ("barrett", BALL), ("shadow_right", Box((0.05, 0.05, 0.08)))]


@pytest.mark.parametrize(("name", "shape"), CASES, ids=[name for name, _ in CASES])
def test_hand_carries_an_object_over_the_table(name: str, shape: Shape):
    motion = CycleMotion(move=(0.02, 0.0), optimised=False)
    scene, plan = find_cycle(Hand.load(name), Body.solid(shape, 0.05), friction=0.7, motion=motion)
    q, distances = opened_posture(scene.grasp, 0.01)
    normals = scene.grasp.contacts.R_OC[:, :, 2] @ scene.grasp.R_HO.T
    for finger, n, distance in zip(scene.grasp.fingers, normals, distances, strict=True):
        before, after = (scene.grasp.hand.tip_pose(each, finger)[0] for each in (scene.grasp.q, q))
        assert -(after - before) @ n == pytest.approx(distance, abs=1e-3)  # a tip that follows another line by 1 mm at most
        assert 1e-3 <= distance <= 0.011
    control = ControlSettings(gravity_H=scene.gravity_H)
    recording = run_episode(scene, plan, World(), PoseError(0.004, np.radians(3.0)), control)
    outcome = judge_cycle(recording)
    assert outcome.status == "done"
    assert outcome.peak_ratio < 1.5

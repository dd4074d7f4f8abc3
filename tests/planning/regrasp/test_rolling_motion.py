"""Rolling along a path: fingertips touch, roll without sliding, and return when the path is reversed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.regrasp_plans import start_state, turn_task

from graspforce.planning.regrasp import HeldObject, RegraspTask
from graspforce.planning.regrasp.pose_path import PosePath
from graspforce.planning.regrasp.rolling_motion import RollingMotion

NAMES = ["four_finger sphere", "four_finger box", "dlr_hit2 sphere"]


def roll(task: RegraspTask, step: float) -> list[HeldObject]:
    """Return the states of a task along its whole path."""
    states = RollingMotion(task.grasp.hand, task.shape, task.path).roll(start_state(task), task.path.length, step)
    assert states[-1].u == task.path.length
    return states


def contact_paths(task: RegraspTask, states: list[HeldObject], finger: int) -> tuple[float, float]:
    """Return the lengths of a contact's path on the object and on the fingertip, m."""
    on_object, on_tip = [], []
    for state in states:
        motion, p_OC = task.path.motion(state.u), state.contacts.p_OC[finger]
        p_HF, R_HF = task.grasp.hand.tip_pose(state.q, state.fingers[finger])
        on_object.append(p_OC)
        on_tip.append(R_HF.T @ (motion.p_HO + motion.R_HO @ p_OC - p_HF))
    return tuple(float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) for path in (on_object, on_tip))


@pytest.mark.parametrize("name", NAMES)
def test_fingertips_touch_the_object(name: str) -> None:
    """The centre of each tip is its radius away from the surface."""
    task = turn_task(0.1, name)
    for state in roll(task, 0.02):
        motion = task.path.motion(state.u)
        for i, finger in enumerate(state.fingers):
            radius = task.grasp.hand.finger(finger).tip_radius or 0.0
            centre = (task.grasp.hand.tip_pose(state.q, finger)[0] - motion.p_HO) @ motion.R_HO
            assert task.shape.phi(centre[None])[0] == pytest.approx(radius, abs=1e-6)
            assert task.shape.phi(state.contacts.p_OC[i : i + 1])[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_contact_paths_on_object_and_tip_are_equally_long(name: str) -> None:
    """Rolling without sliding. The error of the midpoint rule falls with the square of the step."""
    task = turn_task(0.1, name)
    errors = []
    for step in (0.02, 0.005):
        states = roll(task, step)
        lengths = [contact_paths(task, states, finger) for finger in range(len(states[0].fingers))]
        errors.append(max(abs(a - b) for a, b in lengths))
    assert errors[1] < errors[0] / 8.0 + 1e-9  # 16 for the second order; chords and arcs differ by as much


def test_reversed_path_returns_to_the_start() -> None:
    """Three joints of a finger follow the tip uniquely, and rolling depends on the path only."""
    task = turn_task(0.1)
    there = roll(task, 0.005)
    back_path = PosePath(task.path.p_HO[::-1], task.path.R_HO[::-1])
    back = RollingMotion(task.grasp.hand, task.shape, back_path).roll(replace(there[-1], u=0.0), back_path.length, 0.005)
    np.testing.assert_allclose(back[-1].q, task.grasp.q, atol=1e-4)
    np.testing.assert_allclose(back[-1].contacts.p_OC, task.grasp.contacts.p_OC, atol=1e-6)


def test_motion_ends_at_a_joint_limit() -> None:
    task = turn_task(6.0)
    states = RollingMotion(task.grasp.hand, task.shape, task.path).roll(start_state(task), task.path.length)
    assert 0.0 < states[-1].u < task.path.length
    hand = task.grasp.hand
    assert all((state.q >= hand.q_lower).all() and (state.q <= hand.q_upper).all() for state in states)

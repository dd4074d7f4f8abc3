"""Free moves with soft contacts: their moments, and fingers that must not spin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_grasps import named_grasp, soft_box_grasp
from support.planning_cases import block

from graspforce import InvalidInput
from graspforce.contact.contact import ContactSet
from graspforce.grasp.grasp import Grasp
from graspforce.planning import GraspTask, IdealTask, Plan, PlanSettings, StraightPath, plan_along, plan_free
from graspforce.planning.free.program import object_move_program
from graspforce.planning.nlp.optimisers import optimise

GAMMA, FORCE, ANGLE = 0.01, 2.0, 0.4  # m, N, rad


def soft_contacts(contacts: ContactSet, gamma: float) -> ContactSet:
    return ContactSet.stack([replace(each, model="soft", torsional_friction=gamma) for each in contacts.contacts])


def test_turn_about_the_line_of_two_soft_contacts_takes_their_largest_moments() -> None:
    """Without gravity only the moments γ F of both contacts turn the block: T = 2 √(θ I/(2 γ F))."""
    point = block(largest=FORCE)
    task = IdealTask(point.body, soft_contacts(point.contacts, GAMMA), np.zeros(3))
    R = np.array([np.eye(3), Rotation.from_rotvec([ANGLE, 0.0, 0.0]).as_matrix()])
    exact = 2.0 * np.sqrt(ANGLE * point.body.inertia[0, 0] / (2.0 * GAMMA * FORCE))
    along = plan_along(task, StraightPath(np.zeros(3), R[0], np.zeros(3), R[1]))
    assert isinstance(along, Plan)
    move = object_move_program(task, along.at_even_times(40))
    found = move.trajectory(optimise(move.program, move.guess).x)
    for knots in (along.knots, found):
        assert knots.times[-1] == pytest.approx(exact, rel=0.02)  # a step in acceleration takes an interval
    padded = task.contacts.pad(found.f)
    assert np.abs(padded[:, :, 3]).max() == pytest.approx(GAMMA * FORCE, rel=2e-3)
    assert (np.hypot(np.hypot(*np.moveaxis(padded[:, :, :2], 2, 0)) / 0.5, padded[:, :, 3] / GAMMA) <= FORCE * (1 + 2e-3)).all()


def task_of(grasp: Grasp, rolling: bool = True) -> GraspTask:
    return GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers, rolling=rolling, collisions=None)


@pytest.mark.parametrize("rolling", [True, False])
def test_free_move_with_soft_contacts_is_not_slower_than_straight(rolling: bool) -> None:
    """Rolling pads do not spin: the check integrates their spin with the hand's own kinematics."""
    grasp = soft_box_grasp()
    task, p = task_of(grasp, rolling), np.array([grasp.p_HO, grasp.p_HO + 0.001])
    R = np.array([grasp.R_HO, grasp.R_HO])
    settings = PlanSettings(intervals=16)
    along = plan_along(task, StraightPath(p[0], R[0], p[1], R[1]), grasp.q, settings=settings)
    free = plan_free(task, p, R, grasp.q, settings=settings)
    assert isinstance(along, Plan)
    assert isinstance(free, Plan)
    assert free.check.verified
    assert not free.s.size
    assert free.duration < along.duration


def test_fingers_of_three_joints_cannot_roll_on_soft_contacts() -> None:
    grasp = named_grasp("four_finger sphere")
    soft = replace(grasp, contacts=soft_contacts(grasp.contacts, 0.004))
    with pytest.raises(InvalidInput, match="four joints"):
        plan_free(task_of(soft), [grasp.p_HO, grasp.p_HO + 1e-3], [grasp.R_HO, grasp.R_HO], grasp.q)

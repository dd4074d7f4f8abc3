"""Postures that touch an object at the goal of a move: at the contacts, elsewhere on the surface, or not at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.tracked_moves import find_move_grasp

from graspforce.contact.contact import ContactSet
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.planning import GraspTask, Plan, PlanFailure, plan_free
from graspforce.planning.failure import UNREACHABLE
from graspforce.planning.free.touching_posture import EndPosture, find_touching_posture
from graspforce.planning.settings import PlanSettings

TOUCH = 1e-4  # m: largest gap of a fingertip that touches
FAR = 0.5  # m: farther than any finger reaches


def task_of(grasp: Grasp) -> GraspTask:
    return GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)


def reaches(grasp: Grasp, i: int, p_HO: np.ndarray) -> bool:
    contact = ContactSet.stack([grasp.contacts.contacts[i]])
    try:
        grasp.hand.grasp_posture([grasp.fingers[i]], contact, p_HO, grasp.R_HO, grasp.q)
    except InvalidInput:
        return False
    return True


def barely_out_of_reach(grasp: Grasp, i: int) -> np.ndarray:
    """Return the first place of the object, in steps of 1 mm away from finger i, at which its contact is out of reach."""
    n = grasp.R_HO @ grasp.contacts.R_OC[i, :, 2]
    return next(p for p in (grasp.p_HO + 1e-3 * k * n for k in range(1, 200)) if not reaches(grasp, i, p))


@pytest.mark.parametrize("name", ["allegro_right sphere", "allegro_right cylinder", "four_finger box"])
def test_posture_of_contacts_within_reach_has_the_tips_at_them(name):
    grasp = named_grasp(name)
    found = find_touching_posture(task_of(grasp), grasp.p_HO, grasp.R_HO, grasp.q)
    assert isinstance(found, EndPosture)
    assert found.at_contacts
    for tip, planned in zip(grasp.fingers, range(len(grasp.fingers)), strict=True):
        centre = grasp.contacts.p_OC[planned] - grasp.hand.finger(tip).tip_radius * grasp.contacts.R_OC[planned, :, 2]
        p = grasp.hand.tip_pose(found.q, tip)[0]
        assert p == pytest.approx(grasp.p_HO + grasp.R_HO @ centre, abs=1e-6)


@pytest.mark.parametrize("name", ["allegro_right sphere", "allegro_right cylinder", "four_finger box"])
def test_finger_whose_contact_is_barely_out_of_reach_touches_nearby_or_is_refused(name):
    grasp = named_grasp(name)
    for i, finger in enumerate(grasp.fingers):
        p_HO = barely_out_of_reach(grasp, i)
        found = find_touching_posture(task_of(grasp), p_HO, grasp.R_HO, grasp.q)
        if isinstance(found, PlanFailure):
            assert found.kind == UNREACHABLE
            continue
        assert not found.at_contacts
        assert (found.q >= grasp.hand.q_lower - 1e-9).all()
        assert (found.q <= grasp.hand.q_upper + 1e-9).all()
        p_OF = grasp.R_HO.T @ (grasp.hand.tip_pose(found.q, finger)[0] - p_HO)
        assert grasp.body.shape.phi(p_OF) > 0.0  # outside
        height = np.linalg.norm(p_OF - grasp.body.shape.closest_points(p_OF[None])[0])
        assert height == pytest.approx(grasp.hand.finger(finger).tip_radius, abs=TOUCH)


def test_some_finger_out_of_reach_of_its_contact_touches_elsewhere():
    grasp = named_grasp("allegro_right sphere")
    places = [barely_out_of_reach(grasp, i) for i in range(len(grasp.fingers))]
    found = [find_touching_posture(task_of(grasp), p, grasp.R_HO, grasp.q) for p in places]
    assert any(isinstance(each, EndPosture) and not each.at_contacts for each in found)


def test_tips_that_do_not_roll_must_reach_their_contacts():
    grasp = named_grasp("allegro_right sphere")
    task = replace(task_of(grasp), rolling=False)
    for i in range(len(grasp.fingers)):
        found = find_touching_posture(task, barely_out_of_reach(grasp, i), grasp.R_HO, grasp.q)
        assert isinstance(found, PlanFailure)
        assert found.kind == UNREACHABLE


@pytest.mark.parametrize("name", ["allegro_right sphere", "four_finger box"])
def test_object_that_no_finger_reaches_is_out_of_reach(name):
    grasp = named_grasp(name)
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        found = find_touching_posture(task_of(grasp), grasp.p_HO + FAR * direction, grasp.R_HO, grasp.q)
        assert isinstance(found, PlanFailure)
        assert found.kind == UNREACHABLE
        assert found.reason.startswith(f"At the goal, {grasp.fingers[0]} reaches no place on the object")


def test_free_plan_may_end_where_a_contact_of_the_start_is_out_of_reach():
    """A claim that no motion exists would be wrong: the tips roll, and touch elsewhere at the goal."""
    grasp = find_move_grasp("allegro_right")
    task, planned = task_of(grasp), 0
    for i in range(len(grasp.fingers)):
        goal = barely_out_of_reach(grasp, i)
        if isinstance(find_touching_posture(task, goal, grasp.R_HO, grasp.q), PlanFailure):
            continue
        ends = ([grasp.p_HO, goal], [grasp.R_HO, grasp.R_HO])
        answer = plan_free(task, *ends, grasp.q, settings=PlanSettings(intervals=20, budget=20.0))
        if isinstance(answer, Plan):
            planned += 1
            assert answer.check.verified
        else:
            assert answer.kind != UNREACHABLE
    assert planned > 0

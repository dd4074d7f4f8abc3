"""Regrasp plans built step by step, without a search that could fail."""

from __future__ import annotations

from functools import cache

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.control import ControlSettings
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.planning.regrasp import FingerStage, HeldObject, ObjectStage, PosePath, RegraspPlan, RegraspTask
from graspforce.planning.regrasp.contact_candidates import CandidateOptions, ContactCandidates
from graspforce.planning.regrasp.finger_step import FingerStepPlanner
from graspforce.planning.regrasp.holding import HoldingMargin
from graspforce.planning.regrasp.rolling_motion import RollingMotion
from support.control_grasps import named_grasp

CONTROL = ControlSettings(slip_margin=0.1, friction_reserve=0.1)


def turn_task(angle: float = 0.1, name: str = "four_finger sphere") -> RegraspTask:
    """Return the task of turning the object of a grasp about the z axis of H."""
    grasp = named_grasp(name)
    return RegraspTask(grasp, PosePath.turn(grasp.p_HO, grasp.R_HO, [0.0, 0.0, 1.0], angle), CONTROL)


def start_state(task: RegraspTask) -> HeldObject:
    """Return the state at the start of a task."""
    grasp = task.grasp
    return HeldObject(0.0, grasp.q, grasp.fingers, grasp.contacts)


@cache
def plan_with_one_step() -> RegraspPlan:
    """Return a plan that turns the object, moves one finger to another place, and turns the object on."""
    task = turn_task()
    hand, shape = task.grasp.hand, task.shape
    rolling = RollingMotion(hand, shape, task.path)
    first = rolling.roll(start_state(task), 0.05)
    stage = finger_stage(task, first[-1])
    last = rolling.roll(stage.end, task.path.length)
    assert last[-1].u == task.path.length
    return RegraspPlan(task, (ObjectStage(tuple(first), 0.3, 0.1), stage, ObjectStage(tuple(last), 0.3, 0.1)))


def finger_stage(task: RegraspTask, at: HeldObject) -> FingerStage:
    """Return the step of the first finger that can step, to the first place that allows it."""
    hand, shape, motion = task.grasp.hand, task.shape, task.path.motion(at.u)
    scene = SceneCollision(hand, shape, task.grasp.fingers)
    places = ContactCandidates(hand, shape, at.fingers, at.contacts.contacts, CandidateOptions(0.002, scene))
    steps = FingerStepPlanner(hand, shape, scene)
    holding = HoldingMargin(hand, task.grasp.body, task.path, task.control, 1.0)
    for i, finger in enumerate(at.fingers):
        others = [name for name in at.fingers if name != finger]
        if holding.find_without(at, finger) < 1.2 * task.control.slip_margin:
            continue
        for candidate in places.find(finger, motion, at.q, others, 20, np.random.default_rng(0)):
            postures = steps.plan(finger, motion, at.q, at.contacts.contacts[i], candidate.contact)
            if postures is None:
                continue
            contacts = list(at.contacts.contacts)
            contacts[i] = candidate.contact
            end = HeldObject(at.u, postures[-1], at.fingers, ContactSet.stack(contacts))
            if holding.find(end) >= 1.2 * task.control.slip_margin:
                return FingerStage(finger, candidate.contact, postures, end, 0.5, 0.1)
    raise AssertionError("no finger can step")

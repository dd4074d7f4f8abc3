"""A regrasp plan in closed loop: a finger steps while the others hold, with certified forces in every period."""

from __future__ import annotations

import numpy as np
from support.regrasp_plans import CONTROL, plan_with_one_step

from graspforce.control.contacts.contact_change import FORCE_RATE
from graspforce.planning.regrasp import FingerStage, RegraspController, RegraspPhase
from graspforce.simulation import Plant, build_scene
from graspforce.simulation.loops.regrasp_loop import simulate_regrasp


def test_finger_steps_while_the_others_hold() -> None:
    """The object reaches the goal; forces are certified in every step and no torque jumps."""
    plan = plan_with_one_step()
    stage = next(stage for stage in plan.stages if isinstance(stage, FingerStage))
    plant, controller = Plant(build_scene(plan.task.grasp, gravity_H=CONTROL.gravity_H)), RegraspController(plan)
    index = plan.task.grasp.fingers.index(stage.finger)
    touching = []
    run = simulate_regrasp(plant, controller, plan, lambda p, _: touching.append(p.true_contacts().touching))
    assert run.is_complete
    assert run.is_certified.all()
    # the engine's contacts are elastic, the tips penetrate by some µm
    assert np.linalg.norm(run.final_error[:3]) < 1e-4
    assert np.linalg.norm(run.final_error[3:]) < 2e-3
    contact = np.array(touching)
    stepping = np.array([phase is RegraspPhase.STEP for phase in run.phase])
    middle = np.flatnonzero(stepping)[len(np.flatnonzero(stepping)) // 4 : -len(np.flatnonzero(stepping)) // 4]
    assert not contact[middle, index].any()
    assert contact[:, np.arange(contact.shape[1]) != index].all()
    assert contact[-1].all()
    levers = np.abs(plan.task.grasp.actuation().J).sum(axis=0).max()  # m
    ramps = np.array([phase in (RegraspPhase.RELEASE, RegraspPhase.LOAD) for phase in run.phase])
    steps = np.abs(np.diff(run.tau, axis=0)).max(axis=1)
    # forces move by the rate; the feedback adds what the elastic contacts answer
    assert steps[ramps[1:]].max() < 10.0 * FORCE_RATE * CONTROL.period * levers

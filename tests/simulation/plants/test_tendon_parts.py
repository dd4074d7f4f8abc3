"""Tendons in the plant: differentials with free joints, and breakaways that open and close."""

from __future__ import annotations

import numpy as np
import pytest
from support.hands import load
from support.simulated_runs import start_of

from graspforce.control import ControlSettings, ObjectController
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import GraspSearchOptions, find_grasp
from graspforce.hand.tendon_modes import free_differentials
from graspforce.simulation import EngineSettings, Plant, build_scene, simulate
from graspforce.simulation.loops.reference import constant_reference
from graspforce.simulation.recordings.metrics import compute_metrics

DOWN = (0.0, 0.0, -9.81)  # m/s²
FINGERS = ["thumb", "first", "middle"]


@pytest.fixture(scope="module")
def free_grasp() -> Grasp:
    """Return a grasp of two fingers with free differentials and the thumb."""
    hand, ball = free_differentials(load("shadow_right"), FINGERS), Body.solid(Sphere(0.025), 0.05)
    return find_grasp(hand, ball, FINGERS, friction=0.7, gravity_H=DOWN, options=GraspSearchOptions(travel=0.0))


def test_tension_of_a_tendon_turns_both_joints_in_the_ratio_of_their_radii(free_grasp: Grasp) -> None:
    plant = Plant(build_scene(free_grasp, gravity_H=DOWN))
    hand, scene = free_grasp.hand, plant.scene
    tau = np.zeros(hand.n)
    names = [joint.name for joint in hand.joints]
    tau[names.index("FFJ2")] = 0.3
    plant.step(tau)
    applied = {
        plant.model.joint(name).name: plant.data.qfrc_applied[plant.model.joint(name).dofadr[0]] for name in ("FFJ2", "FFJ1")
    }
    assert applied["FFJ2"] == pytest.approx(applied["FFJ1"], rel=1e-12)  # equal pulleys
    virtual = scene.T.T @ plant.data.qfrc_applied[scene.v_address]  # virtual work of both coordinates
    np.testing.assert_allclose(virtual, tau, atol=1e-12)


def test_controller_holds_a_ball_with_free_differentials(free_grasp: Grasp) -> None:
    """Nothing but contacts and the tendon's tension keeps J1 and J2 where they are."""
    plant = Plant(build_scene(free_grasp, gravity_H=DOWN))
    controller = ObjectController(free_grasp, ControlSettings(gravity_H=DOWN, slip_margin=0.1))
    metrics = compute_metrics(simulate(plant, controller, constant_reference(start_of(free_grasp)), 0.3))
    assert metrics.lost_contact_steps == metrics.slip_steps == metrics.reused_force_steps == 0
    assert metrics.position_error_peak < 1e-4  # m
    assert plant.coupling_error() < 1e-6  # rad: couplings of the other fingers
    q = plant.data.qpos[plant.scene.q_address]
    state = plant.state()
    np.testing.assert_allclose(plant.scene.T @ state.q + plant.scene.q0, q, atol=1e-6)


def test_breakaway_opens_within_a_step_and_closes_on_the_way_back() -> None:
    """The first joint of a finger is blocked near its limit; then the second one moves alone, and back."""
    hand = load("barrett")
    grasp = find_grasp(hand, Body.solid(Sphere(0.03), 0.05), friction=0.7, gravity_H=DOWN)
    engine = EngineSettings(solid_links=False)  # the fingers pass through one another
    plant = Plant(build_scene(grasp, gravity_H=(0.0, 0.0, 0.0), engine=engine))
    names = [joint.name for joint in hand.joints]
    motor = names.index("finger_3_inner")
    k = [each.joints[0] for each in hand.tendons].index("finger_3_inner")
    tendon = hand.tendons[k]
    q = np.array(hand.neutral)
    q[motor] = hand.q_upper[motor] - 0.05
    plant.place(q, (1.0, 0.0, 0.0), np.eye(3))
    first, second = (plant.model.joint(name).qposadr[0] for name in tendon.joints)
    tau = np.zeros(hand.n)
    passed = []
    while plant.clutches.stops[k] is None and len(passed) < 600:
        tau[motor] = 0.5 + 2e-3 * len(passed)  # N·m
        plant.step(tau)
        passed.append(plant.clutches.passed[k])
    stop = plant.clutches.stops[k]
    assert stop is not None
    assert max(passed[:-1]) <= tendon.threshold < passed[-1]
    for _ in range(100):
        plant.step(tau)
    assert plant.data.qpos[first] == pytest.approx(stop, abs=1e-3)  # the gear holds it
    moved = plant.data.qpos[second] - tendon.ratio * stop
    assert moved > 0.05
    assert plant.state().q[motor] == pytest.approx(stop + moved / tendon.slope_after_stop(0), abs=1e-3)
    tau[motor] = -0.5
    for _ in range(1000):
        plant.step(tau)
        if plant.clutches.stops[k] is None:
            break
    assert plant.clutches.stops[k] is None
    for _ in range(20):
        state = plant.step(tau)
    assert plant.data.qpos[second] == pytest.approx(tendon.ratio * plant.data.qpos[first], abs=5e-3)
    assert state.q[motor] < stop

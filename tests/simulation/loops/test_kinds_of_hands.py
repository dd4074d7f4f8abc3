"""Held objects in the closed loop: by jaws that are lifted, on a wrist, and after a breakaway."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.hands import load
from support.simulated_runs import start_of
from support.wrists import with_lift, with_wrist

from graspforce.control import ControlSettings, ObjectController
from graspforce.geometry import Box, Sphere
from graspforce.geometry.shape import Solid
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import GraspSearchOptions, find_grasp
from graspforce.grasp.search.common_joints import own_joints, without_common_joints
from graspforce.hand.hand import Hand
from graspforce.hand.tendon_modes import stop_tendon_joints
from graspforce.simulation.loops.closed_loop import simulate
from graspforce.simulation.loops.reference import constant_reference, linear_reference
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.plants.scene import build_scene
from graspforce.simulation.recordings.metrics import RunMetrics, compute_metrics
from graspforce.simulation.recordings.recording import Recording

BALL, BOX = Sphere(0.03), Box([0.04, 0.05, 0.06])


def hold(hand: Hand, shape: Solid, gravity_H: tuple[float, float, float]) -> RunMetrics:
    """Return the metrics of holding 50 g for 0.3 s."""
    grasp = find_grasp(hand, Body.solid(shape, 0.05), friction=0.7)
    plant = Plant(build_scene(grasp, gravity_H=gravity_H))
    controller = ObjectController(grasp, ControlSettings(gravity_H=gravity_H))
    return compute_metrics(simulate(plant, controller, constant_reference(start_of(grasp)), 0.3))


@pytest.mark.parametrize("gravity_H", [(0.0, 0.0, -9.81), (0.0, 9.81, 0.0), (9.81, 0.0, 0.0)])
@pytest.mark.parametrize("shape", [BALL, BOX], ids=["ball", "box"])
def test_jaws_hold_an_object(shape: Solid, gravity_H: tuple[float, float, float]) -> None:
    """Their object cannot be moved; it settles by the stiffness of contacts and of the coupling of the jaws."""
    metrics = hold(load("parallel_jaws"), shape, gravity_H)
    assert metrics.lost_contact_steps == metrics.slip_steps == 0
    assert metrics.position_error_peak < 1e-4  # m
    assert metrics.min_slip_margin > 0.0


def test_hand_holds_after_a_breakaway() -> None:
    metrics = hold(stop_tendon_joints(load("barrett"), {"finger_3_inner": 1.35}), BALL, (0.0, 0.0, -9.81))
    assert metrics.lost_contact_steps == metrics.slip_steps == 0
    assert metrics.position_error_peak < 1e-4  # m


@pytest.mark.parametrize("slip_margin", [0.5, 8.0])
def test_forces_do_not_open_a_closed_breakaway(slip_margin: float) -> None:
    """A wanted margin of 8 N needs motor torques beyond the threshold: the largest feasible margin is kept instead."""
    grasp = find_grasp(load("barrett"), Body.solid(BALL, 0.05), friction=0.7)
    plant = Plant(build_scene(grasp, gravity_H=(0.0, 0.0, -9.81)))
    controller = ObjectController(grasp, ControlSettings(gravity_H=(0.0, 0.0, -9.81), slip_margin=slip_margin))
    recording = simulate(plant, controller, constant_reference(start_of(grasp)), 0.2)
    assert plant.clutches.stops == [None] * 3
    metrics = compute_metrics(recording)
    assert metrics.lost_contact_steps == metrics.slip_steps == metrics.reused_force_steps == 0
    assert metrics.min_slip_margin > 0.0


def move(grasp: Grasp, displacement: tuple[float, float, float], gravity_H: tuple[float, float, float], T: float) -> Recording:
    """Return the run of a displacement of the object, out and back, in the time T, s."""
    plant = Plant(build_scene(grasp, gravity_H=gravity_H))
    controller = ObjectController(grasp, ControlSettings(gravity_H=gravity_H))
    return simulate(plant, controller, linear_reference(start_of(grasp), displacement, T), T)


@pytest.mark.parametrize("shape", [BALL, BOX], ids=["ball", "box"])
def test_jaws_lift_an_object(shape: Solid, tmp_path: Path) -> None:
    """The jaws point downwards, and a lift raises them by 50 mm and lowers them again in a second."""
    downwards = (0.0, 0.0, 9.81)
    hand = with_lift("parallel_jaws", tmp_path)
    grasp = find_grasp(hand, Body.solid(shape, 0.05), friction=0.7, gravity_H=downwards)
    run = move(grasp, (0.0, 0.0, -0.05), downwards, 1.0)
    metrics = compute_metrics(run)
    assert metrics.lost_contact_steps == metrics.slip_steps == metrics.reused_force_steps == 0
    assert metrics.position_error_peak < 2e-4  # m: stiffness of contacts and of the coupling of the jaws
    assert np.ptp(run.p_HO[:, 2]) == pytest.approx(0.05, abs=2e-4)  # m
    lift = [joint.name for joint in grasp.hand.joints].index("lift")
    assert np.ptp(run.q[:, lift]) == pytest.approx(0.05, abs=1e-3)  # m


def test_hand_on_a_driven_wrist_moves_an_object_as_on_a_locked_one(tmp_path: Path) -> None:
    """The driven wrist is one more joint that moves the object: forces and errors differ by its share of the motion only."""
    gravity_H = (0.0, 0.0, 9.81)  # the palm of this hand points up against it
    hand = with_wrist("allegro_right", "driven", tmp_path)
    options = GraspSearchOptions(travel=0.003)
    driven = find_grasp(hand, Body.solid(BALL, 0.05), ["index", "middle", "thumb"], friction=0.7, options=options)
    locked = replace(driven, hand=without_common_joints(hand, hand.neutral), q=driven.q[own_joints(hand)])
    runs = [move(grasp, (0.0, 0.0, 2e-3), gravity_H, 0.4) for grasp in (driven, locked)]
    for run in runs:
        metrics = compute_metrics(run)
        assert metrics.lost_contact_steps == metrics.slip_steps == metrics.reused_force_steps == 0
        assert metrics.position_error_peak < 5e-5  # m
    assert np.ptp(runs[0].q[:, hand.common_joints[0]]) > 1e-4  # rad: it takes part in the motion
    np.testing.assert_allclose(runs[0].f[0], runs[1].f[0], atol=1e-3)  # N: the wrist takes part in the first acceleration
    np.testing.assert_allclose(runs[0].p_HO, runs[1].p_HO, atol=5e-5)  # m

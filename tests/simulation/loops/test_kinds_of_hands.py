"""Held objects in the closed loop: by jaws, and after a breakaway."""

from __future__ import annotations

import pytest
from support.hands import load
from support.simulated_runs import start_of

from graspforce.control import ControlSettings, ObjectController
from graspforce.geometry import Box, Sphere
from graspforce.geometry.shape import Solid
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.hand.hand import Hand
from graspforce.hand.tendon_modes import stop_tendon_joints
from graspforce.simulation.loops.closed_loop import simulate
from graspforce.simulation.loops.reference import constant_reference
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.plants.scene import build_scene
from graspforce.simulation.recordings.metrics import RunMetrics, compute_metrics

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

"""A ball held with palm and inner links: by the object controller in both plants, against a push."""

from __future__ import annotations

import numpy as np
import pytest
from support.link_grasps import power_grasp

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.simulation import (
    Plant,
    PlantOptions,
    Push,
    UrdfPlant,
    build_scene,
    compute_metrics,
    constant_reference,
    simulate,
)

DURATION, PUSH, MARGIN = 0.25, np.array([1.0, 0.0, 0.0]), 1.5  # s, N, N
START, END = 0.05, 0.15  # s, of the push


@pytest.mark.parametrize("hand_name", ["allegro_right", "dlr_hit2"])
def test_ball_stays_in_place_under_a_push_with_certified_forces(hand_name: str) -> None:
    grasp = power_grasp(hand_name).as_grasp()
    rest, settings = BodyMotion(grasp.p_HO, grasp.R_HO), ControlSettings(slip_margin=MARGIN)
    plant = Plant(build_scene(grasp), disturbances=[Push(PUSH, START, END - START)])
    first = ObjectController(grasp, settings).step(plant.reset(), rest)
    run = simulate(plant, ObjectController(grasp, settings), constant_reference(rest), DURATION, initial_forces=first.f)
    metrics = compute_metrics(run)
    assert metrics.reused_force_steps == 0
    assert metrics.lost_contact_steps == 0
    assert metrics.position_error_peak < 1e-3  # in its place: a fall would be 30 cm
    before = run.t < START
    planned, true = run.planned[before], run.f[before]
    # the motors make every force that is planned; friction that no motor determines creeps in the engine
    assert np.abs(planned - true)[..., 2].max() < 0.02 * planned[..., 2].max()


def test_ball_stays_in_place_in_the_plant_of_the_urdf() -> None:
    grasp = power_grasp("dlr_hit2").as_grasp()
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    plant = UrdfPlant(grasp, PlantOptions(), events=[lambda each: each.push(PUSH) if START < each.t < END else None])
    controller = ObjectController(grasp, ControlSettings(slip_margin=MARGIN))
    run = simulate(plant, controller, constant_reference(rest), DURATION)
    assert compute_metrics(run).reused_force_steps == 0
    assert np.abs(run.p_HO - grasp.p_HO).max() < 1e-3  # m

"""The motion that `graspforce simulate` makes without --travel: one that the fingers can make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from support.control_grasps import named_grasp

from graspforce.cli import main
from graspforce.cli.options import GraspOptions
from graspforce.cli.reference_motion import choose_travel, default_travel, make_reference
from graspforce.cli.simulate_options import SimulateOptions
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.grasp.search import travel_limits
from graspforce.hand.hand import GRAVITY_PALM_UP
from graspforce.simulation import Plant, build_scene, compute_metrics, linear_reference, simulate

GRASPS = ("four_finger box", "allegro_right sphere", "dlr_hit2 sphere")
SPHERE = GraspOptions("four_finger", "sphere:0.03", None, None, None, "0,0,-9.81", 0)
OPTIONS = SimulateOptions(SPHERE, reference="reach", travel=None, period=1.0, duration=1.0, pushes=())
ROUNDING = 1e-5  # m, of the chosen travel


@pytest.fixture(scope="module", params=GRASPS)
def grasp(request):
    return named_grasp(request.param)


def test_travel_is_within_the_limits_of_its_direction(grasp):
    travel, reason = default_travel(grasp)
    distance = float(np.linalg.norm(travel))
    along = [each.distance for each in travel_limits(grasp, 0.01) if each.direction @ np.array(travel) >= 0.999 * distance]
    assert reason if distance == 0.0 else distance <= min(max(along), 0.01) + ROUNDING


def test_travel_is_upwards_unless_a_reason_is_given(grasp):
    travel, reason = default_travel(grasp)
    assert bool(reason) != np.allclose(travel, [0.0, 0.0, 0.01])


def test_sine_stays_within_the_limits_both_ways(grasp):
    travel, _ = default_travel(grasp, is_symmetric=True)
    limits = travel_limits(grasp, 0.01)
    for way in (0.5, -0.5):
        moved = way * np.array(travel)
        limit = max(limits, key=lambda each: float(each.direction @ moved))
        assert np.linalg.norm(moved) <= limit.distance + ROUNDING


def test_fingers_follow_the_default_travel(grasp):
    """The object stays on its path, and no fingertip slips or lets go: 0.2 mm, a fifth of the least travel."""
    travel, _ = default_travel(grasp)
    reference = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), travel, 1.0)
    controller = ObjectController(grasp, ControlSettings(gravity_H=GRAVITY_PALM_UP))
    recording = simulate(Plant(build_scene(grasp, gravity_H=GRAVITY_PALM_UP)), controller, reference, 0.6)
    metrics = compute_metrics(recording)
    assert (metrics.lost_contact_steps, metrics.slip_steps, metrics.reused_force_steps) == (0, 0, 0)
    assert np.linalg.norm(recording.position_error, axis=1).max() < 2e-4


def test_given_travel_is_kept_and_the_chosen_one_is_shown(grasp, capsys):
    console, quiet = Console(), Console(quiet=True)
    given = replace(OPTIONS, travel=(0.001, 0.0, 0.0))
    assert choose_travel(given, grasp, quiet) is given
    chosen = choose_travel(OPTIONS, grasp, console)
    _, reason = default_travel(grasp)
    shown = " ".join(capsys.readouterr().out.split())
    assert reason in shown
    assert bool(reason) == bool(shown)
    assert make_reference(OPTIONS, grasp)(0.5).p_HO == pytest.approx(grasp.p_HO + np.array(chosen.travel))


def test_object_is_held_still_if_the_fingers_cannot_translate_it(capsys):
    """The planar fingers of the Ability hand have no common direction."""
    options = ["--hand", "ability_right", "--object", "sphere:0.025", "--duration", "0.1"]
    assert main(["simulate", *options]) == 0
    assert "held still: the fingers cannot translate it" in " ".join(capsys.readouterr().out.split())

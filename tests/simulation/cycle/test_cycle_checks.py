"""Checks before a cycle: a bound of the fingertips' distance that no posture exceeds, and forces that hold the weight."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import replace

import numpy as np
import pytest

from graspforce.control.settings import ControlSettings
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.hand.hand import Hand
from graspforce.simulation.cycle.cycle_checks import check_size, check_weight, largest_tip_distance
from graspforce.simulation.cycle.plan_cycle import find_cycle
from tests.support.table_scenes import ball_scene

HANDS = ("dlr_hit2", "allegro_right", "dclaw", "leap_right", "barrett", "parallel_jaws", "shadow_right")


@pytest.mark.parametrize("name", HANDS)
def test_no_posture_spreads_fingertips_further(name):
    hand = Hand.load(name)
    rng, bound = np.random.default_rng(0), largest_tip_distance(hand)
    for _ in range(200):
        q = rng.uniform(hand.q_lower, hand.q_upper)
        tips = [(hand.tip_pose(q, finger.name)[0], finger.tip_radius or 0.0) for finger in hand.fingers]
        spread = max(np.linalg.norm(p - o) + r + s for (p, r), (o, s) in itertools.combinations(tips, 2))
        assert spread <= bound * (1.0 + 1e-9)


@pytest.mark.parametrize("shape", [Sphere(0.035), Cylinder(0.033, 0.09), Box((0.06, 0.06, 0.06))])
@pytest.mark.parametrize("name", ["dlr_hit2", "allegro_right", "dclaw", "leap_right"])
def test_objects_of_the_usual_sizes_pass(name, shape):
    check_size(Hand.load(name), Body.solid(shape, 0.1), 0.6)


def test_wide_objects_are_refused_with_their_width():
    hand = Hand.load("dclaw")
    for shape in (Sphere(0.5), Cylinder(0.6, 1.0), Box((1.0, 1.2, 2.0))):
        with pytest.raises(InvalidInput, match="1000 mm wide"):
            check_size(hand, Body.solid(shape, 0.1), 0.6)


def test_shapes_and_friction_without_a_bound_pass():
    hand = Hand.load("dclaw")
    check_size(hand, Body.solid(Superquadric((0.5, 0.5, 0.5), (1.0, 1.0)), 0.1), 0.6)
    check_size(hand, Body.solid(Box((1.0, 1.0, 1.0)), 0.1), 0.9)


def test_long_thin_objects_pass():
    check_size(Hand.load("dclaw"), Body.solid(Cylinder(0.02, 2.0), 0.1), 0.6)


def test_cycle_with_a_wide_object_is_refused_without_a_search():
    """A search of a grasp takes seconds."""
    hand = Hand.load("dclaw")
    start = time.process_time()
    with pytest.raises(InvalidInput, match="apart at most"):
        find_cycle(hand, Body.solid(Sphere(0.5), 0.1))
    assert time.process_time() - start < 0.5


def test_weight_is_held_with_little_friction_only_if_forces_exist():
    """The contacts of the ball are opposed to within atan μ' = 14° for μ = 0.6 (1 − 0.4) and 0.1 rad; with 3° they are not."""
    scene = ball_scene()
    check_weight(scene.grasp, ControlSettings(gravity_H=scene.gravity_H, friction_error=0.4, contact_error=0.1))
    with pytest.raises(InvalidInput, match="do not hold the weight"):
        check_weight(scene.grasp, ControlSettings(gravity_H=scene.gravity_H, friction_error=0.92))


def test_heaviest_assumed_object_must_be_held():
    """An object that is almost too heavy for the motors is accepted with an exact mass, and not with one that may be larger."""
    scene = ball_scene()
    body = scene.grasp.body

    def check(mass: float, error: float) -> None:
        grasp = replace(scene.grasp, body=replace(body, mass=mass, inertia=body.inertia * mass / body.mass))
        check_weight(grasp, ControlSettings(gravity_H=scene.gravity_H, friction_error=0.4, mass_error=error))

    light, heavy = body.mass, 1e3 * body.mass  # kg
    while heavy / light > 1.01:
        middle = math.sqrt(light * heavy)
        try:
            check(middle, 0.0)
        except InvalidInput:
            heavy = middle
        else:
            light = middle
    check(light / 1.6, 0.5)
    with pytest.raises(InvalidInput, match="do not hold the weight"):
        check(light / 1.4, 0.5)

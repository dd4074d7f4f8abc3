"""The search keeps the collision shapes of links apart, and its spheres follow these shapes."""

from __future__ import annotations

import numpy as np
import pytest
from support.hands import SHIPPED_HANDS, load

from benchmarks.link_gaps import least_link_distance
from graspforce.core.arrays import freeze
from graspforce.geometry import Box, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import GraspSearchOptions, find_grasp
from graspforce.grasp.search.link_spheres import cover
from graspforce.hand.collision import HandCollision, LinkShape

OBJECTS = {"ball": Body.solid(Sphere(0.03), 0.05), "box": Body.solid(Box([0.05, 0.05, 0.05]), 0.1)}


@pytest.mark.parametrize("what", OBJECTS)
@pytest.mark.parametrize("name", sorted(set(SHIPPED_HANDS) - {"allegro_left"}))
def test_links_of_found_grasps_do_not_overlap(name: str, what: str) -> None:
    """By Pinocchio's reader and its distances; the links of the touching tips may meet the object."""
    hand = load(name)
    options = GraspSearchOptions(travel=0.0)
    grasp = find_grasp(hand, OBJECTS[what], friction=0.7, gravity_H=(0.0, 0.0, -9.81), seed=2, options=options)
    distance, names = least_link_distance(hand, grasp.q)
    assert distance >= 0.0, names
    touching = [hand.model.carrier_of(hand.finger(finger).tip)[0] for finger in grasp.fingers]
    gaps = HandCollision(hand).object_gaps(grasp.q, grasp.body.shape, grasp.p_HO, grasp.R_HO, touching)
    assert gaps[0].distance >= 0.0


def link_shape(kind: str, size: tuple[float, float, float]) -> LinkShape:
    """Return a shape at the origin of its link."""
    return LinkShape("link", 0, kind, freeze(np.zeros(3)), freeze(np.eye(3)), freeze(size))


@pytest.mark.parametrize("size", [(0.02, 0.028, 0.054), (0.015, 0.015, 0.05), (0.02, 0.13, 0.14), (0.012, 0.012, 0.012)])
def test_spheres_of_a_box_touch_its_sides_and_fill_its_middle(size: tuple[float, float, float]) -> None:
    """h is half the least edge. The spheres of radius h lie inside, at most 1.5 h apart."""
    h = min(size) / 2.0
    centres, radius = cover(link_shape("box", size))
    assert radius == pytest.approx(h)
    middle = np.array(size) / 2.0 - h
    np.testing.assert_allclose(np.abs(centres).max(axis=0), middle, atol=1e-12)
    p = np.random.default_rng(0).uniform(-middle, middle, (2000, 3))
    nearest = np.linalg.norm(p[:, None] - centres, axis=2).min(axis=1)
    assert nearest.max() <= np.sqrt(2.0) * 0.75 * h  # half a cell's diagonal


def test_spheres_of_a_cylinder_have_its_radius_and_end_inside() -> None:
    centres, radius = cover(link_shape("cylinder", (0.016, 0.016, 0.1)))
    assert radius == 0.008
    np.testing.assert_array_equal(centres[:, :2], 0.0)
    assert (centres[0, 2], centres[-1, 2]) == pytest.approx((-0.042, 0.042))
    assert np.diff(centres[:, 2]).max() <= radius * (1 + 1e-12)

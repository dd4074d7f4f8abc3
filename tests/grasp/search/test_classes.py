"""Grasp classes, approach directions, tables and several answers, checked by other means than those of the search."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from graspforce.contact.closure import is_force_closed
from graspforce.contact.contact import ContactModel
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.grasp import Body, Grasp, GraspClass, GraspRank, GraspSearchOptions, find_grasp, find_grasps, measure_grasp
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.grasp.search.batch_kinematics import BatchKinematics
from graspforce.grasp.search.candidates import GeometryRequirements
from graspforce.grasp.search.goal import SearchGoal
from graspforce.grasp.search.grasp_class import ENVELOPING_CLASSES
from graspforce.grasp.search.sampling import sample_candidates
from graspforce.grasp.search.side_conditions import SideConditions
from graspforce.hand.hand import Hand

BAR = Cylinder(0.02, 0.08)
HAND = "dlr_hit2"  # thumb, index, middle, ring, little


@cache
def grasp_of(name: str) -> Grasp:
    """Return a grasp of the bar in a class."""
    options = GraspSearchOptions(grasp_class=name, pad_friction=0.004, travel=0.0)
    return find_grasp(Hand.load(HAND), Body.solid(BAR, 0.05), options=options)


def normals_H(grasp: Grasp) -> dict[str, np.ndarray]:
    """Return the inward normal at each finger, in H."""
    return {name: grasp.R_HO @ grasp.contacts.R_OC[i, :, 2] for i, name in enumerate(grasp.fingers)}


CLASSES = [each.value for each in GraspClass if each.value not in ENVELOPING_CLASSES]
SIZES = {"pinch": 2, "tip-pinch": 2, "adduction-grip": 2, "quadpod": 4, "parallel-extension": 4}


@pytest.mark.parametrize("name", CLASSES)
def test_grasps_of_a_class_are_closed_and_free_of_collisions(name: str) -> None:
    grasp = grasp_of(name)
    assert is_force_closed(grasp.contacts)
    gap = SceneCollision(grasp.hand, grasp.body.shape, grasp.fingers).least_gap(grasp.q, grasp.p_HO, grasp.R_HO)
    assert gap is not None
    assert gap.distance >= 0.0
    assert grasp.contact_errors().max() < 1e-8  # m, of an exact projection


@pytest.mark.parametrize("name", CLASSES)
def test_a_class_has_its_number_of_fingers_and_its_thumb(name: str) -> None:
    grasp = grasp_of(name)
    assert len(grasp.fingers) == SIZES.get(name, 3)
    assert ("thumb" in grasp.fingers) is (name != "adduction-grip")


def test_sampled_contacts_of_opposing_fingers_are_on_opposed_faces() -> None:
    hand, up = Hand.load(HAND), np.array([0.0, 0.0, 1.0])
    requirements = GeometryRequirements(0.002, 0.4, up, np.zeros(3), 0.0, SideConditions(opposing=2))
    goal = SearchGoal(hand, BatchKinematics(hand), Box([0.04, 0.05, 0.08]), (0, 1, 2, 3), requirements)
    face = sample_candidates(goal, np.random.default_rng(0)).face  # the last three of six are opposite to the first three
    assert (face[:, 1:3] == ((face[:, 0] + 3) % 6)[:, None]).all()
    assert (face[:, 3] != (face[:, 0] + 3) % 6).any()


@pytest.mark.parametrize(
    ("name", "count"), [("tip-pinch", 1), ("palmar-pinch", 2), ("lateral-tripod", 1), ("parallel-extension", 3)]
)
def test_opposed_fingers_press_against_the_thumb(name: str, count: int) -> None:
    normals = normals_H(grasp_of(name))
    angles = [np.degrees(np.arccos(np.clip(-normals["thumb"] @ n, -1.0, 1.0))) for k, n in normals.items() if k != "thumb"]
    assert sum(angle <= 25.0 + 1e-6 for angle in angles) >= count


@pytest.mark.parametrize("name", ["pinch", "tip-pinch", "adduction-grip"])
def test_two_fingers_have_soft_contacts(name: str) -> None:
    assert all(contact.model is ContactModel.SOFT for contact in grasp_of(name).contacts.contacts)
    with pytest.raises(InvalidInput, match="two point contacts are never force-closed"):
        find_grasp(Hand.load(HAND), Body.solid(BAR, 0.05), options=GraspSearchOptions(grasp_class=name))


@pytest.mark.parametrize("name", ["tip-pinch", "lateral-tripod", "writing-tripod"])
def test_classes_of_the_index_finger_use_it(name: str) -> None:
    assert "index" in grasp_of(name).fingers


def test_classes_that_do_not_fit_are_refused_with_a_reason() -> None:
    body, hand = Body.solid(Sphere(0.03), 0.05), Hand.load(HAND)
    with pytest.raises(InvalidInput, match="for cylinders"):
        find_grasp(hand, body, options=GraspSearchOptions(grasp_class="writing-tripod"))
    with pytest.raises(InvalidInput, match="barrett"):
        find_grasp(Hand.load("barrett"), body, options=GraspSearchOptions(grasp_class="quadpod"))
    options = GraspSearchOptions(grasp_class="tip-pinch", pad_friction=0.004)
    with pytest.raises(InvalidInput, match="fingers of a tip-pinch"):
        find_grasp(hand, body, ["thumb", "little"], options=options)
    with pytest.raises(InvalidInput, match="tripod"):
        GraspSearchOptions(grasp_class="tripot")


@pytest.mark.parametrize("approach", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_the_palm_faces_the_approach_direction(approach: tuple[float, float, float]) -> None:
    options = GraspSearchOptions(approach_O=approach, palm_normal_H=(0.0, 0.0, 1.0), travel=0.0)
    grasp = find_grasp(Hand.load(HAND), Body.solid(BAR, 0.05), options=options)
    palm_O = grasp.R_HO.T @ [0.0, 0.0, 1.0]
    assert np.degrees(np.arccos(palm_O @ approach)) <= 30.0 + 1e-6


@pytest.mark.parametrize(
    ("shape", "up", "half"), [(BAR, (0.0, 0.0, 1.0), 0.04), (Box((0.05, 0.05, 0.08)), (0.0, 0.0, -2.0), 0.04)]
)
def test_fingertips_stay_above_the_table(shape: Solid, up: tuple[float, float, float], half: float) -> None:
    hand = Hand.load(HAND)
    grasp = find_grasp(hand, Body.solid(shape, 0.05), options=GraspSearchOptions(up_O=up, travel=0.0))
    direction = np.array(up) / np.linalg.norm(up)
    for finger in hand.fingers:
        p_O = grasp.R_HO.T @ (hand.tip_pose(grasp.q, finger.name)[0] - grasp.p_HO)
        assert p_O @ direction - (finger.tip_radius or 0.0) > -half + 0.0019  # m: the clearance of 2 mm, to rounding


def test_several_grasps_are_different_ranked_and_reproducible() -> None:
    hand, body = Hand.load(HAND), Body.solid(Sphere(0.03), 0.05)
    options = GraspSearchOptions(travel=0.0)
    found = find_grasps(hand, body, 3, rank="robustness", options=options, seed=4)
    assert len(found) == 3
    values = [each.measures.value(GraspRank.ROBUSTNESS) for each in found]
    assert values == sorted(values, reverse=True)
    again = find_grasp(hand, body, options=options, seed=found[0].seed)
    assert np.array_equal(again.q, found[0].grasp.q)
    points = [(each.grasp.fingers, each.grasp.p_HO + each.grasp.contacts.p_OC @ each.grasp.R_HO.T) for each in found]
    for i in range(3):
        for j in range(i):
            same = points[i][0] == points[j][0]
            assert not same or np.abs(points[i][1] - points[j][1]).max() > 0.005


def test_measures_of_a_ball_do_not_depend_on_its_orientation() -> None:
    grasp = find_grasp(Hand.load(HAND), Body.solid(Sphere(0.03), 0.05), options=GraspSearchOptions(travel=0.0))
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    contacts = type(grasp.contacts).stack(
        [type(c)(R @ c.position, R @ c.normal, c.friction, max_normal=c.max_normal) for c in grasp.contacts.contacts]
    )
    turned = Grasp(grasp.hand, grasp.body, grasp.fingers, contacts, grasp.q, grasp.p_HO, grasp.R_HO @ R.T)
    a, b = measure_grasp(grasp), measure_grasp(turned)
    assert (a.margin, a.robustness) == pytest.approx((b.margin, b.robustness), rel=1e-5)
    assert a.clearance == pytest.approx(b.clearance, abs=1e-6)

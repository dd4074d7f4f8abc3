"""Grasps with contacts on inner links and the palm: they touch without overlap, are closed, and bear weight."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import graspforce as gf
from graspforce.contact.closure import is_force_closed
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.grasp.link_grasp import LinkGrasp
from graspforce.grasp.search import GraspClass, GraspSearchOptions, find_grasp, find_link_grasp
from graspforce.grasp.search.batch_kinematics import BatchKinematics
from graspforce.grasp.search.closing import TouchScene
from graspforce.view import show

MASS, FRICTION, PADS = 0.05, 0.6, 0.004  # kg; coefficient; m
CASES: dict[str, tuple[str, Solid, str, float | None]] = {
    "ball in the Allegro hand": ("allegro_right", Sphere(0.03), "power", None),
    "ball in the DLR hand": ("dlr_hit2", Sphere(0.03), "power", None),
    "small ball in the four-finger hand": ("four_finger", Sphere(0.027), "power", PADS),
    "plate in the Allegro hand": ("allegro_right", Box([0.06, 0.014, 0.029]), "power", PADS),
    "pen at the index finger": ("allegro_right", Cylinder(0.008, 0.08), "lateral", PADS),
    "plate at the index finger": ("dlr_hit2", Box([0.06, 0.014, 0.029]), "lateral", PADS),
    "ball at the index finger": ("leap_right", Sphere(0.027), "lateral", PADS),
    "cube at the first finger": ("shadow_right", Box([0.03, 0.03, 0.03]), "lateral", PADS),
}


@cache
def found(case: str) -> LinkGrasp:
    """Return the grasp of a case."""
    hand, shape, name, pads = CASES[case]
    options = GraspSearchOptions(pad_friction=pads)
    return find_link_grasp(gf.Hand.load(hand), gf.Body.solid(shape, MASS), name, friction=FRICTION, options=options)


@pytest.mark.parametrize("case", CASES)
def test_links_touch_the_object_and_overlap_nothing(case: str) -> None:
    grasp, shape = found(case), CASES[case][1]
    scene = TouchScene(grasp.hand, BatchKinematics(grasp.hand).collision, shape)
    gaps, _ = scene.object_gaps(grasp.q, grasp.p_HO, grasp.R_HO)
    names = [body.name for body in scene.bodies[:-1]]
    assert min(gaps.min(), scene.link_gap(grasp.q)) > -2e-6  # m
    for link in grasp.links:
        assert min(gap for gap, name in zip(gaps, names, strict=True) if name == link) < 1e-5  # m
    assert np.abs(shape.phi(grasp.contacts.p_OC)).max() < 1e-9
    np.testing.assert_allclose(shape.inward_normal(grasp.contacts.p_OC), grasp.contacts.R_OC[:, :, 2], atol=1e-9)
    assert (grasp.q >= grasp.hand.q_lower).all()
    assert (grasp.q <= grasp.hand.q_upper).all()


@pytest.mark.parametrize("case", CASES)
def test_grasp_is_closed_and_its_forces_are_certified_in_six_directions(case: str) -> None:
    grasp = found(case)
    assert is_force_closed(grasp.contacts)
    for g in 9.81 * np.vstack([np.eye(3), -np.eye(3)]):
        solution = gf.solve(grasp.force_problem(g))
        assert solution.found
        assert solution.certificate.verified


def test_power_grasps_touch_with_the_palm_and_several_links_of_a_finger() -> None:
    grasp = found("ball in the DLR hand")
    fingers = [link.split("_")[0] for link in grasp.links]
    assert "palm" in grasp.links
    assert len(set(fingers) - {"palm"}) >= 2
    assert max(fingers.count(name) for name in fingers) >= 2


def test_a_plate_on_the_palm_has_contacts_near_the_ends_of_one_face() -> None:
    grasp = found("plate in the Allegro hand")
    on_palm = [i for i, link in enumerate(grasp.links) if link == "palm_link"]
    normals, points = grasp.contacts.R_OC[on_palm, :, 2], grasp.contacts.p_OC[on_palm]
    assert len(on_palm) >= 3
    np.testing.assert_allclose(normals, normals[:1].repeat(len(on_palm), axis=0), atol=1e-9)
    assert np.ptp(points @ normals[0]) < 1e-6  # m, in one plane
    assert np.ptp(points, axis=0).max() > 0.01  # m, along the face


@pytest.mark.parametrize("case", [name for name, case in CASES.items() if case[2] == "lateral"])
def test_lateral_grasps_hold_between_thumb_and_index_finger_on_the_side_away_from_the_others(case: str) -> None:
    grasp = found(case)
    hand, names = grasp.hand, [finger.name for finger in grasp.hand.fingers]
    thumb, first = names.index("thumb"), next(i for i, name in enumerate(names) if name in ("index", "first"))
    kinematics = BatchKinematics(hand)
    frames = [hand.model.carrier_of(link)[0] for link in grasp.links]
    at_thumb = [i for i, frame in enumerate(frames) if frame in kinematics.own_links[thumb]]
    at_first = [i for i, frame in enumerate(frames) if frame in kinematics.own_links[first]]
    assert at_thumb
    assert at_first
    motion = kinematics.evaluate(grasp.q[None])
    outwards = motion.R_HL[kinematics.own_links[first][-1]][0] @ kinematics.links[kinematics.own_links[first][-1]].axis
    outwards = outwards * np.sign(outwards @ (motion.tip_centres[0, first] - motion.tip_centres[0, names.index("middle")]))
    normals = grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
    assert max(normals[i] @ outwards for i in at_first) > -0.1  # from the finger into the object
    assert min(normals[i] @ normals[j] for i in at_thumb for j in at_first) < -0.8


def test_equal_seeds_give_equal_grasps_and_files_return_them(tmp_path: Path) -> None:
    grasp = found("ball in the Allegro hand")
    again = find_link_grasp(grasp.hand, grasp.body, GraspClass.POWER, friction=FRICTION)
    np.testing.assert_array_equal(again.q, grasp.q)
    grasp.save(tmp_path / "power.json")
    loaded = LinkGrasp.load(tmp_path / "power.json")
    assert loaded.to_dict() == grasp.to_dict()
    with pytest.raises(InvalidInput, match="allegro_right, the hand of the grasp"):
        LinkGrasp.load(tmp_path / "power.json", gf.Hand.load("dlr_hit2"))


def test_picture_shows_links() -> None:
    grasp = found("ball in the Allegro hand")
    figure = show(grasp, gf.solve(grasp.force_problem()))
    assert f"{len(set(grasp.links))} links" in figure.axes[0].get_title()


def test_refusals_name_the_class() -> None:
    hand, body = gf.Hand.load("four_finger"), gf.Body.solid(Sphere(0.03), MASS)
    with pytest.raises(InvalidInput, match="four_finger has no thumb"):
        find_link_grasp(hand, body, "lateral")
    with pytest.raises(InvalidInput, match=r"must be .*power.*lateral"):
        find_link_grasp(hand, body, "pinch")
    with pytest.raises(InvalidInput, match="find_link_grasp finds this one"):
        find_grasp(hand, body, options=GraspSearchOptions(grasp_class="power"))
    with pytest.raises(InvalidInput, match="best candidate"):
        find_link_grasp(hand, gf.Body.solid(Sphere(0.002), MASS), "power", options=GraspSearchOptions(budget=0.2))

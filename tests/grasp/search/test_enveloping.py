"""Grasps with contacts on inner links and the palm: they touch without overlap, are closed, and bear weight."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import graspforce as gf
from graspforce.contact.closure import is_force_closed
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Cylinder, Solid, Sphere
from graspforce.grasp.link_grasp import LinkGrasp
from graspforce.grasp.search import GraspClass, GraspSearchOptions, find_grasp, find_link_grasp
from graspforce.grasp.search.batch_kinematics import BatchKinematics
from graspforce.grasp.search.closing import TouchScene
from graspforce.view import show

MASS, FRICTION, PADS = 0.05, 0.6, 0.004  # kg; coefficient; m
CASES: dict[str, tuple[str, Solid, str, float | None]] = {
    "ball in the Allegro hand": ("allegro_right", Sphere(0.03), "power", None),
    "ball in the DLR hand": ("dlr_hit2", Sphere(0.03), "power", None),
    "pen at the index finger": ("allegro_right", Cylinder(0.008, 0.08), "lateral", PADS),
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


def test_lateral_grasps_touch_with_the_thumb_and_the_index_finger() -> None:
    links = found("pen at the index finger").links
    thumb, index = ("link_12", "link_13", "link_14", "link_15"), ("link_0.", "link_1.", "link_2.", "link_3.")
    assert any(link.startswith(thumb) for link in links)
    assert any(link.startswith(index) for link in links)


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

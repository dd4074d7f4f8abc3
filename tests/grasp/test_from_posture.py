"""Grasps of postures from elsewhere: the inverse of a search, repair of small gaps, and refusals in words."""

from __future__ import annotations

import re
from functools import lru_cache

import numpy as np
import pytest
from support.hands import load

from graspforce.contact.closure import is_force_closed
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.geometry import Box, Cylinder, Solid, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.posture_repair import PostureOptions
from graspforce.grasp.search import find_grasp

SHAPES: dict[str, Solid] = {
    "sphere": Sphere(0.03),
    "box": Box(np.array([0.05, 0.05, 0.06])),
    "cylinder": Cylinder(0.025, 0.08),
    "superquadric": Superquadric((0.03, 0.025, 0.04), (0.8, 0.9)),
}
HANDS = ("allegro_right", "dlr_hit2")
OPTIONS = PostureOptions(friction=0.7)


@lru_cache
def found(hand: str, shape: str) -> Grasp:
    return find_grasp(load(hand), Body.solid(SHAPES[shape], 0.05), friction=0.7)


def from_posture(grasp: Grasp, q: Array, options: PostureOptions = OPTIONS, fingers: list[str] | None = None) -> Grasp:
    return Grasp.from_posture(grasp.hand, grasp.body, q, grasp.p_HO, grasp.R_HO, fingers, options=options)


def tips(grasp: Grasp, q: Array) -> Array:
    return np.array([grasp.hand.tip_pose(q, name)[0] for name in grasp.fingers])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("hand", HANDS)
def test_the_posture_of_a_found_grasp_gives_this_grasp(hand: str, shape: str) -> None:
    grasp = found(hand, shape)
    same = from_posture(grasp, grasp.q)
    assert same.fingers == grasp.fingers
    np.testing.assert_allclose(same.q, grasp.q, atol=1e-8)  # rad; the search ends within a nanometre of contact
    np.testing.assert_allclose(same.contacts.p_OC, grasp.contacts.p_OC, atol=2e-9)
    np.testing.assert_allclose(same.contacts.R_OC[:, :, 2], grasp.contacts.R_OC[:, :, 2], atol=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("hand", HANDS)
def test_perturbed_postures_return_to_contact_or_are_refused_with_a_reason(hand: str, shape: str) -> None:
    grasp, rng, accepted, reasons = found(hand, shape), np.random.default_rng(5), 0, list[str]()
    scene = SceneCollision(grasp.hand, grasp.body.shape, grasp.fingers)
    for _ in range(12):
        q = grasp.q + rng.normal(0.0, 0.02, grasp.hand.n)
        try:
            repaired = from_posture(grasp, q, fingers=list(grasp.fingers))
        except InvalidInput as error:
            reasons.append(str(error))
            continue
        accepted += 1
        assert repaired.contact_errors().max() < 1e-9
        assert np.linalg.norm(tips(repaired, repaired.q) - tips(repaired, q), axis=1).max() <= OPTIONS.repair + 1e-8
        assert is_force_closed(repaired.contacts)
        gap = scene.least_gap(repaired.q, repaired.p_HO, repaired.R_HO)
        assert gap is not None
        assert gap.distance >= 0.0
        assert (repaired.q >= grasp.hand.q_lower).all()
        assert (repaired.q <= grasp.hand.q_upper).all()
    assert all(re.search(r"\d\.\d mm|force-closed|edge", reason) for reason in reasons)
    assert accepted >= 4  # 0.02 rad move a tip at 100 mm by about 2 mm a joint, well below the limit of 5 mm


def test_repaired_posture_is_a_fixed_point() -> None:
    grasp = found("allegro_right", "cylinder")
    once = from_posture(grasp, grasp.q + 0.005)
    twice = from_posture(grasp, once.q)
    np.testing.assert_allclose(twice.q, once.q, atol=1e-8)
    np.testing.assert_allclose(twice.contacts.p_OC, once.contacts.p_OC, atol=1e-9)


def test_repair_moves_only_touching_fingers() -> None:
    grasp = found("allegro_right", "sphere")
    q = grasp.q + 0.005
    repaired = from_posture(grasp, q)
    idle = [j for finger in grasp.hand.fingers if finger.name not in grasp.fingers for j in finger.joints]
    assert (repaired.q[idle] == np.clip(q, grasp.hand.q_lower, grasp.hand.q_upper)[idle]).all()
    assert (repaired.q != q).any()


def test_far_fingers_are_named_with_their_distances() -> None:
    grasp = found("allegro_right", "sphere")
    away = grasp.p_HO + np.array([0.0, 0.0, 0.3])
    with pytest.raises(InvalidInput) as caught:
        Grasp.from_posture(grasp.hand, grasp.body, grasp.q, away, grasp.R_HO)
    for finger in grasp.hand.fingers:
        centre = grasp.hand.tip_pose(grasp.q, finger.name)[0]
        distance = np.linalg.norm(centre - away) - 0.03 - (finger.tip_radius or 0.0)
        assert f"{finger.name} is {1e3 * distance:.1f} mm from the object, more than the 5 mm" in str(caught.value)


def test_a_tip_deep_inside_is_refused() -> None:
    grasp = found("allegro_right", "sphere")
    bigger = Body.solid(Sphere(0.045), 0.05)
    with pytest.raises(InvalidInput, match=r"15\.0 mm inside the object, more than the 5 mm"):
        Grasp.from_posture(grasp.hand, bigger, grasp.q, grasp.p_HO, grasp.R_HO)


def test_a_link_inside_the_object_is_refused() -> None:
    grasp = found("dlr_hit2", "sphere")
    thumb, index = grasp.fingers[:2]
    long = Body.solid(Box(np.array([0.02, 0.02, 0.6])), 0.05)
    p = tips(grasp, grasp.q)[:2].mean(axis=0)  # between two tips, and through the palm
    with pytest.raises(InvalidInput, match=r"and the object overlap by \d+\.\d mm"):
        Grasp.from_posture(
            grasp.hand, long, grasp.q, p, np.eye(3), [thumb, index], options=PostureOptions(repair=0.1, friction=0.7)
        )


def test_contacts_without_closure_are_refused_with_the_fingers_that_do_not_touch() -> None:
    grasp = found("allegro_right", "sphere")
    away, *others = grasp.fingers  # the index finger is stretched; the other two have no pads
    q = grasp.q.copy()
    q[list(grasp.hand.finger(away).joints)] = 0.0
    with pytest.raises(InvalidInput, match=rf"{', '.join(others)} are not force-closed; {away} is \d+\.\d mm from the object"):
        from_posture(grasp, q)


def test_no_repair_leaves_only_exact_contacts() -> None:
    grasp = found("allegro_right", "box")
    q = grasp.q.copy()
    q[list(grasp.hand.finger(grasp.fingers[0]).joints)] += 0.01
    with pytest.raises(InvalidInput, match="mm"):
        from_posture(grasp, q, PostureOptions(repair=0.0, friction=0.7), list(grasp.fingers))


def test_arguments_are_checked() -> None:
    grasp = found("allegro_right", "sphere")
    with pytest.raises(UnknownName):
        from_posture(grasp, grasp.q, fingers=["claw"])
    point = Body(0.05, 1e-5 * np.eye(3))
    with pytest.raises(InvalidInput, match=r"body\.shape"):
        Grasp.from_posture(grasp.hand, point, grasp.q, grasp.p_HO, grasp.R_HO)
    with pytest.raises(InvalidInput, match=r"^q"):
        from_posture(grasp, grasp.q[:3])
    with pytest.raises(InvalidInput, match=r"^repair"):
        PostureOptions(repair=-1.0)

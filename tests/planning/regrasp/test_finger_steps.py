"""Places that fingers can touch, their steps, and the margins of the fingers that hold."""

from __future__ import annotations

import numpy as np
import pytest
from support.regrasp_plans import finger_stage, start_state, turn_task

from graspforce.contact.contact import Contact
from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.geometry.minimum_jerk import minimum_jerk
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.hand.hand import Hand
from graspforce.planning.path.paths import JointPath
from graspforce.planning.regrasp.contact_candidates import CandidateOptions, ContactCandidates
from graspforce.planning.regrasp.finger_step import FingerStepPlanner, step_duration, tip_positions
from graspforce.planning.regrasp.holding import HoldingMargin
from graspforce.planning.regrasp.tip_paths import follow_tip, reach_places

NAMES = ["four_finger sphere", "four_finger box", "allegro_right sphere"]


@pytest.mark.parametrize("name", NAMES)
def test_places_touch_the_surface_within_limits_and_apart(name: str) -> None:
    """At each place the tip is its radius away from the surface, and away from the other tips."""
    task = turn_task(0.1, name)
    hand, shape, at, motion = task.grasp.hand, task.shape, start_state(task), task.path.motion(0.0)
    scene, spacing = SceneCollision(hand, shape, at.fingers), 0.002
    places = ContactCandidates(hand, shape, at.fingers, at.contacts.contacts, CandidateOptions(spacing, scene))
    count = 0
    for finger in at.fingers:
        others = [other for other in at.fingers if other != finger]
        radius, joints = hand.finger(finger).tip_radius, list(hand.finger(finger).joints)
        for candidate in places.find(finger, motion, at.q, others, 10, np.random.default_rng(1)):
            q = np.array(at.q)
            q[joints] = candidate.q
            tip = hand.tip_pose(q, finger)[0]
            contact = candidate.contact
            np.testing.assert_allclose((tip - motion.p_HO) @ motion.R_HO, contact.position - radius * contact.normal, atol=1e-5)
            assert shape.phi(contact.position[None])[0] == pytest.approx(0.0, abs=1e-9)
            assert (q >= hand.q_lower).all()
            assert (q <= hand.q_upper).all()
            for other in others:
                gap = np.linalg.norm(tip - hand.tip_pose(at.q, other)[0]) - radius - hand.finger(other).tip_radius
                assert gap > spacing - 1e-5
            count += 1
    assert count > 0


@pytest.mark.parametrize("name", ["four_finger sphere", "four_finger box"])
def test_step_leaves_the_surface_and_moves_one_finger(name: str) -> None:
    """Between lift and arrival the tip is above the surface; the joints of the other fingers stay."""
    task = turn_task(0.1, name)
    hand, at, motion = task.grasp.hand, start_state(task), task.path.motion(0.0)
    stage = finger_stage(task, at)
    radius, joints = hand.finger(stage.finger).tip_radius, list(hand.finger(stage.finger).joints)
    tips = np.array([hand.tip_pose(q, stage.finger)[0] for q in stage.postures])
    heights = task.shape.phi((tips - motion.p_HO) @ motion.R_HO) - radius
    np.testing.assert_allclose(heights[[0, -1]], 0.0, atol=1e-5)
    path = JointPath.through(stage.postures).points(np.linspace(0.0, 1.0, 501)).q  # as the controller follows it
    along = task.shape.phi((hand.tips_along(path, [stage.finger])[0][:, 0] - motion.p_HO) @ motion.R_HO) - radius
    assert along.min() > -1.001e-4  # elastic tips may touch at the ends
    assert along[200:301].min() > 0.0015
    others = [j for j in range(hand.n) if j not in joints]
    np.testing.assert_array_equal(stage.postures[:, others], np.tile(at.q[others], (len(stage.postures), 1)))


@pytest.mark.parametrize("shape", [Box([0.05, 0.05, 0.08]), Sphere(0.03), Cylinder(0.03, 0.06)])
@pytest.mark.parametrize("beside", [[0.012, -0.04, 0.02], [0.04, 0.01, 0.01], [-0.01, 0.04, -0.02]])
def test_tip_keeps_its_height_on_the_way_to_any_side(shape: Solid, beside: list[float]) -> None:
    """Also where the straight line between the ends goes through the object."""
    radius, height = 0.008, 0.006  # m
    places = [shape.project_to_surface(np.array(each)) for each in ([-0.005, -0.04, 0.01], beside)]  # m
    contacts = [Contact(p, shape.inward_normal(p), 0.8) for p in places]
    tips = tip_positions(shape, radius, (contacts[0], contacts[1]), height)
    heights = shape.phi(tips) - radius
    np.testing.assert_allclose(heights[[0, -1]], 0.0, atol=1e-6)
    from_ends = np.linalg.norm(tips[:, None] - tips[[0, -1]], axis=2).min(axis=1)  # m
    assert (heights > 0.3 * np.minimum(from_ends, height) - 1e-4).all()


def test_step_to_the_same_place_is_refused() -> None:
    """The tip would rest above the surface: no path of the joints leads through equal postures."""
    task = turn_task(0.1)
    at, motion = start_state(task), task.path.motion(0.0)
    contact = at.contacts.contacts[0]
    planner = FingerStepPlanner(task.grasp.hand, task.shape, None)
    assert planner.plan(at.fingers[0], motion, at.q, contact, contact) is None


def test_duration_of_a_step_keeps_the_limits_of_joint_rates_and_torque_rates() -> None:
    """One of three limits is reached: the least duration, a joint rate or a torque rate; T³ is inverse to the torque rate."""
    task = turn_task(0.1)
    hand = task.grasp.hand
    postures = finger_stage(task, start_state(task)).postures
    fast = np.full(hand.n, 1e3)  # rad/s
    durations = [step_duration(hand, postures, fast, torque_rate) for torque_rate in (0.01, 0.08)]
    assert durations[0] / durations[1] == pytest.approx(2.0)
    slow = step_duration(hand, postures, np.full(hand.n, 0.1), 1e9)
    assert step_duration(hand, postures, np.full(hand.n, 0.05), 1e9) == pytest.approx(2.0 * slow)
    path, t = JointPath.through(postures), np.linspace(0.0, durations[0], 2000)
    s, rate, acceleration = np.array([minimum_jerk(each, durations[0]) for each in t]).T
    points = path.points(s)
    torque = (acceleration[:, None] * points.q_s + rate[:, None] ** 2 * points.q_ss) @ hand.mass_matrix(postures[0])
    largest = np.abs(np.diff(torque, axis=0)).max() / t[1]
    assert largest == pytest.approx(0.01, rel=0.05)  # sampled at other instants


def test_fewer_fingers_hold_with_a_smaller_margin() -> None:
    """A force of zero is allowed at each contact with the margin of the others only if it is not needed."""
    task = turn_task()
    at = start_state(task)
    holding = HoldingMargin(task.grasp.hand, task.grasp.body, task.path, task.control, 100.0)
    full = holding.find(at)
    assert full > 0.0
    assert holding.find(at.only([at.fingers[0]])) < 0.0  # one finger holds nothing
    limit = HoldingMargin(task.grasp.hand, task.grasp.body, task.path, task.control, 0.05)
    assert limit.find(at) <= 0.05


def test_tip_follows_places_and_reports_those_out_of_reach() -> None:
    task = turn_task()
    hand, q, finger = task.grasp.hand, task.grasp.q, task.grasp.fingers[0]
    start = hand.tip_pose(q, finger)[0]
    places = start + np.linspace(0.0, 0.01, 6)[:, None] * np.array([0.0, 0.0, 1.0])
    postures = follow_tip(hand, finger, q, places)
    assert postures is not None
    found = np.array([hand.tip_pose(each, finger)[0] for each in postures])
    np.testing.assert_allclose(found, places, atol=1e-6)
    far = np.array([start, start + np.array([1.0, 0.0, 0.0])])
    assert follow_tip(hand, finger, q, far) is None
    _, reached = reach_places(hand, finger, np.array([q, q]), far)
    assert reached.tolist() == [True, False]


def test_links_belong_to_the_finger_that_alone_moves_them() -> None:
    """Each link of a finger names that finger; the palm and the object name none."""
    task = turn_task(0.1)
    scene = SceneCollision(task.grasp.hand, task.shape, task.grasp.fingers)
    owners = {body.name: scene.finger_of(body.name, task.grasp.fingers) for body in scene.bodies}
    assert owners["object"] is None
    assert owners[task.grasp.hand.palm] is None
    assert {owner for owner in owners.values() if owner is not None} == set(task.grasp.fingers)
    for finger in task.grasp.fingers:
        assert owners[scene.bodies[_tip_body(scene, task.grasp.hand, finger)].name] == finger


def _tip_body(scene: SceneCollision, hand: Hand, finger: str) -> int:
    """Return the index of a body on the link that carries a fingertip."""
    frame = next(tip.link for tip in hand.tree().tips if tip.finger == finger)
    return next(i for i, body in enumerate(scene.bodies) if body.frame == frame)

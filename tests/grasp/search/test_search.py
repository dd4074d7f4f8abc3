"""Grasps found by the search meet every requirement, checked by other means than those of the search."""

from __future__ import annotations

import dataclasses
import itertools
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graspforce import ContactSet, ForceProblem, Hand, InvalidInput, Objective, Status, solve
from graspforce.contact.closure import is_force_closed
from graspforce.contact.motion import BodyMotion
from graspforce.core.errors import UnknownName
from graspforce.geometry import Box, Cylinder, ImplicitSurface, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import GraspSearchOptions, GraspSearchProgress, find_grasp, travel_limits
from graspforce.grasp.search.batch_kinematics import BatchKinematics, rotations
from graspforce.grasp.search.faces import face_distances
from graspforce.hand.descriptions.description import shipped_hands
from graspforce.problems.objects import GraspObject, ist_objects

OBJECTS = {each.name: each for each in ist_objects()}
IST_OBJECTS = ("big green ball", "large blue box", "small red cylinder")  # a sphere, a box, a cylinder
GRAVITIES = 9.81 * np.vstack([np.eye(3), -np.eye(3)])  # m/s²
PALM_NORMALS = {"allegro_left": (1, 0, 0), "allegro_right": (1, 0, 0)}  # in H; z for the other hands
# other hands: test_shipped_hands.py
MULTI_FINGER_HANDS = ("allegro_right", "anthropomorphic15", "dlr_hit2", "four_finger")
CLEARANCE, EDGE_RATIO, SLIP_MARGIN = 0.002, 0.4, 0.05  # m, of the tip radius, N: the defaults of `find_grasp`


def body_of(grasp_object: GraspObject) -> Body:
    """Return the body of an IST object."""
    return Body(grasp_object.mass, grasp_object.inertia, grasp_object.com, grasp_object.shape)


@cache
def find_object_grasp(hand: str, name: str) -> Grasp:
    """Return the grasp of an IST object with default options."""
    return find_grasp(Hand.load(hand), body_of(OBJECTS[name]), friction=OBJECTS[name].friction)


@pytest.fixture(params=list(itertools.product(MULTI_FINGER_HANDS, IST_OBJECTS)), ids="-".join)
def grasp(request) -> Grasp:
    return find_object_grasp(*request.param)


def test_tips_touch_inside_faces_along_the_surface_normals(grasp: Grasp) -> None:
    np.testing.assert_allclose(grasp.contact_errors(), 0.0, atol=1e-8)  # m
    shape, contacts = grasp.body.shape, grasp.contacts
    np.testing.assert_allclose(shape.inward_normal(contacts.p_OC), contacts.R_OC[:, :, 2], atol=1e-9)
    radius = np.array([grasp.hand.finger(name).tip_radius for name in grasp.fingers])
    for i, (p, R) in enumerate(zip(contacts.p_OC, contacts.R_OC, strict=True)):  # the face continues around the contact
        ring = p + (EDGE_RATIO - 1e-6) * radius[i] * np.array(
            [np.cos(k) * R[:, 0] + np.sin(k) * R[:, 1] for k in np.arange(16.0)]
        )
        if not isinstance(shape, Sphere):
            # on a cylinder the normal turns along the ring: by less than half a radian on these
            assert (shape.inward_normal(shape.project_to_surface(ring)) @ R[:, 2] > np.cos(0.5)).all()


def test_contacts_are_force_closed_and_support_the_weight_in_six_directions(grasp: Grasp) -> None:
    assert is_force_closed(grasp.contacts)
    for g in GRAVITIES:
        w = grasp.body.wrench(BodyMotion(grasp.p_HO, grasp.R_HO), g)
        actuation = grasp.hand.actuation(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO, gravity_H=g)
        solution = solve(ForceProblem(grasp.contacts, w, actuation))
        assert solution.status is Status.OPTIMAL
        assert solution.certificate.verified
        assert (np.abs(solution.torques) <= grasp.hand.torque_upper * (1 + 1e-7)).all()
        margin = solve(ForceProblem(grasp.contacts, w, actuation, objective=Objective("margin")), backend="clarabel")
        assert margin.certificate.verified
        assert margin.objective >= SLIP_MARGIN * (1 - 1e-6)  # another solver


def test_joints_and_followers_keep_a_margin_from_their_limits(grasp: Grasp) -> None:
    hand = grasp.hand
    required = 0.049 * (hand.q_upper - hand.q_lower)  # 5 %, minus the projection onto the surface
    used = [j for name in grasp.fingers for j in hand.finger(name).joints]
    margin = np.minimum(grasp.q - hand.q_lower, hand.q_upper - grasp.q)
    assert (margin >= 0.0).all()
    assert (margin >= required)[used].all()
    x, links = hand.T @ grasp.q + hand.q0, hand.tree().links
    assert all(link.lower <= angle <= link.upper for link, angle in zip(links, x, strict=True))


def test_fingers_palm_and_object_keep_the_clearance(grasp: Grasp) -> None:
    hand = grasp.hand
    tips = {finger.name: hand.tip_pose(grasp.q, finger.name)[0] for finger in hand.fingers}
    for one, other in itertools.combinations(hand.fingers, 2):
        apart = np.linalg.norm(tips[one.name] - tips[other.name]) - one.tip_radius - other.tip_radius
        assert apart >= CLEARANCE - 1e-9
    for finger in hand.fingers:
        if finger.name not in grasp.fingers:
            p_O = grasp.R_HO.T @ (tips[finger.name] - grasp.p_HO)
            assert grasp.body.shape.phi(p_O) >= finger.tip_radius + CLEARANCE - 1e-9
    surface = grasp.body.shape.project_to_surface(0.3 * np.random.default_rng(5).normal(size=(3000, 3)))
    height = (grasp.p_HO + surface @ grasp.R_HO.T) @ np.array(PALM_NORMALS.get(hand.name, (0, 0, 1)))
    assert height.min() >= CLEARANCE - 1e-4  # m; the search uses 400 points of the hull


COMMON_DIRECTIONS = {"anthropomorphic15": 1}  # of its planar fingers with the thumb; 3 for the other hands


def test_fingers_can_move_the_object_along_each_axis(
    grasp: Grasp,
) -> None:
    """By Euler steps with Pinocchio's Jacobians: the tips touch the moved object, and joints keep their limits."""
    hand, N, travel = grasp.hand, len(grasp.fingers), 0.005
    limits = travel_limits(grasp, travel)
    assert len(limits) == 2 * COMMON_DIRECTIONS.get(hand.name, 3)
    used = [j for name in grasp.fingers for j in hand.finger(name).joints]
    for limit in limits:
        assert limit.distance == pytest.approx(travel)
        assert not limit.reason
        q, p, steps = np.array(grasp.q), np.array(grasp.p_HO), 40
        for _ in range(steps):
            A = _contact_jacobian(grasp, q, p)
            q = q + np.linalg.lstsq(A, np.tile(limit.direction * limit.distance / steps, N), rcond=None)[0]
            p = p + limit.direction * limit.distance / steps
        tips = [hand.tip_pose(q, name)[0] for name in grasp.fingers]
        gaps = [grasp.body.shape.phi(grasp.R_HO.T @ (tip - p)) for tip in tips]
        radii = [hand.finger(name).tip_radius for name in grasp.fingers]
        # error of Euler steps: travel²/(2 steps r) by the curvature of the tip, and at most as much by the finger
        np.testing.assert_allclose(np.ravel(gaps), radii, atol=travel**2 / (steps * min(radii)))
        margin = np.minimum(q - hand.q_lower, hand.q_upper - q)[used]
        assert margin.min() > 0.01  # rad; 0.02 by `travel_limits`, which returns redundant joints to the start


def _contact_jacobian(grasp: Grasp, q: np.ndarray, p_HO: np.ndarray) -> np.ndarray:
    """Return the Jacobian of the contact points (3 N, n), by Pinocchio."""
    rows = []
    for name in grasp.fingers:
        tip, finger = grasp.hand.tip_pose(q, name)[0], grasp.hand.finger(name)
        n_H = grasp.R_HO @ grasp.body.shape.inward_normal(grasp.body.shape.project_to_surface(grasp.R_HO.T @ (tip - p_HO)))
        rows.append(grasp.hand.point_jacobian(q, name, tip + finger.tip_radius * n_H)[:3])
    return np.vstack(rows)


def as_soft(points: Grasp) -> Grasp:
    """Return the grasp with soft contacts."""
    soft = [dataclasses.replace(each, model="soft", torsional_friction=0.005) for each in points.contacts.contacts]
    return dataclasses.replace(points, contacts=ContactSet.stack(soft))


def test_soft_contacts_stop_before_they_would_spin() -> None:
    """With four rows for each contact by Pinocchio, the spin included, the residual is zero up to the limit only."""
    ball, fingers = OBJECTS["big green ball"], ("thumb", "index", "ring")
    points = find_grasp(Hand.load("allegro_right"), body_of(ball), fingers, friction=ball.friction)
    grasp, step = as_soft(points), 1e-4  # m
    limits = travel_limits(grasp, 0.005)
    limited = [limit for limit in limits if limit.reason]
    assert 0 < len(limited) < len(limits)
    assert all("thumb cannot follow without spinning on the object" in limit.reason for limit in limited)
    for limit in limits:
        q, p, far, residuals = np.array(grasp.q), np.array(grasp.p_HO), 0.0, []
        while far < min(limit.distance + 0.001, 0.005) - step / 2:
            A = np.concatenate([_contact_jacobian(grasp, q, p), 0.03 * _spin_jacobian(grasp, q, p)])
            target = np.concatenate([np.tile(limit.direction, len(grasp.fingers)), np.zeros(len(grasp.fingers))])
            rate = np.linalg.pinv(A, rcond=0.01) @ target
            residuals.append((far, np.abs(A @ rate - target).max()))
            q, p, far = q + step * rate, p + step * limit.direction, far + step
        assert max((residual for at, residual in residuals if at < 0.9 * limit.distance), default=0.0) < 1e-6
        assert (max(residual for _, residual in residuals) > 1e-3) == bool(limit.reason)


def test_fingers_of_three_joints_cannot_move_soft_contacts() -> None:
    for limit in travel_limits(as_soft(find_object_grasp("four_finger", "big green ball"))):
        assert limit.distance == 0.0
        assert "cannot follow without spinning on the object" in limit.reason


def test_search_ends_early_where_no_object_can_be_moved() -> None:
    """Soft fingers of three joints cannot follow an object: the search does not look for a grasp that allows it."""
    tried = list[int]()

    def callback(progress: GraspSearchProgress) -> bool:
        tried.append(progress.tried)
        return True

    options = GraspSearchOptions(pad_friction=0.004, callback=callback)
    grasp = find_grasp(Hand.load("four_finger"), body_of(OBJECTS["big green ball"]), friction=0.6, options=options)
    assert all(limit.distance == 0.0 for limit in travel_limits(grasp))
    assert max(tried) <= 4


def _spin_jacobian(grasp: Grasp, q: np.ndarray, p_HO: np.ndarray) -> np.ndarray:
    """Return the Jacobian of the fingers' spin about the normals (N, n), by Pinocchio."""
    rows = []
    for name in grasp.fingers:
        tip = grasp.hand.tip_pose(q, name)[0]
        n_H = grasp.R_HO @ grasp.body.shape.inward_normal(grasp.body.shape.project_to_surface(grasp.R_HO.T @ (tip - p_HO)))
        rows.append(n_H @ grasp.hand.point_jacobian(q, name, tip)[3:])
    return np.vstack(rows)


def test_error_for_a_long_travel_names_direction_and_reason() -> None:
    hand, body = Hand.load("allegro_right"), Body.solid(Sphere(0.03), 0.05)
    who = "thumb, index, ring of allegro_right"
    message = (
        rf"travel = 0.03: must be a distance by which {who} can move the object; best candidate: after \d+ mm along [+-][xyz]"
    )
    with pytest.raises(InvalidInput, match=message) as caught:
        find_grasp(hand, body, ("thumb", "index", "ring"), options=GraspSearchOptions(travel=0.03))
    assert caught.value.field == "travel"
    # the joints of four_finger turn by ±45° only: its fingers, which point along x, can hardly get shorter. The palm is below.
    for limit in travel_limits(find_object_grasp("four_finger", "big green ball"), 0.015):
        along_x = abs(limit.direction[0]) == pytest.approx(1.0)
        down = limit.direction[2] < -0.99
        assert (limit.distance < 0.015) == (along_x or down)
        assert ("finger_" in limit.reason, limit.reason.endswith("the palm touches the object")) == (along_x, down)
    with pytest.raises(InvalidInput, match="travel"):
        travel_limits(find_object_grasp("four_finger", "big green ball"), -1.0)


def test_default_fingers_include_the_thumb(grasp: Grasp) -> None:
    assert "thumb" in grasp.fingers or "thumb" not in [finger.name for finger in grasp.hand.fingers]


def test_travel_directions_of_planar_fingers_are_common_to_their_planes() -> None:
    kinematics = BatchKinematics(Hand.load("anthropomorphic15"))  # fingers: planes across H's y; thumb: its own plane
    four = kinematics.travel_directions((1, 2, 3))
    assert np.abs(four @ [0, 1, 0]).max() < 1e-9
    np.testing.assert_allclose(np.abs(four), [[1, 0, 0], [0, 0, 1]], atol=1e-9)
    both = kinematics.travel_directions((0, 1, 2))
    assert both.shape == (1, 3)
    q = np.full((1, 15), 0.6)
    J = kinematics.evaluate(q).linear_jacobians[0]
    for f in (0, 1, 2):
        moved = J[f] @ np.linalg.pinv(J[f], rcond=1e-9) @ both[0]
        np.testing.assert_allclose(moved, both[0], atol=1e-9)
    np.testing.assert_array_equal(BatchKinematics(Hand.load("four_finger")).travel_directions((0, 1, 2)), np.eye(3))


def test_search_is_deterministic_for_a_seed() -> None:
    hand, ball = Hand.load("allegro_right"), OBJECTS["big green ball"]
    first, again = (find_grasp(hand, body_of(ball), friction=ball.friction) for _ in range(2))
    other = find_grasp(hand, body_of(ball), friction=ball.friction, seed=1)
    np.testing.assert_array_equal(first.q, again.q)
    np.testing.assert_array_equal(first.contacts.p_OC, again.contacts.p_OC)
    np.testing.assert_array_equal(first.R_HO, again.R_HO)
    assert not np.array_equal(first.q, other.q)
    assert other.contact_errors().max() < 1e-8


def test_named_fingers_touch_in_their_order() -> None:
    hand, fingers = Hand.load("allegro_right"), ("thumb", "ring", "middle", "index")
    grasp = find_grasp(hand, Body.solid(Sphere(0.04), 0.05), fingers, gravity_H=[-9.81, 0, 0])
    assert grasp.fingers == fingers
    assert len(grasp.contacts) == 4
    assert grasp.contact_errors().max() < 1e-8


@pytest.mark.parametrize(
    ("radius", "mass", "slip_margin", "fault"),
    [
        (0.3, 0.05, 0.05, "the contacts are not force-closed"),
        (0.002, 0.05, 0.05, "(thumb|index|middle) and (thumb|index|middle) are .* mm apart, below 2.00 mm"),
        (0.03, 20.0, 0.05, r"under gravity \[.*\] m/s² no forces within the motor limits support the object"),
        (0.03, 0.05, 50.0, r"under gravity \[.*\] m/s² the slip margin is at most .* N, below 50 N"),
    ],
    ids=["too large", "too small", "too heavy", "too much slip margin"],
)
def test_error_without_a_grasp_names_the_failed_requirement(radius, mass, slip_margin, fault) -> None:
    body = Body.solid(Sphere(radius), mass)
    with pytest.raises(
        InvalidInput, match="must be an object that thumb, index, middle of dlr_hit2 can hold; best candidate: " + fault
    ) as caught:
        find_grasp(
            Hand.load("dlr_hit2"),
            body,
            ("thumb", "index", "middle"),
            options=GraspSearchOptions(slip_margin=slip_margin, travel=0.0),
        )
    assert caught.value.field == "body"


def test_error_for_an_invalid_argument_names_it() -> None:
    hand, body = Hand.load("four_finger"), Body.solid(Sphere(0.03), 0.05)
    with pytest.raises(InvalidInput, match=r"body\.shape"):
        find_grasp(hand, Body(0.1, np.eye(3)))
    surface = ImplicitSurface(lambda x: (x * x).sum(axis=-1) - 9e-4, lambda x: 2.0 * x, 0.03)
    with pytest.raises(
        InvalidInput, match=r"body\.shape = 'ImplicitSurface': must be a sphere, cylinder, box, superquadric or mesh"
    ):
        find_grasp(hand, Body(0.05, 1e-5 * np.eye(3), shape=surface))
    for fingers in (("finger_1", "finger_2"), ("finger_1", "finger_2", "finger_2"), "finger_1"):
        with pytest.raises(InvalidInput, match="at least three different fingers, or two with soft pads"):
            find_grasp(hand, body, fingers)
    with pytest.raises(UnknownName, match="finger_7"):
        find_grasp(hand, body, ("finger_1", "finger_2", "finger_7"))
    for change in ({"friction": 0.0}, {"gravity_H": [0, 0]}, {"seed": -1}):
        with pytest.raises(InvalidInput, match=next(iter(change))):
            find_grasp(hand, body, **change)
    for change in (
        {"max_normal": 0.0},
        {"slip_margin": -1.0},
        {"travel": -1.0},
        {"clearance": -1.0},
        {"edge_ratio": np.nan},
        {"palm_normal_H": [0, 0, 0]},
    ):
        with pytest.raises(InvalidInput, match=next(iter(change))):
            GraspSearchOptions(**change)


@pytest.mark.parametrize("name", shipped_hands())
def test_batch_kinematics_equal_those_of_the_hand(name: str) -> None:
    hand, rng = Hand.load(name), np.random.default_rng(3)
    kinematics, q = BatchKinematics(hand), rng.uniform(hand.q_lower, hand.q_upper, (5, hand.n))
    postures = kinematics.evaluate(q)
    poses = [hand.link_poses(posture) for posture in q]
    for f, finger in enumerate(hand.fingers):
        own = postures.sphere_centres[:, kinematics.sphere_finger == f]
        for b in range(5):
            p, _ = hand.tip_pose(q[b], finger.name)
            np.testing.assert_allclose(postures.tip_centres[b, f], p, atol=1e-14)
            J = hand.point_jacobian(q[b], finger.name, p)
            np.testing.assert_allclose(postures.linear_jacobians[b, f], J[:3], atol=1e-14)
            np.testing.assert_allclose(postures.angular_jacobians[b, f], J[3:], atol=1e-14)
            np.testing.assert_allclose(own[b, -1], p, atol=1e-14)  # the last sphere is that of the tip
            for shape in hand.urdf.links[finger.tip].shapes:  # some sphere is at the centre of the tip's shape
                p_HF, R_HF = poses[b][finger.tip]
                assert np.linalg.norm(own[b] - p_HF - R_HF @ shape.p, axis=1).min() < 1e-12
    directions = {
        "ability_right": [2, 1, 1, 1, 1],
        "anthropomorphic15": 2,
        "barrett": [2, 2, 1],
        "dex3_right": [3, 2, 2],
        "parallel_jaws": 1,
    }.get(name, 3)
    assert (kinematics.direction_counts == directions).all()


def test_rotations_are_exponentials_also_near_zero() -> None:
    v = np.vstack([np.random.default_rng(1).normal(size=(20, 3)), np.zeros(3), [1e-9, -2e-9, 1e-9], [0, np.pi, 0]])
    np.testing.assert_allclose(rotations(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-14)


@pytest.mark.parametrize(
    "shape", [Box([0.04, 0.06, 0.03]), Cylinder(0.02, 0.05), Sphere(0.03)], ids=["box", "cylinder", "sphere"]
)
def test_face_distance_is_the_distance_and_edge_distance_ends_at_the_edge(shape) -> None:
    p = np.random.default_rng(2).uniform(-0.08, 0.08, (400, 3))
    faces, closest = face_distances(shape, p), shape.project_to_surface(p)
    nearest = faces.face_distance.argmax(axis=1)
    row = np.arange(len(p))
    face_distance, edge_distance, normal = (
        faces.face_distance[row, nearest],
        faces.edge_distance[row, nearest],
        faces.normal[row, nearest],
    )
    beside = (face_distance > 0) & (edge_distance > 1e-6)
    assert beside.sum() > 30
    np.testing.assert_allclose(face_distance[beside], np.linalg.norm(p - closest, axis=1)[beside], atol=1e-15)
    np.testing.assert_allclose(normal[beside], shape.inward_normal(closest[beside]), atol=1e-12)
    np.testing.assert_allclose(p[beside] + face_distance[beside, None] * normal[beside], closest[beside], atol=1e-15)
    t = np.cross(normal[beside], [0.36, 0.48, 0.8])  # along the face, to just inside its edge
    inside = closest[beside] + 0.999 * np.minimum(edge_distance[beside], 0.01)[:, None] * t / np.linalg.norm(t, axis=1)[:, None]
    again = face_distances(shape, inside)
    assert (again.edge_distance[np.arange(len(inside)), nearest[beside]] > 0).all()

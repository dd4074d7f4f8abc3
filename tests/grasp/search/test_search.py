"""A hold that was found is one: every demand is checked here by other means than the search's own."""

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
from graspforce.geometry import Box, Cylinder, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import GraspSearchOptions, find_grasp, travel_limits
from graspforce.grasp.search.batch_kinematics import BatchKinematics, rotations
from graspforce.grasp.search.faces import face_distances
from graspforce.hand.description import shipped_hands
from graspforce.problems.objects import GraspObject, ist_objects

OBJECTS = {one.name: one for one in ist_objects()}
TABLE_1 = ("big green ball", "large blue box", "small red cylinder")  # 004: a sphere, a box and a cylinder
SIX_WAYS = 9.81 * np.vstack([np.eye(3), -np.eye(3)])  # m/s²
OUT = {"allegro_left": (1, 0, 0), "allegro_right": (1, 0, 0)}  # of the palm, in H; z elsewhere, as the hands' notes say
CLEARANCE, EDGE, MARGIN = 0.002, 0.4, 0.05  # m, of a ball's radius, N: what `find_grasp` asks for by default


def body_of(one: GraspObject) -> Body:
    return Body(one.mass, one.inertia, one.com, one.shape)


@cache
def find_object_grasp(hand: str, name: str) -> Grasp:
    one = OBJECTS[name]
    return find_grasp(Hand.load(hand), body_of(one), friction=one.friction)


@pytest.fixture(params=list(itertools.product(sorted(set(shipped_hands()) - {"allegro_left"}), TABLE_1)), ids="-".join)
def grasp(request) -> Grasp:
    return find_object_grasp(*request.param)


def test_balls_touch_inside_faces_along_the_surface_s_own_normals(grasp: Grasp) -> None:
    np.testing.assert_allclose(grasp.contact_errors(), 0.0, atol=1e-8)  # m; asked for: 1e-6
    shape, contacts = grasp.body.shape, grasp.contacts
    np.testing.assert_allclose(shape.inward_normal(contacts.p_OC), contacts.R_OC[:, :, 2], atol=1e-9)
    radius = np.array([grasp.hand.finger(name).tip_radius for name in grasp.fingers])
    for i, (p, R) in enumerate(zip(contacts.p_OC, contacts.R_OC, strict=True)):  # beside the contact the face goes on
        ring = p + (EDGE - 1e-6) * radius[i] * np.array([np.cos(k) * R[:, 0] + np.sin(k) * R[:, 1] for k in np.arange(16.0)])
        if not isinstance(shape, Sphere):
            # a cylinder bends away under the ring: by less than half a radian for a ball's 0.4 r on these
            assert (shape.inward_normal(shape.project_to_surface(ring)) @ R[:, 2] > np.cos(0.5)).all()


def test_the_contacts_close_the_object_and_its_weight_is_borne_whichever_way_the_palm_looks(grasp: Grasp) -> None:
    assert is_force_closed(grasp.contacts)
    for g in SIX_WAYS:
        w = grasp.body.wrench(BodyMotion(grasp.p_HO, grasp.R_HO), g)
        actuation = grasp.hand.actuation(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO, gravity_H=g)
        steady = solve(ForceProblem(grasp.contacts, w, actuation))
        assert steady.status is Status.OPTIMAL
        assert steady.certificate.verified
        assert (np.abs(steady.torques) <= grasp.hand.torque_upper * (1 + 1e-7)).all()
        widest = solve(ForceProblem(grasp.contacts, w, actuation, objective=Objective("margin")), backend="clarabel")
        assert widest.certificate.verified
        assert widest.objective >= MARGIN * (1 - 1e-6)  # two solvers agree to about 1e-8


def test_joints_keep_from_their_limits_couplings_included(grasp: Grasp) -> None:
    hand = grasp.hand
    aside = 0.049 * (hand.q_upper - hand.q_lower)  # a twentieth, but for the last step onto the surface
    used = [j for name in grasp.fingers for j in hand.finger(name).joints]
    room = np.minimum(grasp.q - hand.q_lower, hand.q_upper - grasp.q)
    assert (room >= 0.0).all()
    assert (room >= aside)[used].all()
    x, links = hand.T @ grasp.q + hand.q0, hand.tree().links
    assert all(link.lower <= angle <= link.upper for link, angle in zip(links, x, strict=True))


def test_fingers_keep_from_each_other_and_the_object_from_the_palm_and_from_idle_fingers(grasp: Grasp) -> None:
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
    height = (grasp.p_HO + surface @ grasp.R_HO.T) @ np.array(OUT.get(hand.name, (0, 0, 1)))
    assert height.min() >= CLEARANCE - 1e-4  # m: the palm's gap is measured to 400 points of the hull


def test_the_object_is_not_in_the_links(grasp: Grasp) -> None:
    """Links as thick as the tips' balls, point by point along them, from a kinematics that is written anew here."""
    tree, x = grasp.hand.tree(), grasp.hand.T @ grasp.q + grasp.hand.q0
    places: list[tuple[np.ndarray, np.ndarray]] = []
    for link, angle in zip(tree.links, x, strict=True):
        p, R = places[link.parent] if link.parent >= 0 else (np.zeros(3), np.eye(3))
        places.append((p + R @ link.p_PL, R @ link.R_PL @ Rotation.from_rotvec(angle * link.axis).as_matrix()))
    for tip in tree.tips:
        start, R = places[tip.link]
        end, i, allowed = start + R @ tip.p_LF, tip.link, 0.0 if tip.finger in grasp.fingers else CLEARANCE
        while True:
            along = start + np.linspace(0.0, 1.0, 40)[:, None] * (end - start)
            gap = grasp.body.shape.phi((along - grasp.p_HO) @ grasp.R_HO).min() - tip.radius
            # a touching finger's last link leaves from the contact; between spheres an edge may come 0.13 radii nearer
            assert gap >= allowed - 0.135 * tip.radius
            end, i, allowed = start, tree.links[i].parent, CLEARANCE
            if i < 0:
                break
            start = places[i][0]


PLANES = {"anthropomorphic15": 1}  # how many directions its planar fingers, thumb and others, have in common


def test_the_fingers_can_move_the_object_along_each_axis_and_the_joints_keep_their_limits(
    grasp: Grasp,
) -> None:
    """By Euler's steps with Pinocchio's Jacobians: nothing slips, and balls then touch where the object has come to."""
    hand, N, travel = grasp.hand, len(grasp.fingers), 0.005
    limits = travel_limits(grasp, travel)
    assert len(limits) == 2 * PLANES.get(hand.name, 3)
    used = [j for name in grasp.fingers for j in hand.finger(name).joints]
    for limit in limits:
        assert limit.distance == pytest.approx(travel)
        assert not limit.reason
        q, p, steps = np.array(grasp.q), np.array(grasp.p_HO), 40
        for _ in range(steps):
            A = _at_the_contacts(grasp, q, p)
            q = q + np.linalg.lstsq(A, np.tile(limit.direction * limit.distance / steps, N), rcond=None)[0]
            p = p + limit.direction * limit.distance / steps
        tips = [hand.tip_pose(q, name)[0] for name in grasp.fingers]
        gaps = [grasp.body.shape.phi(grasp.R_HO.T @ (tip - p)) for tip in tips]
        radii = [hand.finger(name).tip_radius for name in grasp.fingers]
        # Euler's steps leave a ball's circle by travel²/(2 steps r), and where a finger is nearly straight by no more again
        np.testing.assert_allclose(np.ravel(gaps), radii, atol=travel**2 / (steps * min(radii)))
        room = np.minimum(q - hand.q_lower, hand.q_upper - q)[used]
        assert room.min() > 0.01  # rad; 0.02 by `travel_limits`, which also takes redundant joints back to where they began


def _at_the_contacts(grasp: Grasp, q: np.ndarray, p_HO: np.ndarray) -> np.ndarray:
    """(3 N, n) velocities of the fingers' points that touch, by Pinocchio."""
    rows = []
    for name in grasp.fingers:
        tip, finger = grasp.hand.tip_pose(q, name)[0], grasp.hand.finger(name)
        n_H = grasp.R_HO @ grasp.body.shape.inward_normal(grasp.body.shape.project_to_surface(grasp.R_HO.T @ (tip - p_HO)))
        rows.append(grasp.hand.point_jacobian(q, name, tip + finger.tip_radius * n_H)[:3])
    return np.vstack(rows)


def as_soft(points: Grasp) -> Grasp:
    """The same hold with fingertips that bear a moment about the normal."""
    soft = [dataclasses.replace(each, model="soft", torsional_friction=0.005) for each in points.contacts.contacts]
    return dataclasses.replace(points, contacts=ContactSet.stack(soft))


def test_soft_fingertips_are_stopped_where_they_would_have_to_spin() -> None:
    """Four rows a contact by Pinocchio, the spin's too: where they cannot all be kept, a contact misses or spins."""
    grasp, step = as_soft(find_object_grasp("allegro_right", "big green ball")), 1e-4  # m
    limits = travel_limits(grasp, 0.005)
    stopped = [limit for limit in limits if limit.reason]
    assert 0 < len(stopped) < len(limits)
    assert all("thumb cannot follow without spinning on the object" in limit.reason for limit in stopped)
    for limit in limits:
        q, p, far, missed = np.array(grasp.q), np.array(grasp.p_HO), 0.0, []
        while far < min(limit.distance + 0.001, 0.005) - step / 2:
            A = np.concatenate([_at_the_contacts(grasp, q, p), 0.03 * _spins(grasp, q, p)])
            wanted = np.concatenate([np.tile(limit.direction, len(grasp.fingers)), np.zeros(len(grasp.fingers))])
            rate = np.linalg.pinv(A, rcond=0.01) @ wanted
            missed.append((far, np.abs(A @ rate - wanted).max()))
            q, p, far = q + step * rate, p + step * limit.direction, far + step
        assert max((miss for at, miss in missed if at < 0.9 * limit.distance), default=0.0) < 1e-6
        assert (max(miss for _, miss in missed) > 1e-3) == bool(limit.reason)


def test_fingers_of_three_joints_cannot_move_what_they_hold_by_soft_fingertips() -> None:
    for limit in travel_limits(as_soft(find_object_grasp("four_finger", "big green ball"))):
        assert limit.distance == 0.0
        assert "cannot follow without spinning on the object" in limit.reason


def _spins(grasp: Grasp, q: np.ndarray, p_HO: np.ndarray) -> np.ndarray:
    """(N, n) the fingers' spin about the normals where they touch, by Pinocchio."""
    rows = []
    for name in grasp.fingers:
        tip = grasp.hand.tip_pose(q, name)[0]
        n_H = grasp.R_HO @ grasp.body.shape.inward_normal(grasp.body.shape.project_to_surface(grasp.R_HO.T @ (tip - p_HO)))
        rows.append(n_H @ grasp.hand.point_jacobian(q, name, tip)[3:])
    return np.vstack(rows)


def test_a_travel_that_is_too_much_is_refused_with_the_way_and_what_stops_it() -> None:
    hand, body = Hand.load("allegro_right"), Body.solid(Sphere(0.03), 0.05)
    who = "thumb, index, ring of allegro_right"
    said = (
        rf"travel = 0.05: must be a distance by which {who} can move the object; best candidate: after \d+ mm along [+-][xyz]"
    )
    with pytest.raises(InvalidInput, match=said) as caught:
        find_grasp(hand, body, ("thumb", "index", "ring"), options=GraspSearchOptions(travel=0.05))
    assert caught.value.field == "travel"
    # four_finger's joints turn by ±45° alone: its fingers hardly get shorter, and they point along x
    for limit in travel_limits(find_object_grasp("four_finger", "big green ball"), 0.015):
        along_x = abs(limit.direction[0]) == pytest.approx(1.0)
        assert (limit.distance < 0.015) == ("finger_" in limit.reason) == along_x
    with pytest.raises(InvalidInput, match="travel"):
        travel_limits(find_object_grasp("four_finger", "big green ball"), -1.0)


def test_the_thumb_is_among_the_fingers(grasp: Grasp) -> None:
    assert "thumb" in grasp.fingers or "thumb" not in [finger.name for finger in grasp.hand.fingers]


def test_ways_are_the_axes_or_what_planes_leave_of_them() -> None:
    skeleton = BatchKinematics(
        Hand.load("anthropomorphic15")
    )  # fingers move in planes across y of H, the thumb in one of its own
    four = skeleton.travel_directions((1, 2, 3))
    assert np.abs(four @ [0, 1, 0]).max() < 1e-9
    np.testing.assert_allclose(np.abs(four), [[1, 0, 0], [0, 0, 1]], atol=1e-9)
    both = skeleton.travel_directions((0, 1, 2))
    assert both.shape == (1, 3)
    q = np.full((1, 15), 0.6)
    J = skeleton.evaluate(q).linear_jacobians[0]
    for f in (0, 1, 2):
        moved = J[f] @ np.linalg.pinv(J[f], rcond=1e-9) @ both[0]
        np.testing.assert_allclose(moved, both[0], atol=1e-9)
    np.testing.assert_array_equal(BatchKinematics(Hand.load("four_finger")).travel_directions((0, 1, 2)), np.eye(3))


def test_the_same_arguments_give_the_same_hold_and_another_seed_another() -> None:
    one, (hand, name) = OBJECTS["big green ball"], ("allegro_right", "big green ball")
    again = find_grasp(Hand.load(hand), body_of(one), friction=one.friction)
    first, other = find_object_grasp(hand, name), find_grasp(Hand.load(hand), body_of(one), friction=one.friction, seed=1)
    np.testing.assert_array_equal(first.q, again.q)
    np.testing.assert_array_equal(first.contacts.p_OC, again.contacts.p_OC)
    np.testing.assert_array_equal(first.R_HO, again.R_HO)
    assert not np.array_equal(first.q, other.q)
    assert other.contact_errors().max() < 1e-8


def test_the_fingers_that_were_named_touch_in_the_order_in_which_they_were_named() -> None:
    hand, fingers = Hand.load("allegro_right"), ("thumb", "ring", "middle", "index")
    grasp = find_grasp(hand, Body.solid(Sphere(0.04), 0.05), fingers, gravity_H=[-9.81, 0, 0])
    assert grasp.fingers == fingers
    assert len(grasp.contacts) == 4
    assert grasp.contact_errors().max() < 1e-8


@pytest.mark.parametrize(
    ("radius", "mass", "margin", "said"),
    [
        (0.3, 0.05, 0.05, "the contacts are not force-closed"),
        (0.002, 0.05, 0.05, "(thumb|index|middle) and (thumb|index|middle) are .* mm apart, below 2.00 mm"),
        (0.03, 20.0, 0.05, r"under gravity \[.*\] m/s² no forces within the motor limits support the object"),
        (0.03, 0.05, 50.0, r"under gravity \[.*\] m/s² the slip margin is at most .* N, below 50 N"),
    ],
    ids=["too large", "too small", "too heavy", "too much asked for"],
)
def test_what_cannot_be_held_is_refused_in_words(radius, mass, margin, said) -> None:
    body = Body.solid(Sphere(radius), mass)
    with pytest.raises(
        InvalidInput, match="must be an object that thumb, index, middle of dlr_hit2 can hold; best candidate: " + said
    ) as caught:
        find_grasp(
            Hand.load("dlr_hit2"),
            body,
            ("thumb", "index", "middle"),
            options=GraspSearchOptions(slip_margin=margin, travel=0.0),
        )
    assert caught.value.field == "body"


def test_arguments_that_cannot_be_are_refused_by_name() -> None:
    hand, body = Hand.load("four_finger"), Body.solid(Sphere(0.03), 0.05)
    with pytest.raises(InvalidInput, match=r"body\.shape"):
        find_grasp(hand, Body(0.1, np.eye(3)))
    with pytest.raises(InvalidInput, match=r"body\.shape = 'Superquadric': must be a sphere, a cylinder or a box"):
        find_grasp(hand, Body.solid(Superquadric([0.02, 0.03, 0.025], [0.8, 0.9]), 0.05))
    for fingers in (("finger_1", "finger_2"), ("finger_1", "finger_2", "finger_2"), "finger_1"):
        with pytest.raises(InvalidInput, match="at least three different fingers"):
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
def test_the_skeleton_stands_and_moves_as_the_hand_does(name: str) -> None:
    hand, rng = Hand.load(name), np.random.default_rng(3)
    skeleton, q = BatchKinematics(hand), rng.uniform(hand.q_lower, hand.q_upper, (5, hand.n))
    seen = skeleton.evaluate(q)
    links = hand.tree().links
    for f, finger in enumerate(hand.fingers):
        base = next(link.p_PL for i, link in enumerate(links) if link.parent == -1 and moves(hand, finger.name, i))
        own = seen.sphere_centres[:, skeleton.sphere_finger == f]
        np.testing.assert_allclose(own[:, 0], np.broadcast_to(base, (5, 3)), atol=1e-15)
        for b in range(5):
            p, _ = hand.tip_pose(q[b], finger.name)
            np.testing.assert_allclose(seen.tip_centres[b, f], p, atol=1e-14)
            J = hand.point_jacobian(q[b], finger.name, p)
            np.testing.assert_allclose(seen.linear_jacobians[b, f], J[:3], atol=1e-14)
            np.testing.assert_allclose(seen.angular_jacobians[b, f], J[3:], atol=1e-14)
            # the last sphere but the tip's ball sits on the last link, at most a radius from the tip, whatever the posture
            np.testing.assert_array_equal(own[b, -1], seen.tip_centres[b, f])
            left = np.linalg.norm(seen.tip_centres[b, f] - own[b, -2])
            parts = np.linalg.norm(hand.tree().tips[f].p_LF) / left
            np.testing.assert_allclose(parts, np.round(parts), rtol=1e-12)
            assert left <= finger.tip_radius * (1 + 1e-12)
    planar = name == "anthropomorphic15"
    assert (skeleton.direction_counts == (2 if planar else 3)).all()


def moves(hand: Hand, finger: str, link: int) -> bool:
    """Whether a link belongs to a finger: one of the finger's actuated joints moves it."""
    return bool(hand.T[link, list(hand.finger(finger).joints)].any())


def test_rotation_vectors_turn_as_rodrigues_says_near_zero_too() -> None:
    v = np.vstack([np.random.default_rng(1).normal(size=(20, 3)), np.zeros(3), [1e-9, -2e-9, 1e-9], [0, np.pi, 0]])
    np.testing.assert_allclose(rotations(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-14)


@pytest.mark.parametrize(
    "shape", [Box([0.04, 0.06, 0.03]), Cylinder(0.02, 0.05), Sphere(0.03)], ids=["box", "cylinder", "sphere"]
)
def test_beside_a_face_its_level_is_the_distance_and_its_room_ends_at_the_edge(shape) -> None:
    p = np.random.default_rng(2).uniform(-0.08, 0.08, (400, 3))
    seen, foot = face_distances(shape, p), shape.project_to_surface(p)
    best = seen.face_distance.argmax(axis=1)
    row = np.arange(len(p))
    face_distance, edge_distance, normal = seen.face_distance[row, best], seen.edge_distance[row, best], seen.normal[row, best]
    beside = (face_distance > 0) & (edge_distance > 1e-6)
    assert beside.sum() > 30
    np.testing.assert_allclose(face_distance[beside], np.linalg.norm(p - foot, axis=1)[beside], atol=1e-15)
    np.testing.assert_allclose(normal[beside], shape.inward_normal(foot[beside]), atol=1e-12)
    np.testing.assert_allclose(p[beside] + face_distance[beside, None] * normal[beside], foot[beside], atol=1e-15)
    t = np.cross(normal[beside], [0.36, 0.48, 0.8])  # along the face, to just short of its edge: still the same face
    inside = foot[beside] + 0.999 * np.minimum(edge_distance[beside], 0.01)[:, None] * t / np.linalg.norm(t, axis=1)[:, None]
    again = face_distances(shape, inside)
    assert (again.edge_distance[np.arange(len(inside)), best[beside]] > 0).all()

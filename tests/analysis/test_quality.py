"""Quality and payload: closed forms, an independent hull, and invariance under rotation, relabelling and units."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.contact_strategies import contact_ring, contacts_around_object
from support.random_problems import random_problem

from graspforce import Actuation, Contact, ContactSet, ForceProblem, InvalidInput, Status, quality, solve
from graspforce.analysis.contact_errors import tolerated_contact_errors
from graspforce.analysis.ellipsoids import finger_ellipsoids, object_ellipsoid, wrench_ellipsoid
from graspforce.analysis.largest_wrench import largest_wrench
from graspforce.analysis.wrench_set import limited_wrench_ball, wrench_volume
from graspforce.cli import main
from graspforce.contact import friction
from graspforce.contact.closure import is_force_closed
from graspforce.contact.inscribed_ball import build_hull
from graspforce.contact.matrices import characteristic_length, normalised_grasp_matrix
from graspforce.contact.quality import inscribed_ball_radius, wrench_ball


def cube() -> list[Contact]:
    """Return twelve frictionless contacts on a cube of edge 2 m, two on each face, that supply ±e_i for all six wrenches."""
    contacts = []
    for axis in range(3):
        for side in (1.0, -1.0):
            normal, arm = np.zeros(3), np.zeros(3)
            normal[axis], arm[(axis + 1) % 3] = -side, 1.0
            for end in (1.0, -1.0):
                contacts.append(Contact(-normal + end * arm, normal, model="frictionless"))
    return contacts


def pair(max_normal: float | None = 10.0, mu: float = 0.5) -> list[Contact]:
    """Return two opposed point contacts on the y axis, 0.1 m apart."""
    return [Contact((0, y, 0), (0, -y, 0), mu, max_normal=max_normal) for y in (0.05, -0.05)]


def test_payload_of_a_pair_is_limited_by_its_friction():
    """Each contact bears μ f_n: 2 · 0.5 · 10 N upwards, of which the problem's weight takes 4 N."""
    problem = ForceProblem(pair(), (0, 0, 4.0, 0, 0, 0))
    up = largest_wrench(problem, (0, 0, 2.0, 0, 0, 0))
    assert up.amount == pytest.approx(3.0, rel=1e-7)  # times 2 N
    np.testing.assert_allclose(up.wrench, (0, 0, 10.0, 0, 0, 0), atol=1e-6)
    np.testing.assert_allclose(problem.G @ up.f, up.wrench, atol=1e-6)
    assert largest_wrench(problem, (0, 0, -1.0, 0, 0, 0)).amount == pytest.approx(14.0, rel=1e-7)
    assert largest_wrench(problem, (0, 0, 1.0, 0, 0, 0), base=np.zeros(6)).amount == pytest.approx(10.0, rel=1e-7)


def test_payload_without_limits_is_unbounded_and_an_infeasible_one_is_none():
    assert largest_wrench(ForceProblem(pair(None), np.zeros(6)), (0, 0, 1.0, 0, 0, 0)).amount == np.inf
    assert largest_wrench(ForceProblem(pair(), np.zeros(6)), (0, 0, 0, 0, 1.0, 0)).amount == pytest.approx(0.0, abs=1e-6)
    assert largest_wrench(ForceProblem(pair(), (0, 0, 30.0, 0, 0, 0)), (1.0, 0, 0, 0, 0, 0)) is None
    with pytest.raises(InvalidInput, match="direction"):
        largest_wrench(ForceProblem(pair(), np.zeros(6)), np.zeros(6))


def test_payload_is_limited_by_motors():
    """One motor of 0.2 N·m drives each contact along its normal with a lever of 0.1 m: f_n ≤ 2 N and 2 N are lifted."""
    J = np.zeros((6, 2))
    J[2, 0] = J[5, 1] = 0.1
    problem = ForceProblem(pair(None), np.zeros(6), Actuation(J, lower=[-0.2, -0.2], upper=[0.2, 0.2]))
    assert largest_wrench(problem, (0, 0, 1.0, 0, 0, 0)).amount == pytest.approx(2.0, rel=1e-6)


def test_the_largest_wrench_is_the_border_of_feasibility():
    """Just below it the problem is solvable, just above it is proven infeasible."""
    for seed in range(6):
        problem = random_problem(np.random.default_rng(seed))
        best = largest_wrench(problem, np.random.default_rng(seed).normal(size=6))
        if best is None or not np.isfinite(best.amount) or best.amount < 1e-3:
            continue
        inside = problem.w + 0.999 * (best.wrench - problem.w)
        outside = problem.w + 1.001 * (best.wrench - problem.w)
        assert solve(problem.replace(w=inside), explain=False).found
        assert solve(problem.replace(w=outside), explain=False).status is Status.INFEASIBLE


def test_epsilon_of_a_cube_has_its_closed_form():
    """The wrenches of the cube are (±e_i, ±e_k/√2) in three orthogonal planes: ε = 1/√6 (sum, as E4) and 2/√3 (each)."""
    contacts = ContactSet.stack(cube())
    assert characteristic_length(contacts) == pytest.approx(np.sqrt(2.0))
    assert wrench_ball(contacts).radius == pytest.approx(1.0 / np.sqrt(6.0), rel=1e-4)
    assert wrench_ball(contacts, limit="each").radius == pytest.approx(2.0 / np.sqrt(3.0), rel=1e-4)
    # three rectangles of 2 by √2: the hull of orthogonal sets has the product of their areas times 2!³/6!
    volume = wrench_volume(contacts)
    assert volume.lower == pytest.approx((2.0 * np.sqrt(2.0)) ** 3 * 8.0 / 720.0, rel=1e-9)
    grasp = quality(ForceProblem(contacts, np.zeros(6)))
    assert grasp.form_closed
    assert grasp.force_closed


def test_three_frictionless_contacts_on_a_disc_supply_planar_forces_only():
    """Normals through one point: rank 2, no closure, ε = 0. Two soft contacts on it close the grasp."""
    angles = 2 * np.pi * np.arange(3) / 3
    ring = [Contact((np.cos(a), np.sin(a), 0), (-np.cos(a), -np.sin(a), 0), model="frictionless") for a in angles]
    grasp = quality(ForceProblem(ring, np.zeros(6)))
    assert (grasp.rank, grasp.force_closed, grasp.form_closed) == (2, False, False)
    assert grasp.epsilon_sum.radius == grasp.volume.upper == 0.0
    assert grasp.wrench.sizes[:2] == pytest.approx(np.sqrt([1.5, 1.5]))
    soft = [Contact((x, 0, 0), (-x, 0, 0), 0.5, "soft", torsional_friction=0.2) for x in (1.0, -1.0)]
    closed = quality(ForceProblem(soft, np.zeros(6)))
    assert closed.force_closed
    assert not closed.form_closed
    # the moment about the common normal is the weakest wrench: γ/L for each newton
    assert closed.epsilon_sum.radius <= 0.2 <= closed.epsilon_sum.upper * (1 + 1e-9)
    assert closed.epsilon_sum.upper - closed.epsilon_sum.radius <= 2e-3
    # with both contacts: for u = (a, b) in force and moment along x, h = 2 γ b while a ≤ γ b, least at a = γ b
    each = 2.0 * 0.2 / np.hypot(1.0, 0.2)
    assert closed.epsilon_each.radius <= each * (1 + 1e-9) <= closed.epsilon_each.upper * (1 + 2e-9)
    assert closed.epsilon_each.upper - closed.epsilon_each.radius <= 2e-3


def test_six_normals_of_a_cube_close_no_moment():
    normals = np.vstack([np.eye(3), -np.eye(3)])
    faces = quality(ForceProblem([Contact(-n, n, model="frictionless") for n in normals], np.zeros(6)))
    assert faces.rank == 3
    assert not faces.form_closed
    np.testing.assert_allclose(faces.wrench.sizes, [np.sqrt(2.0)] * 3 + [0.0] * 3, atol=1e-12)
    assert quality(ForceProblem(cube(), np.zeros(6))).form_closed


def test_the_limited_ball_equals_the_ball_of_each_limit_without_motors():
    """With f_n ≤ 1 N and no motors, the ball within all limits is that of the L∞ limit."""
    rng = np.random.default_rng(31)
    compared = 0
    while compared < 3:
        free = contacts_around_object(rng, 4, models=("point",))
        if not is_force_closed(free):
            continue
        contacts = [Contact(c.position, c.normal, c.friction, max_normal=1.0) for c in free.contacts]
        expected = wrench_ball(free, limit="each")
        found = limited_wrench_ball(ForceProblem(contacts, np.zeros(6)), tolerance=1e-4)
        assert found.radius <= expected.upper * (1 + 1e-6)
        assert expected.radius <= found.upper * (1 + 1e-6)
        compared += 1


def test_motors_scale_the_limited_ball():
    """Twice the torque limits give twice the ball about zero; a disturbance ball about a wrench is smaller."""
    ring = contact_ring(3, mu=0.6)
    J = np.random.default_rng(3).normal(size=(9, 9)) * 0.05
    balls = []
    for limit in (0.1, 0.2):
        problem = ForceProblem(ring, (0, 0, 0.3, 0, 0, 0), Actuation(J, lower=[-limit] * 9, upper=[limit] * 9))
        balls.append(limited_wrench_ball(problem, np.zeros(6)))
    assert balls[1].radius == pytest.approx(2.0 * balls[0].radius, rel=3e-3)
    disturbance = limited_wrench_ball(problem)
    assert 0.0 < disturbance.radius < balls[1].upper
    for _ in range(3):  # wrenches inside the ball are feasible
        u = np.random.default_rng(9).normal(size=6)
        step = 0.999 * disturbance.radius * u / np.linalg.norm(u) * [1, 1, 1, *[problem.length] * 3]
        step[3:] += np.cross(problem.contacts.centroid, step[:3])
        assert solve(problem.replace(w=problem.w + step), explain=False).found


def test_an_unbounded_wrench_set_has_no_ball():
    assert limited_wrench_ball(ForceProblem(contact_ring(3, mu=0.6), np.zeros(6))) is None


def test_volume_of_frictionless_contacts_is_that_of_their_hull():
    rng = np.random.default_rng(5)
    contacts = contacts_around_object(rng, 9, models=("frictionless",))
    volume = wrench_volume(contacts, 3)
    points = np.vstack([np.zeros(6), normalised_grasp_matrix(contacts).reshape(6, -1, 4)[:, :, 2].T])
    assert volume.lower == pytest.approx(build_hull(points).volume, rel=1e-9)
    assert volume.upper == pytest.approx(volume.lower, rel=1e-9)


@pytest.mark.parametrize("count", [12, 60])
def test_volume_of_many_contacts_is_bounded_from_both_sides(count):
    """The volume of a hull of random forces on the cones, which the set contains, is below the upper bound."""
    rng = np.random.default_rng(count)
    contacts = contacts_around_object(rng, count, models=("point",))
    volume = quality(ForceProblem(contacts, np.zeros(6))).volume
    angle = rng.uniform(-np.pi, np.pi, (3, count))
    forces = np.stack([contacts.mu * np.cos(angle), contacts.mu * np.sin(angle), np.ones((3, count)), np.zeros((3, count))], 2)
    bases = normalised_grasp_matrix(contacts).reshape(6, -1, 4)
    inside = build_hull(np.einsum("rnc,snc->snr", bases, forces).reshape(-1, 6))
    assert 0.0 < volume.lower <= volume.upper
    assert inside.volume <= volume.upper
    assert volume.upper <= 5.0 * volume.lower


def independent_radius(contacts: ContactSet, facets: int, limit: str) -> float:
    """Return ε of inner pyramids from a hull of all edges, or for the L∞ limit of all sums of one edge or none each."""
    L, bases = characteristic_length(contacts), normalised_grasp_matrix(contacts).reshape(6, -1, 4)
    points = np.zeros((1, 6))
    for i, (mu, gamma) in enumerate(zip(contacts.mu.tolist(), contacts.gamma.tolist(), strict=True)):
        edges = (friction.pyramid_rays(facets, "inner", mu, gamma) * (1.0, 1.0, 1.0, 1.0 / L)) @ bases[:, i].T
        if limit == "sum":
            points = np.vstack([points, edges])
        else:
            points = (points[:, None] + np.vstack([np.zeros(6), edges])).reshape(-1, 6)
    return inscribed_ball_radius(points)


@pytest.mark.parametrize("limit", ["sum", "each"])
def test_epsilon_equals_that_of_an_independent_hull(limit):
    """`benchmarks.grasp_quality` compares 200 grasps."""
    rng, closed = np.random.default_rng(17), 0
    while closed < 4:
        contacts = contacts_around_object(rng, 3, models=("point", "soft"))
        expected = independent_radius(contacts, 3, limit)
        assert wrench_ball(contacts, 3, limit).radius == pytest.approx(max(expected, 0.0), rel=1e-7, abs=1e-9)
        closed += expected > 0.0


def test_volume_bounds_narrow_with_more_facets():
    ring = contact_ring(3, mu=0.6)
    coarse, fine = wrench_volume(ring, 4), wrench_volume(ring, 8)
    assert coarse.lower <= fine.lower <= fine.upper <= coarse.upper


def test_ellipsoids_of_a_planar_finger_have_their_closed_form():
    """Links of 1 m at a right angle: the force ellipsoid is the inverse of the velocity ellipsoid."""
    contact = Contact((0, 0, 0), (0, 0, 1), 0.5, tangent=(1, 0, 0))
    J = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
    [finger] = finger_ellipsoids(ForceProblem([contact], np.zeros(6), Actuation(J)))
    golden = (1 + np.sqrt(5.0)) / 2
    np.testing.assert_allclose(finger.velocity.sizes, [golden, 1 / golden, 0.0], atol=1e-12)
    np.testing.assert_allclose(finger.force.sizes, [golden, 1 / golden], rtol=1e-12)
    for axis, size in zip(finger.force.axes.T, finger.force.sizes, strict=True):
        assert np.linalg.norm(J.T @ (axis * size)) == pytest.approx(1.0)
    assert finger.velocity.volume_measure == 0.0


def test_object_twists_follow_the_contacts():
    """If every contact can move by its own joints, the object ellipsoid is the inverse of the wrench ellipsoid."""
    ring = contact_ring(4, mu=0.5)
    problem = ForceProblem(ring, np.zeros(6), Actuation(np.eye(12)))
    expected = 1.0 / wrench_ellipsoid(ring).sizes[::-1]
    np.testing.assert_allclose(object_ellipsoid(problem).sizes, expected, rtol=1e-9)


def test_grasps_stay_closed_within_their_tolerated_errors():
    rng = np.random.default_rng(8)
    tried = 0
    while tried < 4:
        contacts = contacts_around_object(rng, 4)
        epsilon = wrench_ball(contacts).radius
        if epsilon < 0.02:
            continue
        errors = tolerated_contact_errors(contacts, epsilon)
        for _ in range(5):
            u = rng.normal(size=contacts.p_OC.shape)
            u *= 0.99 * (errors.position / np.linalg.norm(u, axis=1))[:, None]
            turn = rng.normal(size=u.shape)
            turn *= 0.99 * (errors.normal / np.linalg.norm(turn, axis=1))[:, None]
            turned = Rotation.from_rotvec(turn).as_matrix() @ contacts.R_OC
            for p, R in ((contacts.p_OC + u, contacts.R_OC), (contacts.p_OC, turned)):
                problem = ForceProblem(contacts, np.zeros(6)).replace(p=p, R=R)
                assert is_force_closed(problem.contacts)
        tried += 1


@pytest.mark.parametrize("change", ["rotation", "labels", "length"])
def test_quality_is_invariant(change):
    """A rotation about O, another order of the contacts, and another unit of length change no measure but lengths."""
    contacts = contacts_around_object(np.random.default_rng(21), 4)
    p, R, order, unit = contacts.p_OC, contacts.R_OC, np.arange(4), 1.0
    if change == "rotation":
        turn = Rotation.from_rotvec((0.3, -1.0, 0.5)).as_matrix()
        p, R = p @ turn.T, turn @ R
    if change == "labels":
        order = np.array([2, 0, 3, 1])
    if change == "length":
        unit = 1e3
    models = tuple(contacts.models[i] for i in order)
    other = ContactSet(
        unit * p[order],
        R[order],
        models,
        contacts.mu[order],
        unit * contacts.gamma[order],
        contacts.min_normal[order],
        contacts.max_normal[order],
    )
    one, two = (quality(ForceProblem(c, np.zeros(6))) for c in (contacts, other))
    assert (one.rank, one.force_closed, one.form_closed) == (two.rank, two.force_closed, two.form_closed)
    np.testing.assert_allclose(two.wrench.sizes, one.wrench.sizes, rtol=1e-9)
    assert two.length == pytest.approx(unit * one.length)
    for first, second in ((one.epsilon_sum, two.epsilon_sum), (one.epsilon_each, two.epsilon_each)):
        assert second.radius == pytest.approx(first.radius, rel=2e-4)
    assert two.volume.lower == pytest.approx(one.volume.lower, rel=1e-6)
    np.testing.assert_allclose(two.contact_errors.position, unit * one.contact_errors.position[order], rtol=2e-4)


def test_measures_after_the_deadline_are_none():
    grasp = quality(ForceProblem(pair(), (0, 0, 4.0, 0, 0, 0)), seconds=0.0)
    assert grasp.rank == 5
    assert grasp.payload is not None
    assert grasp.force_closed is grasp.form_closed is None
    assert grasp.epsilon_sum is grasp.volume is grasp.contact_errors is grasp.disturbance is None
    assert json.loads(json.dumps(grasp.to_dict()))["epsilon_each"] is None


def test_the_command_prints_measures(tmp_path, capsys):
    file = tmp_path / "pair.json"
    file.write_text(json.dumps(ForceProblem(pair(), (0, 0, 4.0, 0, 0, 0)).to_dict()))
    assert main(["quality", str(file), "--direction", "0,0,1,0,0,0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["payload"]["amount"] == pytest.approx(6.0)
    assert main(["quality", str(file), "--budget", "0"]) == 0
    assert "characteristic length" in capsys.readouterr().out
    assert main(["quality", str(file), "--direction", "up"]) == 1
    assert "six numbers" in capsys.readouterr().err


def test_the_record_is_json_and_the_text_names_each_measure():
    grasp = quality(ForceProblem(pair(), (0, 0, 4.0, 0, 0, 0)))
    record = json.loads(json.dumps(grasp.to_dict(), allow_nan=False))
    assert record["payload"]["amount"] == pytest.approx(1.5)
    assert record["force_closed"] is False
    for name in ("force closure", "characteristic length", "payload", "volume", "isotropy"):
        assert name in str(grasp)

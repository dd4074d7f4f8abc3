"""Plans along paths of shipped hands: the laws at and between the knots, and invariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.hands import load
from support.planning_cases import DISTANCE, FINGERS, block, random_move, screw_move, star_grasp, straight_move

from graspforce import InvalidInput
from graspforce.contact.contact import ContactSet
from graspforce.core.arrays import Array
from graspforce.grasp.body import Body
from graspforce.planning.check import SAMPLES_PER_INTERVAL, check_at_times, times_between
from graspforce.planning.path.paths import JointPath, ScrewPath, SplinePath, StraightPath
from graspforce.planning.path.plan_along import plan_along, plan_fingers_along
from graspforce.planning.plan import Plan
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import FingerTask
from graspforce.planning.tip_contacts import contacts_at

RANGES = {"four_finger": ((0.005, 0.008), 8.0)}  # m, °: distances and largest turn within its reach
HANDS = list(FINGERS)


def planned(*question: object, **options: object) -> Plan:
    """Return the plan of `plan_along`."""
    plan = plan_along(*question, **options)  # type: ignore[arg-type]
    assert isinstance(plan, Plan), plan.reason
    return plan


@pytest.fixture(scope="module", params=HANDS)
def plan(request: pytest.FixtureRequest) -> Plan:
    return planned(*screw_move(request.param))


# ── laws ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_torques_and_forces_satisfy_the_laws_of_motion(plan: Plan) -> None:
    """tau = M a + h + Jᵀ f, and Newton's and Euler's laws about O, at the knots, with the hand's functions of one posture."""
    task, knots = plan.task, plan.knots
    hand, contacts, body = task.hand, task.contacts, task.body
    for k in range(0, len(knots.times), 9):
        q, p, R = knots.q[k], knots.p_HO[k], knots.R_HO[k]
        contacts = contacts_at(task.contacts, knots.p_OC[k], knots.R_OC[k])
        J = hand.contact_jacobian(q, task.fingers, contacts, p, R)
        tau = hand.inverse_dynamics(q, knots.v[k], knots.a[k], task.gravity_H) + J.T @ knots.f[k]
        assert tau == pytest.approx(knots.tau[k], abs=1e-9)  # N·m; the derivatives of the spline are exact
        forces = knots.f[k].reshape(-1, 3)
        f_H = [R @ contacts.R_OC[i] @ f for i, f in enumerate(forces)]  # N
        arms = [R @ p_OC for p_OC in contacts.p_OC]
        com, omega, alpha = R @ body.p_OM, knots.twist[k, 3:], knots.acceleration[k, 3:]
        p_dd_M = knots.acceleration[k, :3] + np.cross(alpha, com) + np.cross(omega, np.cross(omega, com))
        force = body.mass * (p_dd_M - task.gravity_H)
        assert sum(f_H) == pytest.approx(force, abs=1e-9)
        inertia = R @ body.inertia @ R.T
        moment = inertia @ alpha + np.cross(omega, inertia @ omega) + np.cross(com, force)
        assert sum(np.cross(arm, f) for arm, f in zip(arms, f_H, strict=True)) == pytest.approx(moment, abs=1e-9)


def test_limits_hold_between_knots_and_one_is_active(plan: Plan) -> None:
    """To a thousandth, by direct evaluation at four times as many instants as in the planner's check."""
    assert plan.check.verified
    finer = check_at_times(plan, times_between(plan.knots.times, 4 * SAMPLES_PER_INTERVAL - 1))
    assert finer.excess < 1.01e-3  # the check is accurate to a hundredth of the tolerance
    assert finer.drift < 1e-6
    assert max(finer.slip, finer.torque, finer.normal, finer.speed) > -1e-3
    assert 0.0 <= plan.optimality_gap < 1e-6


def test_forces_and_torques_between_knots_stay_inside_their_limits(plan: Plan) -> None:
    hand, contacts = plan.task.hand, plan.task.contacts
    at = plan.at(np.linspace(0.0, plan.duration, 997))
    f = at.f.reshape(-1, len(contacts), 3)
    assert (contacts.mu * f[:, :, 2] - np.hypot(f[:, :, 0], f[:, :, 1])).min() > -1e-6  # N: the solver's tolerance
    assert f[:, :, 2].max() < contacts.max_normal[0] + 1e-6
    assert (np.abs(at.tau) / hand.torque_upper).max() < 1.0 + 1e-6


def test_states_are_consistent_derivatives_and_rest_at_both_ends(plan: Plan) -> None:
    """Central differences: error dt² times third and fourth derivatives, of order (2π/T)³."""
    dt = 1e-4 * plan.duration
    t = np.linspace(0.02, 0.98, 60) * plan.duration
    before, here, after = (plan.at(t + d) for d in (-dt, 0.0, dt))
    v, a = np.abs(here.v).max(), np.abs(here.a).max()
    assert (after.q - before.q) / (2 * dt) == pytest.approx(here.v, abs=1e-4 * v)
    assert (after.v - before.v) / (2 * dt) == pytest.approx(here.a, abs=2e-2 * a)  # a has kinks at the knots
    assert (after.p_HO - before.p_HO) / (2 * dt) == pytest.approx(here.twist[:, :3], abs=1e-5)
    for end in (0, -1):
        assert np.abs(plan.knots.v[end]).max() == 0.0
        assert np.abs(plan.knots.twist[end]).max() == 0.0
    assert plan.knots.times[0] == 0.0
    assert (np.diff(plan.knots.times) > 0).all()


@pytest.mark.parametrize("name", HANDS)
def test_tips_that_do_not_roll_move_with_the_object(name: str) -> None:
    """Their centres move as points of the object: J_c v = ṗ + ω × (R c)."""
    task, path, q = screw_move(name)
    plan = planned(replace(task, rolling=False), path, q)
    task, hand = plan.task, plan.task.hand
    assert (plan.knots.p_OC == task.contacts.p_OC).all()
    assert (plan.knots.R_OC == task.contacts.R_OC).all()
    at = plan.at(np.linspace(0.0, plan.duration, 101))
    p, J = hand.tips_along(at.q, task.fingers)
    arms = task.tip_centres @ at.R_HO.transpose(0, 2, 1)
    assert p == pytest.approx(at.p_HO[:, None] + arms, abs=1e-6)
    c_d = at.twist[:, None, :3] + np.cross(at.twist[:, None, 3:], arms)
    assert np.einsum("kfcn,kn->kfc", J, at.v) == pytest.approx(c_d, abs=1e-5 * np.abs(c_d).max())


# ── invariances ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("name", ["four_finger", "dlr_hit2"])
def test_reversed_move_takes_the_same_time(name: str) -> None:
    """With time reversed, rates change sign and torques do not; the contacts roll back to the start."""
    task, path, q = screw_move(name)
    there = planned(task, path, q)
    at = path.points(np.array([0.0, 1.0]))
    task = replace(task, contacts=contacts_at(task.contacts, there.knots.p_OC[-1], there.knots.R_OC[-1]))
    back = planned(task, ScrewPath(at.p[1], at.R[1], at.p[0], at.R[0]), there.knots.q[-1])
    assert back.duration == pytest.approx(there.duration, rel=1e-6)
    assert back.knots.q[::-1] == pytest.approx(there.knots.q, abs=1e-7)
    assert back.knots.p_OC[::-1] == pytest.approx(there.knots.p_OC, abs=1e-8)
    assert np.linalg.norm(there.knots.p_OC[-1] - there.knots.p_OC[0], axis=1).max() > 5e-4


def test_friction_never_costs_time_and_a_slip_margin_never_saves_it() -> None:
    plain = planned(*screw_move("allegro_right")).duration
    rougher = planned(*screw_move("allegro_right", friction=0.8)).duration
    task, path, q = screw_move("allegro_right")
    careful = planned(replace(task, slip_margin=0.2), path, q)
    assert rougher <= plain * (1 + 1e-7)
    assert careful.duration > plain
    assert abs(careful.check.slip) <= careful.check.tolerance  # the margin is active somewhere


def test_duration_is_invariant_to_the_object_frame() -> None:
    """Move O to a corner of the object and rotate its axes."""
    task, path, q = screw_move("four_finger")
    shift, turn = np.array([0.02, -0.01, 0.03]), Rotation.from_rotvec([0.4, 0.9, -0.3]).as_matrix()  # O' in O
    c = task.contacts
    contacts = ContactSet((c.p_OC - shift) @ turn, turn.T @ c.R_OC, c.models, c.mu, c.gamma, c.min_normal, c.max_normal)
    body = Body(task.body.mass, turn.T @ task.body.inertia @ turn, (task.body.p_OM - shift) @ turn)

    class MovedPath:
        """The same path of the object, for O'."""

        def points(self, s: Array):  # type: ignore[no-untyped-def]
            x = path.points(s)
            arm = np.cross(x.omega, shift)
            p_s = x.p_s + (x.R @ arm[:, :, None])[:, :, 0]
            p_ss = x.p_ss + (x.R @ (np.cross(x.omega_s, shift) + np.cross(x.omega, arm))[:, :, None])[:, :, 0]
            return type(x)(x.p + x.R @ shift, p_s, p_ss, x.R @ turn, x.omega @ turn, x.omega_s @ turn)

    moved = planned(replace(task, contacts=contacts, body=body), MovedPath(), q)
    assert moved.duration == pytest.approx(planned(task, path, q).duration, rel=1e-6)


def test_duration_converges_with_the_grid() -> None:
    """The error is a thousandth at 50 intervals and at most a quarter of it at 200."""
    times = [planned(*screw_move("dlr_hit2"), settings=PlanSettings(intervals=n)).duration for n in (50, 200, 400)]
    assert times[0] == pytest.approx(times[2], rel=1e-3)
    assert abs(times[1] - times[2]) < abs(times[0] - times[2]) / 4.0


def test_via_pose_is_passed_without_a_stop() -> None:
    task, path, q = screw_move("dlr_hit2")
    ends = path.points(np.array([0.0, 0.5, 1.0]))
    via = ends.p + np.array([[0, 0, 0], [0.001, 0.001, 0.0], [0, 0, 0]])
    bent = planned(task, SplinePath.through(via, ends.R), q)
    middle = np.abs(bent.at(np.linspace(0, bent.duration, 4001)).p_HO - via[1]).max(axis=1)
    assert middle.min() < 1e-5  # m: 1/4000 of the path
    assert np.linalg.norm(bent.knots.twist[1:-1], axis=1).min() > 1e-3  # no stop
    straight = planned(task, StraightPath(ends.p[0], ends.R[0], ends.p[2], ends.R[2]), q)
    assert straight.check.verified
    assert straight.duration == pytest.approx(planned(task, path, q).duration, rel=0.1)


@pytest.mark.parametrize("name", HANDS)
def test_every_reachable_random_move_is_planned(name: str) -> None:
    """5 to 20 mm and up to 20°, or less within the hand's reach; inverse kinematics decides what is reachable."""
    hand = load(name)
    task, middle, q_start = star_grasp(hand)
    rng, tried, found = np.random.default_rng(3), 0, 0
    for _ in range(40):
        path = random_move(rng, middle, *RANGES.get(name, ((0.005, 0.02), 20.0)))
        at, q = path.points(np.linspace(0.0, 1.0, 5)), q_start
        try:
            for p, R in zip(at.p, at.R, strict=True):
                q = hand.grasp_posture(task.fingers, task.contacts, p, R, q)
        except InvalidInput:
            continue
        tried += 1
        answer = plan_along(task, path, q_start, settings=PlanSettings(intervals=50))
        found += answer.found and answer.check.verified
        if tried == 6:
            break
    assert tried >= 3
    assert found == tried


@pytest.mark.parametrize(("name", "seed", "limit"), [("allegro_right", 0, "torque"), ("four_finger", 3, "speed")])
def test_fingers_through_a_via_posture_are_solved_again_until_they_keep_their_limits(name: str, seed: int, limit: str) -> None:
    hand = load(name)
    rng = np.random.default_rng(seed)
    low, high = 0.6 * hand.q_lower + 0.4 * hand.q_upper, 0.4 * hand.q_lower + 0.6 * hand.q_upper
    plan = plan_fingers_along(
        FingerTask(hand, collisions=None),
        JointPath.through(rng.uniform(low, high, size=(3, hand.n))),
        settings=PlanSettings(intervals=40),
    )
    assert isinstance(plan, Plan)
    assert plan.statistics.solves > 1
    assert len(plan.s) == 41  # on the same grid
    assert plan.check.verified
    assert getattr(plan.check, limit) > -5e-3  # margins no larger than necessary
    assert check_at_times(plan, times_between(plan.knots.times, 4 * SAMPLES_PER_INTERVAL - 1)).excess < 1.01e-3
    assert plan.knots.f.shape[1] == 0
    assert plan.knots.p_HO.shape == (0, 3)


def test_times_outside_the_move_are_rejected() -> None:
    plan = planned(block(), straight_move(0, 0, 1), settings=PlanSettings(intervals=20))
    with pytest.raises(InvalidInput, match="between 0 and the duration"):
        plan.at([2.0 * plan.duration])
    assert plan.at([plan.duration]).p_HO[0] == pytest.approx([0.0, 0.0, DISTANCE], abs=1e-15)

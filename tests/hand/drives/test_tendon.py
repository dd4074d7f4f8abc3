"""Tendons and clutches: the laws of a differential and a breakaway, and hands with them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.hands import load

import graspforce as gf
from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.core.errors import InvalidInput, ModelError, UnknownName
from graspforce.force.problem import ForceProblem
from graspforce.force.status import Status
from graspforce.geometry import Sphere
from graspforce.grasp.search import GraspSearchOptions, find_grasp
from graspforce.hand.descriptions.description import MODELS_FOLDER
from graspforce.hand.drives.tendon import Tendon
from graspforce.hand.hand import Hand
from graspforce.hand.tendon_modes import balanced_actuation, free_differentials, stop_tendon_joints

DIFFERENTIAL = Tendon("differential", ("a", "b"), 0.5, (0.008, 0.006), None, None, "test")
BREAKAWAY = Tendon("breakaway", ("a", "b"), 1.0 / 3.0, (1.0, 1.0), 1.0, 4.0 / 3.0, "test")
SHADOW_FINGERS = ("first", "middle", "ring", "thumb")
EQUAL = 1e-9  # N·m
DOWN = (0.0, 0.0, -9.81)  # m/s²


# ── the laws ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@given(st.floats(-100.0, 100.0))
def test_torques_of_a_differential_are_balanced_for_every_tension(tension: float) -> None:
    torques = DIFFERENTIAL.joint_torques(tension)
    np.testing.assert_allclose(torques, [0.008 * tension, 0.006 * tension])
    assert DIFFERENTIAL.tension_difference(torques) == pytest.approx(0.0, abs=1e-15)  # rounding of 1 N·m
    assert abs(DIFFERENTIAL.tension_difference(torques + np.array([1e-3, 0.0]))) > 1e-4


@pytest.mark.parametrize("stopped", [0, 1])
def test_travel_of_a_tendon_goes_to_the_joint_that_is_free(stopped: int) -> None:
    """r_1 q_1 + r_2 q_2 grows at the same rate before and after a joint has stopped."""
    r = DIFFERENTIAL.radii
    before = r[0] + r[1] * DIFFERENTIAL.ratio
    after = r[1 - stopped] * DIFFERENTIAL.slope_after_stop(stopped)
    assert after == pytest.approx(before, rel=1e-15)


def test_breakaway_opens_within_a_step_and_closes_on_the_way_back() -> None:
    """The first joint meets a spring at 0.5 rad; the clutch opens in the first step whose torque is above 1 N·m."""
    stiffness, step = 40.0, 1e-3  # N·m/rad, rad
    there = np.arange(0.0, 0.8, step)
    stop, opened, places = None, None, []
    for position in np.concatenate([there, there[::-1]]):
        torque = stiffness * max(0.0, BREAKAWAY.positions(stop, position)[0] - 0.5)
        before, stop = stop, BREAKAWAY.next_stop(stop, position, torque)
        if before is None and stop is not None and opened is None:
            opened = position
            assert torque > 1.0
            assert stiffness * max(0.0, position - step - 0.5) <= 1.0  # not in the step before
        places.append(BREAKAWAY.positions(stop, position))
    assert opened == pytest.approx(0.5 + 1.0 / stiffness, abs=step * (1 + 1e-9))
    first, second = np.transpose(places)
    assert first.max() == opened  # the gear holds it
    assert second.max() == pytest.approx(opened / 3.0 + 4.0 / 3.0 * (there[-1] - opened), rel=1e-12)
    assert np.abs(np.diff(places, axis=0)).max() <= 4.0 / 3.0 * step * (1 + 1e-9)  # no jumps
    np.testing.assert_allclose(places[: len(there)], places[: len(there) - 1 : -1], atol=4.0 / 3.0 * step)  # reversible
    assert stop is None
    np.testing.assert_array_equal(places[-1], [0.0, 0.0])


def test_laws_reject_the_other_kind() -> None:
    with pytest.raises(InvalidInput, match="breakaway"):
        DIFFERENTIAL.next_stop(None, 0.0, 0.0)
    with pytest.raises(InvalidInput, match="differential"):
        BREAKAWAY.joint_torques(1.0)
    with pytest.raises(InvalidInput, match="first joint only"):
        BREAKAWAY.slope_after_stop(1)


# ── forces that a differential balances ────────────────────────────────────────────────────────────────────────────────────


def balanced_problem(hand: Hand, seed: int) -> tuple[ForceProblem, gf.ContactSet, np.ndarray]:
    """Return a force problem of four fingertips whose normals lie along the middle links, which is feasible.

    With equal pulleys the balance is f · (axis × middle link) = 0: a force along the middle link is balanced.
    """
    rng = np.random.default_rng(seed)
    q = hand.q_lower + rng.uniform(0.3, 0.7, hand.n) * (hand.q_upper - hand.q_lower)
    poses, contacts = hand.link_poses(q), []
    for name in SHADOW_FINGERS:
        tip = hand.finger(name).tip
        prefix = tip.removesuffix("_tip")
        along = poses[f"{prefix}_middle"][1][:, 2]  # both joints turn about x of their links, which extend along z
        contacts.append(gf.Contact(poses[tip][0], along, 0.6))
    contact_set = gf.ContactSet.stack(contacts)
    actuation = balanced_actuation(hand, q, SHADOW_FINGERS, contact_set, np.zeros(3), np.eye(3), np.zeros(3))
    pressing = np.tile([0.0, 0.0, 1.0], len(contacts))  # N, inside the cones
    return ForceProblem(contact_set, grasp_matrix(contact_set) @ pressing, actuation), contact_set, q


@pytest.mark.parametrize("seed", range(5))
def test_certified_torques_are_equal_through_the_differentials(seed: int) -> None:
    hand = load("shadow_right")
    problem, contacts, q = balanced_problem(hand, seed)
    solution = gf.solve(problem)
    assert solution.status is Status.OPTIMAL
    assert solution.certificate.verified
    d = sum(tendon.kind == "differential" for tendon in hand.tendons)
    assert d == 4
    np.testing.assert_allclose(solution.torques[hand.n :], 0.0, atol=EQUAL)
    # independently: torques of single joints from the moments of the tip forces about their axes
    poses, forces_H = hand.link_poses(q), [R @ f for R, f in zip(contacts.R_OC, solution.forces, strict=True)]
    for name, force in zip(SHADOW_FINGERS[:3], forces_H, strict=False):
        prefix = hand.finger(name).tip.removesuffix("_tip")
        tau = []
        for link in ("middle", "distal"):  # moved by J2 and J1
            p, R = poses[f"{prefix}_{link}"]
            tau.append(-R[:, 0] @ np.cross(poses[f"{prefix}_tip"][0] - p, -force))  # the object pushes back
        assert tau[0] == pytest.approx(tau[1], abs=EQUAL)


def test_coupled_torques_are_not_balanced_in_general() -> None:
    """A force across the middle link: the coupled joints hold it, the free differential cannot."""
    hand = load("shadow_right")
    q = np.array(hand.neutral)
    tip, R = hand.link_poses(q)["FF_tip"][0], hand.link_poses(q)["FF_middle"][1]
    contact = gf.ContactSet.stack([gf.Contact(tip, R[:, 1], 0.1)])
    w = grasp_matrix(contact) @ [0.0, 0.0, 1.0]
    pose = np.zeros(3), np.eye(3)
    coupled = ForceProblem(contact, w, hand.actuation(q, ["first"], contact, *pose, gravity_H=np.zeros(3)))
    balanced = ForceProblem(contact, w, balanced_actuation(hand, q, ["first"], contact, *pose, np.zeros(3)))
    assert gf.solve(coupled).status is Status.OPTIMAL
    assert gf.solve(balanced).status is Status.INFEASIBLE


def test_hand_without_differentials_has_its_own_actuation() -> None:
    hand = load("barrett")
    contact = gf.ContactSet.stack([gf.Contact(hand.tip_pose(hand.neutral, "finger_1")[0], [1.0, 0.0, 0.0], 0.5)])
    given = (hand.neutral, ["finger_1"], contact, np.zeros(3), np.eye(3))
    np.testing.assert_array_equal(balanced_actuation(hand, *given).J, hand.actuation(*given).J)


# ── hands whose differentials are free ──────────────────────────────────────────────────────────────────────────────────────


def joint_moments(hand: Hand, q: np.ndarray, finger: str, force_H: np.ndarray) -> list[float]:
    """Return the torques of the joints of a Shadow finger's tendon, J2 and J1, that bear a force at its tip, N·m."""
    poses, prefix = hand.link_poses(q), hand.finger(finger).tip.removesuffix("_tip")
    tip = poses[f"{prefix}_tip"][0]
    return [
        -poses[f"{prefix}_{link}"][1][:, 0] @ np.cross(tip - poses[f"{prefix}_{link}"][0], -force_H)
        for link in ("middle", "distal")
    ]


def test_free_differential_lets_its_joints_move_within_their_limits() -> None:
    coupled = load("shadow_right")
    hand, rng = free_differentials(coupled, ["first", "thumb"]), np.random.default_rng(3)
    assert [joint.name for joint in hand.joints[coupled.n :]] == ["FFJ2-FFJ1"]
    assert hand.torque_upper[-1] == 0.0
    rows = [hand.full_joints.index(name) for name in ("FFJ2", "FFJ1")]
    limits = {link.joint: (link.lower, link.upper) for link in hand.tree().links}
    q = rng.uniform(hand.q_lower, hand.q_upper, (500, hand.n)) @ hand.T[rows].T + hand.q0[rows]
    for j, name in enumerate(("FFJ2", "FFJ1")):
        assert (q[:, j] >= limits[name][0] - 1e-12).all()
        assert (q[:, j] <= limits[name][1] + 1e-12).all()
    assert np.abs(q[:, 0] - q[:, 1]).max() > 0.5  # rad
    with_zero = np.append(coupled.neutral, 0.0)
    np.testing.assert_allclose(hand.tip_pose(with_zero, "first")[0], coupled.tip_pose(coupled.neutral, "first")[0], atol=1e-12)


@pytest.fixture(scope="module")
def free_grasp() -> gf.Grasp:
    """Return a grasp of two fingers with free differentials and the thumb."""
    fingers = ["thumb", "first", "middle"]
    options = GraspSearchOptions(travel=0.0)
    ball = gf.Body.solid(Sphere(0.025), 0.05)
    return find_grasp(
        free_differentials(load("shadow_right"), fingers), ball, fingers, friction=0.7, gravity_H=DOWN, options=options
    )


def test_search_finds_forces_that_free_differentials_balance(free_grasp: gf.Grasp) -> None:
    solution = gf.solve(free_grasp.force_problem(DOWN))
    assert solution.status is Status.OPTIMAL
    hand, contacts = free_grasp.hand, free_grasp.contacts
    np.testing.assert_allclose(solution.torques[-2:], 0.0, atol=EQUAL)
    weight = hand.gravity_torque(free_grasp.q, DOWN)[-2:]  # N·m: difference of the joints' torques for the links' weight
    for i, name in enumerate(free_grasp.fingers[1:], start=1):
        force_H = free_grasp.R_HO @ contacts.R_OC[i] @ contacts.pad(solution.f)[i, :3]
        n_H = free_grasp.R_HO @ contacts.R_OC[i, :, 2]
        lever = hand.finger(name).tip_radius * n_H  # m, from the tip's centre to the contact
        tau = np.array(joint_moments(hand, free_grasp.q, name, force_H))
        prefix = hand.finger(name).tip.removesuffix("_tip")
        axes = [hand.link_poses(free_grasp.q)[f"{prefix}_{link}"][1][:, 0] for link in ("middle", "distal")]
        tau += [axis @ np.cross(lever, force_H) for axis in axes]
        assert (tau[0] - tau[1]) / np.sqrt(2.0) + weight[i - 1] == pytest.approx(0.0, abs=EQUAL)


@pytest.mark.parametrize("step", [0.0, 1e-3])
def test_controller_keeps_free_differentials_in_balance(free_grasp: gf.Grasp, step: float) -> None:
    """At rest, and while it moves the object by a millimetre."""
    rest = BodyMotion(free_grasp.p_HO, free_grasp.R_HO)
    controller = gf.ObjectController(free_grasp, ControlSettings(gravity_H=DOWN, slip_margin=0.1))
    desired = BodyMotion(free_grasp.p_HO + np.array([0.0, 0.0, step]), free_grasp.R_HO)
    command = controller.step(GraspState(free_grasp.q, np.zeros(free_grasp.hand.n), rest), desired)
    assert not command.forces_reused
    assert not command.saturated
    torques = free_grasp.hand.inverse_dynamics(free_grasp.q, np.zeros(free_grasp.hand.n), command.joint_acceleration, DOWN)
    balanced = (
        torques
        + free_grasp.hand.contact_jacobian(
            free_grasp.q, free_grasp.fingers, free_grasp.contacts, free_grasp.p_HO, free_grasp.R_HO
        ).T
        @ command.f
    )
    np.testing.assert_allclose(balanced[-2:], 0.0, atol=1e-6)  # N·m: certificate's tolerance


# ── hands after a joint has stopped ────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("name", "stopped", "moving", "slope"),
    [
        ("barrett", "finger_3_inner", "finger_3_outer", 4.0 / 3.0),
        ("shadow_right", "FFJ2", "FFJ1", 2.0),
        ("shadow_right", "FFJ1", "FFJ2", 2.0),
    ],
)
def test_other_joint_moves_with_the_motor_after_a_stop(name: str, stopped: str, moving: str, slope: float) -> None:
    hand, at = load(name), 0.6  # rad
    after = stop_tendon_joints(hand, {stopped: at})
    leader = next(tendon.joints[0] for tendon in hand.tendons if stopped in tendon.joints)
    j = [joint.name for joint in hand.joints].index(leader)
    assert after.n == hand.n
    assert after.joints[j].name == moving
    q = np.random.default_rng(2).uniform(after.q_lower, after.q_upper)
    full = dict(zip(after.full_joints, after.T @ q + after.q0, strict=True))
    assert full[stopped] == at
    assert full[moving] == q[j]
    old, new = hand.joints[j], after.joints[j]
    assert new.torque * slope == pytest.approx(old.torque)  # the same tension or motor torque
    assert new.torque * new.velocity == pytest.approx(old.torque * old.velocity)  # the same power
    assert new.rotor_inertia * new.velocity**2 == pytest.approx(old.rotor_inertia * old.velocity**2)
    assert len(after.tendons) == len(hand.tendons) - 1


@pytest.mark.parametrize("name", ["barrett", "shadow_right"])
def test_tips_do_not_jump_when_a_joint_stops(name: str) -> None:
    """At the posture of the stop both hands have the same tips."""
    hand = load(name)
    q = 0.5 * (hand.q_lower + hand.q_upper)
    tendon = hand.tendons[0]
    j = [joint.name for joint in hand.joints].index(tendon.joints[0])
    after = stop_tendon_joints(hand, {tendon.joints[0]: q[j]})
    q_after = q.copy()
    q_after[j] = tendon.ratio * q[j]
    for finger in hand.fingers:
        np.testing.assert_allclose(after.tip_pose(q_after, finger.name)[0], hand.tip_pose(q, finger.name)[0], atol=1e-15)


def test_closed_breakaway_limits_the_torque_of_its_motor_to_the_threshold() -> None:
    hand = load("barrett")
    for tendon in hand.tendons:
        j = hand.joint_names.index(tendon.joints[0])
        assert hand.torque_upper[j] == min(hand.joints[j].torque, tendon.threshold)
        assert hand.torque_lower[j] == -hand.joints[j].torque  # it opens in one direction only
        opened = stop_tendon_joints(hand, {tendon.joints[0]: 1.0})
        assert opened.torque_upper[j] == pytest.approx(hand.joints[j].torque / tendon.free_ratio)


def test_stop_of_another_joint_is_rejected() -> None:
    hand = load("barrett")
    with pytest.raises(UnknownName, match="finger_1_inner"):
        stop_tendon_joints(hand, {"finger_1_spread": 0.5})
    with pytest.raises(InvalidInput, match=r"positions\.finger_1_inner = 3\.0: must be within"):
        stop_tendon_joints(hand, {"finger_1_inner": 3.0})
    with pytest.raises(InvalidInput, match="first joint only"):
        stop_tendon_joints(hand, {"finger_1_outer": 0.3})
    with pytest.raises(InvalidInput, match="one joint of each tendon"):
        stop_tendon_joints(load("shadow_right"), {"FFJ1": 0.3, "FFJ2": 0.3})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joints": ["finger_1_outer", "finger_1_inner"]}, r"tendons\[0\] needs a coupling"),
        ({"threshold": None}, r"tendons\[0\]\.threshold"),
        ({"joints": ["finger_2_inner", "finger_2_outer"]}, r"tendons\[1\] has a joint of another tendon"),
    ],
)
def test_faulty_tendon_is_named(tmp_path: Path, change: dict, message: str) -> None:
    record = json.loads((MODELS_FOLDER / "barrett.json").read_text())
    record["tendons"][0] |= change
    (tmp_path / "barrett.json").write_text(json.dumps(record))
    (tmp_path / "barrett.urdf").write_text((MODELS_FOLDER / "barrett.urdf").read_text())
    with pytest.raises(ModelError, match=message):
        Hand.load(tmp_path / "barrett.json")

"""Joints before the fingers branch: a wrist changes neither grasp nor forces, and a fold of the palm joins in the grasp."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.hands import load
from support.wrists import WRIST_OFFSET, with_palm_fold, with_wrist

from graspforce import Hand, InvalidInput, SolverSettings, solve
from graspforce.core.errors import UnknownName
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import GraspSearchOptions, find_grasp, relax_idle_fingers, travel_limits

BALL = Body.solid(Sphere(0.03), 0.05)
QUICK = GraspSearchOptions(travel=0.003)
TOLERANCE = 1e-6  # rad, m, N: rounding of the poses behind the wrist, amplified by the search


@pytest.fixture(scope="module", params=["allegro_right", "dlr_hit2"])
def wrists(request, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Hand]:
    """Return a hand on its wrist: driven, locked and fixed."""
    return {kind: with_wrist(request.param, kind, tmp_path_factory.mktemp(kind)) for kind in ("driven", "locked", "fixed")}


@pytest.fixture(scope="module")
def grasps(wrists: dict[str, Hand]) -> dict[str, Grasp]:
    """Return the grasp of a ball by each of these hands."""
    return {kind: find_grasp(hand, BALL, friction=0.7, options=QUICK) for kind, hand in wrists.items()}


def test_driven_locked_and_fixed_wrists_have_the_same_grasp_and_forces(
    wrists: dict[str, Hand], grasps: dict[str, Grasp]
) -> None:
    fixed = grasps["fixed"]
    own = [j for j, joint in enumerate(wrists["driven"].joints) if joint.name != "wrist"]
    assert len(own) == wrists["driven"].n - 1
    for kind in ("driven", "locked"):
        grasp = grasps[kind]
        assert grasp.fingers == fixed.fingers
        np.testing.assert_allclose(grasp.q[own] if kind == "driven" else grasp.q, fixed.q, atol=TOLERANCE)
        np.testing.assert_allclose(grasp.p_HO, fixed.p_HO, atol=TOLERANCE)
        np.testing.assert_allclose(grasp.R_HO, fixed.R_HO, atol=TOLERANCE)
        for g in np.vstack([np.eye(3), -np.eye(3)]) * 9.81:
            # a tight tolerance: the gap is relative to a cost that the wrist's constant torque dominates
            forces = [solve(each.force_problem(g), settings=SolverSettings(tolerance=1e-12)).forces for each in (grasp, fixed)]
            np.testing.assert_allclose(forces[0], forces[1], atol=TOLERANCE)
        for limit, expected in zip(travel_limits(grasp), travel_limits(fixed), strict=True):
            assert (limit.distance, limit.reason) == (expected.distance, expected.reason)


def test_grasp_on_a_wrist_is_that_of_the_hand_alone_at_the_palm(grasps: dict[str, Grasp]) -> None:
    grasp = grasps["driven"]
    alone = find_grasp(load(grasp.hand.name.removesuffix("_jointed")), BALL, friction=0.7, options=QUICK)
    assert grasp.fingers == alone.fingers
    np.testing.assert_allclose(grasp.p_HO, alone.p_HO + WRIST_OFFSET, atol=1e-5)  # m: other poses have other rounding


def test_torque_of_the_wrist_is_the_moment_of_hand_and_object(grasps: dict[str, Grasp]) -> None:
    """About the wrist's axis y: the gravity torque of the whole hand, and the weight of the ball at its lever."""
    grasp = grasps["driven"]
    hand = grasp.hand
    wrist = [joint.name for joint in hand.joints].index("wrist")
    g = np.array([6.0, 0.0, -7.5])  # m/s²
    moment = np.cross(grasp.p_HO - np.array(WRIST_OFFSET), BALL.mass * g)[1]
    torques = solve(grasp.force_problem(g)).torques
    assert torques[wrist] == pytest.approx(hand.gravity_torque(grasp.q, g)[wrist] - moment, abs=1e-6)


def test_wrist_that_is_too_weak_is_named_as_a_motor_limit(tmp_path: Path) -> None:
    weak = with_wrist("allegro_right", "driven", tmp_path, torque=1e-3)
    with pytest.raises(InvalidInput, match="no forces within the motor limits"):
        find_grasp(weak, BALL, ["index", "middle", "thumb"], friction=0.7, options=GraspSearchOptions(travel=0.0))


def test_fold_of_the_palm_takes_part_in_a_grasp(tmp_path: Path) -> None:
    hand = with_palm_fold("anthropomorphic15", ("ring", "little"), tmp_path)
    fold = [joint.name for joint in hand.joints].index("palm_fold")
    assert hand.common_joints == ()
    grasp = find_grasp(hand, BALL, ["thumb", "ring", "little"], friction=0.7, gravity_H=(0, 0, -9.81))
    np.testing.assert_allclose(grasp.contact_errors(), 0.0, atol=1e-8)
    assert np.abs(grasp.actuation().J[:, fold]).max() > 0.0
    other = find_grasp(hand, BALL, ["thumb", "index", "ring"], friction=0.7, gravity_H=(0, 0, -9.81))
    relaxed = relax_idle_fingers(other)  # moves the little finger, but not the fold, which moves the ring finger
    assert relaxed.q[fold] == other.q[fold]
    np.testing.assert_allclose(relaxed.contact_errors(), other.contact_errors(), atol=1e-12)


def test_grasp_posture_keeps_joints_that_several_fingers_share(grasps: dict[str, Grasp]) -> None:
    grasp = grasps["driven"]
    hand = grasp.hand
    wrist = [joint.name for joint in hand.joints].index("wrist")
    q = hand.grasp_posture(grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    assert q[wrist] == hand.neutral[wrist]
    for name, contact in zip(grasp.fingers, grasp.contacts.p_OC, strict=True):
        distance = np.linalg.norm(hand.tip_pose(q, name)[0] - grasp.p_HO - grasp.R_HO @ contact)
        assert distance == pytest.approx(hand.finger(name).tip_radius, abs=1e-8)


def test_locked_joints_of_a_hand_equal_its_posture(wrists: dict[str, Hand]) -> None:
    """Locking the wrist at an angle leaves the poses, the dynamics and the friction of the other joints."""
    hand = wrists["driven"]
    wrist = [joint.name for joint in hand.joints].index("wrist")
    locked = hand.with_locked_joints({"wrist": 0.4})
    q = hand.neutral.copy()
    q[wrist] = 0.4
    own = np.delete(np.arange(hand.n), wrist)
    for finger in hand.fingers:
        np.testing.assert_allclose(locked.tip_pose(q[own], finger.name)[0], hand.tip_pose(q, finger.name)[0], atol=1e-15)
        assert [locked.joints[j].name for j in locked.finger(finger.name).joints] == [
            hand.joints[j].name for j in finger.joints if j != wrist
        ]
    np.testing.assert_allclose(locked.gravity_torque(q[own]), hand.gravity_torque(q)[own], atol=1e-15)
    np.testing.assert_allclose(locked.mass_matrix(q[own]), hand.mass_matrix(q)[np.ix_(own, own)], atol=1e-15)
    np.testing.assert_array_equal(locked.torque_upper, hand.torque_upper[own])
    np.testing.assert_array_equal(locked.friction.coulomb, hand.friction.coulomb[own])
    assert locked.palm == hand.palm


def test_lock_outside_the_limits_or_of_a_whole_finger_is_an_error(wrists: dict[str, Hand]) -> None:
    hand = wrists["driven"]
    with pytest.raises(InvalidInput, match=r"positions\.wrist = 0\.9"):
        hand.with_locked_joints({"wrist": 0.9})
    with pytest.raises(UnknownName, match="elbow"):
        hand.with_locked_joints({"elbow": 0.0})
    thumb = {hand.joints[j].name: 0.5 * float(hand.q_lower[j] + hand.q_upper[j]) for j in hand.finger("thumb").joints}
    with pytest.raises(InvalidInput, match="finger thumb keeps at least one"):
        hand.with_locked_joints(thumb)

"""The object's pose from touched places, and postures along the normals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.tip_motion import TipMotion, opened_posture
from graspforce.control.phases.touched_grasp import (
    POSE_DEVIATIONS,
    contact_shifts,
    pose_from_touch,
    touch_gaps,
    touched_grasp,
)
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box
from graspforce.geometry.rotations import rotation_exp
from graspforce.grasp.body import Body
from graspforce.hand.hand import Hand
from tests.support.table_scenes import MASS, RADIUS, ball_scene


def tips(grasp):
    return np.array([grasp.hand.tip_pose(grasp.q, name)[0] for name in grasp.fingers])


def test_touch_of_the_expected_object_changes_nothing():
    scene = ball_scene()
    p, R = pose_from_touch(scene.grasp, tips(scene.grasp), scene.down, PhaseSettings())
    assert np.abs(p - scene.grasp.p_HO).max() < 1e-6
    assert np.abs(R - scene.grasp.R_HO).max() < 1e-6


@pytest.mark.parametrize("shift", [0.003, -0.008])
def test_displaced_ball_is_found_from_tips_on_its_surface(shift):
    """The tips follow the ball, so their distances determine its place up to the prior's pull."""
    scene, settings = ball_scene(), PhaseSettings(position_error=0.01, contact_error=1e-4)
    along = np.linalg.svd(scene.down[None])[2][1]
    p, _ = pose_from_touch(scene.grasp, tips(scene.grasp) + shift * along, scene.down, settings)
    assert np.linalg.norm(p - scene.grasp.p_HO - shift * along) < 2e-4


def test_fingertips_that_do_not_touch_do_not_count():
    scene, settings = ball_scene(), PhaseSettings()
    p_tip = tips(scene.grasp)
    far = np.array(p_tip)
    far[1] += 0.03  # m
    for touching in ([True, False, True], [False, False, False]):
        expected = pose_from_touch(scene.grasp, p_tip, scene.down, settings, touching)
        found = pose_from_touch(scene.grasp, far, scene.down, settings, touching)
        np.testing.assert_allclose(found[0], expected[0], rtol=0, atol=1e-9)
    assert np.abs(found[0] - scene.grasp.p_HO).max() < 1e-9  # m: without a touch the object is where it is expected


def test_object_never_leaves_the_table():
    scene = ball_scene()
    rng = np.random.default_rng(0)
    p_tip = tips(scene.grasp) + 0.005 * rng.standard_normal((3, 3))
    p, R = pose_from_touch(scene.grasp, p_tip, scene.down, PhaseSettings())
    assert abs((p - scene.grasp.p_HO) @ scene.down) < 1e-9
    assert np.abs(R @ scene.grasp.R_HO.T @ scene.down - scene.down).max() < 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_fitted_pose_is_within_two_deviations_of_the_expected_one(seed):
    """Touched places far off the surface, of fingers that stuck, do not move the object where it cannot be."""
    scene, settings = ball_scene(), PhaseSettings()
    grasp = replace(scene.grasp, body=Body.solid(Box([1.6 * RADIUS, 2.0 * RADIUS, 2.4 * RADIUS]), MASS))
    rng = np.random.default_rng(seed)
    p_tip = tips(grasp) + 0.015 * rng.standard_normal((len(grasp.fingers), 3))
    p, R = pose_from_touch(grasp, p_tip, scene.down, settings)
    along = np.linalg.svd(scene.down[None])[2][1:] @ (p - scene.grasp.p_HO)  # m
    turn = np.linalg.norm(Rotation.from_matrix(R @ scene.grasp.R_HO.T).as_rotvec())  # rad
    assert np.abs(along).max() <= POSE_DEVIATIONS * settings.position_error + 1e-12  # m, rounding
    assert turn <= POSE_DEVIATIONS * settings.angle_error + 1e-9  # rad, rounding


def test_finger_that_stuck_far_from_the_object_stays_off_the_fitted_surface():
    """The others touch the expected object; the fit does not explain 25 mm of the stuck finger by the object's pose."""
    scene, settings = ball_scene(), PhaseSettings()
    grasp = scene.grasp
    outward = -grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
    p_tip = tips(grasp)
    p_tip[0] += 0.025 * outward[0]
    pose = pose_from_touch(grasp, p_tip, scene.down, settings)
    assert touch_gaps(touched_grasp(grasp, grasp.q, p_tip, pose), p_tip)[0] > settings.fit_tolerance


def test_touched_contacts_are_on_the_surface_below_the_tips():
    scene = ball_scene()
    grasp = scene.grasp
    pose = grasp.p_HO + 0.004 * np.linalg.svd(scene.down[None])[2][1], rotation_exp(0.1 * scene.down) @ grasp.R_HO
    touched = touched_grasp(grasp, grasp.q, tips(grasp), pose)
    assert np.abs(grasp.body.shape.phi(touched.contacts.p_OC)).max() < 1e-9
    centres = touched.p_HO + touched.contacts.p_OC @ touched.R_HO.T
    lines = tips(grasp) - centres
    normals = touched.contacts.R_OC[:, :, 2] @ touched.R_HO.T
    assert np.abs(np.cross(lines, normals)).max() < 1e-9
    distances, angles = contact_shifts(grasp, touched)
    assert distances.max() < 0.01
    assert angles.max() < 0.3


def test_opened_posture_is_off_the_contacts_along_the_normals():
    grasp = ball_scene().grasp
    q, distances = opened_posture(grasp, 0.015)
    normals = grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
    assert np.abs(tips(replace(grasp, q=q)) - tips(grasp) + distances[:, None] * normals).max() < 1e-5


def test_tip_motion_moves_the_tips_with_the_given_velocities():
    grasp = ball_scene().grasp
    motion, dt = TipMotion(grasp.hand, grasp.fingers), 1e-3
    velocities = 0.05 * np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])  # m/s
    q, rates = motion.advance(grasp.q, velocities, dt)
    assert np.abs(motion.positions(q) - motion.positions(grasp.q) - dt * velocities).max() < 5e-6  # m: damping and curvature
    assert np.allclose(rates, (q - grasp.q) / dt)


def test_tips_follow_their_velocities_when_a_joint_is_at_its_limit():
    """Three of the four joints of a finger suffice."""
    grasp = ball_scene().grasp
    motion, dt = TipMotion(grasp.hand, grasp.fingers), 1e-3
    for joint in grasp.hand.finger("index").joints[1:]:  # the first one has the whole spread of the finger
        q, velocities = np.array(grasp.q), np.zeros((3, 3))
        q[joint] = grasp.hand.q_upper[joint]
        velocities[0] = 0.05 * np.array([0.3, 0.0, 0.9])  # m/s
        velocities *= np.sign(motion.rates(q, velocities)[joint])  # towards the limit
        q_next, _ = motion.advance(q, velocities, dt)
        assert q_next[joint] == q[joint]
        assert np.abs(motion.positions(q_next) - motion.positions(q) - dt * velocities).max() < 5e-6


def test_wrist_rests_while_fingertips_move():
    hand = Hand.load("shadow_right")
    fingers = ("thumb", "first", "middle")
    motion = TipMotion(hand, fingers)
    wrist = set.intersection(*(set(hand.finger(name).joints) for name in fingers))
    assert len(wrist) == 2
    q = hand.q_lower + 0.4 * (hand.q_upper - hand.q_lower)
    velocities = 0.02 * np.eye(3)  # m/s
    q_next, _ = motion.advance(q, velocities, 1e-3)
    assert (q_next[list(wrist)] == q[list(wrist)]).all()
    assert np.abs(motion.positions(q_next) - motion.positions(q) - 1e-3 * velocities).max() < 5e-6


def test_gaps_at_the_touch_are_the_distances_of_the_tips_from_the_surface():
    """A fingertip that is moved along its outward normal is as far from the surface of a ball."""
    grasp = ball_scene().grasp
    outward = -grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
    moved = np.array([0.002, 0.0, -0.001])
    at_contact = touch_gaps(grasp, tips(grasp))
    assert touch_gaps(grasp, tips(grasp) + moved[:, None] * outward) - at_contact == pytest.approx(moved, abs=1e-6)


def test_object_without_a_shape_is_refused():
    scene = ball_scene()
    grasp = replace(scene.grasp, body=replace(scene.grasp.body, shape=None))
    p_tip = tips(grasp)
    calls = (
        lambda: pose_from_touch(grasp, p_tip, scene.down, PhaseSettings()),
        lambda: touched_grasp(grasp, grasp.q, p_tip, (grasp.p_HO, grasp.R_HO)),
        lambda: touch_gaps(grasp, p_tip),
    )
    for call in calls:
        with pytest.raises(InvalidInput, match=r"grasp\.body\.shape"):
            call()

"""The pose from the contacts is exact on rolling motion, consistent on noise, and tolerates slip and few contacts."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation
from support.allegro_grasp import three_finger_grasp
from support.control_grasps import make_nearest_grasp, named_grasp
from support.hands import load
from support.rolling_motion import pose_errors, rolling_samples, smooth_motion

from graspforce import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.estimation.pose.contact_pose import ContactPoseTracker
from graspforce.geometry import Sphere
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand

PERIOD, ENCODER_VARIANCE, CONTACT_ERROR = 1e-3, 0.0, 5e-4  # s, rad², m
TRAVEL, TURN = np.array([0.002, -0.004, 0.003]), np.array([0.1, 0.05, -0.15])  # m and rad
GRASPS = ["allegro_right", "four_finger sphere", "four_finger cylinder", "four_finger box", "four_finger superquadric"]


def grasp_of(name: str) -> Grasp:
    """Return a grasp whose fingers can follow all motions of these tests."""
    return three_finger_grasp() if name == "allegro_right" else named_grasp(name)


def track(grasp, samples, period=PERIOD, weights=None):
    """Return the tracked poses of samples."""
    tracker = ContactPoseTracker(grasp, period)
    pose, reference = tracker.start(samples[0].q, ENCODER_VARIANCE, CONTACT_ERROR)
    poses = [pose]
    for sample in samples[1:]:
        pose = tracker.step(pose, reference, sample.q, sample.v, tracker.weights if weights is None else weights)
        poses.append(pose)
    return poses


def some_contacts(grasp: Grasp, count: int, **contact) -> Grasp:
    """Return the grasp with its first contacts only, with changed fields."""
    kept = [replace(each, **contact) for each in grasp.contacts.contacts[:count]]
    return Grasp(grasp.hand, grasp.body, grasp.fingers[:count], ContactSet.stack(kept), grasp.q, grasp.p_HO, grasp.R_HO)


@pytest.mark.parametrize("name", GRASPS)
def test_pose_and_twist_of_rolling_motion_are_exact(name):
    """Rolling 5 mm and 10° at 2 Hz turns a fingertip by about 4 mrad a period; a step's error is of third order in that."""
    grasp = grasp_of(name)
    duration = 0.04 if name.endswith("superquadric") else 0.25  # s; its closest points are computed by iteration
    samples = rolling_samples(grasp, smooth_motion(grasp, TRAVEL, TURN, 2.0), duration, PERIOD)
    for sample, pose in list(zip(samples, track(grasp, samples), strict=True))[1:]:
        position, angle = pose_errors(pose.motion, sample.object)
        assert position < 1e-9
        assert angle < 1e-7
        twist = pose.twist - sample.object.twist
        assert np.abs(twist[:3]).max() < 1e-6  # the velocity is 35 mm/s
        assert np.abs(twist[3:]).max() < 1e-5


def test_errors_fall_with_the_square_of_the_period():
    grasp = grasp_of("allegro_right")
    errors = []
    for period in (8e-3, 4e-3, 2e-3):
        samples = rolling_samples(grasp, smooth_motion(grasp, TRAVEL, TURN, 2.0), 0.24, period)
        poses = track(grasp, samples, period)
        errors.append(max(pose_errors(pose.motion, sample.object)[0] for pose, sample in zip(poses, samples, strict=True)))
    assert errors[0] / errors[1] > 3.0
    assert errors[1] / errors[2] > 3.0


def test_one_long_step_equals_many_short_ones():
    """After a gap in the measurements, the iteration converges; rolling back and forth leaves nothing behind."""
    grasp = grasp_of("allegro_right")
    samples = rolling_samples(grasp, smooth_motion(grasp, TRAVEL / 2, TURN / 2, 2.0), 0.25, PERIOD)
    poses = track(grasp, [samples[0], samples[-1]], PERIOD)
    position, angle = pose_errors(poses[-1].motion, samples[-1].object)
    assert position < 2e-5  # rolling in one step of 2.7 mm: the material points separate in third order
    assert angle < 2e-3


@pytest.mark.parametrize("name", ["allegro_right", "four_finger box"])
def test_errors_from_encoder_noise_are_as_large_as_the_covariance_says(name):
    grasp, sigma, rng = grasp_of(name), 1e-4, np.random.default_rng(3)
    tracker = ContactPoseTracker(grasp, PERIOD)
    squares, slip_squares, count = [], [], 60
    for _ in range(count):
        start_noise, noise = sigma * rng.normal(size=(2, grasp.hand.n))
        pose, reference = tracker.start(grasp.q + start_noise, sigma**2, 1e-3)
        pose = tracker.step(pose, reference, grasp.q + noise, np.zeros(grasp.hand.n), tracker.weights)
        error = np.append(grasp.R_HO.T @ (pose.p_HO - grasp.p_HO), Rotation.from_matrix(grasp.R_HO.T @ pose.R_HO).as_rotvec())
        covariance = tracker.covariance(pose, reference, sigma**2, 1e-9)
        squares.append(error @ np.linalg.solve(covariance, error))
        slip_covariance = tracker.slip_covariance(pose, reference, sigma**2, 1e-9)
        slip_squares.append([s @ np.linalg.solve(C, s) for s, C in zip(pose.slip, slip_covariance, strict=True)])
    low, high = stats.chi2.ppf([1e-3, 1.0 - 1e-3], 6 * count)
    assert low < sum(squares) < high
    low, high = stats.chi2.ppf([1e-3, 1.0 - 1e-3], 2 * count)
    for total in np.sum(slip_squares, axis=0):
        assert low < total < high


def test_start_attributes_differences_to_contacts_or_to_encoders():
    """With exact encoders the object is where the grasp says; with exact contacts it follows the measured posture."""
    grasp = grasp_of("allegro_right")
    moved = BodyMotion(grasp.p_HO + np.array([-1e-3, 0.0, 0.0]), grasp.R_HO)
    q = grasp.hand.grasp_posture(grasp.fingers, grasp.contacts, moved.p_HO, moved.R_HO)
    tracker = ContactPoseTracker(grasp, PERIOD)
    for variance, contact_error, expected in ((0.0, 1e-3, grasp.p_HO), (1e-2, 1e-9, moved.p_HO)):
        pose, reference = tracker.start(q, variance, contact_error)
        for _ in range(3):
            pose = tracker.step(pose, reference, q, np.zeros(grasp.hand.n), tracker.weights)
        np.testing.assert_allclose(pose.p_HO, expected, atol=2e-5)  # second order in 1 mm: 1 mm²/30 mm = 33 µm


def test_pose_is_equivariant_under_a_change_of_the_base_frame(tmp_path):
    """The same hand on a displaced base tracks the same object, displaced."""
    files = load("four_finger")._files
    p, rpy = np.array([0.3, -0.2, 0.1]), np.array([0.4, -0.7, 1.1])
    R = Rotation.from_euler("xyz", rpy).as_matrix()
    origin = f'<origin xyz="{" ".join(map(str, p))}" rpy="{" ".join(map(str, rpy))}"/>'
    joint = f'<joint name="mount" type="fixed"><parent link="base"/><child link="palm"/>{origin}</joint>'
    (tmp_path / files.urdf_path.name).write_text(files.urdf_text.replace("</robot>", f'<link name="base"/>{joint}</robot>'))
    shutil.copy(files.path, tmp_path)
    grasp = named_grasp("four_finger sphere")
    hand, p_HO, R_HO = Hand.load(tmp_path / files.path.name), p + R @ grasp.p_HO, R @ grasp.R_HO
    other = Grasp(hand, grasp.body, grasp.fingers, grasp.contacts, grasp.q, p_HO, R_HO)
    samples = rolling_samples(grasp, smooth_motion(grasp, TRAVEL, TURN, 2.0), 0.1, PERIOD)
    noise = 1e-3 * np.random.default_rng(4).normal(size=(len(samples), hand.n))
    noisy = [sample._replace(q=sample.q + error) for sample, error in zip(samples, noise, strict=True)]
    for here, there in zip(track(grasp, noisy), track(other, noisy), strict=True):
        np.testing.assert_allclose(there.p_HO, p + R @ here.p_HO, atol=1e-9)
        np.testing.assert_allclose(there.R_HO, R @ here.R_HO, atol=1e-9)
        np.testing.assert_allclose(there.twist.reshape(2, 3), here.twist.reshape(2, 3) @ R.T, atol=1e-8)


def slide_finger(grasp, samples, finger, distance):
    """Return the samples with a finger that slides over the object by a distance in the second half."""
    hand, name = grasp.hand, grasp.fingers[finger]
    t = grasp.contacts.R_OC[finger, :, 0]
    start, changed = len(samples) // 2, list(samples[: len(samples) // 2])
    for k, sample in enumerate(samples[start:]):
        share = min(k / 40.0, 1.0)
        body = sample.object
        joints = list(hand.finger(name).joints)
        centre = body.R_HO.T @ (hand.tip_pose(sample.q, name)[0] - body.p_HO)  # m, in O
        axis = np.cross(centre, t) / np.linalg.norm(centre)
        slid = Rotation.from_rotvec(share * distance / np.linalg.norm(centre) * axis).apply(centre)
        q = np.array(sample.q)
        q[joints] = hand.inverse_kinematics(name, body.p_HO + body.R_HO @ slid, q)
        changed.append(sample._replace(q=q))
    return changed


def test_a_finger_that_is_known_to_slip_leaves_the_pose_alone():
    grasp = named_grasp("four_finger sphere")
    samples = rolling_samples(grasp, smooth_motion(grasp, TRAVEL, TURN, 2.0), 0.12, PERIOD)
    sliding = slide_finger(grasp, samples, 1, 1e-3)
    tracker = ContactPoseTracker(grasp, PERIOD)
    slips, none = np.array([False, True, False, False]), np.zeros(4, bool)
    reduced = tracker.reduced_weights(slips, none)
    rest = replace_rates(sliding)
    known, unknown = track(grasp, rest, weights=reduced)[-1], track(grasp, rest)[-1]
    true = samples[-1].object
    assert pose_errors(known.motion, true)[0] < 5e-6
    assert pose_errors(unknown.motion, true)[0] > 5e-5
    # afterwards all fingers count again, and the one that slid keeps its new contact
    assert np.abs(known.slip[1]).max() == 0.0
    assert np.linalg.norm(unknown.slip, axis=1).max() > 1e-4  # the slip shows in the residuals


def replace_rates(samples):
    """Return the samples with zero rates, which only the predictions use."""
    return [sample._replace(v=np.zeros(len(sample.q))) for sample in samples]


def test_a_finger_that_is_apart_does_not_move_the_object():
    grasp = named_grasp("four_finger sphere")
    samples = rolling_samples(grasp, smooth_motion(grasp, TRAVEL, TURN, 2.0), 0.1, PERIOD)
    joints = list(grasp.hand.finger(grasp.fingers[2]).joints)
    away = np.zeros(grasp.hand.n)
    away[joints] = -0.1
    lifted = [sample._replace(q=sample.q + min(k / 50, 1.0) * away) for k, sample in enumerate(samples)]
    tracker = ContactPoseTracker(grasp, PERIOD)
    weights = tracker.reduced_weights(np.zeros(4, bool), np.array([False, False, True, False]))
    poses = track(grasp, lifted, weights=weights)
    assert pose_errors(poses[-1].motion, samples[-1].object)[0] < 1e-6
    assert poses[-1].gap[2] > 2e-3


@pytest.mark.parametrize(
    ("count", "contact", "free"), [(1, {}, 3), (2, {}, 1), (3, {}, 0), (4, {"friction": None, "model": "frictionless"}, 4)]
)
def test_motions_that_contacts_leave_free_keep_the_prediction(count, contact, free):
    """Point contacts on a sphere: one leaves three rotations free, two the rotation about their line.

    Normals in a plane leave all rotations and the motion across the plane free.
    """
    grasp = some_contacts(named_grasp("four_finger sphere"), count, **contact)
    samples = rolling_samples(grasp, smooth_motion(grasp, TRAVEL / 4, 0.0 * TURN, 2.0), 0.1, PERIOD)
    tracker = ContactPoseTracker(grasp, PERIOD)
    poses = track(grasp, samples)
    motions = tracker.free_motions(poses[-1])
    assert motions.shape == (6, free)
    np.testing.assert_allclose(tracker.weights.ravel()[:, None] * (poses[-1].B @ motions), 0.0, atol=1e-2)
    assert all(np.isfinite(pose.p_HO).all() and np.isfinite(pose.twist).all() for pose in poses)
    assert np.linalg.norm(poses[-1].twist) < 1.0
    np.testing.assert_allclose(poses[-1].R_HO.T @ poses[-1].R_HO, np.eye(3), atol=1e-12)


def test_torsional_friction_of_two_contacts_determines_the_orientation():
    grasp = some_contacts(named_grasp("four_finger sphere"), 2, model="soft", torsional_friction=0.005)
    tracker = ContactPoseTracker(grasp, PERIOD)
    pose, _ = tracker.start(grasp.q, 0.0, CONTACT_ERROR)
    assert tracker.free_motions(pose).shape == (6, 0)


def test_rotations_stay_orthonormal_over_many_noisy_steps():
    grasp = make_nearest_grasp(
        load("four_finger"), ("finger_1", "finger_2", "finger_3", "finger_4"), Sphere(0.036), [0, 0, 0.055]
    )
    rng, tracker = np.random.default_rng(5), ContactPoseTracker(grasp, PERIOD)
    pose, reference = tracker.start(grasp.q, 0.0, CONTACT_ERROR)
    for _ in range(500):
        pose = tracker.step(pose, reference, grasp.q + 1e-3 * rng.normal(size=12), np.zeros(12), tracker.weights)
    np.testing.assert_allclose(pose.R_HO.T @ pose.R_HO, np.eye(3), atol=1e-12)

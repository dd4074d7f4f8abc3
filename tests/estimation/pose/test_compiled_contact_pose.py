"""The pose from the contacts in C equals the reference in NumPy to rounding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.allegro_grasp import three_finger_grasp
from support.control_grasps import named_grasp, with_all_contact_models

from graspforce.estimation.pose.compiled_contact_pose import CompiledTracker, make_tracker
from graspforce.estimation.pose.contact_pose import ContactPoseTracker
from graspforce.geometry import ImplicitSurface
from graspforce.grasp.body import Body

pytest.importorskip("graspforce.core._native", reason="the compiled module was not built: no C compiler at installation")

FIELDS = ("p_HO", "R_HO", "twist", "R_OC", "slip", "spin", "gap", "A", "B")
# Numbers of order one, and normal equations with a condition below N/1e-4: some 1e4 times 1e-16.
ROUNDING = 1e-12
GRASPS = ["allegro", "four_finger sphere", "four_finger cylinder", "four_finger box", "four_finger superquadric"]
GRASPS += ["dlr_hit2 sphere", "anthropomorphic15"]


def grasp_of(name, all_models):
    grasp = three_finger_grasp() if name == "allegro" else named_grasp(name)
    return with_all_contact_models(grasp, 0) if all_models else grasp


def assert_equal(found, law, atol):
    for name in FIELDS:
        np.testing.assert_allclose(getattr(found, name), getattr(law, name), rtol=0.0, atol=atol, err_msg=name)
    for name in ("p_OF", "R_OF", "p_OC"):
        ours, theirs = getattr(found.tip_contacts, name), getattr(law.tip_contacts, name)
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=atol, err_msg=name)


@pytest.mark.parametrize("all_models", [False, True])
@pytest.mark.parametrize("name", GRASPS)
def test_tracked_poses_equal_those_of_the_reference(name, all_models):
    """A random walk with noise: coupled joints, point tips, soft and frictionless contacts, slipping and lifted fingers."""
    grasp, rng = grasp_of(name, all_models), np.random.default_rng(6)
    compiled, law = CompiledTracker(grasp, 1e-3), ContactPoseTracker(grasp, 1e-3)
    n, count = grasp.hand.n, len(grasp.contacts)
    q = grasp.q + 1e-4 * rng.normal(size=n)
    (found, reference), (expected, law_reference) = compiled.start(q, 1e-8, 5e-4), law.start(q, 1e-8, 5e-4)
    np.testing.assert_array_equal(reference.gap, law_reference.gap)
    assert_equal(found, expected, 1e-15)
    for k in range(60):
        q = q + 2e-4 * rng.normal(size=n)
        v = 0.1 * rng.normal(size=n)
        slips, apart = rng.random(count) < 0.1, rng.random(count) < 0.05 * (k > 30)
        weights = compiled.reduced_weights(slips, apart) if k > 20 else compiled.weights
        found = compiled.step(found, reference, q, v, weights)
        expected = law.step(expected, law_reference, q, v, weights)
        assert_equal(found, expected, ROUNDING)


def test_a_gap_in_the_measurements_is_iterated_alike():
    grasp = three_finger_grasp()
    compiled, law = CompiledTracker(grasp, 1e-3), ContactPoseTracker(grasp, 1e-3)
    q = grasp.q + 0.02 * np.random.default_rng(7).normal(size=grasp.hand.n)
    poses = []
    for tracker in (compiled, law):
        pose, reference = tracker.start(grasp.q, 0.0, 5e-4)
        poses.append(tracker.step(pose, reference, q, np.zeros(grasp.hand.n), tracker.weights))
    assert_equal(*poses, ROUNDING)


def test_shapes_that_the_c_code_lacks_use_the_reference():
    ball = named_grasp("four_finger sphere")
    same = ImplicitSurface(lambda p: p @ p - 0.036**2, lambda p: 2.0 * p, 0.036)
    body = Body(ball.body.mass, ball.body.inertia, ball.body.p_OM, same)
    assert type(make_tracker(replace(ball, body=body), 1e-3)) is ContactPoseTracker
    assert type(make_tracker(named_grasp("four_finger sphere"), 1e-3)) is CompiledTracker

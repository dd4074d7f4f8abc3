"""Search with a prior of postures: the grasps meet all requirements, and a useless prior does no harm."""

from __future__ import annotations

import numpy as np
import pytest
from support import hands

from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import GraspSearchOptions, PosturePrior, find_grasp, measure_grasp

FINGERS = ("index", "middle", "thumb")
BALL = Body.solid(Sphere(0.03), 0.05)


def prior_about(q, hand, deviation=0.05):
    """Prior with two components about a posture."""
    components = np.linalg.qr(np.random.default_rng(0).normal(size=(hand.n, 2)))[0].T
    return PosturePrior(tuple(joint.name for joint in hand.joints), q, components, [deviation, deviation])


def test_samples_have_mean_and_spread():
    prior = PosturePrior(("a", "b"), [1.0, 2.0], [[0.6, 0.8]], [0.5])
    q = prior.sample(4000, np.random.default_rng(0))
    np.testing.assert_allclose(q.mean(axis=0), [1.0, 2.0], atol=0.03)  # 0.4/√4000 is 0.006
    np.testing.assert_allclose(np.cov(q.T), 0.25 * np.outer([0.6, 0.8], [0.6, 0.8]), atol=0.02)


def test_grasps_of_another_object_help_and_meet_all_requirements():
    """The prior is a grasp of a ball, the object a box. Some grasp holds it in all directions with the margin required."""
    hand = hands.load("leap_right")
    prior = prior_about(find_grasp(hand, BALL, FINGERS).q, hand)
    tried = []
    options = GraspSearchOptions(callback=lambda progress: bool(tried.append(progress.tried)) or True)
    grasp = find_grasp(hand, Body.solid(Box([0.05, 0.05, 0.05]), 0.05), FINGERS, options=options, prior=prior)
    measures = measure_grasp(grasp)
    assert measures.margin >= options.slip_margin
    assert measures.robustness > 0.0
    assert len(tried) <= 5  # candidates of the prior: the search without prior did not follow


def test_equal_arguments_give_equal_grasps():
    hand = hands.load("leap_right")
    prior = prior_about(hand.neutral, hand, 0.3)
    first, second = (find_grasp(hand, BALL, FINGERS, seed=3, prior=prior) for _ in range(2))
    np.testing.assert_array_equal(first.q, second.q)


def test_a_useless_prior_leaves_the_search_without_prior():
    """A prior of one fist: no candidate of it holds the box, and the result is that of the search without prior."""
    hand = hands.load("barrett")
    fist = PosturePrior(tuple(joint.name for joint in hand.joints), hand.q_upper, np.zeros((0, hand.n)), [])
    box = Body.solid(Box([0.05, 0.05, 0.05]), 0.05)
    np.testing.assert_array_equal(find_grasp(hand, box, prior=fist).q, find_grasp(hand, box).q)


def test_joints_are_matched_by_name():
    hand = hands.load("leap_right")
    prior = prior_about(hand.neutral, hand)
    reversed_prior = PosturePrior(
        (*prior.joints[::-1], "wrist"),
        [*prior.mean[::-1], 9.0],
        np.hstack([prior.components[:, ::-1], np.zeros((2, 1))]),
        prior.deviations,
    )
    np.testing.assert_array_equal(reversed_prior.for_hand(hand).mean, prior.mean)
    np.testing.assert_array_equal(reversed_prior.for_hand(hand).components, prior.components)


def test_invalid_priors_are_refused():
    hand = hands.load("leap_right")
    for arguments in (((), [], [[]], []), (("a", "a"), [0, 0], [[1, 0]], [1]), (("a",), [0.0], [[1.0]], [-1.0])):
        with pytest.raises(InvalidInput):
            PosturePrior(*arguments)
    with pytest.raises(InvalidInput, match="is missing"):
        find_grasp(hand, BALL, prior=PosturePrior(("a",), [0.0], [[1.0]], [1.0]))

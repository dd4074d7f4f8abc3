"""Displaced fingertips are found from measured contact points, as closely as the covariance says."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.control_grasps import named_grasp

from graspforce.contact.motion import BodyMotion
from graspforce.core.errors import InvalidInput
from graspforce.estimation import Measurement
from graspforce.estimation.tip_offsets import TipOffsetEstimator

NOISE = 5e-4  # m
GRASPS = ("four_finger box", "allegro_right sphere", "dlr_hit2 sphere")


def touching(grasp, rng):
    """Return contact points in H of tips that are displaced by some millimetres, and the displacements in the tip frames."""
    offsets = rng.uniform(-1.5e-3, 1.5e-3, (len(grasp.fingers), 3))
    tips = grasp.hand.tip_motion(grasp.q, np.zeros(grasp.hand.n), grasp.fingers)
    radii = np.array([grasp.hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])[:, None]
    centres = tips.p_HF + np.einsum("nij,nj->ni", tips.R_HF, offsets)
    points = grasp.body.shape.project_to_surface((centres - grasp.p_HO) @ grasp.R_HO)
    normals = grasp.body.shape.inward_normal(points) @ grasp.R_HO.T
    points = grasp.p_HO + points @ grasp.R_HO.T
    gap = np.sum((points - centres) * normals, axis=1, keepdims=True) - radii  # the tips are moved until they touch
    return points, offsets + np.einsum("nji,nj->ni", tips.R_HF, gap * normals)


def estimated(grasp, noise, steps, rng):
    """Return estimated displacements, and the true ones."""
    points, true = touching(grasp, rng)
    estimator = TipOffsetEstimator(grasp, NOISE)
    memory, state = estimator.initial_memory(), SimpleNamespace(q=grasp.q, object=BodyMotion(grasp.p_HO, grasp.R_HO))
    for _ in range(steps):
        measured = points + noise * rng.normal(size=points.shape)
        memory = estimator.step(memory, Measurement(0.0, grasp.q, contact_points=measured), state)
    return estimator.offsets(memory), true


@pytest.mark.parametrize("name", GRASPS)
def test_exact_points_give_the_offsets(name):
    found, true = estimated(named_grasp(name), 0.0, 2000, np.random.default_rng(1))
    assert np.abs(found.offsets - true).max() < 5e-5  # m: the normal is linear in the point
    assert np.abs(found.offsets).max() > 1e-3


@pytest.mark.parametrize("name", GRASPS)
def test_normalised_errors_are_those_of_the_covariance(name):
    grasp, squares = named_grasp(name), []
    for seed in range(20):
        found, true = estimated(grasp, NOISE, 20, np.random.default_rng(seed))
        for error, covariance in zip(found.offsets - true, found.covariance, strict=True):
            squares.append(error @ np.linalg.solve(covariance, error))
    assert 2.0 < np.mean(squares) < 4.5  # 3 components


def test_hand_with_the_offsets_touches_where_it_was_measured():
    grasp = named_grasp("four_finger box")
    found, true = estimated(grasp, 0.0, 2000, np.random.default_rng(2))
    rest = np.zeros(grasp.hand.n)
    places = [
        hand.tip_motion(grasp.q, rest, grasp.fingers).p_HF
        for hand in (grasp.hand, grasp.hand.with_tip_offsets(found.by_finger))
    ]
    assert np.abs(np.linalg.norm(places[1] - places[0], axis=1) - np.linalg.norm(true, axis=1)).max() < 5e-5


def test_without_points_nothing_is_learned_and_wrong_numbers_are_refused():
    grasp = named_grasp("four_finger box")
    estimator = TipOffsetEstimator(grasp, NOISE, 2e-3)
    memory = estimator.initial_memory()
    assert estimator.step(memory, Measurement(0.0, grasp.q), None) is memory
    np.testing.assert_allclose(estimator.offsets(memory).covariance, np.tile(4e-6 * np.eye(3), (len(grasp.fingers), 1, 1)))
    with pytest.raises(InvalidInput, match="contact_points"):
        estimator.step(memory, Measurement(0.0, grasp.q, contact_points=np.zeros((2, 3))), None)
    with pytest.raises(InvalidInput, match="point_noise"):
        TipOffsetEstimator(grasp, 0.0)
    with pytest.raises(InvalidInput, match=r"grasp\.body\.shape"):
        TipOffsetEstimator(replace(grasp, body=replace(grasp.body, shape=None)), NOISE)

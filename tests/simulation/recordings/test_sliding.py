"""Sliding: known velocities give known distances, and rolling is no sliding."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.allegro_grasp import three_finger_grasp
from support.simulated_runs import replay, simulate_three_fingers, start_of

from graspforce.simulation import rotation_reference
from graspforce.simulation.recordings.sliding import SlidingMeter, sliding_displacement


@pytest.fixture(scope="module")
def run():
    """Return a run in which the ball is turned by 0.3 rad and back, so that the fingertips roll."""
    grasp = three_finger_grasp()
    return grasp, simulate_three_fingers(rotation_reference(start_of(grasp), [1.0, 0.0, 0.0], 0.3, 0.4), 0.4)


def test_rolling_is_no_sliding(run):
    """Contacts move by millimetres on both surfaces, and slide by the depth of their penetration times the turn at most."""
    grasp, recording = run
    moved = np.linalg.norm(recording.p_OC - recording.p_OC[0], axis=2)
    assert moved.max() > 1e-3
    assert sliding_displacement(recording, grasp).max() < 2 * 0.3 * recording.depth.max()


def test_constant_sliding_velocity_adds_up_in_contact_only(run):
    """The fingers rest; the object moves with 10 mm/s, of which the tangential part counts, until contact is lost."""
    grasp, r = run
    steps, velocity = len(r.t), np.array([0.01, 0.0, 0.0])
    touching = np.ones_like(r.touching)
    touching[100:, 1] = 0.0
    still = {name: np.repeat(getattr(r, name)[:1], steps, axis=0) for name in ("q", "p_HO", "R_HO", "p_OC", "R_OC")}
    twist = np.tile(np.append(velocity, np.zeros(3)), (steps, 1))
    r = dataclasses.replace(r, **still, v=np.zeros_like(r.v), twist=twist, touching=touching)
    normals = r.R_HO[0] @ r.R_OC[0, :, :, 2].T  # columns, in H
    speed = np.linalg.norm(velocity[:, None] - normals * (velocity @ normals), axis=0)  # m/s
    expected = speed * np.array([steps, 100, steps]) * 1e-3
    np.testing.assert_allclose(sliding_displacement(r, grasp)[-1], expected, rtol=1e-9)


def test_sliding_there_and_back_cancels(run):
    grasp, r = run
    steps = len(r.t)
    still = {name: np.repeat(getattr(r, name)[:1], steps, axis=0) for name in ("q", "p_HO", "R_HO", "p_OC", "R_OC")}
    twist = np.zeros((steps, 6))
    twist[: steps // 2, 0], twist[steps // 2 :, 0] = 0.01, -0.01
    slid = sliding_displacement(dataclasses.replace(r, **still, v=np.zeros_like(r.v), twist=twist), grasp)
    assert slid[steps // 2 - 1].min() > 1e-4
    assert slid[-1].max() < 1e-12


def test_meter_of_a_run_finds_the_distances_of_the_recording(run):
    """Whenever it is read, also twice."""
    grasp, r = run
    twist = r.twist + np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    r = dataclasses.replace(r, twist=twist)
    expected, meter, dt = sliding_displacement(r, grasp), SlidingMeter(grasp, 1e-3), 1e-3
    for k, (state, contacts) in enumerate(replay(r)):
        meter.add(state, contacts)
        if k % 70 == 0:
            np.testing.assert_allclose(meter.distances(), expected[k], rtol=1e-9, atol=1e-3 * dt)
    for _ in range(2):
        np.testing.assert_allclose(meter.distances(), expected[-1], rtol=1e-9)

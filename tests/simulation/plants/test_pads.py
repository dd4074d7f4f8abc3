"""Soft pads in MuJoCo's condim 4: the controller that plans their torsion, and the one that takes them for points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hands import load

from graspforce import Body, ContactModel, find_grasp
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.core.arrays import Array
from graspforce.geometry import Box, Sphere
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.loops.closed_loop import simulate
from graspforce.simulation.loops.reference import linear_reference
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.plants.urdf_plant import UrdfPlant
from graspforce.simulation.recordings.recording import Recording
from graspforce.simulation.recordings.sliding import sliding_displacement

pytest.importorskip("mujoco")

TORSION = 0.005  # m: MuJoCo's default torsional friction length


@pytest.fixture(scope="module")
def grasp() -> Grasp:
    """Return a grasp of a ball by the Allegro hand with soft pads; its fingers have four motors."""
    hand = load("allegro_right").with_pads(TORSION)
    found = find_grasp(hand, Body.solid(Sphere(0.03), 0.05), friction=0.7)
    assert found.contacts.models == (ContactModel.SOFT,) * 3
    assert np.array_equal(found.contacts.gamma, np.full(3, TORSION))
    return found


def follow(grasp: Grasp) -> tuple[Recording, Array]:
    """Return a run of 5 mm to and fro in 1 s, and the sliding distances at its end, m."""
    plant = UrdfPlant(grasp, PlantOptions(torsional_friction=TORSION))
    reference = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), [0.0, 0.0, 0.005], 1.0)
    recording = simulate(plant, ObjectController(grasp, ControlSettings()), reference, 1.0)
    return recording, sliding_displacement(recording, grasp)[-1]


def test_planned_torsion_keeps_pads_from_spinning_and_sliding(grasp: Grasp) -> None:
    """Four motors follow the spin: the object follows as with points without torsion. A pad that spins slides too.

    At the limit of friction, a pad that spins at ω slides at ω γ/μ · ρ/√(1 − ρ²) for the friction ρ in use: the
    controller for points spins them, and the object goes astray.
    """
    soft, soft_slide = follow(grasp)
    points = replace(grasp, hand=grasp.hand.with_pads(None)).with_pads()
    point, point_slide = follow(points)
    soft_error, point_error = (np.linalg.norm(run.position_error, axis=1).max() for run in (soft, point))
    assert soft_error < 2e-5  # m: ten times the error with ideal points
    assert np.linalg.norm(soft.orientation_error, axis=1).max() < 1e-3  # rad
    assert soft.slip_margin.min() > 0.4  # N: the margin of the settings is 0.5 N
    assert soft_slide.max() < 1e-4  # m: the limit of the controller's own warning
    assert point_error > 10.0 * soft_error
    assert point_slide.max() > 3.0 * soft_slide.max()
    assert (point.slip_margin.min(axis=1) < 1e-6).mean() > 0.5  # the pads spin, at the limit of friction


def test_planned_moments_are_those_of_the_pads(grasp: Grasp) -> None:
    """The plant's moments about the normals are those of the plan, to the error of the regularised contacts."""
    recording, _ = follow(grasp)
    planned, true = recording.planned[200:, :, 3], recording.f[200:, :, 3]  # N·m
    assert np.abs(true).max() > 1e-4
    np.testing.assert_allclose(true, planned, atol=0.05 * np.abs(planned).max())


def test_box_is_held_through_a_posture_in_which_the_fingers_cannot_follow_a_spin() -> None:
    """Without damping of the spins, the controller leaves a rotation uncontrolled there, and drops the box afterwards."""
    hand = load("allegro_right").with_pads(TORSION)
    grasp = find_grasp(hand, Body.solid(Box([0.05, 0.05, 0.05]), 0.05), friction=0.7)
    plant = UrdfPlant(grasp, PlantOptions(torsional_friction=TORSION))
    reference = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), [0.005, 0.0, 0.0], 1.0)
    recording = simulate(plant, ObjectController(grasp, ControlSettings()), reference, 0.5)
    assert not recording.forces_reused.any()
    assert np.linalg.norm(recording.position_error, axis=1).max() < 1e-3  # m
    assert sliding_displacement(recording, grasp)[-1].max() < 2e-4  # m

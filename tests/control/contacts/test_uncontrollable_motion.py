"""Grasps whose fingers cannot make every twist: planar fingers, and soft fingers with three joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_grasps import named_grasp
from support.control_steps import (
    FAST_GRASPS,
    disturbed,
    jacobian,
    pose_at_rest,
    settings_with,
    state_at_rest,
    with_contacts,
)

from graspforce import InvalidInput
from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    Command,
    GraspState,
    ObjectController,
)
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp

pytestmark = pytest.mark.usefixtures("arithmetic")


def planar() -> tuple[Grasp, GraspState, BodyMotion, Command]:
    grasp = named_grasp("anthropomorphic15")
    state, desired = disturbed(grasp, 1)
    return grasp, state, desired, ObjectController(grasp, settings_with()).step(state, desired)


def test_planar_fingers_can_make_exactly_the_controllable_twists() -> None:
    grasp, state, _, command = planar()
    U, R = command.uncontrollable, state.object.R_HO
    np.testing.assert_allclose(U @ U.T, np.eye(len(U)), atol=1e-12)
    J, G = jacobian(grasp, state, command), grasp_matrix(command.contacts)
    B = G.T @ np.kron(np.eye(2), R.T)  # twist in H to contact velocities
    unit = np.repeat([1.0, 0.03], 3)  # angular parts count by the speed at 30 mm
    free = np.linalg.svd(U)[2][len(U) :]  # orthonormal
    assert 0 < len(U) < 6
    for twist in free:
        rates = np.linalg.lstsq(J, B @ twist, rcond=1e-6)[0]
        np.testing.assert_allclose(J @ rates, B @ twist, atol=1e-12)
    for twist in U / unit**2:  # each has a part that no joint rates make
        rates = np.linalg.lstsq(J, B @ twist, rcond=1e-6)[0]
        assert np.abs(J @ rates - B @ twist).max() > 1e-4


def test_commanded_acceleration_is_the_nearest_feasible_one() -> None:
    """Gauss: (a − a_commanded)ᵀ M x = 0 for every feasible acceleration x."""
    grasp, state, desired, command = planar()
    now = state.object
    rotation = Rotation.from_matrix(desired.R_HO @ now.R_HO.T).as_rotvec()
    error = np.array([*(desired.p_HO - now.p_HO), *rotation])
    commanded = desired.acceleration + 80.0 * (desired.twist - now.twist) + 1600.0 * error
    R6 = np.kron(np.eye(2), now.R_HO)
    M = R6 @ grasp.body.mass_matrix() @ R6.T
    change = command.acceleration - commanded
    free = np.linalg.svd(command.uncontrollable)[2][len(command.uncontrollable) :]
    size = np.sqrt(change @ M @ change)
    assert size > 1e-2  # √kg m/s²: part of it is infeasible
    for x in free:
        assert abs(change @ M @ x) < 1e-9 * size * np.sqrt(x @ M @ x)


def test_structural_wrench_comes_from_forces_that_load_no_motor() -> None:
    grasp, state, _, command = planar()
    J, G = jacobian(grasp, state, command), grasp_matrix(command.contacts)
    f = command.f - J @ np.linalg.lstsq(J, command.f, rcond=1e-6)[0]  # the part of f with Jᵀ f = 0
    np.testing.assert_allclose(J.T @ f, 0.0, atol=1e-12)
    np.testing.assert_allclose(command.structural_wrench, G @ f, atol=1e-9)
    assert np.abs(command.structural_wrench[:3]).max() > 1e-2  # N


@pytest.mark.parametrize("name", [name for name in FAST_GRASPS if name != "anthropomorphic15"])
def test_fingers_with_enough_joints_can_make_every_twist(name: str) -> None:
    grasp = named_grasp(name)
    command = ObjectController(grasp, settings_with()).step(*disturbed(grasp, 1))
    assert command.uncontrollable.shape == (0, 6)
    np.testing.assert_array_equal(command.structural_wrench, 0.0)


def test_soft_fingers_with_three_joints_constrain_the_object() -> None:
    """Sixteen rows for twelve joints: structural wrench and uncontrollable twists by least squares."""
    soft = with_contacts(named_grasp("four_finger box"), model="soft", torsional_friction=0.005)
    state, desired = disturbed(soft, 2)
    command = ObjectController(soft, settings_with()).step(state, desired)
    J, G = jacobian(soft, state, command), grasp_matrix(command.contacts)
    unit = np.tile([1.0, 1.0, 1.0, 0.03], 4)  # spins count by the speed at 30 mm from n
    rows, f = unit[:, None] * J, command.f / unit
    null = f - rows @ np.linalg.lstsq(rows, f, rcond=1e-6)[0]  # the part of f with Jᵀ f = 0
    np.testing.assert_allclose(command.structural_wrench, G @ (unit * null), atol=1e-9)
    assert np.abs(command.structural_wrench).max() > 1e-4  # N and N·m
    U, B = command.uncontrollable, G.T @ np.kron(np.eye(2), state.object.R_HO.T)
    assert 0 < len(U) <= 4
    for twist in np.linalg.svd(U)[2][len(U) :]:
        rates = np.linalg.lstsq(J, B @ twist, rcond=1e-6)[0]
        np.testing.assert_allclose(J @ rates, B @ twist, atol=1e-12)


def test_large_uncontrollable_errors_give_a_warning() -> None:
    """Soft fingers with three joints cannot lift a sphere without spinning on it; point contacts can."""
    points = named_grasp("four_finger sphere")
    soft = with_contacts(points, model="soft", torsional_friction=0.005)
    for off, warns in ((2e-3, True), (5e-4, False)):
        desired = BodyMotion(points.p_HO + np.array([0.0, 0.0, off]), points.R_HO)
        warnings = ObjectController(soft, settings_with()).step(state_at_rest(soft), desired).warnings
        assert any("cannot make all of this motion" in text for text in warnings) is warns
        assert not ObjectController(points, settings_with()).step(state_at_rest(points), desired).warnings


def test_integral_does_not_grow_along_uncontrollable_twists() -> None:
    grasp = named_grasp("anthropomorphic15")
    law = ObjectControlLaw(grasp, settings_with())
    off = BodyMotion(grasp.p_HO + np.array([1e-4, 2e-4, -1e-4]), grasp.R_HO)
    command, memory = law.step(law.initial_memory(), state_at_rest(grasp), off)
    np.testing.assert_allclose(command.uncontrollable @ memory.integral, 0.0, atol=1e-18)
    assert np.linalg.norm(memory.integral) > 1e-8


def test_bodies_without_finite_accelerations_are_refused() -> None:
    """The mass matrix is inverted for planar fingers."""
    grasp = replace(named_grasp("anthropomorphic15"), body=Body(1.0, 1e-300 * np.eye(3), [1e160, 0.0, 0.0]))
    with pytest.raises(InvalidInput, match=r"body = .* finite accelerations"):
        ObjectController(grasp).step(state_at_rest(grasp), pose_at_rest(grasp))

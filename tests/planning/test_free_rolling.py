"""Free moves with rolling contacts on shapes other than spheres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_grasps import FOUR_FINGERS, make_nearest_grasp, named_grasp
from support.hands import load

from graspforce import InvalidInput
from graspforce.geometry import ImplicitSurface, Sphere, Superquadric
from graspforce.planning import (
    GraspTask,
    Plan,
    StraightPath,
    plan_along,
    plan_free,
)
from graspforce.planning.free.program import object_move_program
from graspforce.planning.settings import PlanSettings


@pytest.mark.parametrize("name", ["allegro_right cylinder", "four_finger box", "four_finger superquadric"])
def test_free_move_on_other_shapes_is_faster_than_straight(name: str) -> None:
    grasp = named_grasp(name)
    task = GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)
    turned = grasp.R_HO @ Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
    p = grasp.p_HO + np.array([5e-4, -5e-4, 1e-3])
    along = plan_along(task, StraightPath(grasp.p_HO, grasp.R_HO, p, turned), grasp.q, settings=PlanSettings(intervals=20))
    free = plan_free(task, [grasp.p_HO, p], [grasp.R_HO, turned], grasp.q, settings=PlanSettings(intervals=20))
    assert isinstance(along, Plan)
    assert isinstance(free, Plan)
    assert not free.s.size
    assert free.check.verified
    assert free.duration < along.duration
    assert free.knots.R_HO[-1] == pytest.approx(turned, abs=1e-7)


def test_rolling_on_an_unsupported_shape_is_rejected() -> None:
    """Implicit surfaces have no closed form, and superquadrics with an exponent above 1 have edges."""
    ball = named_grasp("allegro_right sphere")
    assert isinstance(ball.body.shape, Sphere)
    radius = ball.body.shape.radius
    implicit = ImplicitSurface(lambda x: float(x @ x / radius**2 - 1.0), lambda x: 2.0 * x / radius**2, radius)
    edged = Superquadric([0.036, 0.034, 0.03], [0.9, 1.2])
    with_edges = make_nearest_grasp(load("four_finger"), FOUR_FINGERS, edged, [0.0, 0.0, 0.055])
    grasps = ((ball, replace(ball.body, shape=implicit), "body.shape"), (with_edges, with_edges.body, "body.shape.exponents"))
    for grasp, body, name in grasps:
        task = GraspTask(grasp.hand, body, grasp.contacts, grasp.fingers)
        with pytest.raises(InvalidInput, match="if tips roll") as caught:
            plan_free(task, [grasp.p_HO, grasp.p_HO + 1e-3], [grasp.R_HO, grasp.R_HO], grasp.q)
        assert caught.value.field == name


def test_superquadric_that_is_a_sphere_is_planned_like_the_sphere() -> None:
    grasp = named_grasp("allegro_right sphere")
    assert isinstance(grasp.body.shape, Sphere)
    radius, durations = grasp.body.shape.radius, []
    p = [grasp.p_HO, grasp.p_HO + np.array([5e-4, -5e-4, 1e-3])]
    for shape in (grasp.body.shape, Superquadric([radius] * 3, [1.0, 1.0])):
        task = GraspTask(grasp.hand, replace(grasp.body, shape=shape), grasp.contacts, grasp.fingers, collisions=None)
        plan = plan_free(task, p, [grasp.R_HO] * 2, grasp.q, settings=PlanSettings(intervals=16))
        assert isinstance(plan, Plan)
        assert not plan.s.size
        durations.append(plan.duration)
    assert durations[1] == pytest.approx(durations[0], rel=2e-3)  # both are slowed down by the check's tolerance


@pytest.mark.parametrize(
    "name", ["allegro_right sphere", "allegro_right cylinder", "four_finger box", "four_finger superquadric"]
)
def test_plan_along_a_path_satisfies_the_equations_of_the_program(name: str) -> None:
    """Contact, torques, normal force and cone, at knots that are not the plan's own."""
    grasp = named_grasp(name)
    task = GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)
    turned = grasp.R_HO @ Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
    plan = plan_along(task, StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + np.array([5e-4, -5e-4, 5e-4]), turned), grasp.q)
    assert isinstance(plan, Plan)
    knots = plan.at(plan.duration * np.linspace(0.0, 1.0, 9))
    move = object_move_program(task, knots)
    back = move.trajectory(move.guess)
    for each in ("q", "v", "a", "f", "p_HO", "R_HO", "twist", "acceleration", "p_OC", "R_OC"):
        assert getattr(back, each) == pytest.approx(getattr(knots, each), abs=1e-7), each
    for i, finger in enumerate(task.fingers):
        placed, numbers = move.program.structure.equations[i], move.program.parameter_values[i]
        joints = list(grasp.hand.finger(finger).joints)
        for k in (2, 5):
            g = np.array(placed.equations.value(move.guess[k, list(placed.variables)], numbers)).ravel()
            assert g[:3] == pytest.approx(0.0, abs=1e-5)  # the plan's quintics slip slightly between its knots
            assert g[3:6] == pytest.approx(0.0, abs=1e-2)  # more in acceleration
            assert g[6:9] == pytest.approx(0.0, abs=1e-7)
            assert g[9 : 9 + len(joints)] == pytest.approx(back.tau[k, joints] / grasp.hand.torque_upper[joints], abs=1e-6)
            f = back.f[k].reshape(-1, 3)[i] / move.variables.scales.force
            assert g[-2] == pytest.approx(f[2], abs=1e-6)
            assert g[-1] == pytest.approx((0.7 * f[2]) ** 2 - f[0] ** 2 - f[1] ** 2, abs=1e-6)

"""Pictures of grasps show what the numbers are: link poses, surfaces, cones and forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from support.box_grasp import make_grasp
from support.meshes import box_mesh
from support.planning_cases import block, straight_move

import graspforce as gf
from graspforce import ForceProblem
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, ImplicitSurface, Sphere, Superquadric, TriangleMesh
from graspforce.planning import plan_along
from graspforce.view import plot_solution, show
from graspforce.view.show import surface_grid

SHAPES = [Sphere(0.03), Cylinder(0.02, 0.07), Box([0.04, 0.05, 0.06]), Superquadric([0.03, 0.02, 0.04], [0.7, 1.2])]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_drawn_points_lie_on_the_surface(shape):
    """Corner points of faces lie on it too: a box and a cylinder are drawn exactly."""
    points = np.column_stack([part.ravel() for part in surface_grid(shape)])
    np.testing.assert_allclose(shape.phi(points), 0.0, atol=1e-9)


def test_a_surface_without_parametrisation_is_left_out():
    ball = ImplicitSurface(lambda x: (x * x).sum(axis=-1) - 9e-4, lambda x: 2.0 * x, 0.03)
    assert surface_grid(ball) is None


def test_a_mesh_is_drawn_with_its_own_faces():
    vertices, faces = box_mesh([0.04, 0.05, 0.06])
    grasp = make_grasp()
    grasp = replace(grasp, body=replace(grasp.body, shape=TriangleMesh(vertices, faces)))
    plain = replace(grasp, body=replace(grasp.body, shape=None))
    drawn, without = (show(each).axes[0].collections for each in (grasp, plain))
    assert len(drawn) == len(without) + 1


def test_every_contact_has_a_cone_and_every_force_an_arrow():
    grasp = make_grasp()
    problem = ForceProblem(grasp.contacts, [0, 0, 1.5, 0, 0, 0])
    solution = gf.solve(problem)
    axes = show(grasp, solution).axes[0]
    cones = [item for item in axes.collections if isinstance(item, Poly3DCollection)]
    assert len(cones) == len(grasp.contacts) + 1  # and the object
    assert "optimal" in axes.get_title()
    assert show(problem).axes[0].get_title().endswith("friction cones")


def test_forces_of_another_grasp_are_refused():
    pair = gf.problems.load("opposed/force").problem
    with pytest.raises(InvalidInput, match="contacts"):
        show(make_grasp(), gf.solve(pair))


def test_records_plot_themselves():
    solution = gf.solve(gf.problems.load("ring/3-force").problem)
    assert len(solution.plot().axes) == 2
    lift = plan_along(block(), straight_move(0.0, 0.0, 1.0))
    assert "ms" in lift.plot().axes[0].get_title() + (lift.plot().get_suptitle() or "")


def test_bars_are_the_solution():
    problem = gf.problems.load("ring/3-force").problem
    solution = gf.solve(problem)
    forces, friction = plot_solution(solution).axes
    normals = [bar.get_height() for bar in forces.containers[0]]
    np.testing.assert_allclose(normals, [f[-1] for f in solution.forces])
    np.testing.assert_allclose([bar.get_height() for bar in friction.containers[0]], 100.0 * solution.friction_used)
    with pytest.raises(InvalidInput, match="infeasible"):
        plot_solution(gf.solve(gf.problems.load(gf.problems.names("infeasible")[0]).problem, explain=False))

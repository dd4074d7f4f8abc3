"""Grasps of a ball, a box and a cylinder by the hands that ship with graspforce, beside those of test_search.py."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import graspforce as gf
from graspforce.contact.closure import is_force_closed
from graspforce.contact.contact import ContactModel
from graspforce.core.errors import InvalidInput
from graspforce.force.status import Status
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.geometry.shape import Solid
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp, travel_limits

MASS, FRICTION = 0.05, 0.7  # kg
SHAPES: dict[str, Solid] = {"ball": Sphere(0.03), "box": Box([0.04, 0.05, 0.06]), "cylinder": Cylinder(0.025, 0.09)}
HELD = {  # the objects that the tests hold
    "ability_right": ("ball",),
    "barrett": ("ball",),
    "dclaw": tuple(SHAPES),
    "dex3_right": ("ball",),
    "leap_right": ("ball",),
    "parallel_jaws": tuple(SHAPES),
    "shadow_right": ("ball",),
}


@cache
def shape_grasp(hand: str, shape: str) -> Grasp:
    """Return the grasp of a shape in any orientation of gravity."""
    return find_grasp(gf.Hand.load(hand), gf.Body.solid(SHAPES[shape], MASS), friction=FRICTION)


@pytest.fixture(params=[(hand, shape) for hand, shapes in HELD.items() for shape in shapes], ids="-".join)
def grasp(request: pytest.FixtureRequest) -> Grasp:
    return shape_grasp(*request.param)


def test_grasp_is_closed_and_its_forces_are_certified_in_six_directions(grasp: Grasp) -> None:
    assert is_force_closed(grasp.contacts)
    np.testing.assert_allclose(grasp.contact_errors(), 0.0, atol=1e-8)  # m; the search stops at 1e-10 m
    for g in 9.81 * np.vstack([np.eye(3), -np.eye(3)]):
        problem = grasp.force_problem(g)
        solution = gf.solve(problem)
        assert solution.status is Status.OPTIMAL
        assert solution.certificate.verified
        np.testing.assert_allclose(problem.G @ np.concatenate(solution.forces), problem.w, atol=1e-9)  # N; weights of 0.5 N
        assert (np.abs(solution.torques) <= grasp.hand.rest_torque_limit * (1.0 + 1e-7)).all()


# ── two soft contacts ──────────────────────────────────────────────────────────────────────────────────────────────────────


def test_two_soft_contacts_are_closed_and_two_points_are_not() -> None:
    grasp = shape_grasp("parallel_jaws", "ball")
    assert grasp.contacts.models == (ContactModel.SOFT, ContactModel.SOFT)
    points = [gf.Contact(c.position, c.normal, c.friction) for c in grasp.contacts.contacts]
    assert is_force_closed(grasp.contacts)
    assert not is_force_closed(gf.ContactSet.stack(points))
    hard = gf.Hand.load("parallel_jaws").with_pads(None)
    with pytest.raises(InvalidInput, match="two point contacts are never force-closed"):
        find_grasp(hard, grasp.body, friction=FRICTION)


def test_forces_of_jaws_follow_from_the_weight_and_the_torsional_friction() -> None:
    """A ball between two jaws, gravity along them: the pads carry half the weight each, at f_n = m g/(2 μ) or more.

    The soft cone is √(f_t²/μ² + m_n²/γ²) ≤ f_n. Weight through the line of the contacts needs no moment, so the least force of
    each jaw is m g/(2 μ), and the motor, which moves both, exerts twice that.
    """
    grasp = shape_grasp("parallel_jaws", "ball")
    solution = gf.solve(grasp.force_problem([0.0, 0.0, -9.81]))
    normal = np.concatenate(solution.forces)[grasp.contacts.normal_rows]
    least = MASS * 9.81 / (2.0 * FRICTION)
    np.testing.assert_allclose(normal, least, rtol=1e-6)
    np.testing.assert_allclose(solution.torques, -2.0 * least, rtol=1e-6)  # N: closing is towards smaller positions


def test_jaws_report_that_they_cannot_move_the_object() -> None:
    limits = travel_limits(shape_grasp("parallel_jaws", "box"))
    assert {tuple(np.round(np.abs(limit.direction), 9)) for limit in limits} == {(0.0, 1.0, 0.0)}  # jaws slide along y
    assert all(limit.distance == 0.0 and "cannot follow the object" in limit.reason for limit in limits)


def test_positions_and_forces_of_prismatic_joints_have_their_units() -> None:
    hand = gf.Hand.load("parallel_jaws")
    assert str(hand).splitlines()[1].split() == ["finger", "joint", "from", "m", "to", "m", "m/s", "N"]
    assert gf.Hand.load("four_finger").position_units == ("rad",)
    assert hand.describe()["joints"][0]["is_prismatic"] is True

"""Paths and interpolation between knots: derivatives match differences of values, and ends are met."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from graspforce import InvalidInput
from graspforce.core.arrays import Array
from graspforce.geometry.hermite import hermite, locate_intervals
from graspforce.planning.interpolation import hermite_rotation
from graspforce.planning.path.eased_path import EasedObjectPath
from graspforce.planning.path.paths import JointPath, ObjectPath, ScrewPath, SplinePath, StraightPath, knot_grid

START = (np.array([0.1, -0.02, 0.03]), Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix())
GOAL = (np.array([0.11, 0.01, 0.05]), Rotation.from_rotvec([-0.4, 0.6, 0.9]).as_matrix())
VIA = (np.array([0.12, -0.01, 0.035]), Rotation.from_rotvec([0.0, 0.4, 0.2]).as_matrix())
TURNS = Rotation.from_rotvec([[0.0, 0.0, angle] for angle in (0.0, 1.2, 2.4, 3.6, 4.8)])  # more than half a turn in all

STEP = 1e-4  # of central differences in s: error 1e-8 times third derivatives of order 1 to 100, rounding 1e-16/STEP


def user_spline() -> SplinePath:
    """Return a path by splines of a user, with quaternions that are not normalised."""
    at = np.linspace(0.0, 1.0, 9)
    quaternions = np.array([0.1, 0.2, -0.3, 2.0]) + np.sin(np.outer(at, [2.0, 3.0, 4.0, 5.0]))
    position = 0.1 * np.cos(np.outer(at, [3.0, 4.0, 5.0]))
    return SplinePath(make_interp_spline(at, position, k=5), make_interp_spline(at, quaternions, k=5))


PATHS: dict[str, ObjectPath] = {
    "straight": StraightPath(*START, *GOAL),
    "straight, axes kept": StraightPath(*START, GOAL[0], START[1]),
    "screw": ScrewPath(*START, *GOAL),
    "screw, axes kept": ScrewPath(*START, GOAL[0], START[1]),
    "through poses": SplinePath.through(*(np.array(x) for x in zip(START, VIA, GOAL, strict=True))),
    "through turns": SplinePath.through(0.01 * np.arange(15.0).reshape(5, 3), TURNS.as_matrix()),
    "spline": user_spline(),
    "eased": EasedObjectPath(user_spline()),
}


def unskew(S: Array) -> Array:
    """Return the vectors (M, 3) of skew-symmetric matrices (M, 3, 3)."""
    return np.stack([S[:, 2, 1] - S[:, 1, 2], S[:, 0, 2] - S[:, 2, 0], S[:, 1, 0] - S[:, 0, 1]], axis=1) / 2.0


@pytest.mark.parametrize("name", PATHS)
def test_derivatives_match_differences_along_the_path(name: str) -> None:
    """Check p', p'' and Ω' by differences, Ω from R' = R [Ω]×, and RᵀR = 1."""
    path, s = PATHS[name], np.linspace(0.01, 0.99, 23)
    before, here, after = (path.points(s + d) for d in (-STEP, 0.0, STEP))
    tolerance = {"rtol": 1e-5, "atol": 1e-5}
    np.testing.assert_allclose((after.p - before.p) / (2 * STEP), here.p_s, **tolerance)
    np.testing.assert_allclose((after.p_s - before.p_s) / (2 * STEP), here.p_ss, **tolerance)
    turning = here.R.transpose(0, 2, 1) @ (after.R - before.R) / (2 * STEP)
    np.testing.assert_allclose(unskew(turning), here.omega, **tolerance)
    np.testing.assert_allclose((after.omega - before.omega) / (2 * STEP), here.omega_s, **tolerance)
    np.testing.assert_allclose(here.R.transpose(0, 2, 1) @ here.R, np.tile(np.eye(3), (23, 1, 1)), atol=1e-14)


@pytest.mark.parametrize("name", ["straight", "screw", "through poses"])
def test_path_begins_and_ends_at_its_poses(name: str) -> None:
    at = PATHS[name].points(np.array([0.0, 1.0]))
    for i, (p, R) in enumerate((START, GOAL)):
        np.testing.assert_allclose(at.p[i], p, atol=1e-15)
        np.testing.assert_allclose(at.R[i], R, atol=1e-14)


def test_screw_has_constant_body_twist_and_straight_path_constant_velocity() -> None:
    s = np.linspace(0.0, 1.0, 11)
    screw, straight = PATHS["screw"].points(s), PATHS["straight"].points(s)
    body = np.einsum("kji,kj->ki", screw.R, screw.p_s)
    np.testing.assert_allclose(body, np.tile(body[0], (11, 1)), atol=1e-15)
    np.testing.assert_allclose(straight.p_s, np.tile(GOAL[0] - START[0], (11, 1)), atol=0.0)
    np.testing.assert_allclose(screw.omega, straight.omega, atol=1e-15)
    assert np.abs(screw.p - straight.p).max() > 1e-3  # m: the paths differ


def test_via_poses_are_passed_without_stops_and_in_the_given_direction() -> None:
    path = PATHS["through turns"]
    s = np.linspace(0.0, 1.0, 2001)
    at = path.points(s)
    errors = [np.abs(at.R - R).max(axis=(1, 2)).min() for R in TURNS.as_matrix()]
    assert max(errors) < 2e-3  # rad: half a step of s, times 4.8 rad
    assert np.linalg.norm(at.omega, axis=1).min() > 3.0  # rad: no stop
    assert (at.omega[:, 2] > 0).all()  # 4.8 rad, not 1.5 rad the other way round
    assert np.trapezoid(at.omega[:, 2], s) == pytest.approx(4.8, rel=1e-6)


def test_joint_path_passes_postures_with_its_derivatives() -> None:
    postures = np.array([[0.0, 0.0], [0.3, 0.1], [0.2, 0.5]])
    path, s = JointPath.through(postures), np.linspace(0.01, 0.99, 31)
    ends = path.points(np.array([0.0, 1.0])).q
    np.testing.assert_allclose(ends, postures[[0, -1]], atol=1e-15)
    before, here, after = (path.points(s + d) for d in (-STEP, 0.0, STEP))
    np.testing.assert_allclose((after.q - before.q) / (2 * STEP), here.q_s, atol=1e-6)
    np.testing.assert_allclose((after.q_s - before.q_s) / (2 * STEP), here.q_ss, atol=1e-5)
    assert np.linalg.norm(here.q_s, axis=1).min() > 0.1


def test_path_through_two_postures_is_straight() -> None:
    at = JointPath.through([[0.0, 1.0], [1.0, -1.0]]).points(knot_grid(10))
    np.testing.assert_allclose(at.q_s, np.tile([1.0, -2.0], (11, 1)), atol=1e-13)
    np.testing.assert_allclose(at.q_ss, 0.0, atol=1e-11)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StraightPath([0, 0], np.eye(3), [0, 0, 1], np.eye(3)), "p_start"),
        (lambda: StraightPath([0, 0, 0], -np.eye(3), [0, 0, 1], np.eye(3)), "R_start.*must be a rotation"),
        (lambda: ScrewPath([0, 0, 0], np.eye(3), [0, 0, 1], 2 * np.eye(3)), "R_goal.*must be a rotation"),
        (lambda: SplinePath.through([[0, 0, 0]], [np.eye(3)]), "at least two poses"),
        (lambda: SplinePath.through(np.zeros((2, 3)), [np.eye(3)] * 2), r"p_HO\[1\].* nothing moves"),
        (lambda: JointPath.through([[0.0], [1.0], [1.0]]), r"postures\[2\].* nothing moves"),
        (lambda: knot_grid(1), "intervals = 1"),
    ],
)
def test_invalid_path_names_its_field(make, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        make()


# ── interpolation ─────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_hermite_reproduces_quintic_polynomials() -> None:
    polynomials = [np.polynomial.Polynomial(c) for c in np.random.default_rng(1).normal(size=(4, 6))]
    knots = np.array([0.0, 0.3, 0.35, 1.0])
    times = np.linspace(0.0, 1.0, 57)

    def derivative(t: Array, order: int) -> Array:
        return np.stack([p.deriv(order)(t) if order else p(t) for p in polynomials], axis=-1)

    i, u = locate_intervals(knots, times)
    ends = [derivative(knots[j], order) for j in (i, i + 1) for order in range(3)]
    found = hermite(u, knots[i + 1] - knots[i], tuple(ends))
    for order in range(3):  # rounding over the square of the shortest step
        np.testing.assert_allclose(found[order], derivative(times, order), rtol=1e-10, atol=1e-10)


def tumbling(t: Array) -> tuple[Array, Array, Array]:
    """Return R, ω and α in the body's axes of R = exp(a t²) exp(b sin t); ω of a product is E₂ᵀ ω₁ + ω₂."""
    a, b = np.array([0.7, -0.4, 0.9]), np.array([-0.5, 0.8, 0.3])
    first = Rotation.from_rotvec(np.outer(t**2, a)).as_matrix()
    second = Rotation.from_rotvec(np.outer(np.sin(t), b)).as_matrix()
    omega_1, omega_2 = np.outer(2 * t, a), np.outer(np.cos(t), b)
    carried = np.einsum("kji,kj->ki", second, omega_1)
    alpha = np.einsum("kji,kj->ki", second, np.tile(2 * a, (len(t), 1))) + np.cross(carried, omega_2) - np.outer(np.sin(t), b)
    return first @ second, carried + omega_2, alpha


@pytest.mark.parametrize("intervals_between", [2, 8])
def test_angular_rates_match_differences_of_interpolated_rotations(intervals_between: int) -> None:
    """ω and α are the derivatives of the interpolated R, for rotations of up to a radian an interval."""
    knots = np.linspace(0.0, 1.5, intervals_between + 1)
    at = tumbling(knots)

    def interpolated(times: Array) -> tuple[Array, Array, Array]:
        i, u = locate_intervals(knots, times)
        return hermite_rotation(u, knots[i + 1] - knots[i], tuple(x[j] for j in (i, i + 1) for x in at))

    t = np.linspace(0.03, 1.47, 40)
    t = t[np.abs(t[:, None] - knots).min(axis=1) > 2 * STEP]
    before, here, after = (interpolated(t + d) for d in (-STEP, 0.0, STEP))
    turning = here[0].transpose(0, 2, 1) @ (after[0] - before[0]) / (2 * STEP)
    np.testing.assert_allclose(unskew(turning), here[1], atol=1e-6)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * STEP), here[2], atol=1e-5)
    for found, exact in zip(interpolated(knots), at, strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-12)


def test_interpolated_rotations_converge_with_order_six() -> None:
    t = np.linspace(0.0, 1.5, 301)
    exact = tumbling(t)[0]
    errors = []
    for count in (4, 8, 16):
        knots = np.linspace(0.0, 1.5, count + 1)
        at = tumbling(knots)
        i, u = locate_intervals(knots, t)
        R, _, _ = hermite_rotation(u, knots[i + 1] - knots[i], tuple(x[j] for j in (i, i + 1) for x in at))
        errors.append(np.abs(R - exact).max())
    assert errors[0] / errors[1] > 40.0  # 64 in the limit
    assert errors[1] / errors[2] == pytest.approx(64.0, rel=0.2)

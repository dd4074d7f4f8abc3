"""Friction cone: membership, duality, projection and pyramids, for frictionless, point and soft contacts."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.contact_strategies import coefficients, seeds

from graspforce.contact import friction

EPS = np.finfo(float).eps
lengths = st.one_of(st.just(0.0), st.floats(1e-4, 0.1))  # m
facet_counts = st.integers(3, 24)
sides = st.sampled_from(["inner", "outer"])


def members(rng, count, mu, gamma):
    """Return forces of the exact cone, half of them on its surface: f_n (1, ρ μ d_t, ρ γ d_m), d a unit vector, ρ ≤ 1."""
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    depth = np.where(rng.uniform(size=count) < 0.5, 1.0, rng.uniform(size=count))[:, None]
    f = np.column_stack([mu * depth * d[:, :2], np.ones(count), gamma * depth * d[:, 2:]])
    return f * rng.exponential(5.0, size=(count, 1))


def in_pyramid(f, facets, side, mu, gamma, slack):
    """Return whether forces satisfy a pyramid's rows, and have no component without friction."""
    rows = friction.pyramid_facets(facets, side, gamma)
    use = friction.pyramid_friction(mu, facets, side)
    scaled = np.column_stack([f[:, :2] / use, f[:, 3] / gamma if gamma else np.zeros(len(f))])
    return ((scaled @ rows.T).max(axis=1) <= f[:, friction.F_N] * (1 + slack)) & ((f[:, 3] == 0.0) | (gamma > 0.0))


# --- membership -----------------------------------------------------------------------------------------------------------


@given(seeds, coefficients, lengths)
@settings(max_examples=80, deadline=None)
def test_forces_of_the_cone_have_no_violation_and_others_have_one(seed, mu, gamma):
    f = members(np.random.default_rng(seed), 50, mu, gamma)
    assert (friction.violation(f, mu, gamma) <= 4 * EPS * f[:, 2]).all()
    assert (friction.violation(-f, mu, gamma) >= f[:, 2]).all()  # pulling, by f_n at least
    for component in (0, 1, 3):
        out = f.copy()
        out[:, component] += np.where(out[:, component] < 0, -1.0, 1.0) * (2 * max(mu, gamma) * f[:, 2] + 1.0)
        assert (friction.violation(out, mu, gamma) > 1e-3).all()


@given(seeds, st.floats(0.05, 2.0))
@settings(max_examples=40, deadline=None)
def test_the_slip_margin_of_a_point_contact_is_mu_f_n_minus_f_t(seed, mu):
    f = np.random.default_rng(seed).normal(size=(20, 4)) * [1, 1, 1, 0]
    tangential = np.sqrt(f[:, 0] ** 2 + f[:, 1] ** 2)
    assert friction.required_friction(f, mu, 0.0) == pytest.approx(tangential, rel=4 * EPS)
    assert friction.slip_margin(f, mu, 0.0) == pytest.approx(mu * f[:, 2] - tangential, abs=1e-14)


def test_a_moment_reduces_the_slip_margin():
    mu, gamma = 0.5, 0.01
    f = np.array([[0.3, 0.0, 1.0, 0.008], [0.0, 0.0, 1.0, 0.01], [0.3, 0.4, 1.0, 0.0]])  # 0.6² + 0.8² = 1: all on the surface
    assert friction.required_friction(f, mu, gamma) == pytest.approx([0.5, 0.5, 0.5], rel=4 * EPS)
    assert friction.slip_margin(f, mu, gamma) == pytest.approx([0.0, 0.0, 0.0], abs=4 * EPS)
    assert friction.violation(f * [1, 1, 0.9, 1], mu, gamma) == pytest.approx(
        [0.05, 0.1, 0.05], rel=1e-14
    )  # for a pure moment, by which f_n is too small


@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e160, 1e300])
def test_margins_are_linear_in_the_force_without_overflow(size):
    f = np.array([0.3, 0.0, 1.0, 0.004])
    required_friction = friction.required_friction(f, 0.5, 0.01)
    assert friction.required_friction(size * f, 0.5, 0.01) == pytest.approx(size * required_friction, rel=4 * EPS)
    assert friction.slip_margin(size * f, 0.5, 0.01) == pytest.approx(size * (0.5 - required_friction), rel=16 * EPS)
    assert friction.dual_violation(-size * f, 0.5, 0.01) == pytest.approx(
        size * friction.dual_violation(-f, 0.5, 0.01), rel=4 * EPS
    )
    assert friction.project(size * np.array([3.0, 0.0, 1.0]), 0.5) == pytest.approx(
        [size * x for x in (1.0, 0.0, 2.0)], rel=1e-14
    )


def test_each_contact_has_its_own_coefficients():
    f = np.array([[0.3, 0.4, 1.0, 0.0]] * 3)
    assert friction.slip_margin(f, np.array([0.0, 0.5, 1.0]), np.zeros(3)) == pytest.approx([-0.5, 0.0, 0.5], abs=4 * EPS)


# --- duality --------------------------------------------------------------------------------------------------------------


def support(z, mu, gamma):
    """Return min zᵀf over forces of the cone with f_n = 1, z_n − √(μ²‖z_t‖² + γ²z_m²), and the minimiser."""
    d = -np.column_stack([mu * z[:, :2], gamma * z[:, 3:]])
    length = np.linalg.norm(d, axis=1)[:, None]
    d = np.divide(d, length, out=np.zeros_like(d), where=length > 0)
    f = np.column_stack([mu * d[:, :2], np.ones(len(z)), gamma * d[:, 2:]])
    return np.sum(z * f, axis=1), f


@given(seeds, coefficients, lengths)
@settings(max_examples=80, deadline=None)
def test_multipliers_of_the_dual_cone_have_no_negative_product_with_a_force_of_the_cone(seed, mu, gamma):
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(40, 4)) * [1, 1, 1, 30]
    violation = friction.dual_violation(z, mu, gamma)
    products = z @ members(rng, 200, mu, gamma).T
    assert (products[violation == 0.0] >= -1e-12).all()
    least, worst = support(z, mu, gamma)
    assert (friction.violation(worst, mu, gamma) <= 8 * EPS).all()
    assert violation == pytest.approx(np.maximum(-least, 0.0), abs=1e-14)


def test_without_friction_the_dual_cone_is_a_half_space():
    assert friction.dual_violation(np.array([[5.0, -3.0, 0.2, 7.0], [0, 0, -0.2, 0]]), 0.0, 0.0) == pytest.approx([0.0, 0.2])


# --- projection -----------------------------------------------------------------------------------------------------------


@given(seeds, coefficients)
@settings(max_examples=80, deadline=None)
def test_the_projection_is_idempotent_and_the_closest_force_of_the_cone(seed, mu):
    rng = np.random.default_rng(seed)
    f = rng.normal(size=(30, 3)) * rng.exponential(3.0, size=(30, 1))
    p = friction.project(f, mu)
    largest = np.abs(f).max()  # N: rounding is relative to it
    assert (friction.violation(np.column_stack([p, np.zeros(30)]), mu, 0.0) <= 8 * EPS * largest).all()
    assert friction.project(p, mu) == pytest.approx(p, abs=8 * EPS * largest)
    inside = friction.slip_margin(np.column_stack([f, np.zeros(30)]), mu, 0.0) >= 0
    assert np.array_equal(p[inside], f[inside])
    others = members(rng, 300, mu, 0.0)[:, :3]
    away = np.linalg.norm(f - p, axis=1)
    assert (away[:, None] <= np.linalg.norm(f[:, None] - others, axis=2) + 100 * EPS * largest).all()


@given(seeds, coefficients)
@settings(max_examples=80, deadline=None)
def test_a_force_is_the_sum_of_its_projections_onto_cone_and_polar_cone(seed, mu):
    """Moreau's decomposition: f = p + r with p in K, −r in K*, and p·r = 0."""
    f = np.random.default_rng(seed).normal(size=(30, 3))
    p = friction.project(f, mu)
    r = f - p
    assert np.sum(p * r, axis=1) == pytest.approx(0.0, abs=1e-14)
    assert (friction.dual_violation(np.column_stack([-r, np.zeros(30)]), mu, 0.0) <= 1e-14).all()


def test_projection_with_very_high_friction_keeps_all_compressive_forces():
    assert friction.project(np.array([3.0, 4.0, 1e-9]), 1e200) == pytest.approx([3.0, 4.0, 1e-9], rel=1e-14)
    assert friction.project(np.array([3.0, 4.0, -1.0]), 1e200) == pytest.approx([3.0, 4.0, 0.0], abs=1e-14)


# --- pyramids -------------------------------------------------------------------------------------------------------------


@given(facet_counts, sides, st.floats(0.05, 2.0), lengths)
@settings(max_examples=80, deadline=None)
def test_rays_are_the_edges_of_the_pyramid(facets, side, mu, gamma):
    """Each ray is on enough facets to define an edge, and each facet contains enough rays to span it."""
    rows = friction.pyramid_facets(facets, side, gamma)
    rays = friction.pyramid_rays(facets, side, mu, gamma)
    use = friction.pyramid_friction(mu, facets, side)
    scaled = np.column_stack([rays[:, :2] / use, rays[:, 3] / gamma if gamma else np.zeros(len(rays))])
    slack = rays[:, friction.F_N, None] - scaled @ rows.T  # (rays, facets)
    dimension = 4 if gamma else 3
    assert slack.min() >= -1e-13
    assert ((slack < 1e-12).sum(axis=1) >= dimension - 1).all()
    assert ((slack < 1e-12).sum(axis=0) >= dimension - 1).all()
    assert np.array_equal(rays[:, friction.F_N], np.ones(len(rays)))


@given(seeds, facet_counts, st.floats(0.05, 2.0), lengths)
@settings(max_examples=80, deadline=None)
def test_the_inner_pyramid_is_in_the_cone_and_the_cone_in_the_outer_pyramid(seed, facets, mu, gamma):
    rng = np.random.default_rng(seed)
    inner = friction.pyramid_rays(facets, "inner", mu, gamma)
    mixed = rng.exponential(size=(60, len(inner))) @ inner
    assert (friction.violation(np.vstack([inner, mixed]), mu, gamma) <= 1e-13 * mixed[:, 2].max()).all()
    assert in_pyramid(mixed, facets, "inner", mu, gamma, 1e-12).all()
    exact = members(rng, 100, mu, gamma)
    assert in_pyramid(exact, facets, "outer", mu, gamma, 1e-12).all()
    outer = friction.pyramid_rays(facets, "outer", mu, gamma)
    assert (friction.violation(outer, mu, gamma) > 0.0).all()  # its edges are outside the cone


@given(facet_counts, st.floats(0.05, 2.0))
@settings(max_examples=40, deadline=None)
def test_inner_edges_and_the_middles_of_outer_facets_are_on_the_cone(facets, mu):
    inner, outer = (friction.pyramid_rays(facets, side, mu, 0.0) for side in ("inner", "outer"))
    assert friction.slip_margin(inner, mu, 0.0) == pytest.approx(0.0, abs=8 * EPS)
    middle = 0.5 * (outer + np.roll(outer, 1, axis=0))
    assert friction.slip_margin(middle, mu, 0.0) == pytest.approx(0.0, abs=1e-14)
    assert friction.pyramid_facets(facets, "inner", 0.0)[0] == pytest.approx([1.0, 0.0, 0.0], abs=0.0)  # along t₁


@given(seeds, facet_counts, sides, st.floats(0.05, 2.0), lengths)
@settings(max_examples=60, deadline=None)
def test_the_dual_cone_of_a_pyramid_is_generated_by_its_facet_normals(seed, facets, side, mu, gamma):
    """Farkas' lemma in both directions: positive sums of facet normals have no negative product with a ray, others have one."""
    rng = np.random.default_rng(seed)
    rows = friction.pyramid_facets(facets, side, gamma)
    rays = friction.pyramid_rays(facets, side, mu, gamma)
    use = float(friction.pyramid_friction(mu, facets, side))
    normals = np.column_stack([-rows[:, :2] / use, np.ones(len(rows)), -rows[:, 2] / gamma if gamma else np.zeros(len(rows))])
    inside = rng.exponential(size=(20, len(rows))) @ normals
    assert (inside @ rays.T >= -1e-10).all()
    lifted = normals - [0.0, 0.0, 1e-6, 0.0]
    assert (lifted @ rays.T).min(axis=1) == pytest.approx(-1e-6, rel=1e-3)


def test_inner_and_outer_friction_converge_at_second_order():
    """Inner and outer friction differ by 1 − cos(π/m) ≈ π²/2m²: second order in the number of facets."""
    gaps = [1.0 - friction.pyramid_friction(1.0, m, "inner") / friction.pyramid_friction(1.0, m, "outer") for m in (16, 32, 64)]
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.01)
    assert gaps[1] / gaps[2] == pytest.approx(4.0, rel=0.01)
    assert gaps[0] == pytest.approx(np.pi**2 / 512, rel=0.01)


@given(seeds, st.floats(0.05, 2.0), st.floats(1e-3, 0.1))
@settings(max_examples=40, deadline=None)
def test_the_linear_soft_finger_law_is_inside_the_elliptic_law(seed, mu, gamma):
    f = members(np.random.default_rng(seed), 100, mu, gamma)
    linear = np.hypot(f[:, 0], f[:, 1]) / mu + np.abs(f[:, 3]) / gamma
    assume((linear > f[:, 2] * (1 + 1e-9)).any())
    kept = in_pyramid(f, 64, "inner", mu, gamma, 0.0)
    assert (linear[kept] <= f[kept, 2] * (1 + 1e-12)).all()

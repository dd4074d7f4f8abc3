"""Quality measures: known values, invariance, and laws that connect the Ferrari–Canny ε with force closure."""

from __future__ import annotations

import numpy as np
import pytest
from support.contact_strategies import contact_ring, contacts_around_object

from graspforce import Contact, ContactSet, InvalidInput
from graspforce.contact import friction
from graspforce.contact.closure import is_force_closed
from graspforce.contact.inscribed_ball import inscribed_ball
from graspforce.contact.matrices import RANK_TOLERANCE, characteristic_length, normalised_grasp_matrix
from graspforce.contact.quality import ferrari_canny, inscribed_ball_radius, smallest_singular_value, wrench_ball

FACETS = 8


def inside_pyramid(contacts: ContactSet) -> ContactSet:
    """Return the contacts with the friction of the largest exact cone inside ε's inner pyramids.

    A pyramid of m facets with its edges on the cone contains the cone of μ cos(π/m). With torsional friction its facets are
    ‖f_t‖/(μ c) + |m_n|/γ ≤ f_n with c = cos(π/m), which contain the ellipsoid of μ and γ times c/√(1 + c²).
    """
    c = np.cos(np.pi / FACETS)
    factor = np.where(contacts.gamma > 0, c / np.sqrt(1 + c**2), c)
    mu, gamma = contacts.mu * factor, contacts.gamma * factor
    return ContactSet(contacts.p_OC, contacts.R_OC, contacts.models, mu, gamma, contacts.min_normal, contacts.max_normal)


def test_epsilon_of_zero_implies_that_a_grasp_is_not_force_closed():
    rng = np.random.default_rng(12)
    open_grasps = closed_grasps = 0
    for _ in range(150):
        contacts = contacts_around_object(rng, int(rng.integers(2, 6)))
        if ferrari_canny(contacts, FACETS) == 0.0:
            open_grasps += 1
            assert not is_force_closed(inside_pyramid(contacts))
        else:
            closed_grasps += 1
            assert is_force_closed(contacts)
    assert min(open_grasps, closed_grasps) >= 20  # both kinds were drawn


def test_epsilon_is_positive_exactly_where_frictionless_grasps_close():
    """Without friction the pyramids are exact: ε > 0 and force closure are the same statement."""
    rng = np.random.default_rng(13)
    closed = [0, 0]
    for _ in range(60):
        contacts = contacts_around_object(rng, int(rng.integers(7, 14)), models=("frictionless",))
        is_closed = is_force_closed(contacts)
        closed[is_closed] += 1
        assert is_closed == (ferrari_canny(contacts, FACETS) > 0.0)
    assert min(closed) >= 5


def test_the_inscribed_ball_of_unit_wrenches_has_its_known_radius():
    cross = np.vstack([np.eye(6), -np.eye(6)])
    assert inscribed_ball_radius(cross) == pytest.approx(1.0 / np.sqrt(6.0), rel=1e-12)
    assert inscribed_ball_radius(2.5e-200 * cross) == pytest.approx(2.5e-200 / np.sqrt(6.0), rel=1e-12)
    shifted = cross + 0.3 * np.eye(6)[0]  # the facets with normal −e₀ move closer by 0.3/√6
    assert inscribed_ball_radius(shifted) == pytest.approx(0.7 / np.sqrt(6.0), rel=1e-12)


def test_the_radius_is_negative_outside_the_hull_and_zero_for_flat_hulls():
    cross = np.vstack([np.eye(6), -np.eye(6)])
    assert inscribed_ball_radius(cross + 2.0 * np.eye(6)[0]) == pytest.approx(-1.0 / np.sqrt(6.0), rel=1e-12)
    assert inscribed_ball_radius(cross[:, [0, 1, 2, 3, 4, 4]]) == 0.0
    assert inscribed_ball_radius(np.zeros((9, 6))) == 0.0
    assert inscribed_ball_radius(np.eye(6)) == 0.0
    assert inscribed_ball_radius(np.zeros((0, 6))) == 0.0


def test_the_inscribed_ball_is_bounded_by_the_support_function():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(40, 6))
    directions = rng.normal(size=(20000, 6))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    support = (directions @ points.T).max(axis=1)  # the ball is inside every supporting plane
    radius = inscribed_ball_radius(points)
    assert 0.0 < radius <= support.min()
    assert radius >= 0.6 * support.min()  # 20000 directions resolve about 40 % in six dimensions


def test_rejects_an_unknown_limit():
    with pytest.raises(InvalidInput, match="limit"):
        ferrari_canny(contact_ring(3), limit="motors")


def test_ferrari_canny_is_positive_only_if_closed_and_increases_with_facets():
    rng = np.random.default_rng(11)
    positive = 0
    for _ in range(15):
        contacts = contacts_around_object(rng, 4, models=("point", "soft"))
        coarse, fine = ferrari_canny(contacts, 4), ferrari_canny(contacts, 12)
        assert 0.0 <= coarse <= fine + 1e-12  # the edges of the 4-sided pyramid are edges of the 12-sided one
        positive += fine > 1e-9
        assert is_force_closed(contacts) or fine <= 1e-9
    assert positive >= 3


def test_ferrari_canny_of_a_ring_is_at_most_its_weakest_direction():
    # At Σ f_n = 1 the vertical force is at most μ, and so is the moment about the vertical over L.
    assert 0.0 < ferrari_canny(contact_ring(3, mu=0.3), 16) <= 0.3
    assert ferrari_canny(contact_ring(3, mu=0.6)) > ferrari_canny(contact_ring(3, mu=0.3))


def test_epsilon_of_two_coincident_soft_pairs_is_their_torsional_friction():
    """The weakest wrench is the moment about the common normal, at most γ for each newton; Qhull fails on all its points."""
    pairs = [Contact((x, 0, 0), (-x, 0, 0), 0.5, "soft", torsional_friction=0.1) for x in (1.0, 1.0, -1.0, -1.0)]
    ball = wrench_ball(ContactSet.stack(pairs))
    assert ball.radius <= 0.1 <= ball.upper * (1.0 + 1e-9)
    assert ball.upper - ball.radius <= 1e-4 * ball.upper
    assert ferrari_canny(ContactSet.stack(pairs), 8) > 0.09
    np.testing.assert_allclose(np.abs(ball.direction), np.eye(6)[3], atol=1e-2)


@pytest.mark.parametrize("limit", ["sum", "each"])
def test_epsilon_agrees_with_the_hull_of_all_wrenches(limit):
    """The nearest facet of an adaptive hull is the nearest facet of the hull of all wrenches."""
    rng = np.random.default_rng(17)
    positive = 0
    for _ in range(200):
        contacts = contacts_around_object(rng, 5 if limit == "sum" else 4, models=("point",))
        if limit == "each" and (positive >= 4 or not is_force_closed(contacts)):
            continue  # the hull of the sum of four polytopes takes half a second
        rays = [wrenches @ base.T for wrenches, base in _pyramid_wrenches(contacts, 3)]
        if limit == "sum":
            points = np.vstack(rays)
        else:  # Minkowski sum of the hulls of 0 and each contact's wrenches
            points = np.zeros((1, 6))
            for each in rays:
                points = (points[:, None] + np.vstack([np.zeros((1, 6)), each])).reshape(-1, 6)
        expected = max(inscribed_ball_radius(points), 0.0)
        assert ferrari_canny(contacts, 3, limit) == pytest.approx(expected, rel=1e-7, abs=1e-9)
        positive += expected > 0.0
    assert positive >= 3


def _pyramid_wrenches(contacts: ContactSet, facets: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the pyramid edges (m, 4) of each contact, and the wrenches (6, 4) of its force components."""
    L = characteristic_length(contacts)
    bases = normalised_grasp_matrix(contacts).reshape(6, -1, 4)
    edges = [
        friction.pyramid_rays(facets, "inner", mu, gamma) * (1.0, 1.0, 1.0, 1.0 / L)
        for mu, gamma in zip(contacts.mu.tolist(), contacts.gamma.tolist(), strict=True)
    ]
    return [(edge, bases[:, i]) for i, edge in enumerate(edges)]


def test_epsilon_of_many_facets_approaches_the_exact_cones():
    rng = np.random.default_rng(19)
    for _ in range(5):
        contacts = contacts_around_object(rng, 5, models=("point",))
        exact, fine = wrench_ball(contacts), ferrari_canny(contacts, 128)
        assert fine <= exact.upper * (1.0 + 1e-9)
        assert fine >= exact.radius * np.cos(np.pi / 128) - 1e-4 * exact.upper - 2e-3 * (exact.upper > 0)


def test_limits_at_each_contact_give_at_least_the_epsilon_of_a_limit_of_the_sum():
    rng = np.random.default_rng(23)
    for _ in range(10):
        contacts = contacts_around_object(rng, 5)
        total, each = wrench_ball(contacts, limit="sum"), wrench_ball(contacts, limit="each")
        assert total.radius <= each.upper * (1.0 + 1e-9)
        assert each.radius <= len(contacts) * total.upper * (1.0 + 1e-9)


def test_smallest_singular_value_of_a_ring():
    assert smallest_singular_value(contact_ring(3)) == pytest.approx(np.sqrt(1.5), rel=1e-14)  # 0.0612372/0.05
    assert smallest_singular_value(contact_ring(2)) == 0.0


@pytest.mark.parametrize("facets", [2, 257, 8.0, True, "8"])
def test_rejects_an_invalid_number_of_facets(facets):
    with pytest.raises(InvalidInput, match=r"facets = .*integer from 3 to 256"):
        ferrari_canny(contact_ring(3), facets)


@pytest.mark.parametrize("wrenches", [np.eye(5), [[1, 2, 3]], [[np.nan] * 6], "wrenches", None])
def test_rejects_invalid_wrenches(wrenches):
    with pytest.raises(InvalidInput, match="wrenches"):
        inscribed_ball_radius(wrenches)


@pytest.mark.parametrize("factor", [0.01, 0.03, 0.1, 0.2, 0.3, 0.4])
def test_search_of_the_ball_ends_for_a_set_that_is_flat_within_rounding(factor: float) -> None:
    """An ellipsoid with one semi-axis below the tolerance of the rank."""
    Q = np.linalg.qr(np.random.default_rng(5).normal(size=(6, 6)))[0]
    D = Q @ np.diag([1.0, 1.0, 1.0, 1.0, 1.0, factor * RANK_TOLERANCE]) @ Q.T
    calls = 0

    def support(u):
        nonlocal calls
        calls += 1
        assert calls <= 12 + 2 * 7, "a point in each of twelve directions, and two for each rank"
        size = float(np.linalg.norm(D @ u))
        return size, D @ (D @ u) / size

    assert inscribed_ball(support).radius == 0.0

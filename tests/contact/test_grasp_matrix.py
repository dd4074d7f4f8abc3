"""Grasp analysis: G against forces summed by hand, invariance, known answers, closure against a cone program."""

import clarabel
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import sparse
from support.contact_strategies import contact_ring, contacts_around_object, random_rotation, seeds, transformed

from graspforce import Contact, ContactSet, InvalidInput
from graspforce.contact.grasp_matrix import (
    characteristic_length,
    ferrari_canny,
    grasp_matrix,
    grasp_matrix_rank,
    inscribed_ball_radius,
    internal_forces,
    is_force_closed,
    smallest_singular_value,
)

EPS = np.finfo(float).eps


def tilted_pair(angle, mu=0.5, gamma=0.01):
    """Two opposed soft fingers, both normals tilted the same way out of the line between them."""
    lean = [np.cos(angle), np.sin(angle)]
    return ContactSet.stack(
        [
            Contact([0.05, 0, 0], [-lean[0], lean[1], 0], mu, "soft", torsional_friction=gamma),
            Contact([-0.05, 0, 0], [lean[0], lean[1], 0], mu, "soft", torsional_friction=gamma),
        ]
    )


def frictionless_box(offset):
    """Frictionless contacts on a cube, on each face but one a pair displaced to both sides, so that they turn it both ways."""
    faces = [
        ([1, offset, 0], [-1, 0, 0]),
        ([1, -offset, 0], [-1, 0, 0]),
        ([-1, 0, offset], [1, 0, 0]),
        ([-1, 0, -offset], [1, 0, 0]),
        ([0, 1, 0], [0, -1, 0]),
        ([offset, -1, 0], [0, 1, 0]),
        ([-offset, -1, 0], [0, 1, 0]),
        ([0, offset, 1], [0, 0, -1]),
        ([0, -offset, 1], [0, 0, -1]),
        ([offset, 0, -1], [0, 0, 1]),
        ([-offset, 0, -1], [0, 0, 1]),
    ]
    return ContactSet.stack([Contact(p, n, model="frictionless") for p, n in faces])


# --- G -------------------------------------------------------------------------------------------------------------------


@given(seeds, st.integers(1, 6))
@settings(max_examples=50, deadline=None)
def test_wrench_is_the_sum_of_forces_and_their_moments(seed, count):
    rng = np.random.default_rng(seed)
    contacts = contacts_around_object(rng, count)
    f = rng.normal(size=contacts.size)
    force, moment = np.zeros(3), np.zeros(3)
    for contact, part in zip(contacts.contacts, contacts.split(f), strict=True):
        t1, n = contact.tangent, contact.normal
        t2 = np.array([n[1] * t1[2] - n[2] * t1[1], n[2] * t1[0] - n[0] * t1[2], n[0] * t1[1] - n[1] * t1[0]])
        push = part[0] * n if len(part) == 1 else part[0] * t1 + part[1] * t2 + part[2] * n
        x, y, z = contact.position
        force += push
        moment += [y * push[2] - z * push[1], z * push[0] - x * push[2], x * push[1] - y * push[0]]
        moment += part[3] * n if len(part) == 4 else 0.0
    assert grasp_matrix(contacts) @ f == pytest.approx(np.concatenate([force, moment]), abs=50 * EPS)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_another_object_frame_transforms_G_by_the_adjoint(seed):
    rng = np.random.default_rng(seed)
    contacts, R, p = contacts_around_object(rng, 4), random_rotation(rng), rng.normal(size=3)
    cross = np.cross(p, np.eye(3)).T  # S(p)
    adjoint = np.block([[R, np.zeros((3, 3))], [cross @ R, R]])
    assert grasp_matrix(transformed(contacts, R, p)) == pytest.approx(adjoint @ grasp_matrix(contacts), abs=1e-14)


def test_grasp_matrix_cannot_be_written():
    assert not grasp_matrix(contact_ring(3)).flags.writeable
    assert not internal_forces(contact_ring(3)).flags.writeable


def test_three_symmetric_contacts_have_the_known_singular_values():
    sigma = np.linalg.svd(grasp_matrix(contact_ring(3)), compute_uv=False)
    known = [np.sqrt(3)] * 3 + [0.05 * np.sqrt(3)] + [0.05 * np.sqrt(1.5)] * 2  # 0.0866025, 0.0612372
    assert sigma == pytest.approx(known, rel=1e-14)
    assert known[3:] == pytest.approx([0.0866025, 0.0612372, 0.0612372], abs=5e-8)


# --- characteristic length, rank, internal forces ---------------------------------------------------------------------------


@given(seeds, st.floats(1e-3, 1e3))
@settings(max_examples=30, deadline=None)
def test_characteristic_length_is_a_length_of_the_grasp_alone(seed, scale):
    rng = np.random.default_rng(seed)
    contacts = contacts_around_object(rng, 5)
    there = transformed(contacts, random_rotation(rng), scale * rng.normal(size=3), scale)
    assert characteristic_length(there) == pytest.approx(scale * characteristic_length(contacts), rel=1e-12)


def test_characteristic_length_of_a_ring_is_its_radius_and_falls_back_where_contacts_coincide():
    assert characteristic_length(contact_ring(3, radius=0.07)) == pytest.approx(0.07, rel=1e-14)
    n = [0, 0, 1]
    assert characteristic_length(ContactSet.stack([Contact([0.3, 0, 0.4], n, 0.5)] * 3)) == pytest.approx(0.5, rel=1e-14)
    assert characteristic_length(ContactSet.stack([Contact([0, 0, 0], n, 0.5)] * 2)) == 1.0
    assert characteristic_length(ContactSet.stack([Contact([1e-200, 0, 0], n, 0.5)])) == 1e-200


@given(seeds, st.integers(3, 7))
@settings(max_examples=30, deadline=None)
def test_point_contacts_in_general_position_have_3n_minus_6_internal_forces(seed, count):
    contacts = contacts_around_object(np.random.default_rng(seed), count, models=("point",))
    assert grasp_matrix_rank(contacts) == 6
    assert internal_forces(contacts).shape == (3 * count, 3 * count - 6)


@given(seeds, st.integers(1, 6), st.floats(1e-4, 1e4))
@settings(max_examples=50, deadline=None)
def test_internal_forces_cancel_and_are_orthonormal_in_every_unit_of_length(seed, count, scale):
    rng = np.random.default_rng(seed)
    contacts = transformed(contacts_around_object(rng, count), np.eye(3), np.zeros(3), scale)
    N = internal_forces(contacts)
    G = grasp_matrix(contacts)
    assert N.shape[1] == contacts.size - grasp_matrix_rank(contacts)
    # Rounding of up to 24 products, 2e-16 each, of forces and of moments over lengths of some scales, and of the SVD's own.
    assert np.abs(G @ N).max(initial=0.0) <= 1e-12 * max(1.0, scale)
    assert np.abs(N.T @ N - np.eye(N.shape[1])).max(initial=0.0) <= 1e-13


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_a_particular_force_and_internal_forces_make_every_force_that_supplies_a_wrench(seed):
    rng = np.random.default_rng(seed)
    contacts = contacts_around_object(rng, 4, models=("point", "soft"))
    G, N, f = grasp_matrix(contacts), internal_forces(contacts), rng.normal(size=contacts.size)
    particular = G.T @ np.linalg.solve(G @ G.T, G @ f)
    assert particular + N @ (N.T @ f) == pytest.approx(f, abs=1e-9)  # G Gᵀ squares G's condition, ~1e3


@given(seeds, st.floats(1e-4, 1e4), st.floats(0.0, 1e5))
@settings(max_examples=40, deadline=None)
def test_rank_does_not_depend_on_frame_or_unit(seed, scale, shift):
    rng = np.random.default_rng(seed)
    p = shift * scale * 0.05 * rng.normal(size=3)  # up to some 10⁵ times the grasp's size away
    R = random_rotation(rng)
    assert grasp_matrix_rank(transformed(contact_ring(2), R, p, scale)) == 5
    assert grasp_matrix_rank(transformed(contact_ring(1), R, p, scale)) == 3
    assert grasp_matrix_rank(transformed(contact_ring(2, model="soft", torsional_friction=0.01), R, p, scale)) == 6
    assert grasp_matrix_rank(transformed(contact_ring(3), R, p, scale)) == 6


def test_coincident_contacts_pass_on_a_force_and_no_moment():
    contacts = ContactSet.stack([Contact([0.1, 0.2, 0.3], n, 0.5) for n in ([1, 0, 0], [0, 1, 0], [0.3, 0.4, 0.5])])
    assert grasp_matrix_rank(contacts) == 3
    assert internal_forces(contacts).shape == (9, 6)
    assert not is_force_closed(contacts)
    assert ferrari_canny(contacts) == 0.0
    assert smallest_singular_value(contacts) == 0.0


# --- force closure --------------------------------------------------------------------------------------------------------


def closure_margin(contacts):
    """s* of the closure program as one second-order cone program, in Clarabel, on G itself with no reduction."""
    count = len(contacts)
    scale = np.column_stack([contacts.mu, contacts.mu, np.ones(count), contacts.gamma]).ravel()
    G = contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1) * scale
    rows = [np.column_stack([G, np.zeros(6)]), np.append(np.tile([0.0, 0.0, 1.0, 0.0], count), 0.0)[None]]
    for i in range(count):
        cone = np.zeros((4, 4 * count + 1))
        cone[[0, 1, 2, 3], 4 * i + np.array([2, 0, 1, 3])] = -1.0
        cone[0, -1] = 1.0
        rows.append(cone)
    b = np.concatenate([np.zeros(6), [1.0], np.zeros(4 * count)])
    cones = [clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(1), *[clarabel.SecondOrderConeT(4)] * count]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    q = np.append(np.zeros(4 * count), -1.0)
    nothing = sparse.csc_matrix((len(q), len(q)))
    solution = clarabel.DefaultSolver(nothing, q, sparse.csc_matrix(np.vstack(rows)), b, cones, settings).solve()
    assert str(solution.status) == "Solved"
    return solution.x[-1]


def borne_rank(contacts):
    """Rank of what friction can bear, in lengths of 5 cm, by NumPy's own rule."""
    scale = np.column_stack([contacts.mu, contacts.mu, np.ones(len(contacts)), contacts.gamma / 0.05]).ravel()
    G = contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1) * scale
    G[3:] /= 0.05
    return np.linalg.matrix_rank(G, tol=1e-9)


def test_closure_agrees_with_a_cone_program_on_closed_and_open_grasps():
    rng = np.random.default_rng(20240)
    answers = []
    for _ in range(120):
        contacts = contacts_around_object(rng, int(rng.integers(2, 7)))
        margin = closure_margin(contacts)
        if 1e-7 < margin < 1e-6:
            continue  # too near the boundary for Clarabel's own 1e-8
        answers.append(is_force_closed(contacts))
        assert answers[-1] == (margin > 1e-6 and borne_rank(contacts) == 6)
    assert 30 <= sum(answers) <= len(answers) - 30  # both kinds were tried


@given(seeds, st.integers(2, 5), st.floats(1e-3, 1e3))
@settings(max_examples=30, deadline=None)
def test_closure_and_quality_do_not_depend_on_frame_or_unit(seed, count, scale):
    rng = np.random.default_rng(seed)
    contacts = contacts_around_object(rng, count)
    assume(abs(closure_margin(contacts)) > 1e-6 or borne_rank(contacts) < 6)
    there = transformed(contacts, random_rotation(rng), 3.0 * scale * rng.normal(size=3), scale)
    assert is_force_closed(there) == is_force_closed(contacts)
    assert ferrari_canny(there, 8) == pytest.approx(ferrari_canny(contacts, 8), rel=1e-9, abs=1e-12)
    assert smallest_singular_value(there) == pytest.approx(smallest_singular_value(contacts), rel=1e-9, abs=1e-12)


def test_two_opposed_fingers_close_when_soft_and_three_around_close():
    assert not is_force_closed(contact_ring(2))
    assert is_force_closed(contact_ring(2, model="soft", torsional_friction=0.01))
    assert is_force_closed(contact_ring(3))
    assert is_force_closed(contact_ring(8))


@pytest.mark.parametrize("mu", [0.05, 0.5, 1.7])
def test_a_soft_pair_closes_up_to_the_friction_angle_and_not_on_it(mu):
    friction_angle = np.arctan(mu)
    assert is_force_closed(tilted_pair(friction_angle - 1e-6, mu))
    assert not is_force_closed(tilted_pair(friction_angle, mu))
    assert not is_force_closed(tilted_pair(friction_angle + 1e-6, mu))


def test_fingers_that_cannot_press_against_each_other_do_not_close():
    up = [Contact([np.cos(a), np.sin(a), 0], [0, 0, 1], 0.9) for a in (0.0, 2.0, 4.0)]
    assert grasp_matrix_rank(ContactSet.stack(up)) == 6
    assert not is_force_closed(ContactSet.stack(up))


def test_a_coefficient_of_zero_is_no_friction():
    assert not is_force_closed(contact_ring(3, mu=0.0))
    assert not is_force_closed(contact_ring(2, model="soft", torsional_friction=0.0))
    assert grasp_matrix_rank(contact_ring(3, mu=0.0)) == 6  # of G, whatever friction bears


def test_contacts_without_friction_close_by_form_alone():
    assert is_force_closed(frictionless_box(0.5))
    assert not is_force_closed(frictionless_box(0.0))  # all normals meet: nothing turns the box
    assert not is_force_closed(ContactSet.stack(list(frictionless_box(0.5).contacts[:6])))  # six rays never span six dimensions


def test_one_more_contact_never_opens_a_grasp():
    rng = np.random.default_rng(5)
    for _ in range(20):
        contacts = list(contacts_around_object(rng, 5).contacts)
        assert is_force_closed(ContactSet.stack(contacts)) >= is_force_closed(ContactSet.stack(contacts[:4]))


# --- quality --------------------------------------------------------------------------------------------------------------


def test_ball_in_the_hull_of_the_unit_wrenches():
    cross = np.vstack([np.eye(6), -np.eye(6)])
    assert inscribed_ball_radius(cross) == pytest.approx(1.0 / np.sqrt(6.0), rel=1e-12)
    assert inscribed_ball_radius(2.5e-200 * cross) == pytest.approx(2.5e-200 / np.sqrt(6.0), rel=1e-12)
    shifted = cross + 0.3 * np.eye(6)[0]  # the facets with normal −e₀ come nearer by 0.3/√6
    assert inscribed_ball_radius(shifted) == pytest.approx(0.7 / np.sqrt(6.0), rel=1e-12)


def test_ball_is_negative_outside_and_zero_on_flat_hulls():
    cross = np.vstack([np.eye(6), -np.eye(6)])
    assert inscribed_ball_radius(cross + 2.0 * np.eye(6)[0]) == pytest.approx(-1.0 / np.sqrt(6.0), rel=1e-12)
    assert inscribed_ball_radius(cross[:, [0, 1, 2, 3, 4, 4]]) == 0.0
    assert inscribed_ball_radius(np.zeros((9, 6))) == 0.0
    assert inscribed_ball_radius(np.eye(6)) == 0.0
    assert inscribed_ball_radius(np.zeros((0, 6))) == 0.0


def test_ball_agrees_with_the_support_function():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(40, 6))
    directions = rng.normal(size=(20000, 6))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    support = (directions @ points.T).max(axis=1)  # the ball fits under every supporting plane
    radius = inscribed_ball_radius(points)
    assert 0.0 < radius <= support.min()
    assert radius >= 0.6 * support.min()  # 20000 directions come within some 40 % in six dimensions


def test_ferrari_canny_is_positive_only_when_closed_and_grows_with_facets():
    rng = np.random.default_rng(11)
    positive = 0
    for _ in range(15):
        contacts = contacts_around_object(rng, 4, models=("point", "soft"))
        coarse, fine = ferrari_canny(contacts, 4), ferrari_canny(contacts, 12)
        assert 0.0 <= coarse <= fine + 1e-12  # every edge of the 4-sided pyramid is one of the 12-sided
        positive += fine > 1e-9
        assert is_force_closed(contacts) or fine <= 1e-9
    assert positive >= 3


def test_ferrari_canny_of_a_ring_has_no_more_than_its_weakest_direction():
    # At Σ f_n = 1 the vertical force is at most μ, and so is the moment about the vertical over L.
    assert 0.0 < ferrari_canny(contact_ring(3, mu=0.3), 16) <= 0.3
    assert ferrari_canny(contact_ring(3, mu=0.6)) > ferrari_canny(contact_ring(3, mu=0.3))


def test_smallest_singular_value_of_a_ring():
    assert smallest_singular_value(contact_ring(3)) == pytest.approx(np.sqrt(1.5), rel=1e-14)  # 0.0612372/0.05
    assert smallest_singular_value(contact_ring(2)) == 0.0


@pytest.mark.parametrize("facets", [2, 257, 8.0, True, "8"])
def test_a_bad_number_of_facets_is_named(facets):
    with pytest.raises(InvalidInput, match=r"facets = .*integer from 3 to 256"):
        ferrari_canny(contact_ring(3), facets)


@pytest.mark.parametrize("wrenches", [np.eye(5), [[1, 2, 3]], [[np.nan] * 6], "wrenches", None])
def test_bad_wrenches_are_named(wrenches):
    with pytest.raises(InvalidInput, match="wrenches"):
        inscribed_ball_radius(wrenches)

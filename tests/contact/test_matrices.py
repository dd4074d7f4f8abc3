"""Grasp matrix, rank and internal forces: G against sums of forces, and invariance to frame and unit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.contact_strategies import contact_ring, contacts_around_object, random_rotation, seeds, transformed

from graspforce import Contact, ContactSet
from graspforce.contact.closure import is_force_closed
from graspforce.contact.matrices import (
    characteristic_length,
    contact_jacobians,
    grasp_matrices,
    grasp_matrix,
    grasp_matrix_rank,
    internal_forces,
)
from graspforce.contact.quality import ferrari_canny, smallest_singular_value

EPS = np.finfo(float).eps


# --- G -------------------------------------------------------------------------------------------------------------------


@given(seeds, st.integers(1, 6))
@settings(max_examples=50, deadline=None)
def test_the_wrench_is_the_sum_of_forces_and_moments(seed, count):
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
def test_a_change_of_the_object_frame_transforms_G_by_the_adjoint(seed):
    rng = np.random.default_rng(seed)
    contacts, R, p = contacts_around_object(rng, 4), random_rotation(rng), rng.normal(size=3)
    cross = np.cross(p, np.eye(3)).T  # S(p)
    adjoint = np.block([[R, np.zeros((3, 3))], [cross @ R, R]])
    assert grasp_matrix(transformed(contacts, R, p)) == pytest.approx(adjoint @ grasp_matrix(contacts), abs=1e-14)


def test_the_grasp_matrix_is_read_only():
    assert not grasp_matrix(contact_ring(3)).flags.writeable
    assert not internal_forces(contact_ring(3)).flags.writeable


def test_three_symmetric_contacts_have_known_singular_values():
    sigma = np.linalg.svd(grasp_matrix(contact_ring(3)), compute_uv=False)
    known = [np.sqrt(3)] * 3 + [0.05 * np.sqrt(3)] + [0.05 * np.sqrt(1.5)] * 2  # 0.0866025, 0.0612372
    assert sigma == pytest.approx(known, rel=1e-14)
    assert known[3:] == pytest.approx([0.0866025, 0.0612372, 0.0612372], abs=5e-8)


# --- characteristic length, rank, internal forces ---------------------------------------------------------------------------


@given(seeds, st.floats(1e-3, 1e3))
@settings(max_examples=30, deadline=None)
def test_characteristic_length_scales_with_the_grasp_and_ignores_the_frame(seed, scale):
    rng = np.random.default_rng(seed)
    contacts = contacts_around_object(rng, 5)
    there = transformed(contacts, random_rotation(rng), scale * rng.normal(size=3), scale)
    assert characteristic_length(there) == pytest.approx(scale * characteristic_length(contacts), rel=1e-12)


def test_characteristic_length_of_a_ring_and_of_coincident_contacts():
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
def test_internal_forces_are_an_orthonormal_null_space_in_every_unit_of_length(seed, count, scale):
    rng = np.random.default_rng(seed)
    contacts = transformed(contacts_around_object(rng, count), np.eye(3), np.zeros(3), scale)
    N = internal_forces(contacts)
    G = grasp_matrix(contacts)
    assert N.shape[1] == contacts.size - grasp_matrix_rank(contacts)
    # Rounding of up to 24 products at 2e-16 each, of moments over lengths of a few scales, and of the SVD.
    assert np.abs(G @ N).max(initial=0.0) <= 1e-12 * max(1.0, scale)
    assert np.abs(N.T @ N - np.eye(N.shape[1])).max(initial=0.0) <= 1e-13


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_every_force_is_a_particular_force_plus_internal_forces(seed):
    rng = np.random.default_rng(seed)
    contacts = contacts_around_object(rng, 4, models=("point", "soft"))
    G, N, f = grasp_matrix(contacts), internal_forces(contacts), rng.normal(size=contacts.size)
    particular = G.T @ np.linalg.solve(G @ G.T, G @ f)
    assert particular + N @ (N.T @ f) == pytest.approx(f, abs=1e-9)  # G Gᵀ squares the condition of G, about 1e3


@given(seeds, st.floats(1e-4, 1e4), st.floats(0.0, 1e5))
@settings(max_examples=40, deadline=None)
def test_rank_is_invariant_to_frame_and_unit(seed, scale, shift):
    rng = np.random.default_rng(seed)
    p = shift * scale * 0.05 * rng.normal(size=3)  # up to about 10⁵ grasp sizes away
    R = random_rotation(rng)
    assert grasp_matrix_rank(transformed(contact_ring(2), R, p, scale)) == 5
    assert grasp_matrix_rank(transformed(contact_ring(1), R, p, scale)) == 3
    assert grasp_matrix_rank(transformed(contact_ring(2, model="soft", torsional_friction=0.01), R, p, scale)) == 6
    assert grasp_matrix_rank(transformed(contact_ring(3), R, p, scale)) == 6


def test_coincident_contacts_transmit_forces_and_no_moments():
    contacts = ContactSet.stack([Contact([0.1, 0.2, 0.3], n, 0.5) for n in ([1, 0, 0], [0, 1, 0], [0.3, 0.4, 0.5])])
    assert grasp_matrix_rank(contacts) == 3
    assert internal_forces(contacts).shape == (9, 6)
    assert not is_force_closed(contacts)
    assert ferrari_canny(contacts) == 0.0
    assert smallest_singular_value(contacts) == 0.0


@given(seeds, st.integers(1, 5))
@settings(max_examples=30, deadline=None)
def test_grasp_matrices_are_the_grasp_matrix_of_each_instant(seed, count):
    rng = np.random.default_rng(seed)
    sets = [contacts_around_object(rng, count, models=("point",)) for _ in range(3)]
    p_OC, R_OC = np.array([each.p_OC for each in sets]), np.array([each.R_OC for each in sets])
    for k, G in enumerate(grasp_matrices(sets[0], p_OC, R_OC)):
        np.testing.assert_array_equal(G, grasp_matrix(sets[k]))


@given(seeds, st.integers(1, 5))
@settings(max_examples=30, deadline=None)
def test_contact_jacobians_are_velocities_and_spin_in_contact_frames(seed, count):
    rng = np.random.default_rng(seed)
    contacts, R_HO, twists = contacts_around_object(rng, count), random_rotation(rng), rng.normal(size=(2, count, 6, 7))
    v = rng.normal(size=7)  # rad/s
    J = contact_jacobians(contacts, twists, np.stack([np.eye(3), R_HO]), contacts.R_OC)
    for R, rows, twist in zip((np.eye(3), R_HO), J, twists @ v, strict=True):
        expected = [
            (np.append(R_OC.T @ R.T @ linear, R_OC[:, 2] @ R.T @ angular))[list(model.columns)]
            for R_OC, model, (linear, angular) in zip(contacts.R_OC, contacts.models, twist.reshape(-1, 2, 3), strict=True)
        ]
        np.testing.assert_allclose(rows @ v, np.concatenate(expected), atol=1e-13)

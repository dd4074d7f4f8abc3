"""Rows of the contact constraints: which relative velocities each contact model constrains."""

from __future__ import annotations

import numpy as np
from support.control_grasps import named_grasp, with_all_contact_models

from graspforce.control.contacts.contact_constraints import ContactConstraints


def test_padded_rows_are_three_for_friction_one_for_pressing_and_a_fourth_for_a_spin() -> None:
    grasp = named_grasp("allegro_right box")
    points = ContactConstraints.from_contacts(grasp.contacts)
    np.testing.assert_array_equal(points.padded_rows, [0, 1, 2, 4, 5, 6, 8, 9, 10])
    assert not any(points.is_spin_row(row) for row in range(9))

    mixed = ContactConstraints.from_contacts(with_all_contact_models(grasp, 3).contacts)  # point, soft, frictionless
    np.testing.assert_array_equal(mixed.padded_rows, [0, 1, 2, 4, 5, 6, 10, 7])
    np.testing.assert_array_equal(mixed.contact_index, [0, 0, 0, 1, 1, 1, 2, 1])
    assert [mixed.is_spin_row(row) for row in range(8)] == [False] * 7 + [True]


def test_forces_do_the_work_of_their_rows() -> None:
    """A moment m_n counts as the force m_n / 30 mm, at the speed of the spin at that distance."""
    mixed = ContactConstraints.from_contacts(with_all_contact_models(named_grasp("allegro_right box"), 3).contacts)
    padded = np.arange(12.0).reshape(3, 4)  # N and N·m
    np.testing.assert_allclose(mixed.constraint_forces(padded), [0, 1, 2, 4, 5, 6, 10, 7 / 0.03])


def test_rows_without_a_contact_are_those_of_the_other_contacts() -> None:
    mixed = ContactConstraints.from_contacts(with_all_contact_models(named_grasp("allegro_right box"), 3).contacts)
    first = mixed.without(np.array([True, False, False]))
    np.testing.assert_array_equal(first.padded_rows, [4, 5, 6, 10, 7])
    np.testing.assert_array_equal(first.contact_index, [1, 1, 1, 2, 1])
    second = mixed.without(np.array([False, True, False]))
    np.testing.assert_array_equal(second.padded_rows, [0, 1, 2, 10])
    assert second.spin_count == 0
    padded = np.arange(12.0).reshape(3, 4)  # N and N·m
    np.testing.assert_allclose(first.constraint_forces(padded), [4, 5, 6, 10, 7 / 0.03])
    np.testing.assert_allclose(second.constraint_forces(padded), [0, 1, 2, 10])

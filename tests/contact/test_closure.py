"""Force closure against a cone program, and known grasps."""

import clarabel
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import sparse
from support.contact_strategies import contact_ring, contacts_around_object, random_rotation, seeds, transformed

from graspforce import Contact, ContactSet
from graspforce.contact.closure import is_force_closed
from graspforce.contact.matrices import grasp_matrix_rank
from graspforce.contact.quality import ferrari_canny, smallest_singular_value


def tilted_pair(angle, mu=0.5, gamma=0.01):
    """Return two opposed soft contacts, with both normals tilted the same way from the line between them."""
    lean = [np.cos(angle), np.sin(angle)]
    return ContactSet.stack(
        [
            Contact([0.05, 0, 0], [-lean[0], lean[1], 0], mu, "soft", torsional_friction=gamma),
            Contact([-0.05, 0, 0], [lean[0], lean[1], 0], mu, "soft", torsional_friction=gamma),
        ]
    )


def frictionless_box(offset):
    """Return frictionless contacts on a cube: on each face but one a pair, displaced to both sides, to resist both moments."""
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


def closure_margin(contacts):
    """Return s* from one second-order cone program, solved by Clarabel on the full G."""
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


def transmissible_rank(contacts):
    """Return the rank of the components that friction can transmit, in lengths of 5 cm, by NumPy."""
    scale = np.column_stack([contacts.mu, contacts.mu, np.ones(len(contacts)), contacts.gamma / 0.05]).ravel()
    G = contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1) * scale
    G[3:] /= 0.05
    return np.linalg.matrix_rank(G, tol=1e-9)


def test_closure_agrees_with_a_cone_program():
    rng = np.random.default_rng(20240)
    results = []
    for _ in range(120):
        contacts = contacts_around_object(rng, int(rng.integers(2, 7)))
        margin = closure_margin(contacts)
        if 1e-7 < margin < 1e-6:
            continue  # too close to the boundary for Clarabel's tolerance of 1e-8
        results.append(is_force_closed(contacts))
        assert results[-1] == (margin > 1e-6 and transmissible_rank(contacts) == 6)
    assert 30 <= sum(results) <= len(results) - 30  # both kinds occur


@given(seeds, st.integers(2, 5), st.floats(1e-3, 1e3))
@settings(max_examples=30, deadline=None)
def test_closure_and_quality_are_invariant_to_frame_and_unit(seed, count, scale):
    rng = np.random.default_rng(seed)
    contacts = contacts_around_object(rng, count)
    assume(abs(closure_margin(contacts)) > 1e-6 or transmissible_rank(contacts) < 6)
    there = transformed(contacts, random_rotation(rng), 3.0 * scale * rng.normal(size=3), scale)
    assert is_force_closed(there) == is_force_closed(contacts)
    assert ferrari_canny(there, 8) == pytest.approx(ferrari_canny(contacts, 8), rel=1e-9, abs=1e-12)
    assert smallest_singular_value(there) == pytest.approx(smallest_singular_value(contacts), rel=1e-9, abs=1e-12)


def test_two_opposed_contacts_close_if_soft_and_three_around_close():
    assert not is_force_closed(contact_ring(2))
    assert is_force_closed(contact_ring(2, model="soft", torsional_friction=0.01))
    assert is_force_closed(contact_ring(3))
    assert is_force_closed(contact_ring(8))


@pytest.mark.parametrize("mu", [0.05, 0.5, 1.7])
def test_a_soft_pair_closes_below_the_friction_angle_and_not_at_it(mu):
    friction_angle = np.arctan(mu)
    assert is_force_closed(tilted_pair(friction_angle - 1e-6, mu))
    assert not is_force_closed(tilted_pair(friction_angle, mu))
    assert not is_force_closed(tilted_pair(friction_angle + 1e-6, mu))


def test_contacts_with_parallel_normals_do_not_close():
    up = [Contact([np.cos(a), np.sin(a), 0], [0, 0, 1], 0.9) for a in (0.0, 2.0, 4.0)]
    assert grasp_matrix_rank(ContactSet.stack(up)) == 6
    assert not is_force_closed(ContactSet.stack(up))


def test_a_zero_coefficient_transmits_no_friction():
    assert not is_force_closed(contact_ring(3, mu=0.0))
    assert not is_force_closed(contact_ring(2, model="soft", torsional_friction=0.0))
    assert grasp_matrix_rank(contact_ring(3, mu=0.0)) == 6  # of G, which ignores friction coefficients


def test_frictionless_contacts_can_close_by_form():
    assert is_force_closed(frictionless_box(0.5))
    assert not is_force_closed(frictionless_box(0.0))  # all normals intersect: no moment on the box
    assert not is_force_closed(
        ContactSet.stack(list(frictionless_box(0.5).contacts[:6]))
    )  # six rays cannot span six dimensions positively


def test_another_contact_never_opens_a_closed_grasp():
    rng = np.random.default_rng(5)
    for _ in range(20):
        contacts = list(contacts_around_object(rng, 5).contacts)
        assert is_force_closed(ContactSet.stack(contacts)) >= is_force_closed(ContactSet.stack(contacts[:4]))

"""Laws that tie the Ferrari–Canny quality ε to force closure."""

from __future__ import annotations

import numpy as np
from support.contact_strategies import contacts_around_object

from graspforce import ContactSet
from graspforce.contact.grasp_matrix import ferrari_canny, is_force_closed

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

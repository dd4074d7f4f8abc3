"""Errors of contacts that the payload survives: forces exist for every sampled error, and the bounds follow the load."""

from __future__ import annotations

import numpy as np
import pytest

import graspforce as gf
from graspforce.analysis.contact_errors import payload_contact_errors
from graspforce.core.errors import InvalidInput


def ring(load: float) -> gf.ForceProblem:
    """Return four contacts around a vertical axis with μ = 0.5 and f_n ≤ 5 N that lift a load, N."""
    angles = 0.5 * np.pi * np.arange(4)
    contacts = [
        gf.Contact((0.03 * np.cos(a), 0.03 * np.sin(a), 0), (-np.cos(a), -np.sin(a), 0), 0.5, max_normal=5.0) for a in angles
    ]
    return gf.ForceProblem(contacts, (0, 0, load, 0, 0, 0))


def test_forces_exist_for_every_error_that_the_payload_survives():
    problem, rng = ring(6.0), np.random.default_rng(41)
    errors = payload_contact_errors(problem)
    assert errors.position.min() > 1e-4
    for contact, radius in enumerate(errors.position):
        for _ in range(20):
            direction = rng.normal(size=3)
            p = problem.contacts.p_OC.copy()
            p[contact] += radius * direction / np.linalg.norm(direction)
            assert gf.solve(problem.replace(p=p), explain=False).found
    for contact, angle in enumerate(errors.normal):
        for _ in range(20):
            normal = problem.contacts.R_OC[contact, :, 2]
            across = np.cross(normal, rng.normal(size=3))
            tilted = np.cos(angle) * normal + np.sin(angle) * across / np.linalg.norm(across)
            listed = list(problem.contacts.contacts)
            listed[contact] = gf.Contact(listed[contact].position, tilted, 0.5, max_normal=5.0)
            assert gf.solve(gf.ForceProblem(listed, problem.w), explain=False).found


def test_a_larger_payload_survives_smaller_errors():
    light, heavy = payload_contact_errors(ring(2.0)), payload_contact_errors(ring(8.0))
    assert (heavy.position < light.position).all()
    assert (heavy.normal < light.normal).all()


def test_normal_error_of_one_of_four_contacts_has_its_closed_form():
    """Moments make opposed contacts bear equal loads: the other pair bears μ N each, and this pair the rest.

    With its normal up to α off, a contact bears μ' N' with μ' = tan(atan μ − α) and N' = N/(cos α + μ' sin α).
    """
    load, mu, most = 8.0, 0.5, 5.0
    alphas = np.linspace(0.0, np.arctan(mu), 100_001)
    tilted = np.tan(np.arctan(mu) - alphas)
    borne = tilted * most / (np.cos(alphas) + tilted * np.sin(alphas))
    expected = alphas[np.flatnonzero(borne >= (load - 2.0 * mu * most) / 2.0)[-1]]
    errors = payload_contact_errors(ring(load), tolerance=1e-3)
    assert errors.normal == pytest.approx(np.full(4, expected), rel=3e-3)


def test_no_error_is_guaranteed_without_payload_or_without_the_rank_for_it():
    assert not payload_contact_errors(ring(40.0)).position.any()
    pair = [gf.Contact((0, y, 0), (0, -np.sign(y), 0), 0.5, max_normal=10.0) for y in (0.03, -0.03)]
    errors = payload_contact_errors(gf.ForceProblem(pair, (0, 0, 1.0, 0, 0, 0)))
    assert not errors.position.any()
    assert errors.normal.min() > 0.1
    with pytest.raises(InvalidInput, match="tolerance"):
        payload_contact_errors(ring(1.0), tolerance=1.0)


def test_quality_has_the_errors_if_asked_for():
    quality = gf.quality(ring(6.0), payload_errors=True)
    assert quality.payload_errors.position == pytest.approx(payload_contact_errors(ring(6.0)).position)
    assert "payload survives" in str(quality)
    assert quality.to_dict()["payload_errors"]["normal"]
    assert gf.quality(ring(6.0)).payload_errors is None

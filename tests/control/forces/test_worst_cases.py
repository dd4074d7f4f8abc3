"""Forces for uncertain friction, contact normals and mass: checked with samples of the true values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_grasps import FOUR_FINGERS, named_grasp, with_all_contact_models
from support.control_steps import disturbed, pose_at_rest, settings_with, state_at_rest, with_contacts

from graspforce import InvalidInput
from graspforce.contact import friction
from graspforce.contact.matrices import grasp_matrix
from graspforce.control import ObjectController
from graspforce.control.forces.worst_cases import least_friction, weight_margin
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp

pytestmark = pytest.mark.usefixtures("arithmetic")

ROUNDING = 1e-6  # N: the certificate's tolerance of 1e-8 is relative to some newtons
GRASPS = ["allegro_right sphere", "four_finger box", "dlr_hit2 sphere"]


def soft(grasp: Grasp) -> Grasp:
    return with_contacts(grasp, model="soft", torsional_friction=0.005)


def true_margins(grasp: Grasp, f: Array, mu: Array, gamma: Array, tilts: Array) -> Array:
    """Return the slip margins of planned forces for other friction and tilted normals, (N,), N.

    Args:
        grasp: the grasp, with the modelled contacts.
        f: (k,) planned forces in the modelled contact frames, N and N·m.
        mu: (N,) true friction coefficients.
        gamma: (N,) true torsional friction lengths, m.
        tilts: (N, 3) rotations from the modelled to the true contact frames, as rotation vectors about tangents, rad.
    """
    padded = grasp.contacts.pad(f)
    padded[:, :3] = np.einsum("nji,nj->ni", Rotation.from_rotvec(tilts).as_matrix(), padded[:, :3])
    return friction.slip_margin(padded, mu, gamma)


@pytest.mark.parametrize("name", GRASPS)
def test_forces_stay_in_all_true_cones(name: str) -> None:
    """Friction down to 60 % of the modelled one, and normals that are 5° off, in the worst directions and in random ones."""
    grasp, rng, error, angle = named_grasp(name), np.random.default_rng(84), 0.4, np.radians(5.0)
    settings = settings_with(friction_error=error, contact_error=angle, friction_reserve=0.0)
    mu, tightest = grasp.contacts.mu, np.inf
    for seed in range(4):
        command = ObjectController(grasp, settings).step(*disturbed(grasp, seed))
        assert not command.warnings
        tangential = grasp.contacts.pad(command.f)[:, :2]
        # the rotation about t moves the normal away from a force along n × t
        across = np.column_stack([tangential[:, 1], -tangential[:, 0], np.zeros(len(mu))])
        worst = angle * across / np.linalg.norm(across, axis=1)[:, None]
        for sample in range(40):
            tilts = rng.normal(size=(len(mu), 3)) * [1.0, 1.0, 0.0]
            tilts *= angle * rng.uniform(0.0, 1.0) / np.linalg.norm(tilts, axis=1)[:, None]
            share = 1.0 - error * rng.uniform(0.0, 1.0)
            if sample < 2:
                tilts, share = (-1.0) ** sample * worst, 1.0 - error
            margins = true_margins(grasp, command.f, share * mu, grasp.contacts.gamma, tilts)
            assert margins.min() >= settings.slip_margin - ROUNDING
            tightest = min(tightest, float(margins.min()))
    # the cosines of the friction angles make the true margin larger, by at most 1/cos(atan 0.42)
    assert tightest <= settings.slip_margin / np.cos(np.arctan(0.6 * 0.7)) + ROUNDING


def test_moments_of_soft_contacts_stay_in_all_true_cones() -> None:
    """Friction and torsional friction scale together."""
    grasp = soft(named_grasp("four_finger box"))
    settings = settings_with(friction_error=0.4, friction_reserve=0.0)
    for seed in range(4):
        command = ObjectController(grasp, settings).step(*disturbed(grasp, seed))
        for share in (0.6, 0.8, 1.0, 1.3):
            mu, gamma = share * grasp.contacts.mu, share * grasp.contacts.gamma
            assert true_margins(grasp, command.f, mu, gamma, np.zeros((4, 3))).min() >= settings.slip_margin - ROUNDING


@pytest.mark.parametrize("name", [*GRASPS, "soft", "mixed"])
def test_forces_bear_the_error_of_the_weight_in_every_direction(name: str) -> None:
    """The further load is shared as least-norm forces, by another formula: Gᵀ (G Gᵀ)⁻¹."""
    grasp = named_grasp(name if name in GRASPS else "four_finger box")
    grasp = soft(grasp) if name == "soft" else with_all_contact_models(grasp, 2) if name == "mixed" else grasp
    rng, settings = np.random.default_rng(85), settings_with(mass_error=0.5, friction_reserve=0.0)
    load = 0.5 * grasp.body.mass * np.linalg.norm(settings.gravity_H)  # N
    G, contacts = grasp_matrix(grasp.contacts), grasp.contacts
    length = np.sqrt(((contacts.p_OC - contacts.p_OC.mean(axis=0)) ** 2).sum() / len(contacts))  # m
    unit = np.where(contacts.columns % 4 == 3, length, 1.0)
    command = ObjectController(grasp, settings).step(state_at_rest(grasp), pose_at_rest(grasp))
    assert not command.warnings
    rough, least = contacts.mu > 0.0, np.inf
    for _ in range(300):
        force = rng.normal(size=3)
        force *= load / np.linalg.norm(force)
        wrench = np.append(force, np.cross(grasp.body.p_OM, force))
        shared = unit * ((G * unit).T @ np.linalg.solve((G * unit) @ (G * unit).T, wrench))
        margins = friction.slip_margin(contacts.pad(command.f + shared), contacts.mu, contacts.gamma)
        least = min(least, float(margins[rough].min()))
    assert settings.slip_margin - ROUNDING <= least
    extra = weight_margin(grasp, settings, contacts.mu)
    assert 0.0 < extra < 3.0 * load  # three or four contacts; least norms share the load


def test_worst_cases_without_errors_are_the_model() -> None:
    grasp, settings = named_grasp("four_finger box"), settings_with()
    assert np.array_equal(least_friction(grasp.contacts, settings), [grasp.contacts.mu, grasp.contacts.gamma])
    assert weight_margin(grasp, settings, grasp.contacts.mu) == 0.0


def test_weight_margin_of_a_box_is_its_share_of_the_load() -> None:
    """Four contacts at equal heights: a load along t takes a quarter each, along the normals of two opposite faces μ/4."""
    grasp = named_grasp("four_finger box")
    assert grasp.fingers == FOUR_FINGERS
    settings = settings_with(mass_error=0.2, gravity_H=[0.0, 0.0, -10.0])
    at_centre = replace(grasp, contacts=replace(grasp.contacts, p_OC=grasp.contacts.p_OC * [1.0, 1.0, 0.0]))
    load = 0.2 * 0.05 * 10.0  # N
    assert weight_margin(at_centre, settings, np.full(4, 0.7)) == pytest.approx(load * (0.25 + 0.7 * 0.25), rel=1e-9)


def test_contact_error_beyond_the_friction_angle_is_named() -> None:
    with pytest.raises(InvalidInput, match=r"settings.contact_error = 0.7: must be less than 0.6107 rad"):
        ObjectController(named_grasp("four_finger box"), settings_with(contact_error=0.7))

"""Worst cases of uncertain friction, contact normals and mass: the friction and the margin that forces must keep.

For each true friction of at least μ (1 − e) and each true normal within the angle α of the modelled one, the cone of friction

    μ' = tan(atan(μ (1 − e)) − α)

about the modelled normal is inside the true cone, and a slip margin in it is at least as large in the true cone. The torsional
length shrinks too (`graspforce.force.error_vertices.tilted_friction`).

For a mass in [m (1 − e), m (1 + e)] the contacts bear a further load of at most e m g at the centre of mass, until feedback has
adapted. Shared as the forces of least norm, Δf = G⁺ Δw, it takes friction of at most

    σ = max_i (‖T_i‖ + μ'_i ‖n_i‖) e m g,

where T_i and n_i map a force at the centre of mass to the tangential and normal components of Δf_i. Contacts that keep the
margin s + σ before keep s with this load in every direction.
"""

from __future__ import annotations

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import RANK_TOLERANCE, characteristic_length, grasp_matrix
from graspforce.control.friction.friction_compensation import friction_slip_margin
from graspforce.control.settings import ControlSettings
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.force.error_vertices import tilted_friction
from graspforce.geometry.vectors import skew
from graspforce.grasp.grasp import Grasp


def least_friction(contacts: ContactSet, settings: ControlSettings) -> Array:
    """Return (2, N) the coefficients μ' and the torsional lengths γ' that hold for all errors of the settings.

    Args:
        contacts: the contacts with the modelled friction.
        settings: with `friction_error` and `contact_error`.

    Raises:
        InvalidInput: the contact error leaves no friction at a contact that has some.
    """
    mu, gamma = contacts.mu, contacts.gamma
    if settings.friction_error > 0.0:
        mu, gamma = mu * (1.0 - settings.friction_error), gamma * (1.0 - settings.friction_error)
    smallest = float(np.arctan(mu).min(initial=np.inf, where=mu > 0.0))  # rad
    if settings.contact_error >= smallest:
        allowed = f"less than {smallest:.4g} rad, the angle of the least friction"
        raise InvalidInput("settings.contact_error", settings.contact_error, allowed)
    return freeze(tilted_friction(mu, gamma, np.array([settings.contact_error])))


def friction_margin(grasp: Grasp, settings: ControlSettings) -> float:
    """Return the slip margin that covers the friction of the joints, N; 0 if the settings do not compensate it.

    Args:
        grasp: hand, object and contacts.
        settings: with `friction`.
    """
    return 0.0 if settings.friction is None else friction_slip_margin(grasp, settings.friction.torque_errors(grasp.hand))


def weight_margin(grasp: Grasp, settings: ControlSettings, mu: Array) -> float:
    """Return σ, the slip margin that the error of the weight may use, N; 0 without friction.

    Args:
        grasp: the object and its contacts.
        settings: with `mass_error` and gravity.
        mu: (N,) friction coefficients of the forces.
    """
    load = settings.mass_error * grasp.body.mass * float(np.linalg.norm(settings.gravity_H))  # N
    if load == 0.0 or not (mu > 0.0).any():
        return 0.0
    contacts = grasp.contacts
    length = characteristic_length(contacts)
    unit = np.where(contacts.columns % 4 == friction.M_N, length, 1.0)  # so that least norm does not depend on units
    force_at_centre = np.vstack([np.eye(3), skew(grasp.body.p_OM)])
    row_unit = np.repeat([1.0, length], 3)[:, None]
    shares = unit[:, None] * (
        np.linalg.pinv(grasp_matrix(contacts) * unit / row_unit, RANK_TOLERANCE) @ (force_at_centre / row_unit)
    )
    padded = np.moveaxis(contacts.pad(shares.T), 0, -1)  # (N, 4, 3) components of each contact by the load's direction
    lever = np.divide(mu, contacts.gamma, out=np.zeros(len(mu)), where=contacts.gamma > 0.0)  # 1/m
    friction_rows = np.stack([padded[:, 0], padded[:, 1], lever[:, None] * padded[:, friction.M_N]], axis=1)
    used = np.linalg.norm(friction_rows, 2, axis=(1, 2)) + mu * np.linalg.norm(padded[:, friction.F_N], axis=1)
    return load * float(used.max(where=mu > 0.0, initial=0.0))

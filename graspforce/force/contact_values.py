"""Contacts with changed values: friction, positions, frames and limits of the normal forces."""

from __future__ import annotations

import contextlib

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactModel, ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput

_ROTATION_TOLERANCE = 1e-9  # largest |RᵀR − 1| of a contact frame given as a matrix: a bound on rounding


def with_contact_values(
    contacts: ContactSet,
    mu: npt.ArrayLike | None,
    p: npt.ArrayLike | None,
    R: npt.ArrayLike | None,
    normal_limits: npt.ArrayLike | None,
) -> ContactSet:
    """Return the contacts with new friction, positions, frames or limits of the normal forces.

    Args:
        contacts: the contacts.
        mu: (N,) friction coefficients, or (2, N) with the torsional friction lengths in the second row, m; None to keep them.
        p: (N, 3) positions in O, m; None to keep them.
        R: (N, 3, 3) frames in O; None to keep them.
        normal_limits: (2, N) smallest and largest normal forces, N; None to keep them.

    Raises:
        InvalidInput: another shape, or a value outside its range.
    """
    count = len(contacts)
    new_mu, gamma = contacts.mu, contacts.gamma
    if mu is not None:
        has_gamma = _has_two_dimensions(mu)
        new_mu = arrays.check_array(mu, "mu", (2, count) if has_gamma else (count,), minimum=0.0).copy()
        if has_gamma:
            new_mu, gamma = new_mu
            gamma = arrays.freeze(np.where([model is ContactModel.SOFT for model in contacts.models], gamma, 0.0))
        new_mu[[model is ContactModel.FRICTIONLESS for model in contacts.models]] = 0.0
    new_p = contacts.p_OC if p is None else arrays.check_array(p, "p", (count, 3))
    new_R = contacts.R_OC if R is None else arrays.check_array(R, "R", (count, 3, 3))
    if R is not None:
        skewed = np.abs(new_R.transpose(0, 2, 1) @ new_R - np.eye(3)).max(axis=(1, 2)) > _ROTATION_TOLERANCE
        for i in np.flatnonzero(skewed | (np.linalg.det(new_R) < 0)):
            raise InvalidInput(f"R[{i}]", new_R[i], "a rotation matrix, its third column the inward normal")
    limits = contacts.min_normal, contacts.max_normal
    if normal_limits is not None:
        limits = _check_normal_limits(normal_limits, count)
    return ContactSet(new_p, new_R, contacts.models, arrays.freeze(new_mu), gamma, *limits)


def _has_two_dimensions(value: npt.ArrayLike) -> bool:
    """Return whether a value is a matrix; False for ragged lists."""
    with contextlib.suppress(ValueError):
        return np.ndim(value) == 2
    return False


def _check_normal_limits(value: npt.ArrayLike, count: int) -> tuple[Array, Array]:
    """Return the smallest and the largest normal forces, (N,) each; the largest may be infinite."""
    unlimited = np.zeros((2, count), dtype=bool)
    with contextlib.suppress(ValueError):  # no rectangular array: the check below raises the error
        given = np.asarray(value)
        if given.shape == (2, count) and given.dtype.kind == "f":
            unlimited[1] = given[1] == np.inf
            value = np.where(unlimited, 0.0, given)
    lower, upper = np.where(unlimited, np.inf, arrays.check_array(value, "normal_limits", (2, count), minimum=0.0))
    for i in np.flatnonzero(lower > upper):
        raise InvalidInput(f"normal_limits[0][{i}]", float(lower[i]), f"at most the largest normal force, {upper[i]:g}")
    return arrays.freeze(lower), arrays.freeze(upper)

"""Proofs of infeasibility as text."""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem

NEGLIGIBLE_SHARE = 1e-6  # of the largest term: smaller terms are rounding


def explanation_text(
    problem: ForceProblem, m: Multipliers, direction: Array, unit: float, contacts: list[int], joints: list[int]
) -> str:
    """Return the proof as text.

    Args:
        problem: the force problem.
        m: the multipliers of the proof.
        direction: (6,) unit direction of the wrench that cannot be supplied; zeros if the limits contradict each other.
        unit: size of the wrench's multipliers.
        contacts: indices of the contacts whose limits the proof uses.
        joints: indices of the motors whose torque limits it uses.
    """
    actuation = problem.actuation
    rest = m.normal_lower @ problem.contacts.min_normal - _finite_product(m.normal_upper, problem.contacts.max_normal)
    if actuation is not None:
        rest += _finite_product(m.torque_lower, actuation.lower - actuation.tau_u) - _finite_product(
            m.torque_upper, actuation.upper - actuation.tau_u
        )
    limits = []
    if contacts:
        limits.append(f"the friction and normal-force limits of contact{_format_indices(contacts)}")
    if joints:
        sides = ", ".join(f"{j} ({'upper' if m.torque_upper[j] >= m.torque_lower[j] else 'lower'})" for j in joints)
        limits.append(f"the torque limits of joint{'s' if len(joints) > 1 else ''} {sides}")
    carried = " and ".join(limits)
    if unit == 0.0:
        return f"For every wrench, {carried} contradict each other."
    force, moment = direction[:3], direction[3:]
    parts = []
    if np.linalg.norm(force) > NEGLIGIBLE_SHARE:
        parts.append(f"force along ({_format_vector(force)})")
    if np.linalg.norm(moment) > NEGLIGIBLE_SHARE:
        parts.append(f"moment about ({_format_vector(moment)})")
    required, available = float(direction @ problem.w), -float(rest) / unit
    if abs(available) < NEGLIGIBLE_SHARE * abs(required):
        available = 0.0
    return (
        f"In the wrench direction with {' and '.join(parts)}, {required:.6g} is required and at most {available:.6g} can be "
        f"supplied. The active limits are {carried}."
    )


def reach_text(reach: float | None) -> str:
    """Return the sentence on the forces that a proof covers; empty if it covers all.

    Args:
        reach: sum of the normal forces that it covers, N; None for all.
    """
    return "" if reach is None else f" The proof covers normal forces up to a sum of {reach:.2g} N."


def _finite_product(multiplier: Array, limit: Array) -> float:
    """Return multiplier · limit over the limits that exist."""
    return float(multiplier @ np.where(np.isfinite(limit), limit, 0.0))


def _format_indices(items: list[int]) -> str:
    """Return " 3" for one index, "s 3, 4" for several: the end of a word and the list."""
    return f" {items[0]}" if len(items) == 1 else "s " + ", ".join(map(str, items))


def _format_vector(vector: Array) -> str:
    """Return the components with three digits; negligible ones as 0."""
    return ", ".join(f"{x:.3g}" for x in np.where(np.abs(vector) < NEGLIGIBLE_SHARE, 0.0, vector))

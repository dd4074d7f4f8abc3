"""Colours of friction use, safe for colour-blind readers: green far from the cone's edge, amber near it, red on it."""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array

_COLOURS = np.array([[0.0, 0.62, 0.45], [0.95, 0.72, 0.0], [0.84, 0.15, 0.0]])
_STOPS = np.array([0.35, 0.75, 1.0])  # friction uses of these colours


def friction_use(slip_margin: float, mu: float, f_n: float) -> float:
    """Return the friction use of a contact, 0 to 1: 1 for a finger that does not touch, 0 for a contact without friction.

    Args:
        slip_margin: μ f_n − ‖f_t‖, N.
        mu: coefficient of friction.
        f_n: normal force, N.
    """
    bound = mu * f_n
    return float(np.clip(1.0 - slip_margin / bound, 0.0, 1.0)) if bound > 0.0 else float(mu > 0.0)


def use_colour(use: float) -> Array:
    """Return the colour of a friction use.

    Args:
        use: friction use, 0 to 1.

    Returns:
        (3,) red, green, blue, 0 to 1.
    """
    return np.array([np.interp(use, _STOPS, _COLOURS[:, k]) for k in range(3)])

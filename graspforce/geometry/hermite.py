"""Quintic Hermite polynomials between knots: values, rates and accelerations are continuous.

The polynomial of an interval has the values, rates and accelerations of both its knots.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array

Ends = tuple[Array, Array, Array, Array, Array, Array]  # value, rate, acceleration at the first knot, then at the second


def locate_intervals(knots: Array, times: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """Return the interval (M,) of each time, and the fraction of the interval (M,), 0 to 1.

    Args:
        knots: (K,) times of the knots, s.
        times: (M,) times, s.
    """
    i = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
    return i, (times - knots[i]) / (knots[i + 1] - knots[i])


def hermite(u: Array, step: Array, ends: Ends) -> tuple[Array, Array, Array]:
    """Return value, rate and acceleration of quintic polynomials.

    Args:
        u: (M,) fractions of the intervals, 0 to 1.
        step: (M,) durations of the intervals, s.
        ends: (M, …) each: value, rate and acceleration at the first knot, then at the second.
    """
    x, v, a, x_end, v_end, a_end = ends
    u, h = (each.reshape(-1, *(1,) * (x.ndim - 1)) for each in (u, step))
    # x + v h u + ½ a h² u² + u³ (c₃ + c₄ u + c₅ u²); the c follow from the errors of the first three terms at the end
    error = x_end - (x + v * h + 0.5 * a * h**2)
    error_v = (v_end - (v + a * h)) * h
    error_a = (a_end - a) * h**2
    c3 = 10.0 * error - 4.0 * error_v + 0.5 * error_a
    c4 = -15.0 * error + 7.0 * error_v - error_a
    c5 = 6.0 * error - 3.0 * error_v + 0.5 * error_a
    value = x + v * h * u + 0.5 * a * (h * u) ** 2 + u**3 * (c3 + u * (c4 + u * c5))
    rate = v + a * h * u + u**2 * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)) / h
    acceleration = a + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5)) / h**2
    return value, rate, acceleration

"""The rise from rest to rest with least jerk."""

from __future__ import annotations


def minimum_jerk(t: float, period: float) -> tuple[float, float, float]:
    """Return the rise from 0 to 1 with least jerk, and its first and second derivatives, 1/s and 1/s².

        s = 10 r³ − 15 r⁴ + 6 r⁵,  r = t/T

    Both derivatives are zero at both ends. Source: Flash and Hogan (1985).

    Args:
        t: time since the start, s; later than T counts as T.
        period: T, s, > 0.
    """
    r = min(t / period, 1.0)
    s = r**3 * (10.0 - 15.0 * r + 6.0 * r**2)
    return s, 30.0 * r**2 * (1.0 - r) ** 2 / period, 60.0 * r * (1.0 - r) * (1.0 - 2.0 * r) / period**2

"""Paths that start and end at rest: the path parameter of another path as a function of a new one.

With s = h(σ) and h' = h'' = 0 at both ends, a motion along σ with a rate σ̇ > 0 at the ends starts and ends without velocity and
without acceleration, so that its jerk is finite. Here h is the quintic of least jerk, 10 σ³ − 15 σ⁴ + 6 σ⁵. Derivatives follow
from the chain rule: x_σ = x' h', x_σσ = x' h'' + x'' h'².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.path.paths import JointPath, JointPoints, ObjectPath, PosePoints


def ease(sigma: Array) -> tuple[Array, Array, Array]:
    """Return h, h' and h'' (K,).

    Args:
        sigma: (K,) σ from 0 to 1.
    """
    h = sigma**3 * (10.0 + sigma * (6.0 * sigma - 15.0))
    slope = 30.0 * sigma**2 * (1.0 - sigma) ** 2
    return h, slope, 60.0 * sigma * (1.0 - sigma) * (1.0 - 2.0 * sigma)


def _eased_derivatives(slope: Array, bend: Array, x_s: Array, x_ss: Array) -> tuple[Array, Array]:
    """Return x_σ and x_σσ (K, m) from h' and h'' (K,), x' and x'' (K, m)."""
    return slope[:, None] * x_s, bend[:, None] * x_s + slope[:, None] ** 2 * x_ss


@dataclass(frozen=True, eq=False, slots=True)
class EasedObjectPath:
    """A path of an object as a function of σ.

    Args:
        path: the path as a function of s.
    """

    path: ObjectPath

    def points(self, s: Array) -> PosePoints:
        """Return poses and derivatives with respect to σ.

        Args:
            s: (K,) σ from 0 to 1.
        """
        h, slope, bend = ease(s)
        at = self.path.points(h)
        p = _eased_derivatives(slope, bend, at.p_s, at.p_ss)
        omega = _eased_derivatives(slope, bend, at.omega, at.omega_s)
        return PosePoints(at.p, *p, at.R, *omega)


@dataclass(frozen=True, eq=False, slots=True)
class EasedJointPath:
    """A path of joints as a function of σ.

    Args:
        path: the path as a function of s.
    """

    path: JointPath

    def points(self, s: Array) -> JointPoints:
        """Return postures and derivatives with respect to σ.

        Args:
            s: (K,) σ from 0 to 1.
        """
        h, slope, bend = ease(s)
        at = self.path.points(h)
        return JointPoints(at.q, *_eased_derivatives(slope, bend, at.q_s, at.q_ss))


def even_knots(intervals: int) -> Array:
    """Return even values of σ (intervals + 1,) from 0 to 1.

    Args:
        intervals: number of intervals.
    """
    return np.linspace(0.0, 1.0, intervals + 1)

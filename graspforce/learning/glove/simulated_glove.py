"""A simulated glove: bend sensors with cross-talk, curvature, noise and drift, for tests and for practice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.records import set_fields


@dataclass(frozen=True, eq=False, slots=True)
class SimulatedGlove:
    """A glove with one sensor for each joint, whose readings run from 0 to 1 over the range of the joint.

        s = x + κ x (1 − x) + C (x − ½) + d t + noise,   x = (q − q_lower)/(q_upper − q_lower)

    Args:
        lower: (n,) joint positions of reading 0, rad.
        upper: (n,) joint positions of reading 1, rad; above `lower`.
        noise: standard deviation of a reading, ≥ 0.
        cross_talk: part of a neighbour's signal in a reading, ≥ 0; the two neighbours act with random signs.
        curvature: κ, the deviation from a linear sensor.
        drift: standard deviation over the sensors of the constant rate d, 1/s, ≥ 0.
        seed: seed of signs, rates and noise, ≥ 0.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    lower: Array
    upper: Array
    noise: float = 0.01
    cross_talk: float = 0.1
    curvature: float = 0.0
    drift: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        lower = arrays.check_array(self.lower, "lower", (None,))
        upper = arrays.check_array(self.upper, "upper", (len(lower),))
        arrays.check_array(upper - lower, "upper - lower", (len(lower),), above=0.0)
        set_fields(
            self,
            lower=lower,
            upper=upper,
            noise=arrays.check_number(self.noise, "noise", minimum=0.0),
            cross_talk=arrays.check_number(self.cross_talk, "cross_talk", minimum=0.0),
            curvature=arrays.check_number(self.curvature, "curvature"),
            drift=arrays.check_number(self.drift, "drift", minimum=0.0),
            seed=fields.check_integer(self.seed, "seed", minimum=0, maximum=2**32 - 1),
        )

    def readings(self, q: npt.ArrayLike, rng: np.random.Generator, t: float = 0.0) -> Array:
        """Return the readings of one frame in each of several postures, (T, n).

        Args:
            q: (T, n) joint positions, rad.
            rng: random generator of the noise.
            t: time since the calibration, s.

        Raises:
            InvalidInput: another shape.
        """
        q = arrays.check_array(q, "q", (None, len(self.lower)))
        own = np.random.default_rng(self.seed)
        n = len(self.lower)
        signs, rates = own.choice([-1.0, 1.0], (n, 2)), self.drift * own.normal(size=n)
        C = np.zeros((n, n))
        for i in range(n):
            for k, j in enumerate((i - 1, i + 1)):
                if 0 <= j < n:
                    C[i, j] = self.cross_talk * signs[i, k]
        x = (q - self.lower) / (self.upper - self.lower)
        s = x + self.curvature * x * (1.0 - x) + (x - 0.5) @ C.T + rates * t
        return freeze(s + self.noise * rng.normal(size=s.shape))

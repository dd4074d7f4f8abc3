"""Workspaces of fingers: the points that a tip reaches, and how well it moves there.

Measures of the tip's linear Jacobian J_v (3, m) over the finger's joints, with singular values σ_1 ≥ σ_2 ≥ …:

- σ_min: tip speed per joint rate in the slowest of the min(3, m) directions that the finger has, m/rad,
- manipulability √det(J_v J_vᵀ), the product of these singular values. Source: Yoshikawa (1985).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from graspforce.core import fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import Hand


@dataclass(frozen=True, eq=False, slots=True)
class TipMeasures:
    """A fingertip in K postures.

    Attributes:
        finger: name of the finger.
        q: (K, n) postures of the hand, rad.
        p_HF: (K, 3) positions of the tip frame in H, m.
        min_singular_value: (K,) σ_min, m/rad.
        manipulability: (K,) product of the min(3, m) singular values, (m/rad)^min(3, m).
    """

    finger: str
    q: Array
    p_HF: Array
    min_singular_value: Array
    manipulability: Array

    def to_dict(self) -> JsonRecord:
        """Return a summary: extent (m), hull volume (m³), and least and median σ_min (m/rad) and manipulability."""
        return {
            "finger": self.finger,
            "lower": self.p_HF.min(axis=0).tolist(),
            "upper": self.p_HF.max(axis=0).tolist(),
            "hull_volume": self.hull_volume,
            **{
                name: {"least": float(values.min()), "median": float(np.median(values))}
                for name, values in (("min_singular_value", self.min_singular_value), ("manipulability", self.manipulability))
            },
        }

    @property
    def hull_volume(self) -> float:
        """Volume of the convex hull of the positions, m³; 0 if they lie in a plane or on a line."""
        extent = np.linalg.svd(self.p_HF - self.p_HF.mean(axis=0), compute_uv=False)
        if extent[-1] <= _FLAT * extent[0]:
            return 0.0
        try:
            return float(ConvexHull(self.p_HF).volume)
        except QhullError:
            return 0.0


@dataclass(frozen=True, eq=False, slots=True)
class JointSweep:
    """A joint that moves through its range while the other joints rest in the neutral posture.

    Attributes:
        joint: name of the joint.
        x: (K,) positions of the joint, rad or m.
        tip: the fingertip at these positions.
    """

    joint: str
    x: Array
    tip: TipMeasures


_FLAT = 1e-9  # relative extent across a plane that counts as none
_LARGEST_COUNT = 10_000_000


def speed_unit(hand: Hand, finger: str) -> tuple[float, str]:
    """Return a unit for σ_min of a finger, with its factor: mm/rad, or mm/mm if all its joints are prismatic.

    Args:
        hand: the hand.
        finger: name of the finger.
    """
    joints = [hand.joints[j] for j in hand.finger(finger).joints]
    return (1.0, "mm/mm") if all(joint.is_prismatic for joint in joints) else (1e3, "mm/rad")


def sample_workspace(hand: Hand, finger: str, samples: int = 20_000, seed: int = 0) -> TipMeasures:
    """Return a fingertip in random postures: its own joints uniform within their limits, the others neutral.

    Args:
        hand: the hand.
        finger: name of the finger.
        samples: number of postures, ≥ 4.
        seed: seed of the postures, ≥ 0.

    Raises:
        UnknownName: the hand has no finger of that name.
        InvalidInput: a number is not allowed.
    """
    joints = list(hand.finger(finger).joints)
    count = fields.check_integer(samples, "samples", minimum=4, maximum=_LARGEST_COUNT)
    rng = np.random.default_rng(fields.check_integer(seed, "seed", minimum=0, maximum=2**32 - 1))
    q = np.tile(hand.neutral, (count, 1))
    q[:, joints] = rng.uniform(hand.q_lower[joints], hand.q_upper[joints], size=(count, len(joints)))
    return measure_tip(hand, finger, q)


def sweep_joints(hand: Hand, finger: str, steps: int = 101) -> tuple[JointSweep, ...]:
    """Move each joint of a finger through its range, one at a time, from the neutral posture.

    Args:
        hand: the hand.
        finger: name of the finger.
        steps: number of positions of each joint, ≥ 2.

    Raises:
        UnknownName: the hand has no finger of that name.
        InvalidInput: the number is not allowed.
    """
    count = fields.check_integer(steps, "steps", minimum=2, maximum=_LARGEST_COUNT)
    sweeps = []
    for joint in hand.finger(finger).joints:
        x = np.linspace(hand.q_lower[joint], hand.q_upper[joint], count)
        q = np.tile(hand.neutral, (count, 1))
        q[:, joint] = x
        sweeps.append(JointSweep(hand.joints[joint].name, freeze(x), measure_tip(hand, finger, q)))
    return tuple(sweeps)


def measure_tip(hand: Hand, finger: str, q: Array) -> TipMeasures:
    """Return the measures of a fingertip in K postures.

    Args:
        hand: the hand.
        finger: name of the finger.
        q: (K, n) postures, rad.

    Raises:
        UnknownName: the hand has no finger of that name.
        InvalidInput: q has another shape.
    """
    p, J = hand.tips_along(q, [finger])
    own = J[:, 0][:, :, list(hand.finger(finger).joints)]  # m/rad
    sigma = np.linalg.svd(own, compute_uv=False)
    return TipMeasures(finger, freeze(q), freeze(p[:, 0]), freeze(sigma[:, -1]), freeze(sigma.prod(axis=1)))

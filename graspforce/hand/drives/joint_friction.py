"""Friction of the joints: Coulomb, Stribeck and viscous, from a hand's description or its URDF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.hand.descriptions.description import STRIBECK_VELOCITY, FrictionDescription, friction_matches
from graspforce.hand.descriptions.urdf import UrdfJoint

SMOOTHING_RATE = 0.01  # rad/s: friction is about proportional to the rate below it, and constant above three times it

_LARGEST_COULOMB_FRACTION = 0.5  # of the motor's torque: a joint with more cannot hold anything
_NUMBERS = ("coulomb", "stribeck", "stribeck_velocity", "viscous")


@dataclass(frozen=True, eq=False, slots=True)
class JointFriction:
    """Friction of a hand's n actuated joints. It opposes the motion with the torque

        τ(v) = (c + s e^(−(v/v_s)²)) sign v + b v.

    Source: Armstrong-Hélouvry, Dupont and Canudas de Wit (1994), section 2.

    Args:
        coulomb: (n,) c, torque of a joint in steady motion, N·m, at least 0.
        stribeck: (n,) s, torque by which static friction exceeds c, N·m, at least 0; zeros by default.
        stribeck_velocity: (n,) v_s, rate at which the excess has fallen to 37 %, rad/s, greater than 0; 0.05 by default.
        viscous: (n,) b, torque per rate, N·m·s/rad, at least 0; zeros by default.
        sources: source of each joint's numbers; empty texts for joints whose friction is unknown.

    Raises:
        InvalidInput: a value is out of range or the lengths differ; names the field and the allowed values.
    """

    coulomb: Array
    stribeck: Array
    stribeck_velocity: Array
    viscous: Array
    sources: tuple[str, ...]

    def __init__(
        self,
        coulomb: npt.ArrayLike,
        stribeck: npt.ArrayLike | None = None,
        stribeck_velocity: npt.ArrayLike | None = None,
        viscous: npt.ArrayLike | None = None,
        sources: Sequence[str] | None = None,
    ) -> None:
        c = arrays.check_array(coulomb, "coulomb", (None,), minimum=0.0)
        n, zeros, default_velocity = len(c), np.zeros_like(c), np.full_like(c, STRIBECK_VELOCITY)
        names = ("given",) * n if sources is None else tuple(fields.check_sequence(sources, "sources"))
        if len(names) != n:
            raise InvalidInput("sources", names, f"a list of {n} texts")
        set_fields(
            self,
            coulomb=c,
            stribeck=arrays.check_array(zeros if stribeck is None else stribeck, "stribeck", (n,), minimum=0.0),
            stribeck_velocity=arrays.check_array(
                default_velocity if stribeck_velocity is None else stribeck_velocity, "stribeck_velocity", (n,), above=0.0
            ),
            viscous=arrays.check_array(zeros if viscous is None else viscous, "viscous", (n,), minimum=0.0),
            sources=tuple(fields.check_text(text, f"sources[{i}]") for i, text in enumerate(names)),
        )

    @classmethod
    def unknown(cls, n: int) -> JointFriction:
        """Return the friction of n joints about which nothing is known: zeros without sources.

        Args:
            n: number of joints.
        """
        return cls(np.zeros(n), sources=[""] * n)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.coulomb)

    @property
    def known(self) -> npt.NDArray[np.bool_]:
        """(n,) whether a joint's friction has a source."""
        return np.array([source != "" for source in self.sources], dtype=np.bool_)

    def torque(self, v: npt.ArrayLike, smoothing_rate: float = SMOOTHING_RATE) -> Array:
        """Return the torques that overcome friction at joint rates, with tanh(v/ε) in place of sign v.

        Args:
            v: (n,) joint rates, rad/s.
            smoothing_rate: ε, rad/s, greater than 0.

        Returns:
            (n,) in the direction of the rates, N·m.

        Raises:
            InvalidInput: not n finite rates, or ε is not positive.
        """
        v = arrays.check_array(v, "v", (self.n,))
        return freeze(self.torque_unchecked(v, arrays.check_number(smoothing_rate, "smoothing_rate", above=0.0)))

    def torque_unchecked(self, v: Array, smoothing_rate: float) -> Array:
        """Return `torque` without checks, for control loops.

        Args:
            v: (n,) joint rates, rad/s.
            smoothing_rate: ε, rad/s.
        """
        level = self.coulomb + self.stribeck * np.exp(-np.square(v / self.stribeck_velocity))  # N·m
        return np.asarray(level * np.tanh(v / smoothing_rate) + self.viscous * v)

    def to_dict(self) -> JsonRecord:
        """Return a plain record with a list of n values for every field."""
        return {**{name: getattr(self, name).tolist() for name in _NUMBERS}, "sources": list(self.sources)}

    @classmethod
    def from_dict(cls, record: object, field: str = "friction") -> JointFriction:
        """Read the friction of n joints from a plain record.

        Args:
            record: as `to_dict` returns it; only `coulomb` is required.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["coulomb"], optional=[*_NUMBERS[1:], "sources"])
        try:
            return cls(**values)
        except InvalidInput as error:
            raise error.with_prefix(field) from None


def is_plausible(joint: UrdfJoint, torque: float, velocity: float | None) -> bool:
    """Return whether the `<dynamics>` of a URDF joint can be those of its motor and gear.

    Static friction up to half of the motor's torque is plausible, and viscous friction that lets the motor reach the largest
    rate. Many URDFs carry larger values, which only stabilise a simulator.

    Args:
        joint: the joint.
        torque: largest torque of its motor, N·m.
        velocity: its largest rate, rad/s; None if it is unknown.
    """
    least_torque = joint.damping * (velocity or 0.0)  # N·m
    is_positive = joint.friction >= 0.0 and joint.damping >= 0.0
    return is_positive and joint.friction <= _LARGEST_COULOMB_FRACTION * torque and least_torque <= torque


def resolve_friction(
    described: Sequence[FrictionDescription],
    joints: Mapping[str, tuple[float, float]],
    moved: Mapping[str, Sequence[tuple[UrdfJoint, float]]],
    file: str,
) -> JointFriction:
    """Return the friction of a hand's actuated joints, from its description or otherwise from its URDF.

    In the URDF a motor also overcomes the friction of the followers: Σ|r| c and Σr² b with their ratios r.

    Args:
        described: friction entries of the description.
        joints: largest torque (N·m) and rate (rad/s) of each actuated joint, by name.
        moved: URDF joints that each actuated joint moves, with their ratios: itself with 1, and its followers.
        file: name of the description, for error messages.

    Raises:
        ModelError: a joint matches two entries, or an entry no joint.
    """
    for entry in described:
        if not any(friction_matches(entry, name) for name in joints):
            patterns, names = ", ".join(entry.joints), ", ".join(joints)
            raise ModelError(f"{file}: the friction of {patterns} matches no actuated joint; these are {names}")
    rows: list[tuple[float, float, float, float]] = []
    sources: list[str] = []
    for name, (torque, velocity) in joints.items():
        entries = [entry for entry in described if friction_matches(entry, name)]
        if len(entries) > 1:
            raise ModelError(f"{file}: joint {name} must match at most one friction entry, not {len(entries)}")
        if entries:
            entry = entries[0]
            rows.append((entry.coulomb, entry.stribeck, entry.stribeck_velocity, entry.viscous))
            sources.append(entry.source)
            continue
        parts = moved[name]
        is_given = any(joint.friction != 0.0 or joint.damping != 0.0 for joint, _ in parts)
        usable = is_given and all(is_plausible(joint, torque, velocity) for joint, _ in parts)
        coulomb = sum(abs(ratio) * joint.friction for joint, ratio in parts) if usable else 0.0
        viscous = sum(ratio**2 * joint.damping for joint, ratio in parts) if usable else 0.0
        rows.append((coulomb, 0.0, STRIBECK_VELOCITY, viscous))
        sources.append("URDF <dynamics>" if usable else "")
    coulombs, stribecks, velocities, viscosities = np.array(rows).reshape(-1, 4).T
    return JointFriction(coulombs, stribecks, velocities, viscosities, sources)

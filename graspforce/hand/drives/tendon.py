"""Tendons and clutches: one motor that drives two joints.

While both joints move, the second follows the first as their coupling states, q_2 = ρ q_1 + q_0, and the motor's coordinate is
q_1. The two kinds differ in the torques, and in the motion after a joint has stopped:

- A differential pulls both joints with one tension s over pulleys of the radii r_1 and r_2. Without friction

      tau_1 = r_1 s,    tau_2 = r_2 s,

  whatever the joints do. If one stops, at its limit or at a contact, the other takes all the travel r_1 q_1 + r_2 q_2.
- A breakaway is a clutch between the motor and the first joint. It opens when that joint's torque exceeds a threshold. The gear
  of the first joint then holds it, and the motor turns the second joint only. The clutch closes when the motor has turned back.

Sources: Birglen, Laliberté and Gosselin (2008), chapter 2; Barrett Technology (2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.core.json_text import JsonRecord
from graspforce.hand.descriptions.description import Coupling
from graspforce.hand.descriptions.tendon_description import TendonDescription, TendonKind


@dataclass(frozen=True, slots=True)
class Tendon:
    """One motor that drives two joints.

    Attributes:
        kind: "differential" or "breakaway".
        joints: names of the first joint, whose position is the motor's coordinate, and of the second, which follows it.
        ratio: ρ, turns of the second joint per turn of the first while both move.
        radii: (r_1, r_2) of a differential; only their ratio matters.
        threshold: torque of the first joint at which a breakaway opens, N·m; None for a differential.
        free_ratio: turns of the second joint per turn of the motor's coordinate after a breakaway; None for a differential.
        source: where the numbers come from.
    """

    kind: TendonKind
    joints: tuple[str, str]
    ratio: float
    radii: tuple[float, float]
    threshold: float | None
    free_ratio: float | None
    source: str

    @classmethod
    def from_description(cls, entry: TendonDescription, coupling: Coupling) -> Tendon:
        """Return the tendon of an entry in a hand's description.

        Args:
            entry: the entry.
            coupling: the coupling of its joints.

        Raises:
            InvalidInput: a number that the kind needs is missing.
        """
        needs = {"threshold": entry.threshold, "free_ratio": entry.free_ratio} if entry.kind == "breakaway" else {}
        for name, value in needs.items():
            if value is None:
                raise InvalidInput(name, None, "a number above 0: a breakaway needs it")
        return cls(
            entry.kind, entry.joints, coupling.ratio, entry.radii, entry.threshold, entry.free_ratio, source=entry.source
        )

    def to_dict(self) -> JsonRecord:
        """Return the tendon as a plain record."""
        return {**asdict(self), "joints": list(self.joints), "radii": list(self.radii)}

    def joint_torques(self, tension: float) -> Array:
        """Return the (2,) torques (r_1, r_2) s of a differential's joints, N·m.

        Args:
            tension: s, N if the radii are in m; otherwise the torque of a joint of radius 1.

        Raises:
            InvalidInput: the tendon is a breakaway, or the tension is not finite.
        """
        if self.kind != "differential":
            raise InvalidInput("kind", self.kind, "differential: the torques of a breakaway's joints have no fixed ratio")
        return freeze(arrays.check_number(tension, "tension") * np.array(self.radii))

    def tension_difference(self, torques: npt.ArrayLike) -> float:
        """Return (r_2 tau_1 − r_1 tau_2)/‖r‖, N·m: zero for torques that a differential can exert.

        Args:
            torques: (2,) torques of the two joints, N·m.
        """
        tau = arrays.check_array(torques, "torques", (2,))
        return float(self.balance @ tau)

    @property
    def balance(self) -> Array:
        """(2,) weights (r_2, −r_1)/‖r‖ of the joints' torques in `tension_difference`."""
        r = np.array(self.radii)
        return freeze(np.array([r[1], -r[0]]) / np.linalg.norm(r))

    def slope_after_stop(self, stopped: int) -> float:
        """Return the turns of the moving joint per turn of the motor's coordinate after the other joint has stopped.

        Args:
            stopped: 0 if the first joint has stopped, 1 for the second, which a breakaway cannot stop.

        Raises:
            InvalidInput: the second joint of a breakaway.
        """
        if self.free_ratio is not None:
            if stopped != 0:
                raise InvalidInput("stopped", stopped, "0: a breakaway stops the first joint only")
            return self.free_ratio
        return (self.radii[0] + self.ratio * self.radii[1]) / self.radii[1 - stopped]

    def next_stop(self, stop: float | None, position: float, torque: float) -> float | None:
        """Return the state of a breakaway after a step: the motor's coordinate at which it opened, None while it is closed.

        Args:
            stop: the state before the step.
            position: the motor's coordinate, the position of the first joint while the clutch is closed, rad.
            torque: torque that the motor exerts on the first joint through the clutch, N·m.

        Raises:
            InvalidInput: the tendon is a differential.
        """
        if self.threshold is None:
            raise InvalidInput("kind", self.kind, "breakaway")
        if stop is None:
            return position if torque > self.threshold else None
        return None if position < stop else stop

    def positions(self, stop: float | None, position: float, offset: float = 0.0) -> Array:
        """Return the (2,) positions of a breakaway's joints, rad.

        Args:
            stop: state of the clutch, as `next_stop` returns it.
            position: the motor's coordinate, rad.
            offset: q_0 of the coupling, rad.
        """
        first = position if stop is None else stop
        second = self.ratio * first + offset
        return freeze([first, second if stop is None else second + self.slope_after_stop(0) * (position - stop)])


def resolve_tendons(entries: Sequence[TendonDescription], couplings: Sequence[Coupling], file: str) -> tuple[Tendon, ...]:
    """Return the tendons of a description.

    Args:
        entries: the entries.
        couplings: the couplings of the description.
        file: path of the description, for error messages.

    Raises:
        ModelError: an entry lacks a number or the coupling of its joints, or two entries share a joint.
    """
    tendons: list[Tendon] = []
    seen: set[str] = set()
    for i, entry in enumerate(entries):
        first, second = entry.joints
        coupling = next((each for each in couplings if (each.leader, each.follower) == (first, second)), None)
        if coupling is None:
            raise ModelError(f"{file}: tendons[{i}] needs a coupling of {second}, the follower, to {first}, the leader")
        if seen & set(entry.joints):
            raise ModelError(f"{file}: tendons[{i}] has a joint of another tendon: {first}, {second}")
        seen |= set(entry.joints)
        try:
            tendons.append(Tendon.from_description(entry, coupling))
        except InvalidInput as error:
            raise ModelError(f"{file}: {error.with_prefix(f'tendons[{i}]')}") from None
    return tuple(tendons)

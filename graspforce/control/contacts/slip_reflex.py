"""Reflex on slip: a contact that slips is planned with less friction, from the same period on.

Forces with a slip margin s and a friction reserve r need the friction ρ = (‖f_t‖ + s)/((1 − r) f_n) ≤ μ. When a contact slips,
the reflex plans it with

    μ' = ρ/(1 + g),

so that the same tangential force takes (1 + g) times the normal force of the last step. With L = μ/μ' − 1, the reflex level:

- at the first step that slips, L rises to (1 + g) μ/ρ − 1, unless it is larger;
- while the contact slips, 1 + L grows by the factor 1 + g every 50 ms, to 5 at most;
- otherwise L decays as exp(−t/T), with the reflex time T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.control.contacts.contact_conditions import Mask
from graspforce.control.settings import ControlSettings
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord

RISE_TIME = 0.05  # s in which 1 + L grows by 1 + g while a contact slips
LARGEST_SQUEEZE = 5.0  # of 1 + L
_NEGLIGIBLE = 1e-3  # level below which the friction is as modelled


@dataclass(frozen=True, eq=False, slots=True)
class ReflexMemory:
    """State of the reflex after a step.

    Attributes:
        level: (N,) reflex levels L ≥ 0: contacts are planned with μ/(1 + L).
        slipping: (N,) whether each contact slipped in that step.
    """

    level: Array
    slipping: Mask

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `level` and `slipping`."""
        return {"level": self.level.tolist(), "slipping": self.slipping.tolist()}

    @classmethod
    def from_dict(cls, record: object, count: int, field: str = "reflex") -> ReflexMemory:
        """Read a memory from a plain record.

        Args:
            record: as `to_dict` returns it.
            count: number of contacts.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["level", "slipping"])
        items = fields.check_sequence(values["slipping"], f"{field}.slipping")
        slipping = [fields.check_boolean(item, f"{field}.slipping[{i}]") for i, item in enumerate(items)]
        level = arrays.check_array(values["level"], f"{field}.level", (len(slipping),), minimum=0.0)
        arrays.check_array(level, f"{field}.level", (count,))
        return cls(level, np.array(slipping, dtype=np.bool_))


class SlipReflex:
    """Reflex of the contacts of one grasp, without memory of its own.

    Args:
        contacts: the contacts.
        settings: with `reflex_squeeze`, `reflex_time`, `friction_reserve` and the period.
        margin: slip margin of the planned forces, N.
    """

    def __init__(self, contacts: ContactSet, settings: ControlSettings, margin: float) -> None:
        self._contacts, self._margin, self._squeeze = contacts, margin, 1.0 + settings.reflex_squeeze
        self._share = 1.0 - settings.friction_reserve
        self._growth = self._squeeze ** (settings.period / RISE_TIME)
        self._decay = math.exp(-settings.period / settings.reflex_time)

    def step(self, memory: ReflexMemory | None, slipping: Mask | None, mu: Array, f: Array | None) -> ReflexMemory | None:
        """Return the memory after this step; None if no contact is squeezed.

        Args:
            memory: memory after the last step; None if no contact is squeezed.
            slipping: (N,) whether each contact slips now; None: none does.
            mu: (N,) friction coefficients without the reflex.
            f: (k,) planned forces of the last step, N and N·m; None before the first.
        """
        if slipping is None:
            slipping = np.zeros(len(mu), dtype=np.bool_)
        if memory is None:
            if not slipping.any():
                return None
            memory = ReflexMemory(np.zeros(len(mu)), np.zeros(len(mu), dtype=np.bool_))
        first = slipping & ~memory.slipping
        at_first = np.maximum(memory.level, self._squeeze * mu / np.maximum(self._required_friction(mu, f), _TINY) - 1.0)
        growing = (1.0 + memory.level) * self._growth - 1.0
        level = np.where(slipping, np.where(first, at_first, growing), self._decay * memory.level)
        level = np.where(mu > 0.0, np.minimum(level, LARGEST_SQUEEZE - 1.0), 0.0)
        level[level < _NEGLIGIBLE] = 0.0
        return ReflexMemory(level, slipping) if level.any() or slipping.any() else None

    def _required_friction(self, mu: Array, f: Array | None) -> Array:
        """Return the friction ρ that the planned forces need, at most μ, (N,); μ without forces."""
        if f is None:
            return mu
        padded = self._contacts.pad(f)
        normal = self._share * padded[:, friction.F_N]  # N
        required = friction.required_friction(padded, mu, self._contacts.gamma) + self._margin  # N
        return np.asarray(np.minimum(np.divide(required, normal, out=mu.copy(), where=normal > 0.0), mu))


_TINY = 1e-12  # friction ratio, to divide by

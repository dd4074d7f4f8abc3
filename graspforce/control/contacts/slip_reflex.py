"""Reflex on slip, and precaution: contacts are planned with less friction, from the same period on.

Forces with a slip margin s and a friction reserve r need the friction ρ = (‖f_t‖ + s)/((1 − r) f_n) ≤ μ. When a contact slips,
the reflex plans it with

    μ' = ρ/(1 + g),

so that the same tangential force takes (1 + g) times the normal force of the last step. With L = μ/μ' − 1, the reflex level:

- at the first step that slips, L rises to (1 + g) μ/ρ − 1, unless it is larger;
- while the contact slips, 1 + L grows by the factor 1 + g every 50 ms, to 5 at most;
- otherwise L decays as exp(−t/T), with the reflex time T.

**Precaution.** Forces or motion may surely differ from the commanded ones before slip is found
(`estimation.slip.precaution`). Then all contacts are planned with μ/(1 + max(L, P)). Without any squeeze, the forces of the
last step would need the friction ρ₀ = min(ρ (1 + max(L, P)), μ). The precaution level P

- rises to (1 + g/2) μ/ρ₀ − 1 at the first step of a request, unless it is larger: normal forces rise by g/2 at most;
- stays while the request lasts, and decays as exp(−t/50 ms) afterwards.

Precaution does not add to the reflex: a slip that follows has the level that it would have without, which is at least
(1 + g) (1 + P)/(1 + g/2) − 1. Where the limits of motors or contacts leave no room for certified forces with the whole slip
margin, `ForcePlanner` plans the step without precaution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.control.contacts.contact_conditions import Mask
from graspforce.control.settings import ControlSettings
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.json_text import JsonRecord

RISE_TIME = 0.05  # s in which 1 + L grows by 1 + g while a contact slips
LARGEST_SQUEEZE = 5.0  # of 1 + L
PRECAUTION_SHARE = 0.5  # of the reflex's squeeze
PRECAUTION_TIME = 0.05  # s: time constant with which a precaution decays
_NEGLIGIBLE = 1e-3  # level below which the friction is as modelled


@dataclass(frozen=True, eq=False, slots=True)
class ReflexMemory:
    """State of the reflex after a step.

    Attributes:
        level: (N,) reflex levels L ≥ 0: contacts are planned with μ/(1 + L).
        slipping: (N,) whether each contact slipped in that step.
        precaution: (N,) precaution levels P ≥ 0; None without precaution.
        is_due: whether a precaution was requested in that step.
    """

    level: Array
    slipping: Mask
    precaution: Array | None = None
    is_due: bool = False

    @property
    def squeeze(self) -> Array:
        """(N,) levels of reflex and precaution together: contacts are planned with μ/(1 + squeeze)."""
        return self.level if self.precaution is None else np.maximum(self.level, self.precaution)

    @property
    def without_precaution(self) -> ReflexMemory | None:
        """The memory of the reflex alone; None if no contact is squeezed then."""
        is_used = bool(self.level.any() or self.slipping.any())
        return ReflexMemory(self.level, self.slipping) if is_used else None

    def for_contacts(self, kept: Sequence[int], new: int) -> ReflexMemory:
        """Return the memory of some of the contacts, followed by new ones without slip.

        Args:
            kept: indices of the contacts that stay.
            new: number of the new contacts.
        """
        zeros, slipping = np.zeros(new), np.append(self.slipping[list(kept)], np.zeros(new, dtype=np.bool_))
        level, precaution = np.append(self.level[list(kept)], zeros), self.precaution
        if precaution is not None:
            precaution = freeze(np.append(precaution[list(kept)], zeros))
        return ReflexMemory(freeze(level), slipping, precaution, self.is_due)

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `level` and `slipping`; with a precaution also its levels `precaution`, and `is_due`."""
        record: JsonRecord = {"level": self.level.tolist(), "slipping": self.slipping.tolist()}
        if self.precaution is not None:
            record |= {"precaution": self.precaution.tolist(), "is_due": self.is_due}
        return record

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
        values = fields.check_record(record, field, required=["level", "slipping"], optional=["precaution", "is_due"])
        items = fields.check_sequence(values["slipping"], f"{field}.slipping")
        slipping = [fields.check_boolean(item, f"{field}.slipping[{i}]") for i, item in enumerate(items)]
        level = arrays.check_array(values["level"], f"{field}.level", (len(slipping),), minimum=0.0)
        arrays.check_array(level, f"{field}.level", (count,))
        precaution, is_due = values.get("precaution"), fields.check_boolean(values.get("is_due", False), f"{field}.is_due")
        if precaution is not None:
            precaution = arrays.check_array(precaution, f"{field}.precaution", (count,), minimum=0.0)
        return cls(level, np.array(slipping, dtype=np.bool_), precaution, is_due)


class SlipReflex:
    """Reflex of the contacts of one grasp, without memory of its own.

    Args:
        contacts: the contacts.
        settings: with `reflex_squeeze`, `reflex_time`, `friction_reserve` and the period.
        margin: slip margin of the planned forces, N.
    """

    def __init__(self, contacts: ContactSet, settings: ControlSettings, margin: float) -> None:
        self._contacts, self._margin, self._squeeze = contacts, margin, 1.0 + settings.reflex_squeeze
        self._precaution = 1.0 + PRECAUTION_SHARE * settings.reflex_squeeze
        self._share = 1.0 - settings.friction_reserve
        self._growth = self._squeeze ** (settings.period / RISE_TIME)
        self._decay = math.exp(-settings.period / settings.reflex_time)
        self._precaution_decay = math.exp(-settings.period / PRECAUTION_TIME)

    def step(
        self, memory: ReflexMemory | None, slipping: Mask | None, mu: Array, f: Array | None, is_due: bool = False
    ) -> ReflexMemory | None:
        """Return the memory after this step; None if no contact is squeezed.

        Args:
            memory: memory after the last step; None if no contact is squeezed.
            slipping: (N,) whether each contact slips now; None: none does.
            mu: (N,) friction coefficients without the reflex.
            f: (k,) planned forces of the last step, N and N·m; None before the first.
            is_due: whether a precaution is due now.
        """
        if slipping is None:
            slipping = np.zeros(len(mu), dtype=np.bool_)
        if memory is None:
            if not slipping.any() and not is_due:
                return None
            memory = ReflexMemory(np.zeros(len(mu)), np.zeros(len(mu), dtype=np.bool_))
        first, required = slipping & ~memory.slipping, self._required_friction(mu, f)
        if memory.precaution is not None:  # without it, the forces of the last step would need more friction
            required = np.minimum(required * (1.0 + memory.squeeze) / (1.0 + memory.level), mu)
        at_first = np.maximum(memory.level, self._squeeze * mu / np.maximum(required, _TINY) - 1.0)
        if memory.precaution is not None:  # contacts that used less than all of their friction when it began
            at_first = np.maximum(at_first, self._squeeze / self._precaution * (1.0 + memory.precaution) - 1.0)
        growing = (1.0 + memory.level) * self._growth - 1.0
        level = np.where(slipping, np.where(first, at_first, growing), self._decay * memory.level)
        level = _bounded(level, mu)
        precaution = self._next_precaution(memory, mu, required, is_due)
        is_used = precaution is not None or is_due or level.any() or slipping.any()
        return ReflexMemory(level, slipping, precaution, is_due) if is_used else None

    def _next_precaution(self, memory: ReflexMemory, mu: Array, required: Array, is_due: bool) -> Array | None:
        """Return the precaution levels of this step, (N,); None without precaution.

        Args:
            memory: memory after the last step.
            mu: (N,) friction coefficients without reflex and precaution.
            required: (N,) friction that the forces of the last step would need without precaution.
            is_due: whether a precaution is due now.
        """
        level = memory.precaution
        if self._precaution == 1.0 or (level is None and not is_due):
            return None
        level = np.zeros(len(mu)) if level is None else level
        if not is_due:
            level = self._precaution_decay * level
        elif not memory.is_due:
            without = np.minimum(required * (1.0 + memory.level), mu)
            level = np.maximum(level, self._precaution * mu / np.maximum(without, _TINY) - 1.0)
        level = _bounded(level, mu)
        return level if level.any() else None

    def _required_friction(self, mu: Array, f: Array | None) -> Array:
        """Return the friction ρ that the planned forces need, at most μ, (N,); μ without forces."""
        if f is None:
            return mu
        padded = self._contacts.pad(f)
        normal = self._share * padded[:, friction.F_N]  # N
        required = friction.required_friction(padded, mu, self._contacts.gamma) + self._margin  # N
        return np.asarray(np.minimum(np.divide(required, normal, out=mu.copy(), where=normal > 0.0), mu))


_TINY = 1e-12  # friction ratio, to divide by


def _bounded(level: Array, mu: Array) -> Array:
    """Return levels within their bound, and without negligible ones, (N,)."""
    level = np.where(mu > 0.0, np.minimum(level, LARGEST_SQUEEZE - 1.0), 0.0)
    level[level < _NEGLIGIBLE] = 0.0
    return level

"""Change of the contacts of a held object: fingers that let go, and fingers that join.

The normal force of a changing contact has an upper limit c that moves at the force rate r, N/s, or more slowly if the forces of
other contacts would change faster than r:

- a finger that joins starts with c = 0, and c rises until it limits neither force nor slip margin;
- a finger that lets go starts with c = f_n, or above if its slip margin takes more, and c falls to zero. Fingers that join come
  first.

A slip margin s takes s/μ of a normal force, at a changing contact at most c/2. It shrinks and grows with c.

Forces of least torque exist for every c ≥ 0 if they exist for c = 0, because f = 0 at the contact is allowed for each of them.
They depend continuously on c, so that no motor torque jumps, and the forces of every step have their certificate. If the
other fingers cannot hold the object, c rises again and the finger stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from graspforce.contact.contact import Contact
from graspforce.control.contacts.contact_conditions import Mask
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.hand_contacts import contacts_from_dicts, contacts_to_dicts
from graspforce.hand.hand import Hand

FORCE_RATE = 20.0  # N/s
_NEGLIGIBLE = 1e-3  # N: a contact with a lower limit carries nothing
_LEAST_CHANGE = 1e-5  # N: the limits move at least by this in a step, so that every change ends
_LEAST_SHARE = 0.05  # of the largest change of a step: noise of an estimated state moves all forces, and must not stop the ramp
_FIRST_SHARE = 0.1  # of the largest change of a step: the first one, which shows how the forces follow
_GROWTH = 1.5  # largest ratio of the changes of two steps
_FREE_SHARE = 0.95  # of its limit: a smaller force is no longer limited by it


@dataclass(frozen=True, eq=False, slots=True)
class ContactChange:
    """Fingers that let go of the object, and contacts of fingers that join.

    Args:
        release: names of the fingers that let go.
        add: for each finger that joins its contact in O. The fingertip must be there when the change begins.
        force_rate: rate at which normal forces change, N/s, > 0.

    Raises:
        InvalidInput: nothing changes, a finger lets go and joins at once, or the rate is out of range.
    """

    release: tuple[str, ...] = ()
    add: Mapping[str, Contact] = field(default_factory=dict)
    force_rate: float = FORCE_RATE

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self, release: Sequence[str] = (), add: Mapping[str, Contact] = ..., force_rate: float = FORCE_RATE
        ) -> None: ...

    def __post_init__(self) -> None:
        names = fields.check_sequence(self.release, "release")
        release = tuple(fields.check_text(name, f"release[{i}]") for i, name in enumerate(names))
        add = dict(self.add)
        if not release and not add:
            raise InvalidInput("release", release, "at least one finger that lets go, or one in `add`")
        if len(set(release)) < len(release) or set(release) & set(add):
            raise InvalidInput("release", release, "each finger once, and no finger of `add`")
        rate = arrays.check_number(self.force_rate, "force_rate", above=0.0)
        set_fields(self, release=release, add=add, force_rate=rate)

    def check(self, grasp: Grasp, is_changing: bool = False) -> None:
        """Check that a grasp can change its contacts so.

        Args:
            grasp: the present grasp.
            is_changing: whether another change is in progress.

        Raises:
            InvalidInput: another change is in progress, a finger that joins has a contact, or none would be left.
            UnknownName: the hand has no such finger, or a finger that lets go has no contact.
        """
        if is_changing:
            name = "release" if self.release else "add"
            raise InvalidInput(name, self.to_dict()[name], "absent: another change of contacts is in progress")
        for i, name in enumerate(self.release):
            if name not in grasp.fingers:
                raise UnknownName(f"release[{i}]", name, grasp.fingers)
        known = [finger.name for finger in grasp.hand.fingers]
        for i, name in enumerate(self.add):
            if name not in known:
                raise UnknownName(f"add[{i}].finger", name, known)
            if name in grasp.fingers:
                raise InvalidInput(f"add[{i}].finger", name, "a finger without contact; it must let go first")
        if not self.add and len(self.release) == len(grasp.fingers):
            raise InvalidInput("release", self.release, "fewer fingers: one contact must be left")

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `release`, `add` as a list of contacts with their `finger`, and `force_rate`."""
        return {
            "release": list(self.release),
            "add": contacts_to_dicts(self.add.values(), self.add),
            "force_rate": self.force_rate,
        }

    @classmethod
    def from_dict(cls, record: object, hand: Hand, field: str = "contacts") -> ContactChange:
        """Read a change from a plain record.

        Args:
            record: as `to_dict` returns it; every field may be absent or null.
            hand: the hand.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
            UnknownName: the hand has no finger of that name.
        """
        values = fields.check_record(record, field, optional=["release", "add", "force_rate"])
        release, add, rate = (values.get(name) for name in ("release", "add", "force_rate"))
        contacts: Sequence[Contact] = ()
        fingers: Sequence[str] = ()
        if add is not None and len(fields.check_sequence(add, f"{field}.add")):
            contacts, fingers = contacts_from_dicts(add, f"{field}.add")
        for i, name in enumerate(fingers):
            if name in fingers[:i]:
                raise InvalidInput(f"{field}.add[{i}].finger", name, "another finger: it has a contact in this list")
        try:
            return cls(
                () if release is None else fields.check_sequence(release, "release"),
                dict(zip(fingers, contacts, strict=True)),
                FORCE_RATE if rate is None else arrays.check_number(rate, "force_rate", above=0.0),
            )
        except InvalidInput as error:
            raise error.with_prefix(field) from None


@dataclass(frozen=True, eq=False, slots=True)
class ForceRamp:
    """Upper limits of the normal forces of changing contacts.

    Attributes:
        limit: (N,) limit c of each contact, N; infinite where none acts.
        releasing: (N,) whether each contact is to let go.
        rate: largest rate of the limits and of the normal forces, N/s.
        change: by which the limits of the last step moved, N; None before the first.
        normal_force: (N,) planned normal forces before that step, N; None if there were none.
        blocked: whether the other fingers cannot hold the object, so that all limits rise.
    """

    limit: Array
    releasing: Mask
    rate: float
    change: float | None = None
    normal_force: Array | None = None
    blocked: bool = False

    @classmethod
    def begin(cls, fingers: Sequence[str], change: ContactChange) -> ForceRamp:
        """Return the ramp at the begin of a change.

        Args:
            fingers: names of the fingers at the contacts, those that join included.
            change: the change.
        """
        limit = np.array([0.0 if name in change.add else np.inf for name in fingers])  # N
        return cls(freeze(limit), np.array([name in change.release for name in fingers]), change.force_rate)

    @property
    def idle(self) -> Mask:
        """(N,) whether each contact carries nothing."""
        return np.asarray(self.limit <= _NEGLIGIBLE)

    @property
    def is_released(self) -> bool:
        """Whether the contacts that let go carry nothing, and no other limit acts."""
        return bool(self.releasing.any() and (self.idle == self.releasing).all())

    def step(self, normal_force: Array | None, dt: float, full: Array | float = 0.0, share: float = 1.0) -> ForceRamp | None:
        """Return the ramp of the next step; None if nothing changes any more.

        Args:
            normal_force: (N,) planned normal forces of the last step, N; None before the first.
            dt: control period, s.
            full: (N,) smallest limits with which contacts keep the full slip margin, N.
            share: part of the usual change of the limits.
        """
        change, limit = share * self._next_change(normal_force, dt), self.limit.copy()  # N
        joining = np.isfinite(limit) & (~self.releasing | self.blocked)
        if normal_force is not None:
            limit[joining & (normal_force < _FREE_SHARE * limit - change) & (limit >= full)] = np.inf
        joining &= np.isfinite(limit)
        limit[joining] += change
        if self.blocked or not joining.any():
            if self.blocked or not self.releasing.any():
                return self._moved(limit, change, normal_force) if joining.any() else None
            loaded = limit if normal_force is None else np.minimum(limit, np.maximum(normal_force, full))
            limit = np.where(self.releasing, np.maximum(loaded - change, 0.0), limit)
        return self._moved(limit, change, normal_force)

    def _next_change(self, normal_force: Array | None, dt: float) -> float:
        """Return the change of the limits in the next step, N, with which no normal force should exceed the rate."""
        largest = self.rate * dt  # N
        if self.change is None:
            return _FIRST_SHARE * largest
        if normal_force is None or self.normal_force is None:
            return min(largest, _GROWTH * self.change)
        seen = float(np.abs(normal_force - self.normal_force).max())  # N
        share = min(1.0, max(self.change / max(seen, _LEAST_CHANGE), _LEAST_SHARE))
        return min(largest * share, _GROWTH * self.change)

    def _moved(self, limit: Array, change: float, normal_force: Array | None) -> ForceRamp:
        """Return the ramp with other limits."""
        change = max(change, _LEAST_CHANGE)
        return replace(self, limit=freeze(limit), change=change, normal_force=normal_force)

    def stopped(self) -> ForceRamp:
        """Return the ramp after a step without forces: no contact lets go, and all limits rise."""
        return replace(self, releasing=np.zeros(len(self.releasing), dtype=np.bool_), blocked=True)

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `limit` (null where none acts), `releasing`, `rate`, `change`, `normal_force`, `blocked`."""
        return {
            "limit": [value if np.isfinite(value) else None for value in self.limit.tolist()],
            "releasing": self.releasing.tolist(),
            "rate": self.rate,
            "change": self.change,
            "normal_force": None if self.normal_force is None else self.normal_force.tolist(),
            "blocked": self.blocked,
        }

    @classmethod
    def from_dict(cls, record: object, count: int, field: str = "ramp") -> ForceRamp:
        """Read a ramp from a plain record.

        Args:
            record: as `to_dict` returns it.
            count: number of contacts.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        names = ["limit", "releasing", "rate", "blocked"]
        values = fields.check_record(record, field, required=names, optional=["change", "normal_force"])
        change, normal_force = values.get("change"), values.get("normal_force")
        items = {name: fields.check_sequence(values[name], f"{field}.{name}") for name in ("limit", "releasing")}
        for name, given in items.items():
            if len(given) != count:
                raise InvalidInput(f"{field}.{name}", given, f"a list of {count}, one for each contact")
        limit = [
            np.inf if value is None else arrays.check_number(value, f"{field}.limit[{i}]", minimum=0.0)
            for i, value in enumerate(items["limit"])
        ]
        releasing = [fields.check_boolean(flag, f"{field}.releasing[{i}]") for i, flag in enumerate(items["releasing"])]
        return cls(
            freeze(limit),
            np.array(releasing, dtype=np.bool_),
            arrays.check_number(values["rate"], f"{field}.rate", above=0.0),
            None if change is None else arrays.check_number(change, f"{field}.change", above=0.0),
            None if normal_force is None else arrays.check_array(normal_force, f"{field}.normal_force", (count,)),
            fields.check_boolean(values["blocked"], f"{field}.blocked"),
        )

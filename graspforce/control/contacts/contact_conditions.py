"""What is known of the contacts in one step beyond the model: slip, friction, and fingers without drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import make_unchecked, set_fields
from graspforce.grasp.grasp import Grasp

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class ContactConditions:
    """Conditions of the contacts of a grasp, in the order of its fingers. What is None is as modelled.

    Args:
        slipping: (N,) whether a contact slips now. Warnings of slip then come from here; None: they come from the sliding
            distance, and the forces are those of contacts that do not slip.
        friction: (N,) lower bounds of the friction coefficients, ≥ 0, such as `estimation` gives. They replace the friction
            of the contacts.
        lost: names of the fingers whose drives are off: they apply no planned force.
        touching: (N,) whether a contact touches. Warnings of lost contacts then come from here; None: they come from the gap.
        is_precaution_due: whether all contacts are squeezed a little for a short time; see `slip_reflex`. The monitor of an
            `OutputFeedbackController` decides it; records do not contain it.

    Raises:
        InvalidInput: not booleans, a negative friction, or different numbers of contacts.
    """

    slipping: Mask | None = None
    friction: Array | None = None
    lost: tuple[str, ...] = ()
    touching: Mask | None = None
    is_precaution_due: bool = False

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            slipping: Sequence[bool] | Mask | None = None,
            friction: npt.ArrayLike | None = None,
            lost: Sequence[str] = (),
            touching: Sequence[bool] | Mask | None = None,
            is_precaution_due: bool = False,
        ) -> None: ...

    def __post_init__(self) -> None:
        friction = self.friction
        if friction is not None:
            friction = arrays.check_array(friction, "friction", (None,), minimum=0.0)
        lost = [fields.check_text(name, f"lost[{i}]") for i, name in enumerate(fields.check_sequence(self.lost, "lost"))]
        flags = {name: _check_flags(getattr(self, name), name) for name in ("slipping", "touching")}
        set_fields(self, friction=friction, lost=tuple(lost), **flags)

    def check(self, grasp: Grasp) -> None:
        """Check that the conditions are of the contacts of a grasp.

        Args:
            grasp: the grasp.

        Raises:
            InvalidInput: another number of contacts.
            UnknownName: a lost finger that the grasp does not use.
        """
        count = len(grasp.contacts)
        for name in ("slipping", "friction", "touching"):
            value = getattr(self, name)
            if value is not None and len(value) != count:
                raise InvalidInput(name, value, f"a list of {count}, one for each contact")
        for i, finger in enumerate(self.lost):
            if finger not in grasp.fingers:
                raise UnknownName(f"lost[{i}]", finger, grasp.fingers)

    def for_grasp(self, grasp: Grasp, fingers: Sequence[str]) -> ContactConditions:
        """Return the conditions of the contacts of a grasp, from conditions in the order of other fingers.

        Contacts of fingers that are not named are as modelled. Conditions of fingers without a contact are omitted.

        Args:
            grasp: the grasp.
            fingers: names of the fingers in the order of these conditions.

        Raises:
            InvalidInput: the conditions have another number of contacts than `fingers`, or a finger is named twice.
        """
        places = {name: i for i, name in enumerate(fingers)}
        if len(places) < len(fingers):
            raise InvalidInput("fingers", fingers, "different fingers")
        for name in ("slipping", "friction", "touching"):
            value = getattr(self, name)
            if value is not None and len(value) != len(fingers):
                raise InvalidInput(name, value, f"a list of {len(fingers)}, one for each finger of `fingers`")
        found = [places.get(name, -1) for name in grasp.fingers]
        is_given = np.array(found) >= 0
        slipping, friction, touching = self.slipping, self.friction, self.touching
        return make_unchecked(
            ContactConditions,
            slipping=None if slipping is None else np.where(is_given, slipping[found], False),
            friction=None if friction is None else np.where(is_given, friction[found], grasp.contacts.mu),
            lost=tuple(name for name in self.lost if name in grasp.fingers),
            touching=None if touching is None else np.where(is_given, touching[found], True),
            is_precaution_due=self.is_precaution_due,
        )

    @property
    def has_evidence(self) -> bool:
        """Whether a contact slips or does not touch."""
        slipping, touching = self.slipping, self.touching
        is_slipping = slipping is not None and True in slipping.tolist()  # of a few flags, faster than any()
        return is_slipping or (touching is not None and False in touching.tolist())

    @property
    def affects_forces(self) -> bool:
        """Whether the contact forces are planned otherwise than as modelled."""
        slipping = self.slipping
        is_slipping = slipping is not None and True in slipping.tolist()
        return bool(self.lost) or self.friction is not None or is_slipping or self.is_precaution_due

    def completed(
        self, slipping: Mask, friction: Array | None, touching: Mask, is_precaution_due: bool = False
    ) -> ContactConditions:
        """Return conditions with estimates of slip, friction and contact where they have none. Nothing is checked.

        Args:
            slipping: (N,) whether a contact slips.
            friction: (N,) lower bounds of the friction coefficients; None for those of the contacts.
            touching: (N,) whether a contact touches.
            is_precaution_due: whether a precaution is due.
        """
        return make_unchecked(
            ContactConditions,
            slipping=slipping if self.slipping is None else self.slipping,
            friction=friction if self.friction is None else self.friction,
            lost=self.lost,
            touching=touching if self.touching is None else self.touching,
            is_precaution_due=is_precaution_due or self.is_precaution_due,
        )

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `slipping`, `friction`, `lost` and `touching`, each only if given."""
        record: JsonRecord = {}
        if self.slipping is not None:
            record["slipping"] = self.slipping.tolist()
        if self.friction is not None:
            record["friction"] = self.friction.tolist()
        if self.lost:
            record["lost"] = list(self.lost)
        if self.touching is not None:
            record["touching"] = self.touching.tolist()
        return record

    @classmethod
    def from_dict(cls, record: object, field: str = "conditions") -> ContactConditions:
        """Read conditions from a plain record.

        Args:
            record: as `to_dict` returns it; fields may be absent or null.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, optional=["slipping", "friction", "lost", "touching"])
        slipping, lost, touching = (values.get(name) for name in ("slipping", "lost", "touching"))
        try:
            return cls(
                None if slipping is None else fields.check_sequence(slipping, "slipping"),
                values.get("friction"),
                fields.check_sequence([] if lost is None else lost, "lost"),
                None if touching is None else fields.check_sequence(touching, "touching"),
            )
        except InvalidInput as error:
            raise error.with_prefix(field) from None


def make_conditions(
    slipping: Sequence[bool] | Mask | None, friction: npt.ArrayLike | None, lost: Sequence[str]
) -> ContactConditions | None:
    """Return the conditions of the contacts; None if all are as modelled.

    Args:
        slipping: as in `ContactConditions`.
        friction: as in `ContactConditions`.
        lost: as in `ContactConditions`.
    """
    return ContactConditions(slipping, friction, lost) if slipping is not None or friction is not None or lost else None


def _check_flags(flags: Sequence[bool] | Mask | None, name: str) -> Mask | None:
    """Return booleans as an array that cannot be changed."""
    if flags is None:
        return None
    try:
        checked = np.array(flags)
    except ValueError:  # ragged lists
        checked = np.zeros(())
    if checked.dtype != np.bool_ or checked.ndim != 1:
        raise InvalidInput(name, flags, "a list of booleans, one for each contact")
    checked.setflags(write=False)
    return checked

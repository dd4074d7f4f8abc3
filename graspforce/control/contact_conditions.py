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
from graspforce.core.records import set_fields
from graspforce.grasp.grasp import Grasp

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class ContactConditions:
    """Conditions of the contacts of a grasp, in the order of its fingers. What is None is as modelled.

    Args:
        slipping: (N,) whether a contact slips now; None: none does.
        friction: (N,) lower bounds of the friction coefficients, ≥ 0, such as `estimation` gives. They replace the friction
            of the contacts.
        lost: names of the fingers whose drives are off: they apply no planned force.

    Raises:
        InvalidInput: not booleans, a negative friction, or different numbers of contacts.
    """

    slipping: Mask | None = None
    friction: Array | None = None
    lost: tuple[str, ...] = ()

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            slipping: Sequence[bool] | Mask | None = None,
            friction: npt.ArrayLike | None = None,
            lost: Sequence[str] = (),
        ) -> None: ...

    def __post_init__(self) -> None:
        slipping, friction = self.slipping, self.friction
        if slipping is not None:
            slipping = np.array(slipping)
            if slipping.dtype != np.bool_ or slipping.ndim != 1:
                raise InvalidInput("slipping", self.slipping, "a list of booleans, one for each contact")
            slipping.setflags(write=False)
        if friction is not None:
            friction = arrays.check_array(friction, "friction", (None,), minimum=0.0)
        lost = [fields.check_text(name, f"lost[{i}]") for i, name in enumerate(fields.check_sequence(self.lost, "lost"))]
        set_fields(self, slipping=slipping, friction=friction, lost=tuple(lost))

    def check(self, grasp: Grasp) -> None:
        """Check that the conditions are of the contacts of a grasp.

        Args:
            grasp: the grasp.

        Raises:
            InvalidInput: another number of contacts.
            UnknownName: a lost finger that the grasp does not use.
        """
        count = len(grasp.contacts)
        for name in ("slipping", "friction"):
            value = getattr(self, name)
            if value is not None and len(value) != count:
                raise InvalidInput(name, value, f"a list of {count}, one for each contact")
        for finger in self.lost:
            if finger not in grasp.fingers:
                raise UnknownName("lost", finger, grasp.fingers)

    def completed(self, slipping: Mask | None, friction: Array | None) -> ContactConditions:
        """Return conditions with estimates of slip and friction where they have none.

        Args:
            slipping: (N,) whether a contact slips; None if it is not estimated.
            friction: (N,) lower bounds of the friction coefficients; None if they are not estimated.
        """
        known = slipping if self.slipping is None else self.slipping, friction if self.friction is None else self.friction
        return ContactConditions(*known, self.lost)

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `slipping`, `friction` and `lost`, each only if given."""
        record: JsonRecord = {}
        if self.slipping is not None:
            record["slipping"] = self.slipping.tolist()
        if self.friction is not None:
            record["friction"] = self.friction.tolist()
        if self.lost:
            record["lost"] = list(self.lost)
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
        values = fields.check_record(record, field, optional=["slipping", "friction", "lost"])
        slipping, lost = values.get("slipping"), values.get("lost")
        try:
            return cls(
                None if slipping is None else fields.check_sequence(slipping, "slipping"),
                values.get("friction"),
                fields.check_sequence([] if lost is None else lost, "lost"),
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

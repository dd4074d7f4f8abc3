"""Options of a force problem: the friction cone and the objective."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields

ConeType = Literal["exact", "pyramid"]
PyramidSide = Literal["inner", "outer"]
ObjectiveType = Literal["torque", "force", "max_normal", "sum_normal", "margin"]

OBJECTIVE_TYPES: tuple[str, ...] = get_args(ObjectiveType)
MAX_FACETS = 1024


@dataclass(frozen=True, slots=True)
class Cone:
    """The model of the friction cones: exact, or pyramids inside or outside the exact cone.

    Args:
        type: "exact" or "pyramid".
        facets: m, the number of facets of a pyramid, 3 to 1024. Their normals are at the angles 2πk/m from t₁.
        side: "inner" uses the friction μ cos(π/m), so that every force of the pyramid is in the cone. "outer" uses the
            friction μ, so that every force of the cone is in the pyramid.

    Raises:
        InvalidInput: a value that is not allowed.
    """

    type: ConeType = "exact"
    facets: int = 8
    side: PyramidSide = "inner"

    def __post_init__(self) -> None:
        """Validate the values."""
        fields.check_choice(self.type, "type", get_args(ConeType))
        fields.check_integer(self.facets, "facets", minimum=3, maximum=MAX_FACETS)
        fields.check_choice(self.side, "side", get_args(PyramidSide))

    @classmethod
    def from_dict(cls, record: object, field: str = "cone") -> Cone:
        """Return the cone of a ``cone`` record of a problem file.

        Args:
            record: mapping with ``type``, and for pyramids ``facets`` and ``side``.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or has a value that is not allowed.
        """
        values = fields.check_record(record, field, required=["type"], optional=["facets", "side"])
        try:
            return cls(**values)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the ``cone`` record of a problem file."""
        if self.type == "exact":
            return {"type": "exact"}
        return {"type": "pyramid", "facets": self.facets, "side": self.side}


@dataclass(frozen=True, slots=True)
class Objective:
    """The objective. All are minimised but "margin", which is maximised.

    Args:
        type: "torque": ½‖tau‖²_W + ½ ρ ‖f‖². "force": ½‖f‖². "max_normal": the largest normal force. "sum_normal": the sum
            of the normal forces. "margin": the largest s ≥ 0 with ‖f_t‖ ≤ μ f_n − s at every contact with friction.
        force_weight: ρ ≥ 0, (N·m/N)², for "torque" only.
        moment_length: length ℓ > 0 that weighs the moments m_n of soft contacts in ‖f‖² = Σ ‖f_i‖² + m_n,i²/ℓ², m; for "force"
            and "torque". With 1 m, 1 N·m counts as much as 1 N.

    Raises:
        InvalidInput: a value that is not allowed.
    """

    type: ObjectiveType
    force_weight: float = 0.0
    moment_length: float = 1.0

    def __post_init__(self) -> None:
        """Validate the values."""
        fields.check_choice(self.type, "type", OBJECTIVE_TYPES)
        set_fields(self, force_weight=arrays.check_number(self.force_weight, "force_weight", minimum=0.0))
        set_fields(self, moment_length=arrays.check_number(self.moment_length, "moment_length", minimum=0.0))
        if self.moment_length == 0.0:
            raise InvalidInput("moment_length", 0.0, "greater than 0")
        if self.type not in ("torque", "force") and self.moment_length != 1.0:
            raise InvalidInput("moment_length", self.moment_length, f"absent or 1 with the objective {self.type}")
        if self.type != "torque" and self.force_weight:
            raise InvalidInput("force_weight", self.force_weight, f"absent or 0 with the objective {self.type}")

    @classmethod
    def from_dict(cls, record: object, field: str = "objective") -> Objective:
        """Return the objective of an ``objective`` record of a problem file.

        Args:
            record: mapping with ``type``; for "torque" ``force_weight``, and for "torque" and "force" ``moment_length``.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or has a value that is not allowed.
        """
        values = fields.check_record(record, field, required=["type"], optional=["force_weight", "moment_length"])
        try:
            return cls(**values)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the ``objective`` record of a problem file."""
        record: JsonRecord = {"type": self.type}
        if self.type == "torque":
            record["force_weight"] = self.force_weight
        if self.moment_length != 1.0:
            record["moment_length"] = self.moment_length
        return record

"""The request to find a grasp of an object, and its answer: a grasp that `distribute`, `control` and streams take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from enum import Enum

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import GraspMeasures, GraspRank, GraspSearchOptions, RankedGrasp
from graspforce.hand.hand import Hand

_OPTIONS = (
    "max_normal", "slip_margin", "travel", "clearance", "edge_ratio", "palm_normal_H", "grasp_class", "approach_O", "up_O",
    "pad_friction",
)  # fmt: skip
_ARGUMENTS = ("friction", "gravity", "fingers", "seed", "count", "rank")
_MAX_COUNT = 16  # grasps of one answer
_MAX_GRAVITIES = 64
_MAX_SEED = 2**32 - 1


@dataclass(frozen=True, eq=False)
class GraspRequest:
    """An object to hold, and what the grasp must bear; see `graspforce.find_grasp`.

    Args:
        body: the object.
        friction: μ of all contacts, > 0.
        gravity: (3,) or (K, 3) accelerations of gravity in H, m/s², each a load case; None for the six directions of H's axes.
        fingers: names of the fingers that touch; None for the search's choice.
        seed: seed of the random candidates, from 0 to 2³² − 1.
        options: further requirements; their budget and callback are not sent.
        count: number of different grasps, from 1 to 16.
        rank: measure that orders them, a `GraspRank` or its name.

    Raises:
        InvalidInput: a value has the wrong type, shape or range; names the field of the record.
    """

    body: Body
    friction: float = 0.6
    gravity: npt.ArrayLike | None = None
    fingers: tuple[str, ...] | None = None
    seed: int = 0
    options: GraspSearchOptions = field(default_factory=GraspSearchOptions)
    count: int = 1
    rank: GraspRank | str = GraspRank.MARGIN

    def __post_init__(self) -> None:
        gravity = self.gravity
        if gravity is not None:
            gravity = arrays.check_array(gravity, "gravity", (None, 3) if _has_rows(gravity) else (3,))
            if gravity.ndim == 2 and not 1 <= len(gravity) <= _MAX_GRAVITIES:
                raise InvalidInput("gravity", f"{len(gravity)} load cases", f"from 1 to {_MAX_GRAVITIES}")
        rank = self.rank
        if not isinstance(rank, GraspRank):
            rank = GraspRank(fields.check_choice(rank, "rank", [each.value for each in GraspRank]))
        names = None if self.fingers is None else fields.check_sequence(self.fingers, "fingers", at_least=2)
        set_fields(
            self,
            friction=arrays.check_number(self.friction, "friction", above=0.0),
            gravity=gravity,
            fingers=None if names is None else tuple(fields.check_text(name, f"fingers[{i}]") for i, name in enumerate(names)),
            seed=fields.check_integer(self.seed, "seed", minimum=0, maximum=_MAX_SEED),
            count=fields.check_integer(self.count, "count", minimum=1, maximum=_MAX_COUNT),
            rank=rank,
        )

    @classmethod
    def from_dict(cls, record: object) -> GraspRequest:
        """Read the request from its record.

        Args:
            record: as `to_dict` returns it.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, "", required=["body"], optional=[*_ARGUMENTS, *_OPTIONS])
        given = {name: value for name, value in values.items() if value is not None}
        options = GraspSearchOptions(**{name: given[name] for name in _OPTIONS if name in given})
        arguments = {name: given[name] for name in _ARGUMENTS if name in given}
        return cls(Body.from_dict(values["body"]), options=options, **arguments)

    def to_dict(self) -> JsonRecord:
        """Return the plain record: `body`, and the values that are not None.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be sent.
        """
        sent = {name: getattr(self, name) for name in _ARGUMENTS} | {name: getattr(self.options, name) for name in _OPTIONS}
        sent["fingers"] = None if self.fingers is None else list(self.fingers)
        plain = {name: _plain(value) for name, value in sent.items()}
        return {"body": self.body.to_dict(), **{name: value for name, value in plain.items() if value is not None}}


def _has_rows(value: object) -> bool:
    """Return whether a value is a matrix: an array with rows, or a list whose items are all lists."""
    if isinstance(value, np.ndarray):
        return value.ndim == 2
    return (
        isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(row, list | tuple | np.ndarray) for row in value)
    )


def _plain(value: object) -> object:
    """Return a value as JSON has it."""
    if isinstance(value, Enum):
        return value.value
    return value.tolist() if isinstance(value, np.ndarray) else value


def write_grasps(found: Sequence[RankedGrasp]) -> JsonRecord:
    """Return the part of an answer with grasps: the best as `hold`, and all as `grasps` with their measures.

    Args:
        found: the grasps, the best first.
    """
    grasps = [{"hold": each.grasp.to_dict(), **asdict(each.measures), "seed": each.seed} for each in found]
    for record in grasps:
        record["clearance"] = None if np.isinf(record["clearance"]) else record["clearance"]
    return {"hold": grasps[0]["hold"], "grasps": grasps}


def read_grasps(hand: Hand, record: object) -> tuple[RankedGrasp, ...]:
    """Return the grasps of an answer, the best first.

    Args:
        hand: the hand of the request.
        record: the answer without the service's own fields.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    values, found = fields.check_record(record, "", required=["id", "hold", "grasps"]), []
    for i, item in enumerate(fields.check_sequence(values["grasps"], "grasps", at_least=1)):
        place = f"grasps[{i}]"
        each = fields.check_record(item, place, required=["hold", "margin", "robustness", "clearance", "seed"])
        margin, robustness = (arrays.check_number(each[name], f"{place}.{name}") for name in ("margin", "robustness"))
        clearance = each["clearance"]
        clear = np.inf if clearance is None else arrays.check_number(clearance, f"{place}.clearance")
        seed = fields.check_integer(each["seed"], f"{place}.seed", minimum=0, maximum=_MAX_SEED)
        grasp = Grasp.from_dict(each["hold"], hand, f"{place}.hold")
        found.append(RankedGrasp(grasp, GraspMeasures(margin, robustness, clear), seed))
    return tuple(found)


def read_grasp(hand: Hand, record: object) -> Grasp:
    """Return the grasp of an answer.

    Args:
        hand: the hand of the request.
        record: the answer without the service's own fields.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    values = fields.check_record(record, "", required=["id", "hold", "grasps"])
    return Grasp.from_dict(values["hold"], hand, "hold")

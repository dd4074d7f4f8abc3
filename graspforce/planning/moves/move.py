"""The union of all moves, and the move of a record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

from graspforce.core import fields
from graspforce.core.errors import MissingField
from graspforce.hand.hand import Hand
from graspforce.planning.moves.fingers_move import FingersMove
from graspforce.planning.moves.object_moves import FreeMove, PathMove

Move: TypeAlias = PathMove | FreeMove | FingersMove

_MOVES: dict[str, type[PathMove | FreeMove | FingersMove]] = {"path": PathMove, "free": FreeMove, "fingers": FingersMove}
METHODS = tuple(_MOVES)


def move_from_dict(record: object, hand: Hand) -> Move:
    """Return the move of a record, of the kind that its ``method`` names.

    Args:
        record: mapping that a move's `to_dict` made.
        hand: the hand, which the record does not contain.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    if not isinstance(record, Mapping) or "method" not in record:
        raise MissingField("method", f"one of {', '.join(METHODS)}")
    return _MOVES[fields.check_choice(record["method"], "method", METHODS)].from_dict(record, hand)

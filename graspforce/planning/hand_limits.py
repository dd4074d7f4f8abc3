"""Limits of a hand's joints as a record: a task may use less torque, speed and range than the hand has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

from graspforce.core import arrays
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import Hand

_ARRAYS = {"torque": "torque_upper", "speed": "velocity_limit", "lower": "q_lower", "upper": "q_upper"}
LIMIT_FIELDS = tuple(_ARRAYS)
_LEAST_SHARE = 1e-6  # of the hand's own limit: smaller torques and speeds are rounding errors


def limits_to_dict(hand: Hand) -> JsonRecord:
    """Return the limits of each joint: torque in N·m, speed in rad/s, and lower and upper position in rad.

    Args:
        hand: the hand.
    """
    return {name: getattr(hand, array).tolist() for name, array in _ARRAYS.items()}


def hand_with_limits(hand: Hand, record: Mapping[str, object]) -> Hand:
    """Return a hand with the limits of a record, each within its own; the same hand for equal limits.

    Args:
        hand: the hand.
        record: mapping with optional fields as of `limits_to_dict`; the others are ignored.

    Raises:
        InvalidInput: a limit below 1e-6 of the hand's own, or that exceeds the hand's own.
    """
    own = {name: getattr(hand, array) for name, array in _ARRAYS.items()}
    limits = {name: arrays.check_array(record.get(name, own[name]), name, (hand.n,)) for name in _ARRAYS}
    for name, unit in (("torque", "N·m"), ("speed", "rad/s")):
        for i, (value, largest) in enumerate(zip(limits[name], own[name], strict=True)):
            least = _LEAST_SHARE * largest
            if not least <= value <= largest:
                allowed = f"from {least:g} to {largest:g} {unit}, the limit of {hand.joints[i].name}"
                raise InvalidInput(f"{name}[{i}]", float(value), allowed)
    for i, joint in enumerate(hand.joints):
        lower, upper = float(limits["lower"][i]), float(limits["upper"][i])
        if not joint.lower <= lower <= upper <= joint.upper:
            allowed = f"a range within [{joint.lower:g}, {joint.upper:g}] rad, the range of {joint.name}"
            raise InvalidInput(f"lower[{i}]", [lower, upper], allowed)
    if all((limits[name] == own[name]).all() for name in _ARRAYS):
        return hand
    return _cached_hand(hand, tuple(tuple(limits[name].tolist()) for name in _ARRAYS))


@lru_cache(maxsize=16)
def _cached_hand(hand: Hand, limits: tuple[tuple[float, ...], ...]) -> Hand:
    """Return the same object for equal limits: planners cache the equations of each hand that they have seen."""
    joints = tuple(
        replace(joint, torque=torque, velocity=speed, lower=lower, upper=upper)
        for joint, torque, speed, lower, upper in zip(hand.joints, *limits, strict=True)
    )
    return replace(hand, joints=joints)

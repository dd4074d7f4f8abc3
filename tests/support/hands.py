"""The shipped hands, loaded once, and postures for tests."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from graspforce.core.errors import ModelError
from graspforce.hand.descriptions.description import shipped_hands
from graspforce.hand.hand import Hand

SHIPPED_HANDS = list(shipped_hands())


@cache
def _loaded(name: str) -> Hand | ModelError:
    try:
        return Hand.load(name)
    except ModelError as error:
        return error


def load(name: str) -> Hand:
    """Return a shipped hand; skip the test if the package of its URDF is not installed."""
    hand = _loaded(name)
    if isinstance(hand, ModelError):
        if "example-robot-data" not in str(hand):
            raise hand
        pytest.skip(str(hand))
    return hand


def random_posture(hand: Hand, seed: int) -> np.ndarray:
    """Return a random posture within the limits; every fifth has some joints at a limit."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(hand.q_lower, hand.q_upper)
    if seed % 5 == 0:
        q = np.where(rng.uniform(size=hand.n) < 0.3, hand.q_lower, q)
    return q


def hand_finger_pairs(names: list[str]) -> list[tuple[str, str]]:
    """Return (hand, finger) for every finger; (hand, "?") for a hand that cannot be loaded, whose test is skipped."""
    pairs = []
    for name in names:
        hand = _loaded(name)
        pairs += [(name, "?")] if isinstance(hand, ModelError) else [(name, finger.name) for finger in hand.fingers]
    return pairs

"""Notes about postures within the limits in which links collide."""

from __future__ import annotations

import re

import numpy as np
import pytest
from support.hands import load

from graspforce.core.errors import InvalidInput
from graspforce.hand.collision import HandCollision
from graspforce.hand.lint.posture_checks import check_postures


def test_note_has_the_share_and_an_example_that_collides() -> None:
    """The example's posture is evaluated again, and the share counted again from the same seed."""
    hand = load("four_finger")
    (note,) = check_postures(hand, 60, seed=3)
    assert note.severity == "note"
    collision = HandCollision(hand)
    rng = np.random.default_rng(3)
    distances = [collision.link_gaps(q)[0].distance for q in rng.uniform(hand.q_lower, hand.q_upper, (60, hand.n))]
    assert f"in {100 * np.mean(np.array(distances) < -1e-6):.0f} % of 60" in note.problem
    found = re.search(r"q = \((.*)\) rad", note.problem)
    assert found is not None
    q = np.array([float(x) for x in found[1].split(",")])
    assert collision.link_gaps(q)[0].distance == pytest.approx(min(distances), abs=1e-3)  # the note has three digits


def test_hand_whose_links_never_meet_has_no_note() -> None:
    assert check_postures(load("parallel_jaws"), 50) == ()


def test_count_of_samples_is_checked() -> None:
    with pytest.raises(InvalidInput, match="samples"):
        check_postures(load("four_finger"), 0)

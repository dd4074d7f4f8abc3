"""Meta motions: the published conditions, for all patterns of signs."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
import pytest

from graspforce.learning import meta_motion_conditions

# HANDLE project (undated), table 2: the two rows of v_1 and v_2 of each motion, and the relations of v_3 and v_4.
OPENING, CLOSING = (("any", "<"), ("<", "=")), (("any", ">"), (">", "="))
TABLE = {
    1: (OPENING, ">=", ">="), 2: (OPENING, "<=", ">="), 3: (OPENING, "<=", "<="), 4: (OPENING, ">=", "<="),
    5: (CLOSING, ">=", ">="), 6: (CLOSING, "<=", ">="), 7: (CLOSING, "<=", "<="), 8: (CLOSING, ">=", "<="),
}  # fmt: skip
RELATIONS = {
    "any": lambda v: True, "<": lambda v: v < 0, ">": lambda v: v > 0, "=": lambda v: v == 0, ">=": lambda v: v >= 0,
    "<=": lambda v: v <= 0,
}  # fmt: skip
PATTERNS = list(itertools.product((-1, 0, 1), repeat=4))


def labels(v):
    return [j + 1 for j in np.flatnonzero(meta_motion_conditions([v])[0])]


def test_all_patterns_agree_with_the_published_table():
    for v in PATTERNS:
        expected = [
            j
            for j, (flexion, third, fourth) in TABLE.items()
            if any(RELATIONS[first](v[0]) and RELATIONS[second](v[1]) for first, second in flexion)
            and RELATIONS[third](v[2])
            and RELATIONS[fourth](v[3])
        ]
        assert labels(v) == (expected if any(v) else [9]), v


def test_the_table_is_ambiguous_for_as_many_patterns_as_are_known():
    """33 patterns have one label, with rest; 32 have two, 8 have four, and 8 have none."""
    assert Counter(len(labels(v)) for v in PATTERNS) == {1: 33, 2: 32, 4: 8, 0: 8}


def test_a_deadband_makes_small_changes_rest():
    assert labels([0.1, -0.1, 0.1, -0.1]) == [4]
    assert np.flatnonzero(meta_motion_conditions([[0.1, -0.1, 0.1, -0.1]], 0.1)[0]).tolist() == [8]


@pytest.mark.parametrize("v", [[[0.0, 1.0]], [[0.0, 1.0, 2.0, np.nan]]])
def test_invalid_changes_are_refused(v):
    with pytest.raises(ValueError, match="must be"):
        meta_motion_conditions(v)

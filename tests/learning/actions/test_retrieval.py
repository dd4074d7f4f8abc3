"""Recordings that are like a given one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspforce.core.errors import InvalidInput
from graspforce.learning import ActionGist, find_similar, gist_similarity

MOTIONS = st.tuples(st.sampled_from(["thumb", "first", "middle"]), st.integers(1, 8))
GISTS = st.lists(MOTIONS, min_size=1, max_size=10).map(lambda motions: ActionGist(tuple(motions)))


@given(GISTS, GISTS)
@settings(max_examples=100, deadline=None)
def test_similarity_is_symmetric_between_0_and_1_and_1_for_equal_gists(a, b):
    assert gist_similarity(a, a) == pytest.approx(1.0)
    assert gist_similarity(a, b) == pytest.approx(gist_similarity(b, a), rel=1e-12)
    assert 0.0 <= gist_similarity(a, b) <= 1.0
    if not set(a.motions) & set(b.motions):
        assert gist_similarity(a, b) == 0.0


def test_a_variation_is_more_similar_than_a_reversed_order():
    rng = np.random.default_rng(0)
    for _ in range(20):
        motions = [(str(finger), int(motion)) for finger, motion in zip(rng.permutation(8), rng.integers(1, 9, 8), strict=True)]
        given_gist, missing = ActionGist(tuple(motions)), ActionGist(tuple(motions[:3] + motions[4:]))
        swapped = ActionGist((*motions[:2], motions[3], motions[2], *motions[4:]))
        backwards = ActionGist(tuple(reversed(motions)))
        other = gist_similarity(given_gist, backwards)
        assert gist_similarity(given_gist, missing) > other
        assert gist_similarity(given_gist, swapped) > other


def test_runs_of_the_same_task_are_found_among_others():
    """Of each of 6 tasks there are 5 runs, in which two random neighbours change places, and one motion is new."""
    rng = np.random.default_rng(1)
    fingers = ["thumb", "first", "middle", "ring"]
    recordings = {}
    for task in range(6):
        motions = [(str(rng.choice(fingers)), int(rng.integers(1, 9))) for _ in range(10)]
        for run in range(5):
            order, k = list(motions), int(rng.integers(0, 9))
            order[k], order[k + 1] = order[k + 1], order[k]
            order.insert(int(rng.integers(0, 11)), (str(rng.choice(fingers)), int(rng.integers(1, 9))))
            recordings[f"{task}/{run}"] = ActionGist(tuple(order))
    for name, gist in recordings.items():
        found = find_similar(gist, recordings, count=5)
        assert found[0].similarity == pytest.approx(1.0)
        assert recordings[found[0].name] == gist
        assert {each.name[0] for each in found} == {name[0]}
        assert [each.similarity for each in found] == sorted((each.similarity for each in found), reverse=True)


def test_errors_name_the_argument():
    gist = ActionGist((("thumb", 1),))
    with pytest.raises(InvalidInput, match="recordings"):
        find_similar(gist, {})
    with pytest.raises(InvalidInput, match="count"):
        find_similar(gist, {"one": gist}, count=0)

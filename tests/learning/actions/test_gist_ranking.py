"""Histogram and ranking of action gists, with the published gists."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspforce.core.errors import InvalidInput
from graspforce.learning import ActionGist, GistHistogram, rank_gists


def gist(text):
    """Return a gist of words such as T7: the first letter of the finger and the motion."""
    return ActionGist(tuple((word[0], int(word[1:])) for word in text.split()))


# HANDLE project (undated), tables 3 and 4: the three best gists of a block's and of a ladle's rotation.
BLOCK = [
    gist("T7 M5 R6 F6 T1 F5 M8 R4 F8 T4 M3 R8"),
    gist("T7 M5 R6 F6 F5 R4 T1 M8 F8 M3 T5"),
    gist("T7 F6 M5 R5 F5 F8 M3 R2 M5"),
]
LADLE = [gist("T5 F8 M7"), gist("F5 T5 M7 F8"), gist("F8 F5 T5 M7 F8")]


def test_published_ranking_of_the_block():
    """No two of the 18 recordings have equal gists. The other 15 are not published; the three alone have this order."""
    ranked = rank_gists(BLOCK)
    assert [each.gist for each in ranked] == BLOCK
    assert [each.count for each in ranked] == [1, 1, 1]


@pytest.mark.parametrize("counts", [(3, 1, 1), (4, 1, 1), (5, 1, 1), (5, 2, 1), (5, 2, 2), (6, 1, 1), (7, 1, 1)])
def test_published_ranking_of_the_ladle(counts):
    """Nine recordings have five gists; the first is the most common. The other two gists are not published."""
    every = [each for each, count in zip(LADLE, counts, strict=True) for _ in range(count)]
    ranked = rank_gists(every)
    assert [each.gist for each in ranked] == LADLE
    assert tuple(each.count for each in ranked) == counts


def test_the_histogram_of_one_element_is_the_gaussian():
    """One motion at ψ = 0 with σ_w = 1: G(a, 1) over 100 positions."""
    values = GistHistogram((gist("T5"),)).values["T", 5]
    a = np.arange(100) / 100
    np.testing.assert_allclose(values, np.exp(-0.5 * a**2) / (np.sqrt(2 * np.pi) * 100), rtol=1e-12)


def test_positions_belong_to_the_nearest_motion_of_the_finger():
    """T has motions at ψ = 0 and 2/3: the first counts below 1/3 only, the second above."""
    values = GistHistogram((gist("T5 F1 T7"),)).values
    a = np.arange(100) / 100
    assert ((values["T", 5] > 0.0) == (a < 1 / 3)).all()
    assert ((values["T", 7] > 0.0) == (a > 1 / 3)).all()
    assert (values["F", 1] > 0.0).all()


def test_the_histogram_is_the_sum_of_those_of_the_gists():
    together = GistHistogram(tuple(BLOCK)).values
    for motion, values in together.items():
        single = [GistHistogram((each,)).values.get(motion, 0.0) for each in BLOCK]
        np.testing.assert_allclose(values, sum(single), rtol=1e-12)


def best_by_enumeration(histogram, motions):
    """Largest sum over all beginnings b_1 < b_2 < …; a section ends where the finger's next one begins."""
    R, best = histogram.resolution, -np.inf
    for begins in itertools.combinations(range(R), len(motions)):
        total = 0.0
        for i, motion in enumerate(motions):
            later = [begins[j] for j in range(i + 1, len(motions)) if motions[j][0] == motion[0]]
            values = histogram.values.get(motion, np.zeros(R))
            total += values[begins[i] : (later[0] if later else R)].sum()
        best = max(best, total)
    return best


motions = st.lists(st.tuples(st.sampled_from("TF"), st.integers(5, 7)), min_size=1, max_size=4)


@given(st.lists(motions, min_size=1, max_size=3), motions)
@settings(deadline=None, max_examples=60)
def test_the_score_is_the_best_of_all_divisions(recorded, asked):
    histogram = GistHistogram(tuple(ActionGist(tuple(each)) for each in recorded), resolution=9)
    expected = best_by_enumeration(histogram, asked)
    assert histogram.score(ActionGist(tuple(asked))) == pytest.approx(expected, abs=1e-12)


def test_unknown_motions_score_nothing():
    assert GistHistogram((gist("T5"),)).score(gist("F1")) == 0.0


@pytest.mark.parametrize("motions", [(), (("T", 9),), (("T", 0),), ((3, 1),)])
def test_invalid_gists_are_refused(motions):
    with pytest.raises(InvalidInput):
        ActionGist(motions)


def test_a_gist_longer_than_the_resolution_is_refused():
    with pytest.raises(InvalidInput, match="resolution"):
        GistHistogram((gist("T5"),), resolution=2).score(gist("T5 F5 T6"))
    with pytest.raises(InvalidInput):
        rank_gists([])

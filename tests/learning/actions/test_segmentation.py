"""Segmentation: known motions of a finger come back with their boundaries."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from graspforce.core.errors import InvalidInput
from graspforce.learning import ActionGist, GistSettings, MotionSegment, action_gist, segment_finger

SIGNS = {5: (1, 1, 1, 1), 7: (1, 1, -1, -1), 2: (-1, -1, -1, 1), 9: (0, 0, 0, 0)}
NOISE = np.radians(0.02)  # of an encoder
SETTINGS = GistSettings(deadband=0.1)  # degrees per frame: above the noise, below the motions


def stream(phases, noise=0.0, seed=0):
    """Angles of a finger that moves at 0.5 degrees per frame; phases are (motion, frames)."""
    v = np.concatenate([np.tile(0.5 * np.array(SIGNS[motion], float), (frames, 1)) for motion, frames in phases])
    q = np.radians(np.cumsum(v, axis=0))
    return q + noise * np.random.default_rng(seed).normal(size=q.shape)


def test_motions_and_rests_are_found_exactly_without_noise():
    found = segment_finger(stream([(9, 60), (5, 50), (2, 40), (9, 50), (7, 45)]), SETTINGS)
    assert [each.motion for each in found] == [9, 5, 2, 9, 7]
    np.testing.assert_allclose([each.begin for each in found], [0, 60, 110, 150, 200], atol=1)
    assert found[-1].end == 245


@pytest.mark.parametrize("seed", range(5))
def test_boundaries_are_within_three_frames_with_noise(seed):
    found = segment_finger(stream([(9, 60), (5, 50), (2, 40), (9, 50), (7, 45)], NOISE, seed), SETTINGS)
    assert [each.motion for each in found] == [9, 5, 2, 9, 7]
    np.testing.assert_allclose([each.begin for each in found], [0, 60, 110, 150, 200], atol=3)


def test_segments_cover_all_frames_in_order():
    rng = np.random.default_rng(2)
    q = np.radians(np.cumsum(rng.normal(size=(300, 4)), axis=0))
    found = segment_finger(q, GistSettings(sigma=4.0))
    assert found[0].begin == 0
    assert found[-1].end == 300
    assert all(a.end == b.begin for a, b in pairwise(found))


def test_a_larger_sigma_gives_fewer_motions():
    rng = np.random.default_rng(3)
    q = np.radians(np.cumsum(np.cumsum(rng.normal(size=(600, 4)), axis=0), axis=0))
    counts = [len(segment_finger(q, GistSettings(sigma=sigma))) for sigma in (2.0, 10.0, 50.0)]
    assert counts[0] > counts[1] > counts[2]


def test_a_short_tremor_does_not_interrupt_a_motion():
    found = segment_finger(stream([(5, 60), (2, 3), (5, 60)]), GistSettings())
    assert [each.motion for each in found] == [5]


def test_a_single_rest_frame_is_no_idle_section():
    """With the sum itself compared with 0.90, as printed in the source, this frame would be idle."""
    assert [each.motion for each in segment_finger(stream([(5, 60), (9, 1), (5, 60)]), GistSettings())] == [5]


def test_a_finger_at_rest_is_idle():
    assert segment_finger(np.zeros((50, 4))) == (MotionSegment(9, 0, 50),)


def test_an_opposite_tip_joint_does_not_change_the_label():
    """A contact bends the tip joint back: angle 2 decides."""
    q = stream([(5, 60)])
    q[:, 0] *= -1
    assert [each.motion for each in segment_finger(q)] == [5]


def test_ties_keep_the_label_of_the_frame_before():
    """Angle 3 rests in the second half, where motions 7 and 8 are equally likely."""
    v = np.vstack([np.tile([1.0, 1.0, -0.2, -1.0], (60, 1)), np.tile([1.0, 1.0, 0.0, -1.0], (200, 1))])
    assert [each.motion for each in segment_finger(np.radians(np.cumsum(v, axis=0)), GistSettings(sigma=2.0))] == [7]


def test_the_gist_is_the_order_of_beginnings_without_rests():
    segments = {
        "thumb": (MotionSegment(9, 0, 10), MotionSegment(7, 10, 30), MotionSegment(1, 30, 60)),
        "first": (MotionSegment(5, 0, 20), MotionSegment(9, 20, 60)),
    }
    assert action_gist(segments) == ActionGist((("first", 5), ("thumb", 7), ("thumb", 1)))


def test_invalid_arguments_are_refused():
    for call in (
        lambda: segment_finger(np.zeros((1, 4))),
        lambda: segment_finger(np.zeros((5, 3))),
        lambda: GistSettings(sigma=0.0),
        lambda: GistSettings(idle_fraction=1.1),
        lambda: GistSettings(idle_window=2.5),
        lambda: action_gist({"thumb": (MotionSegment(9, 0, 5),)}),
    ):
        with pytest.raises(InvalidInput):
            call()

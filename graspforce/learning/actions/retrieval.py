"""Recordings that are like a given one, by the order of their motions.

The similarity of two recordings is the cosine of the angle between their histograms, equation (5):

    similarity(a, b) = Σ H_a H_b / √(Σ H_a² Σ H_b²),

with sums over positions, fingers and motions. It is 1 for equal gists, and 0 without a common motion. Common motions count
more the nearer they are in the order. Source of the histogram: HANDLE project, Parameterizing and creating new actions
(undated), equation (5).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from graspforce.core import fields
from graspforce.core.errors import InvalidInput
from graspforce.learning.actions.gist_ranking import ActionGist, GistHistogram

_MAX_COUNT = 1_000_000


@dataclass(frozen=True, slots=True)
class SimilarRecording:
    """A recording that was found.

    Attributes:
        name: its name.
        similarity: to the given gist, 0 to 1.
    """

    name: str
    similarity: float


def gist_similarity(first: ActionGist, second: ActionGist, resolution: int = 100) -> float:
    """Return how alike the orders of motions of two recordings are, 0 to 1. It is symmetric.

    Args:
        first: gist of one recording.
        second: gist of the other.
        resolution: number of positions of the histograms, ≥ 1.

    Raises:
        InvalidInput: the resolution is out of range.
    """
    return _cosine(GistHistogram((first,), resolution), GistHistogram((second,), resolution))


def find_similar(
    gist: ActionGist, recordings: Mapping[str, ActionGist], count: int = 5, resolution: int = 100
) -> tuple[SimilarRecording, ...]:
    """Return the recordings whose order of motions is most like a gist, the most similar first.

    Args:
        gist: the gist that is looked for.
        recordings: gist of each recording by name, at least one. Equally similar ones keep their order.
        count: number of recordings to return at most, ≥ 1.
        resolution: number of positions of the histograms, ≥ 1.

    Raises:
        InvalidInput: no recording, or an argument out of range.
    """
    if not recordings:
        raise InvalidInput("recordings", {}, "at least one recording")
    count = fields.check_integer(count, "count", minimum=1, maximum=_MAX_COUNT)
    wanted = GistHistogram((gist,), resolution)
    found = [SimilarRecording(name, _cosine(wanted, GistHistogram((each,), resolution))) for name, each in recordings.items()]
    return tuple(sorted(found, key=lambda each: -each.similarity)[:count])


def _cosine(a: GistHistogram, b: GistHistogram) -> float:
    """Return the cosine of the angle between two histograms."""
    common = sum(float(a.values[motion] @ b.values[motion]) for motion in a.values.keys() & b.values.keys())
    squares = [sum(float(values @ values) for values in each.values.values()) for each in (a, b)]
    return min(common / float(np.sqrt(squares[0] * squares[1])), 1.0)

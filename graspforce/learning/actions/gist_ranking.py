"""Action gists: the order of the fingers' motions in a recording, the histogram of several, and their ranking.

An element i of a gist of length L has the order position ψ = i / L. The histogram counts, for each finger r and motion l, the
weight of the motion at each position a in [0, 1), equation (5):

    H[a, r, l] = Σ G(a − ψ, σ_w), σ_w = 1 / L,

over the elements with that finger and motion of which a is nearer than to every other element of the finger. The score of a
gist is the largest sum of H over sections, one for each element, equation (6). The sections of a finger follow each other, and
all begin in the order of the gist, equation (4). Source: HANDLE project, Parameterizing and creating new actions (undated),
equations (4) to (6).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from graspforce.core import fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields

Motion = tuple[str, int]  # finger and meta motion, 1 to 8
_MAX_RESOLUTION = 100_000


@dataclass(frozen=True, slots=True)
class ActionGist:
    """The order in which fingers begin their motions.

    Args:
        motions: name of the finger and number of the meta motion of each element, 1 to 8, at least one.

    Raises:
        InvalidInput: names the element and what is allowed.
    """

    motions: tuple[Motion, ...]

    def __post_init__(self) -> None:
        if not self.motions:
            raise InvalidInput("motions", self.motions, "at least one motion")
        checked = tuple(
            (
                fields.check_text(finger, f"motions[{i}][0]"),
                fields.check_integer(motion, f"motions[{i}][1]", minimum=1, maximum=8),
            )
            for i, (finger, motion) in enumerate(self.motions)
        )
        set_fields(self, motions=checked)

    def __str__(self) -> str:
        return ", ".join(f"{finger} {motion}" for finger, motion in self.motions)


@dataclass(frozen=True, eq=False, slots=True)
class GistHistogram:
    """The histogram of motions over order positions, equation (5).

    Args:
        gists: the gists of all recordings of one task, at least one.
        resolution: number R of positions.

    Attributes:
        values: (R,) histogram of each finger and motion that occurs.

    Raises:
        InvalidInput: an argument is not allowed.
    """

    gists: tuple[ActionGist, ...]
    resolution: int = 100
    values: dict[Motion, Array] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        if not self.gists:
            raise InvalidInput("gists", self.gists, "at least one gist")
        R = fields.check_integer(self.resolution, "resolution", minimum=1, maximum=_MAX_RESOLUTION)
        values: dict[Motion, Array] = {}
        for gist in self.gists:
            for motion, weights in _weights(gist, R):
                values[motion] = values.get(motion, np.zeros(R)) + weights
        set_fields(self, values={motion: freeze(one) for motion, one in values.items()}, gists=tuple(self.gists))

    def score(self, gist: ActionGist) -> float:
        """Return the score of a gist, equation (6). Gists that contain common motions at their usual positions score high.

        Dynamic programming over the beginnings b_1 < b_2 < … of the sections: with the sums C of H up to a position, the
        score is Σ_i (C_before(b_i) − C_i(b_i)) + Σ_last C(1), and each term depends on one beginning. Every section contains
        a position at least; otherwise an additional motion would never lower a score.

        Args:
            gist: the gist, of R motions at most.

        Raises:
            InvalidInput: the gist has more motions than the histogram has positions.
        """
        R, L = self.resolution, len(gist.motions)
        if L > R:
            raise InvalidInput("gist", f"{L} motions", f"at most {R} motions, the resolution of the histogram")
        sums = {motion: np.concatenate([[0.0], np.cumsum(values)]) for motion, values in self.values.items()}
        nothing = np.zeros(R + 1)
        before: dict[str, Array] = {}
        reach = np.zeros(R)  # largest sum of the terms so far, if the last section begins at this position or earlier
        for i, motion in enumerate(gist.motions):
            own, finger = sums.get(motion, nothing), motion[0]
            previous = np.concatenate([[-np.inf], reach[:-1]]) if i else reach
            reach = np.maximum.accumulate(previous + (before.get(finger, nothing) - own)[:R])
            before[finger] = own
        return float(reach[-1] + sum(each[-1] for each in before.values()))


@dataclass(frozen=True, slots=True)
class RankedGist:
    """A gist with its score.

    Attributes:
        gist: the gist.
        score: its score.
        count: number of recordings that have it.
    """

    gist: ActionGist
    score: float
    count: int


def rank_gists(gists: Iterable[ActionGist], resolution: int = 100) -> tuple[RankedGist, ...]:
    """Return the different gists of recordings of one task, the highest score first.

    Args:
        gists: the gist of each recording.
        resolution: number of positions of the histogram.

    Raises:
        InvalidInput: no gist.
    """
    every = tuple(gists)
    histogram = GistHistogram(every, resolution)
    different: Sequence[ActionGist] = list(dict.fromkeys(every))
    ranked = [RankedGist(each, histogram.score(each), every.count(each)) for each in different]
    return tuple(sorted(ranked, key=lambda each: -each.score))


def _weights(gist: ActionGist, resolution: int) -> Iterable[tuple[Motion, Array]]:
    """Yield each element with its weights over all positions (R,)."""
    L = len(gist.motions)
    position = np.arange(resolution) / resolution
    psi = np.arange(L) / L
    distance = np.abs(position[:, None] - psi)  # (R, L)
    for finger in dict.fromkeys(name for name, _ in gist.motions):
        own = [i for i, (name, _) in enumerate(gist.motions) if name == finger]
        nearest = np.asarray(own)[distance[:, own].argmin(axis=1)]
        for i in own:
            gauss = np.exp(-0.5 * np.square(distance[:, i] * L)) * L / (np.sqrt(2.0 * np.pi) * resolution)
            yield gist.motions[i], np.where(nearest == i, gauss, 0.0)

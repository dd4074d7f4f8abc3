"""The motions of a finger in a stream of joint positions, by its meta motions.

The likelihood of each motion in a frame is the sum of its intensities over all frames with Gaussian weights, equation (2). The
most likely motion is the label of the frame. A frame is idle if more than a fraction of the frames of a window about it rest,
equation (3); the source compares the sum itself with the fraction, which one frame at rest would exceed. If the two most likely
motions are equal, the label of the frame before is kept if it is one of them; otherwise the smaller number is taken, because
the source states no rule. Source: HANDLE project, Parameterizing and creating new actions (undated), equations (1) to (3).

Boundaries are then moved to the frame at which one motion ends and the next one begins, see `boundaries`. This step is not in
the source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.learning.actions.boundaries import best_boundary
from graspforce.learning.actions.gist_ranking import ActionGist
from graspforce.learning.actions.meta_motions import IDLE, intensities, meta_motion_conditions

Labels = npt.NDArray[np.intp]
_TIE = 1e-12  # relative difference of likelihoods that counts as equal
_MAX_FRAMES = 1_000_000


@dataclass(frozen=True, slots=True)
class GistSettings:
    """Parameters of the segmentation. Defaults as in the source, for a glove at 30 to 100 frames per second.

    Args:
        epsilon: ε of the intensities, degrees per frame, > 0.
        sigma: standard deviation of the Gaussian weights, frames, > 0. Shorter motions are merged, and shorter rests do not
            count.
        idle_fraction: a frame is idle if more than this fraction of its window rests, 0 to 1.
        idle_window: length of that window, frames, ≥ 1.
        shortest: segments with fewer frames are given to their neighbours, ≥ 1.
        deadband: largest change of an angle that counts as rest, degrees per frame, ≥ 0. Choose it above the noise.
        refine: move each boundary to the frame between the two motions that fits the angles best.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    epsilon: float = 0.05
    sigma: float = 10.0
    idle_fraction: float = 0.90
    idle_window: int = 20
    shortest: int = 5
    deadband: float = 0.0
    refine: bool = True

    def __post_init__(self) -> None:
        fraction = arrays.check_number(self.idle_fraction, "idle_fraction", minimum=0.0)
        if fraction > 1.0:
            raise InvalidInput("idle_fraction", self.idle_fraction, "a number from 0 to 1")
        set_fields(
            self,
            epsilon=arrays.check_number(self.epsilon, "epsilon", above=0.0),
            sigma=arrays.check_number(self.sigma, "sigma", above=0.0),
            idle_fraction=fraction,
            idle_window=fields.check_integer(self.idle_window, "idle_window", minimum=1, maximum=_MAX_FRAMES),
            shortest=fields.check_integer(self.shortest, "shortest", minimum=1, maximum=_MAX_FRAMES),
            deadband=arrays.check_number(self.deadband, "deadband", minimum=0.0),
            refine=fields.check_boolean(self.refine, "refine"),
        )


@dataclass(frozen=True, slots=True)
class MotionSegment:
    """A motion of one finger.

    Attributes:
        motion: number of the meta motion; 9 is rest.
        begin: first frame.
        end: frame after the last one.
    """

    motion: int
    begin: int
    end: int


def segment_finger(angles: npt.ArrayLike, settings: GistSettings | None = None) -> tuple[MotionSegment, ...]:
    """Return the motions of one finger in the order of time. They cover all frames.

    Args:
        angles: (T, 4) angles of the finger at frames of equal distance in time, rad, flexion positive, in the order of
            `meta_motions`; a missing angle is a column of zeros.
        settings: the parameters.

    Raises:
        InvalidInput: an argument is not allowed.
    """
    settings = GistSettings() if settings is None else settings
    angles = arrays.check_array(angles, "angles", (None, 4))
    if len(angles) < 2:
        raise InvalidInput("angles", len(angles), "at least two frames")
    v = np.degrees(np.diff(angles, axis=0, prepend=angles[:1]))  # degrees per frame
    v[0] = v[1]
    allowed = meta_motion_conditions(v, settings.deadband)
    strength = intensities(v, allowed, settings.epsilon)
    labels = _most_likely(_gaussian_sum(strength[:, :-1], settings.sigma))
    labels[_idle_frames(strength[:, -1], settings)] = IDLE
    segments = _drop_short(_runs(labels), settings.shortest)
    return _refine(segments, angles, settings) if settings.refine else segments


def action_gist(segments: Mapping[str, Sequence[MotionSegment]]) -> ActionGist:
    """Return the order in which fingers begin their motions, without rests, equation (4).

    Args:
        segments: motions of each finger, by its name. Of motions that begin in the same frame, the first finger's comes first.

    Raises:
        InvalidInput: no finger moves.
    """
    order = [
        (one.begin, i, name, one.motion) for i, name in enumerate(segments) for one in segments[name] if one.motion != IDLE
    ]
    return ActionGist(tuple((name, motion) for _, _, name, motion in sorted(order)))


def _gaussian_sum(strength: Array, sigma: float) -> Array:
    """Return Σ_t I_t G(t, i, σ) for all frames i; the weights end at 5 σ."""
    from scipy.ndimage import gaussian_filter1d  # imported here to keep the package fast to import

    return np.asarray(gaussian_filter1d(strength, sigma, axis=0, mode="constant", truncate=5.0))


def _most_likely(likelihood: Array) -> Labels:
    """Return the label of each frame."""
    largest = likelihood.max(axis=1)
    tied = likelihood >= (largest * (1.0 - _TIE))[:, None]
    labels = tied.argmax(axis=1).astype(np.intp)
    labels[largest == 0.0] = IDLE - 1  # no motion anywhere near
    for i in np.flatnonzero(tied.sum(axis=1) > 1):
        if i > 0 and largest[i] > 0.0 and labels[i - 1] < IDLE - 1 and tied[i, labels[i - 1]]:
            labels[i] = labels[i - 1]
    return np.asarray(labels + 1)


def _idle_frames(rests: Array, settings: GistSettings) -> npt.NDArray[np.bool_]:
    """Return the frames at rest: enough of the window rests, and the rest lasts σ frames at least."""
    window = settings.idle_window
    sums = np.concatenate([[0.0], np.cumsum(rests)])
    centre = np.arange(len(rests))
    first, last = np.maximum(centre - window // 2, 0), np.minimum(centre + (window + 1) // 2, len(rests))
    idle = (sums[last] - sums[first]) / (last - first) > settings.idle_fraction
    for run in _runs(idle.astype(np.intp)):
        if run.motion == 1 and run.end - run.begin < settings.sigma:
            idle[run.begin : run.end] = False
    return np.asarray(idle)


def _runs(labels: Labels) -> tuple[MotionSegment, ...]:
    """Return the runs of equal labels."""
    borders = [0, *(np.flatnonzero(np.diff(labels)) + 1).tolist(), len(labels)]
    return tuple(MotionSegment(int(labels[a]), a, b) for a, b in pairwise(borders))


def _drop_short(segments: Sequence[MotionSegment], shortest: int) -> tuple[MotionSegment, ...]:
    """Return the segments without the short ones: the shortest goes first, each half to one neighbour."""
    kept = list(segments)
    while len(kept) > 1:
        i = min(range(len(kept)), key=lambda j: kept[j].end - kept[j].begin)
        short = kept[i]
        if short.end - short.begin >= shortest:
            break
        middle = (short.begin + short.end) // 2
        if i == 0:
            middle = short.begin
        elif i == len(kept) - 1:
            middle = short.end
        if i > 0:
            kept[i - 1] = MotionSegment(kept[i - 1].motion, kept[i - 1].begin, middle)
        if i + 1 < len(kept):
            kept[i + 1] = MotionSegment(kept[i + 1].motion, middle, kept[i + 1].end)
        del kept[i]
        if 0 < i < len(kept) and kept[i - 1].motion == kept[i].motion:
            kept[i - 1 : i + 1] = [MotionSegment(kept[i].motion, kept[i - 1].begin, kept[i].end)]
    return tuple(kept)


def _refine(segments: Sequence[MotionSegment], angles: Array, settings: GistSettings) -> tuple[MotionSegment, ...]:
    """Move the boundaries by at most an idle window and half of each neighbour."""
    borders = [each.begin for each in segments] + [segments[-1].end]
    moved = list(borders)
    for k in range(1, len(borders) - 1):
        left = min(settings.idle_window, (borders[k] - borders[k - 1]) // 2)
        right = min(settings.idle_window, (borders[k + 1] - borders[k]) // 2)
        first, last = borders[k] - 2 * left, borders[k] + 2 * right
        if left and right:
            moved[k] = first + best_boundary(angles[first:last], 2 * left - left, 2 * left + right)
    return tuple(
        MotionSegment(each.motion, moved[k], moved[k + 1]) for k, each in enumerate(segments) if moved[k + 1] > moved[k]
    )

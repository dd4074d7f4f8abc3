"""Motions of fingers, and published gists.

A simulated run is a finger that performs five to eight motions and rests of 0.4 to 1.2 s in random order, with joint speeds of
30 to 90 °/s, and noise of its sensors. Each motion begins and ends at rest. *Ramps*: the speeds rise and fall linearly within
20 to 60 ms, as with limits of acceleration. *Minimum jerk*: the first 30 ms of a motion of 1 s contain 0.03 % of the way. A
boundary is found if a boundary of the segmentation is within 30 ms, between the same two motions. The glove has 0.3° noise at
30 frames per second, with which a frame lasts 33 ms; its limit is therefore one frame. All deadbands are 4.5 standard
deviations of the noise, at least 0.1° per frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report_page
from graspforce.core.arrays import Array
from graspforce.geometry.minimum_jerk import minimum_jerk
from graspforce.learning import ActionGist, GistSettings, rank_gists, segment_finger

TITLE = "Actions"
RUNS = 200
LIMIT = 0.030  # s
_SIGNS = {
    1: (-1, -1, 1, 1), 2: (-1, -1, -1, 1), 3: (-1, -1, -1, -1), 4: (-1, -1, 1, -1), 5: (1, 1, 1, 1), 6: (1, 1, -1, 1),
    7: (1, 1, -1, -1), 8: (1, 1, 1, -1), 9: (0, 0, 0, 0),
}  # fmt: skip
_BLOCK = (
    "Thumb 7, Middle 5, Ring 6, First 6, Thumb 1, First 5, Middle 8, Ring 4, First 8, Thumb 4, Middle 3, Ring 8",
    "Thumb 7, Middle 5, Ring 6, First 6, First 5, Ring 4, Thumb 1, Middle 8, First 8, Middle 3, Thumb 5",
    "Thumb 7, First 6, Middle 5, Ring 5, First 5, First 8, Middle 3, Ring 2, Middle 5",
)
_LADLE = (
    "Thumb 5, First 8, Middle 7",
    "First 5, Thumb 5, Middle 7, First 8",
    "First 8, First 5, Thumb 5, Middle 7, First 8",
)


@dataclass(frozen=True)
class Sensor:
    """A sensor of joint angles.

    Attributes:
        name: its name.
        rate: frames per second.
        noise: standard deviation, degrees.
        smooth: whether the motions have minimum jerk instead of ramps.
        sigma: σ of the segmentation, frames.
    """

    name: str
    rate: float
    noise: float
    smooth: bool
    sigma: float


SENSORS = (
    Sensor("encoder, ramps", 100.0, 0.02, False, 10.0),
    Sensor("encoder, minimum jerk", 100.0, 0.02, True, 10.0),
    Sensor("glove, ramps", 30.0, 0.3, False, 3.0),
)


def run(_records: Path, _pictures: Path) -> dict[str, Any]:
    """Segment all runs, and rank the published gists."""
    streams = [{"sensor": each.name, **_segment_runs(each)} for each in SENSORS]
    block = [_gist(text) for text in _BLOCK]
    ladle = [_gist(text) for text in _LADLE]
    counts = (5, 1, 1)
    return {
        "streams": streams,
        "block": [block.index(each.gist) + 1 for each in rank_gists(block)],
        "block_scores": [each.score for each in rank_gists(block)],
        "ladle": [
            ladle.index(each.gist) + 1
            for each in rank_gists([gist for gist, n in zip(ladle, counts, strict=True) for _ in range(n)])
        ],
    }


def _gist(text: str) -> ActionGist:
    words = [element.split() for element in text.split(", ")]
    return ActionGist(tuple((finger, int(motion)) for finger, motion in words))


def _segment_runs(sensor: Sensor) -> dict[str, float]:
    """Return the fractions of boundaries and motions that are found, and the numbers of boundaries."""
    limit = max(LIMIT, 1.0 / sensor.rate) + 1e-9
    total = found = extra = 0
    errors = []
    for seed in range(RUNS):
        labels, instants, angles = simulate_run(sensor, np.random.default_rng(seed))
        deadband = max(0.1, 4.5 * sensor.noise * np.sqrt(2.0))
        settings = GistSettings(sigma=sensor.sigma, deadband=deadband, idle_window=round(0.2 * sensor.rate))
        segments = segment_finger(angles, settings)
        borders = [(b.begin / sensor.rate, a.motion, b.motion) for a, b in pairwise(segments)]
        for t, before, after in zip(instants[1:-1], labels[:-1], labels[1:], strict=True):
            near = [abs(each[0] - t) for each in borders if each[1:] == (before, after)]
            total += 1
            found += int(min(near, default=np.inf) <= limit)
            errors += [min(near)] if near and min(near) < 0.3 else []
        extra += max(len(borders) - (len(labels) - 1), 0)
    return {"total": total, "found": found, "extra": extra, "p95": float(np.quantile(errors, 0.95))}


def simulate_run(sensor: Sensor, rng: np.random.Generator) -> tuple[list[int], Array, Array]:
    """Return the motions of a run, their instants (k + 1,), s, and the measured angles (T, 4), rad.

    Args:
        sensor: the sensor and the kind of motion.
        rng: random generator.
    """
    labels: list[int] = []
    for _ in range(int(rng.integers(5, 9))):
        labels.append(int(rng.choice([each for each in _SIGNS if not labels or each != labels[-1]])))
    durations = rng.uniform(0.4, 1.2, len(labels))
    instants = np.concatenate([[0.0], np.cumsum(durations)])
    speeds = [rng.uniform(30.0, 90.0, 4) * _SIGNS[label] for label in labels]  # degrees/s
    t = np.arange(0.0, instants[-1], 1.0 / sensor.rate)
    if sensor.smooth:
        angles = np.zeros((len(t), 4))
        for k, speed in enumerate(speeds):
            share = np.array([minimum_jerk(s, 1.0)[0] for s in np.clip((t - instants[k]) / durations[k], 0.0, 1.0)])
            angles += share[:, None] * speed * durations[k]
    else:
        fine = np.arange(0.0, instants[-1] + 1e-3, 1e-3)
        v = np.zeros((len(fine), 4))
        for k, speed in enumerate(speeds):
            inside = np.minimum(fine - instants[k], instants[k + 1] - fine)  # s, from the nearer end of the motion
            v += np.clip(inside / rng.uniform(0.02, 0.06), 0.0, 1.0)[:, None] * speed
        q = np.cumsum(v, axis=0) * 1e-3
        angles = np.array([np.interp(t, fine, column) for column in q.T]).T
    return labels, instants, np.radians(angles + sensor.noise * rng.normal(size=angles.shape))


def page(result: dict[str, Any]) -> str:
    """Return the tables.

    Args:
        result: of `run`.
    """
    rows = [
        (
            each["sensor"],
            f"{each['found']}/{each['total']}",
            f"{100 * each['found'] / each['total']:.1f} %",
            f"{1e3 * each['p95']:.0f} ms",
            f"{each['extra']}",
        )
        for each in result["streams"]
    ]
    scores = ", ".join(f"{score:.1f}" for score in result["block_scores"])
    text = (
        f"Published gists: the three of the block's rotation alone rank {result['block']} (scores {scores}); the source ranks "
        f"them 1, 2, 3 among 18 recordings. The three of the ladle's rotation rank {result['ladle']} if the first occurs in "
        "five of seven recordings; the source ranks them 1, 2, 3 among nine recordings and does not state how often each "
        "occurs. The conditions of the motions equal the published table for all 81 patterns of signs (a test)."
    )
    head = ("stream", "boundaries found", "fraction", "95 % of errors below", "additional boundaries")
    return f"{report_page.table(head, rows)}\n\n{text}"

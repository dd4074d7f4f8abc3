"""Gloves.

A simulated glove has a sensor for each joint, whose reading runs from 0 to 1 over the range of the joint, with 1 % noise in
each frame and 10 % cross-talk from both neighbours. 60 pairs are random postures within the limits, with readings averaged
over 30 frames. The errors are those of 1000 other postures, single frames. *Drift*: each sensor drifts at a constant rate with
a standard deviation of 0.05 % of the range per second. After each time, 30 frames of the neutral posture are compared with the
calibration. A joint has drifted if its error exceeds four times its cross-validated error.

*Mapping*: the fingertips of the LEAP hand go from the neutral posture to ten grasps of its library and back, in 50 frames each
way, and drive three fingers of other hands. Scale and frame are fitted to the fingertips of 20 other grasps of the same
objects by both hands. The gap is the least distance of links that must not touch, over all frames. *Held back*: frames in
which it stopped a finger.
"""

from __future__ import annotations

import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report_page
from benchmarks.learning.objects import library
from graspforce import Hand
from graspforce.hand.collision import HandCollision
from graspforce.learning import FingertipMapper, SimulatedGlove, calibrate_glove, fit_fingertip_map

TITLE = "Gloves"
HANDS = ("allegro_right", "leap_right", "dlr_hit2", "shadow_right")
_PAIRS, _AVERAGED, _TESTS, _SEEDS = 60, 30, 1000, 5
_DRIFT_TIMES = (0, 30, 60, 120)  # s
_SOURCE = "leap_right"
_GRASPS, _FRAMES = 10, 50  # of the library, and frames of each way
_FINGERS = {  # of each target hand: the finger of the source
    "allegro_right": {name: name for name in ("index", "middle", "thumb")},
    "dlr_hit2": {name: name for name in ("index", "middle", "thumb")},
    "shadow_right": {"first": "index", "middle": "middle", "thumb": "thumb"},
}
_CLEARANCE = 0.0  # m: neutral postures of some hands have less than 1 mm


def run(records: Path, _pictures: Path) -> dict[str, Any]:
    """Calibrate gloves, and map fingertips.

    Args:
        records: folder of the libraries.
    """
    return {"calibration": [_calibrations(name) for name in HANDS], "mapping": [_map(name, records) for name in _FINGERS]}


def _calibrations(hand_name: str) -> dict[str, Any]:
    """Return the errors, degrees, and the drifted joints of one hand over several gloves."""
    hand = Hand.load(hand_name)
    joints = tuple(joint.name for joint in hand.joints)
    all_rms, worst, methods, drifted = [], [], [], {t: [] for t in _DRIFT_TIMES}
    for seed in range(_SEEDS):
        glove, rng = SimulatedGlove(hand.q_lower, hand.q_upper, drift=0.0005, seed=seed), np.random.default_rng(seed)
        q = rng.uniform(hand.q_lower, hand.q_upper, (_PAIRS, hand.n))
        readings = np.mean([glove.readings(q, rng) for _ in range(_AVERAGED)], axis=0)
        calibration = calibrate_glove(readings, joints, q)
        other = rng.uniform(hand.q_lower, hand.q_upper, (_TESTS, hand.n))
        error = np.degrees(calibration.postures(glove.readings(other, rng)) - other)
        all_rms.append(np.sqrt(np.square(error).mean()))
        worst.append(np.sqrt(np.square(error).mean(axis=0)).max())
        methods.append(calibration.method)
        frames = np.tile(hand.neutral, (_AVERAGED, 1))
        for t in _DRIFT_TIMES:
            drifted[t].append(len(calibration.drift(glove.readings(frames, rng, t), hand.neutral).joints))
    return {
        "hand": hand_name,
        "joints": hand.n,
        "rms": float(np.max(all_rms)),
        "worst": float(np.max(worst)),
        "methods": sorted(set(methods)),
        "drifted": [float(np.mean(drifted[t])) for t in _DRIFT_TIMES],
    }


def _map(hand_name: str, records: Path) -> dict[str, Any]:
    """Return errors, gaps and times of the fingertips of the source that drive another hand."""
    source, hand = Hand.load(_SOURCE), Hand.load(hand_name)
    fingers = _FINGERS[hand_name]
    known, own = library(_SOURCE, records).for_hand(source), library(hand_name, records).for_hand(hand)
    pairs = [(known.objects.index(name), own.objects.index(name)) for name in known.objects[_GRASPS:] if name in own.objects]
    tips_S = [source.tip_pose(known.q[i], name)[0] for i, _ in pairs for name in fingers.values()]
    tips_H = [hand.tip_pose(own.q[j], name)[0] for _, j in pairs for name in fingers]
    fitted = fit_fingertip_map(fingers, tips_S, tips_H, clearance=_CLEARANCE)
    mapper = FingertipMapper(hand, fitted)
    collision, places = HandCollision(hand), [source.neutral]
    for grasp in known.q[:_GRASPS]:
        places += [grasp, source.neutral]
    errors, gaps, times, held = [], [], [], 0
    for a, b in pairwise(places):
        for share in np.linspace(0.0, 1.0, _FRAMES, endpoint=False):
            q = a + share * (b - a)
            frame = {name: source.tip_pose(q, name)[0] for name in fingers.values()}
            start = time.process_time()
            posture = mapper.step(frame)
            times.append(time.process_time() - start)
            errors += list(posture.errors.values())
            gaps.append(collision.link_gaps(posture.q)[0].distance)
            held += int(posture.is_held_back)
    return {
        "hand": hand_name,
        "scale": fitted.scale,
        "median": float(1e3 * np.median(errors)),
        "p95": float(1e3 * np.quantile(errors, 0.95)),
        "gap": float(1e3 * np.min(gaps)),
        "held": held,
        "frames": len(gaps),
        "time": float(1e3 * np.median(times)),
        "time_p99": float(1e3 * np.quantile(times, 0.99)),
    }


def page(result: dict[str, Any]) -> str:
    """Return the tables.

    Args:
        result: of `run`.
    """
    head = ("hand", "joints", "RMS error", "worst joint", "kept method", *(f"drifted after {t} s" for t in _DRIFT_TIMES))
    rows = [
        (
            each["hand"],
            str(each["joints"]),
            f"{each['rms']:.2f}°",
            f"{each['worst']:.2f}°",
            ", ".join(each["methods"]),
            *(f"{count:.1f}" for count in each["drifted"]),
        )
        for each in result["calibration"]
    ]
    mapped = [
        (
            each["hand"],
            f"{each['scale']:.2f}",
            f"{each['median']:.1f} mm",
            f"{each['p95']:.1f} mm",
            f"{each['gap']:.2f} mm",
            f"{each['held']}/{each['frames']}",
            f"{each['time']:.1f} ms",
            f"{each['time_p99']:.1f} ms",
        )
        for each in result["mapping"]
    ]
    mapped_head = ("target hand", "scale", "median error", "95 %", "least gap", "held back", "median time", "99 %")
    note = f"Errors are the largest of {_SEEDS} gloves; drifted joints are their mean."
    return f"{report_page.table(head, rows)}\n\n{note}\n\n{report_page.table(mapped_head, mapped)}"

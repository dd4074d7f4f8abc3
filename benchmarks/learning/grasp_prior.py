"""Grasp search with a prior of synergies.

Each hand searches a grasp of 20 objects of 50 g that are not in its library, with the same three fingers and seed 0: without
prior; without prior but ended at the first grasp that meets all requirements; and with the first components of the hand's
library as prior, which also ends there. The requirements are the same. Times are processor time; "closure" is the median
quality of the force closure of the grasps, from 0 to 1. Median ratio: median over the objects of the time divided by that
without prior.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report_page
from benchmarks.learning.objects import FINGERS, MASS, library, unseen_objects
from graspforce import GraspForceError, Hand
from graspforce.geometry import Solid
from graspforce.grasp.body import Body
from graspforce.grasp.search import GraspSearchOptions, GraspSearchProgress, PosturePrior, find_grasp
from graspforce.grasp.search.checks import closure_quality
from graspforce.learning import fit_synergies

TITLE = "Grasp search with a prior"
COUNTS = (3, 4, 5)
FRICTION = 0.6
_HEAD = ("hand", "search", "found", "median, s", "largest, s", "median ratio", "closure")


def run(records: Path, _pictures: Path) -> list[dict[str, Any]]:
    """Search all grasps.

    Args:
        records: folder of the libraries.
    """
    results = []
    for hand_name in FINGERS:
        hand, synergies = Hand.load(hand_name), fit_synergies(library(hand_name, records))
        searches: dict[str, tuple[PosturePrior | None, GraspSearchOptions | None]] = {
            "without prior": (None, None),
            "first grasp": (None, GraspSearchOptions(callback=_none_found)),
        }
        searches.update({f"{b} components": (synergies.prior(b), None) for b in COUNTS})
        for name, shape in unseen_objects().items():
            for kind, (prior, options) in searches.items():
                seconds, closure = _search(hand, shape, prior, options)
                results.append({"hand": hand_name, "object": name, "search": kind, "seconds": seconds, "closure": closure})
            print(results[-1], flush=True)
    return results


def _none_found(progress: GraspSearchProgress) -> bool:
    return progress.found == 0


def _search(
    hand: Hand, shape: Solid, prior: PosturePrior | None, options: GraspSearchOptions | None
) -> tuple[float, float | None]:
    """Return the processor time, s, and the closure quality of the grasp; None if none was found."""
    start = time.process_time()
    try:
        grasp = find_grasp(hand, Body.solid(shape, MASS), FINGERS[hand.name], friction=FRICTION, options=options, prior=prior)
    except GraspForceError:
        return time.process_time() - start, None
    return time.process_time() - start, closure_quality(grasp.contacts, FRICTION)


def page(results: list[dict[str, Any]]) -> str:
    """Return the table of each hand and of all.

    Args:
        results: of `run`.
    """
    kinds = list(dict.fromkeys(each["search"] for each in results))
    rows = []
    for hand in [*dict.fromkeys(each["hand"] for each in results), "all"]:
        own = [each for each in results if hand in (each["hand"], "all")]
        base = np.array([each["seconds"] for each in own if each["search"] == kinds[0]])
        for kind in kinds:
            these = [each for each in own if each["search"] == kind]
            seconds = np.array([each["seconds"] for each in these])
            closure = [each["closure"] for each in these if each["closure"] is not None]
            found = f"{len(closure)}/{len(these)}"
            numbers = (np.median(seconds), seconds.max(), np.median(seconds / base), np.median(closure))
            rows.append((hand, kind, found, *(f"{number:.2f}" for number in numbers)))
    return report_page.table(_HEAD, rows, 2)

"""Measures of grasps against an independent hull, and their times: `python -m benchmarks.grasp_quality --grasps 200`.

ε of Ferrari and Canny of random closed grasps, with inner pyramids, against the hull of all points. For Σ f_n ≤ 1 N ("sum")
these are zero and all pyramid edges, of three to five contacts with eight facets. For f_n ≤ 1 N at each contact ("each") they
are all sums of one edge or none of each contact, of three contacts with four facets. Qhull computes the hull of all points at
once, ε the hull of a few support points. Errors are relative to the hull's ε.

Times are of one call each, of `ferrari_canny` for random grasps of five contacts, closed and open, and of `wrench_volume`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import graspforce as gf
from benchmarks import report_page
from graspforce.analysis.wrench_set import wrench_volume
from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import characteristic_length, normalised_grasp_matrix
from graspforce.contact.quality import NormalLimit, ferrari_canny, inscribed_ball_radius, wrench_ball

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.contact_strategies import contacts_around_object

HEAD = ("limit", "closed grasps", "open grasps", "largest error", "open grasps with ε > 0")
TIMES_HEAD = ("measure", "calls", "median (s)", "longest (s)")
FACETS: dict[NormalLimit, int] = {"sum": 8, "each": 4}


def hull_radius(contacts: ContactSet, limit: NormalLimit) -> float:
    """Return ε from the hull of all points; negative for open grasps.

    Args:
        contacts: the contacts.
        limit: "sum" or "each".
    """
    L, bases = characteristic_length(contacts), normalised_grasp_matrix(contacts).reshape(6, -1, 4)
    points = np.zeros((1, 6))
    for i, (mu, gamma) in enumerate(zip(contacts.mu.tolist(), contacts.gamma.tolist(), strict=True)):
        edges = (friction.pyramid_rays(FACETS[limit], "inner", mu, gamma) * (1.0, 1.0, 1.0, 1.0 / L)) @ bases[:, i].T
        if limit == "sum":
            points = np.vstack([points, edges])
        else:
            points = (points[:, None] + np.vstack([np.zeros(6), edges])).reshape(-1, 6)
    return inscribed_ball_radius(points)


def compare(limit: NormalLimit, count: int) -> tuple[str, ...]:
    """Return the row of a limit: numbers of grasps and the largest error.

    Args:
        limit: "sum" or "each".
        count: number of closed grasps.
    """
    rng, errors, opened, wrong = np.random.default_rng(17), [], 0, 0
    while len(errors) < count:
        contacts = contacts_around_object(rng, int(rng.integers(3, 6)) if limit == "sum" else 3, models=("point", "soft"))
        expected, found = hull_radius(contacts, limit), wrench_ball(contacts, FACETS[limit], limit).radius
        if expected > 1e-9:
            errors.append(abs(found - expected) / expected)
        else:
            opened += 1
            wrong += found > 1e-9
    return limit, str(count), str(opened), f"{max(errors):.1e}", str(wrong)


def timed(name: str, count: int, contacts: int, measure: Callable[[ContactSet], object]) -> tuple[str, ...]:
    """Return the row of a measure: its times for random grasps.

    Args:
        name: the measure.
        count: number of grasps.
        contacts: number of their contacts.
        measure: the measure.
    """
    rng, times = np.random.default_rng(5), []
    for _ in range(count):
        grasp = contacts_around_object(rng, contacts, models=("point", "soft"))
        start = time.perf_counter()
        measure(grasp)
        times.append(time.perf_counter() - start)
    return name, str(count), f"{np.median(times):.3f}", f"{max(times):.3f}"


def main() -> None:
    """Measure, print the tables and write the page."""
    options = report_page.parser("grasp_quality", __doc__)
    options.add_argument("--grasps", type=int, default=20, help="number of closed grasps for each limit")
    options.add_argument("--calls", type=int, default=10, help="number of calls that are timed")
    given = options.parse_args()
    rows = [compare(limit, given.grasps) for limit in FACETS]
    report_page.show("Against an independent hull", HEAD, rows)
    times = [
        timed("ε, 5 contacts, 128 facets", given.calls, 5, lambda grasp: ferrari_canny(grasp, 128)),
        timed("ε, 5 contacts, 8 facets", given.calls, 5, lambda grasp: ferrari_canny(grasp, 8)),
        timed("ε, 5 contacts, exact cones", given.calls, 5, ferrari_canny),
        timed("volume, 8 contacts", given.calls, 8, wrench_volume),
        timed("volume, 50 contacts", given.calls, 50, wrench_volume),
    ]
    report_page.show("Times", TIMES_HEAD, times)
    if given.save:
        facts = report_page.facts(f"graspforce {gf.__version__}")
        text = "\n\n".join([report_page.table(HEAD, rows), report_page.table(TIMES_HEAD, times)])
        report_page.save(given.save, "Measures of grasps", __doc__, facts, text)


if __name__ == "__main__":
    main()

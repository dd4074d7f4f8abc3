"""Measures of grasps against an independent hull, and their times: `python -m benchmarks.grasp_quality --grasps 200`.

ε of Ferrari and Canny of random closed grasps, with inner pyramids, against two independent computations. With Σ f_n ≤ 1 N
("sum"), Qhull computes the hull of zero and all pyramid edges at once, of three to five point and soft contacts with eight
facets; ε uses the hull of a few support points. With f_n ≤ 1 N at each contact ("each"), the wrenches are a Minkowski sum of
the pyramids of three point contacts with four facets, at about equal angles around the object. Each of its facets has a normal
that is orthogonal to five edges of these pyramids. The independent ε is the smallest support in all such directions, without a
hull. Errors are relative to the independent ε. Of the open grasps drawn, a quarter as many as closed ones are compared.

Times are of one call each, of `ferrari_canny` for random grasps of five contacts, closed and open, and of `wrench_volume`.
"""

from __future__ import annotations

import itertools
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
from graspforce.core.arrays import Array

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.contact_strategies import contacts_around_object

HEAD = ("limit", "closed grasps", "open grasps", "largest error", "open grasps with ε > 0")
TIMES_HEAD = ("measure", "calls", "median (s)", "longest (s)")
FACETS: dict[NormalLimit, int] = {"sum": 8, "each": 4}
SMALLEST = 1e-9  # ε of a closed grasp, N
INDEPENDENT = 1e-6  # volume of five unit edges below which they count as dependent


def edge_wrenches(contacts: ContactSet, facets: int) -> list[Array]:
    """Return (m, 6) the wrenches of the pyramid edges of each contact for f_n = 1 N, moments divided by the length.

    Args:
        contacts: the contacts.
        facets: facets of the inner pyramids.
    """
    L, bases = characteristic_length(contacts), normalised_grasp_matrix(contacts).reshape(6, -1, 4)
    pairs = zip(contacts.mu.tolist(), contacts.gamma.tolist(), strict=True)
    rays = [friction.pyramid_rays(facets, "inner", *pair) * (1.0, 1.0, 1.0, 1.0 / L) for pair in pairs]
    return [edges @ bases[:, i].T for i, edges in enumerate(rays)]


def radius_of_sum(contacts: ContactSet) -> float:
    """Return ε for Σ f_n ≤ 1 N from the hull of all points; negative for open grasps.

    Args:
        contacts: the contacts.
    """
    return inscribed_ball_radius(np.vstack([np.zeros((1, 6)), *edge_wrenches(contacts, FACETS["sum"])]))


def radius_of_each(contacts: ContactSet) -> float:
    """Return ε for f_n ≤ 1 N at each contact: the smallest support in all directions orthogonal to five edges.

    Args:
        contacts: point contacts.
    """
    vertices = [np.vstack([np.zeros(6), edges]) for edges in edge_wrenches(contacts, FACETS["each"])]
    edges = np.vstack([np.vstack([points[1:], points[1:] - np.roll(points[1:], 1, axis=0)]) for points in vertices])
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    fives = edges[np.array(list(itertools.combinations(range(len(edges)), 5)))]
    minors = [(-1) ** r * np.linalg.det(np.delete(fives, r, axis=2)) for r in range(6)]  # the cross product in six dimensions
    normals = np.stack(minors, axis=1)
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > INDEPENDENT] / lengths[lengths > INDEPENDENT, None]
    heights = [normals @ points.T for points in vertices]
    upper, lower = (sum(choose(h, axis=1) for h in heights) for choose in (np.max, np.min))
    return float(min(np.min(upper), -np.max(lower)))


def three_contacts(rng: np.random.Generator) -> ContactSet:
    """Return point contacts at about equal angles around an object of 5 cm; most such grasps are closed.

    Args:
        rng: random numbers.
    """
    angles = 2.0 * np.pi / 3.0 * np.arange(3) + rng.uniform(-0.5, 0.5, size=3)
    outward = np.column_stack([np.cos(angles), np.sin(angles), rng.uniform(-0.3, 0.3, size=3)])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    tangents, friction_coefficients = rng.normal(size=(3, 3)), rng.uniform(0.4, 1.0, size=3)
    return ContactSet.stack(
        [
            gf.Contact(position=0.05 * n, normal=-n, tangent=t, friction=mu)
            for n, t, mu in zip(outward, tangents, friction_coefficients, strict=True)
        ]
    )


def compare(limit: NormalLimit, count: int) -> tuple[str, ...]:
    """Return the row of a limit: numbers of grasps and the largest error.

    Args:
        limit: "sum" or "each".
        count: number of closed grasps.
    """
    rng, opened, wrong, is_sum = np.random.default_rng(17), 0, 0, limit == "sum"
    errors: list[float] = []
    while len(errors) < count:
        some = rng.integers(3, 6)
        contacts = contacts_around_object(rng, int(some), models=("point", "soft")) if is_sum else three_contacts(rng)
        found = wrench_ball(contacts, FACETS[limit], limit).radius
        if found <= SMALLEST and opened >= max(count // 4, 1):
            continue
        expected = radius_of_sum(contacts) if is_sum else radius_of_each(contacts)
        if expected > SMALLEST:
            errors.append(abs(found - expected) / expected)
        else:
            opened += 1
            wrong += found > SMALLEST
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

"""Distances between the links of found grasps by Pinocchio's reader of the shapes: `python -m benchmarks.link_gaps`.

The search uses its own collision model. This check builds another one from the URDF, so that an error of the search is seen.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.report_page import parser
from graspforce import GraspForceError, Hand
from graspforce.core.arrays import Array
from graspforce.geometry import Box, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.hand.descriptions.description import robot_data_folders, shipped_hands

OBJECTS = {"ball of 60 mm": Body.solid(Sphere(0.03), 0.05), "cube of 50 mm": Body.solid(Box([0.05, 0.05, 0.05]), 0.1)}
SEEDS = 8


@dataclass(frozen=True)
class Row:
    """The grasps of one hand.

    Attributes:
        hand: name of the hand.
        what: the object.
        found: number of grasps found.
        least: least distance of two links in these grasps, m; infinite without a grasp.
        pair: the two shapes.
        seconds: median time of a search, s.
    """

    hand: str
    what: str
    found: int
    least: float
    pair: str
    seconds: float


def least_link_distance(hand: Hand, q: Array) -> tuple[float, str]:
    """Return the least distance of two links that may not touch, m, and their shapes' names.

    Links may touch if a joint connects them, or a chain of joints with links without shapes in between; and a link and an
    ancestor may if they overlap in the neutral posture.
    """
    text, packages = hand.urdf_path.read_text(), [str(folder.parent) for folder in robot_data_folders()]
    model = pin.buildModelFromXML(text)
    shapes = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION, package_dirs=packages)
    carriers = [each.parentJoint for each in shapes.geometryObjects]
    above = {joint: _carrier_above(model, joint, set(carriers)) for joint in set(carriers)}
    for i, a in enumerate(carriers):
        for j, b in enumerate(carriers[:i]):
            if a != b and above[a] != b and above[b] != a:
                shapes.addCollisionPair(pin.CollisionPair(j, i))
    data, placed = model.createData(), shapes.createData()
    pin.computeDistances(model, data, shapes, placed, hand.T @ hand.neutral + hand.q0)
    for index, pair in reversed(list(enumerate(shapes.collisionPairs))):
        a, b = carriers[pair.first], carriers[pair.second]
        is_chain = a in list(model.supports[b]) or b in list(model.supports[a])
        if is_chain and placed.distanceResults[index].min_distance < 0.0:
            shapes.removeCollisionPair(pin.CollisionPair(pair.first, pair.second))
    placed = shapes.createData()
    pin.computeDistances(model, data, shapes, placed, hand.T @ q + hand.q0)
    distances = [result.min_distance for result in placed.distanceResults]
    pair = shapes.collisionPairs[int(np.argmin(distances))]
    names = " and ".join(shapes.geometryObjects[index].name for index in (pair.first, pair.second))
    return float(min(distances)), names


def measure_hand(name: str, what: str) -> dict[str, Any]:
    """Search grasps of a hand, and measure the distances between its links.

    Args:
        name: name of a shipped hand.
        what: one of `OBJECTS`.
    """
    hand, distances, times = Hand.load(name), [], []
    for seed in range(SEEDS):
        start = time.perf_counter()
        try:
            grasp = find_grasp(hand, OBJECTS[what], friction=0.7, gravity_H=(0.0, 0.0, -9.81), seed=seed)
        except GraspForceError:
            times.append(time.perf_counter() - start)
            continue
        times.append(time.perf_counter() - start)
        distances.append(least_link_distance(hand, grasp.q))
    least, pair = min(distances, default=(None, ""))
    return {"found": len(distances), "least": least, "pair": pair, "seconds": float(np.median(times))}


def section(results: dict[tuple[Any, ...], dict[str, Any]]) -> list[str]:
    """Return the section of a page with the distances of several hands.

    Args:
        results: by hand and object, as `measure_hand` returns them.
    """
    rows = [
        Row(*task, result["found"], np.inf if result["least"] is None else result["least"], result["pair"], result["seconds"])
        for task, result in results.items()
        if "found" in result
    ]
    text = markdown(rows).split("\n", 4)[-1].strip()
    about = (
        f"Grasps by `find_grasp` for {SEEDS} seeds, palm up, friction 0.7. The least distance of two links that no joint "
        "connects, by Pinocchio's reader of the URDF's collision shapes, which the search does not use."
    )
    return ["## Distances between links", about, text] if rows else []


def measure() -> Iterator[Row]:
    """Search grasps of all shipped hands, and measure the distances between their links."""
    for name in shipped_hands():
        for what in OBJECTS:
            result = measure_hand(name, what)
            least = np.inf if result["least"] is None else result["least"]
            yield Row(name, what, result["found"], least, result["pair"], result["seconds"])


def markdown(rows: list[Row]) -> str:
    """Return the rows as a Markdown page."""
    lines = [
        "# Distances between the links of found grasps",
        "",
        f"`python -m benchmarks.link_gaps --save FILE`: grasps by `find_grasp` for {SEEDS} seeds, palm up, friction 0.7.",
        "The least distance of two links that no joint connects, by Pinocchio's reader of the URDF's collision shapes.",
        "",
        f"| hand | object | grasps found of {SEEDS} | least distance, mm | shapes | median search, s |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        least = f"{1e3 * row.least:.2f}" if np.isfinite(row.least) else "–"
        lines.append(f"| {row.hand} | {row.what} | {row.found} | {least} | {row.pair or '–'} | {row.seconds:.1f} |")
    found, count = sum(row.found for row in rows), len(rows) * SEEDS
    overlaps = sum(row.least < 0.0 for row in rows)
    lines += ["", f"{found} of {count} searches found a grasp. Rows with an overlap: {overlaps}."]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print, and write the page."""
    options = parser("link_gaps", __doc__).parse_args()
    rows = []
    for row in measure():
        rows.append(row)
        print(f"{row.hand}, {row.what}: {row.found} of {SEEDS}, least {1e3 * row.least:.2f} mm ({row.pair})", flush=True)
    if options.save:
        options.save.write_text(markdown(rows))


def _carrier_above(model: pin.Model, joint: int, carriers: set[int]) -> int:
    """Return the nearest ancestor of a joint whose link has shapes, or the base; -1 above the base."""
    if joint == 0:
        return -1
    joint = model.parents[joint]
    while joint > 0 and joint not in carriers:
        joint = model.parents[joint]
    return int(joint)


if __name__ == "__main__":
    main()

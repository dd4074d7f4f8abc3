"""Grasp search: objects of the IST set and generated meshes, with grasp classes, within 3 s of processor time.

Each case is one call of `find_grasp`, or of `find_link_grasp` for the classes power and lateral: seed 0, an object of 50 g,
μ = 0.6, and a torsional friction of 4 mm for tips without pads. The search is told to end before the 3 s are over, and ends
after the candidate that it then tries. Cases run in a random order, so that a part of them covers all hands and objects.

Three checks use no code of the search. MuJoCo finds no penetration above 0.1 mm between links, or between the object and links
other than those of touching fingertips. The contacts are force-closed by a linear program over pyramids of 16 edges inside the
friction cones, or 114 edges inside the ellipsoids of soft contacts. A second one finds forces within the motors' limits that
bear the weight in six directions.

The set *any* is the search without a class. Palmar pinch, parallel extension and lateral grasp are those of a thumb; the hand
four_finger has none. A writing tripod applies to cylinders. Other programs shared the processor, so that times are upper
bounds.

Several machines run parts of the cases with `--slice K/N --records DIR`; `--merge FILE …` then adds their files to the records.
"""

from __future__ import annotations

import argparse
import random
import re
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks import report_page
from benchmarks.lifecycle.grasp_checks import bears_weight, is_closed, penetration
from benchmarks.lifecycle.lump_meshes import lumps
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.result_file import ResultFile, read_results
from graspforce.geometry import Cylinder, Solid
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.link_grasp import LinkGrasp
from graspforce.grasp.search import GraspClass, GraspSearchOptions, GraspSearchProgress, find_grasp, find_link_grasp
from graspforce.grasp.search.grasp_class import ENVELOPING_CLASSES
from graspforce.hand.hand import Hand
from graspforce.problems.objects import ist_objects

TITLE = "Grasp search"
SCHEMA = "graspforce/grasp_search/1"
HANDS = ("dlr_hit2", "allegro_right", "leap_right", "shadow_right", "four_finger")
CLASSES = ("any", *(each.value for each in GraspClass))
BUDGET, STOP = 3.0, 2.0  # s of processor time: allowed, and when the search is told to end
LINK_STOP = 2.8  # s: the same for the classes power and lateral, whose candidates take less time
MASS, FRICTION, PADS = 0.05, 0.6, 0.004  # kg; coefficient; m
TOLERANCE = 1e-4  # m: largest penetration
THUMB_CLASSES = ("palmar-pinch", "parallel-extension", "lateral")  # a thumb against several fingers, or the index finger's side
_KINDS = {"IST": "Objects of the IST set", "mesh": "Meshes"}


@dataclass(frozen=True, slots=True)
class SearchRecord:
    """The result of one search.

    Args:
        hand: name of the hand.
        kind: "IST" or "mesh".
        name: name of the object.
        grasp_class: name of the class, or "any".
        fault: the search's message; empty for a grasp.
        seconds: processor time, s.
        penetration: deepest penetration that MuJoCo finds, m.
        is_closed: whether the contacts are force-closed by the check.
        directions: number of directions of gravity, of six, in which the check finds forces.
    """

    hand: str
    kind: str
    name: str
    grasp_class: str
    fault: str
    seconds: float
    penetration: float = 0.0
    is_closed: bool = False
    directions: int = 0

    @property
    def case(self) -> tuple[str, str, str, str]:
        """Hand, kind and name of the object, and class."""
        return self.hand, self.kind, self.name, self.grasp_class

    @property
    def is_good(self) -> bool:
        """Whether a grasp was found in time and passes every check."""
        in_time = not self.fault and self.seconds <= BUDGET
        return in_time and self.penetration <= TOLERANCE and self.is_closed and self.directions == 6


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the section.

    Args:
        parser: the parser.
    """
    parser.add_argument("--hands", default=",".join(HANDS), help="names of the hands")
    parser.add_argument("--classes", default=",".join(CLASSES), help="names of grasp classes, or any")
    parser.add_argument("--objects", type=int, default=20, help="number of objects of each kind")
    parser.add_argument("--cases", type=int, help="largest number of cases (default: all)")
    parser.add_argument(
        "--slice", type=_slice, default=(1, 1), metavar="K/N", help="run part K of N of the cases (default: 1/1)"
    )
    parser.add_argument(
        "--merge", type=Path, nargs="*", default=[], help="add the cases of other files of results, and run none"
    )


def run(path: Path, options: argparse.Namespace) -> None:
    """Run the searches that are missing in a file of results, or add those of other files.

    Args:
        path: the file.
        options: of the section.
    """
    part, parts = options.slice
    conditions = {"mass": MASS, "friction": FRICTION, "pads": PADS, "budget": BUDGET, "stop": STOP, "link_stop": LINK_STOP}
    with ResultFile(path, SCHEMA, conditions) as results:
        known = [SearchRecord(**record) for record in results.records if isinstance(record, dict)]
        done = {each.case for each in known}
        for other in options.merge:
            merge(results, read_results(other, SCHEMA), done)
        if options.merge:
            return
        names = [(kind, k) for kind in _KINDS for k in range(options.objects)]
        cases = list(product(names, options.hands.split(","), options.classes.split(",")))
        random.Random(0).shuffle(cases)
        for (kind, k), hand, grasp_class in cases[: options.cases][part - 1 :: parts]:
            thing = _objects()[kind][k]
            if _fits(hand, thing[1], grasp_class) and (hand, kind, thing[0], grasp_class) not in done:
                record = _search(hand, kind, thing, grasp_class)
                print(record, flush=True)
                results.append(asdict(record))


def merge(results: ResultFile, other: tuple[JsonRecord, list[object]], done: set[tuple[str, str, str, str]]) -> None:
    """Add the cases of another file that are missing in a file of results.

    Args:
        results: the file of results.
        other: conditions and results of the other file, as `read_results` returns them.
        done: cases in the file of results; those that are added join.

    Raises:
        InvalidInput: the conditions differ.
    """
    conditions, records = other
    if conditions != results.conditions:
        raise InvalidInput("merge", conditions, f"a file with the conditions {results.conditions}")
    for record in records:
        if isinstance(record, dict) and (case := SearchRecord(**record).case) not in done:
            results.append(record)
            done.add(case)


def _slice(text: str) -> tuple[int, int]:
    """Return K and N of the text "K/N"."""
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise argparse.ArgumentTypeError(f"{text!r}: must be K/N with 1 ≤ K ≤ N, such as 1/4")
    return int(found[1]), int(found[2])


@cache
def _objects() -> dict[str, list[tuple[str, Solid, list[Array]]]]:
    """Return name, shape and convex layers of the objects of each kind; no layers for a shape that MuJoCo has."""
    ist: list[tuple[str, Solid, list[Array]]] = [(each.title, each.shape, []) for each in ist_objects()]
    return {"IST": ist, "mesh": [(each.name, each.mesh, each.layers) for each in lumps()]}


def _fits(hand: str, shape: Solid, grasp_class: str) -> bool:
    """Return whether a class applies to a hand and a shape."""
    if hand == "four_finger" and grasp_class in THUMB_CLASSES:
        return False
    return grasp_class != GraspClass.WRITING_TRIPOD.value or isinstance(shape, Cylinder)


def _search(hand_name: str, kind: str, thing: tuple[str, Solid, list[Array]], grasp_class: str) -> SearchRecord:
    """Search one grasp, and check it."""
    name, shape, layers = thing
    hand, body = Hand.load(hand_name), Body.solid(shape, MASS)
    start = time.process_time()

    def callback(_: GraspSearchProgress) -> bool:
        return time.process_time() - start < (LINK_STOP if grasp_class in ENVELOPING_CLASSES else STOP)

    options = GraspSearchOptions(
        grasp_class=None if grasp_class == "any" else GraspClass(grasp_class), pad_friction=PADS, callback=callback
    )
    try:
        if grasp_class in ENVELOPING_CLASSES:
            grasp: Grasp | LinkGrasp = find_link_grasp(hand, body, grasp_class, friction=FRICTION, options=options)
        else:
            grasp = find_grasp(hand, body, friction=FRICTION, options=options)
    except InvalidInput as error:
        return SearchRecord(hand_name, kind, name, grasp_class, str(error), time.process_time() - start)
    seconds = time.process_time() - start
    directions = sum(bears_weight(grasp, 9.81 * g) for g in np.vstack([np.eye(3), -np.eye(3)]))
    return SearchRecord(
        hand_name, kind, name, grasp_class, "", seconds, penetration(grasp, layers), is_closed(grasp), directions
    )


def page(path: Path) -> str:
    """Return the Markdown of the section.

    Args:
        path: the file of results.
    """
    records = [SearchRecord(**record) for record in read_results(path, SCHEMA)[1] if isinstance(record, dict)]
    hands = [hand for hand in HANDS if any(each.hand == hand for each in records)]
    sets = [name for name in CLASSES if any(each.grasp_class == name for each in records)]
    rows = []
    for hand in hands:
        for name in sets:
            chosen = [each for each in records if (each.hand, each.grasp_class) == (hand, name)]
            rows += [_row(hand, name, chosen)] if chosen else []
    rows += [_row("**all**", kind, [each for each in records if each.kind == kind]) for kind in _KINDS]
    rows.append(_row("**all**", "", records))
    head = (
        "hand",
        "class",
        "cases",
        "found in time",
        "collision-free",
        "closed",
        "bear weight",
        "all checks",
        "median s",
        "95 % s",
    )
    about = [" ".join(part.split()) for part in (__doc__ or "").split("\n\n")[1:]]
    names = {kind: "; ".join(dict.fromkeys(each.name for each in records if each.kind == kind)) for kind in _KINDS}
    objects = " ".join(f"{title}: {names[kind]}." for kind, title in _KINDS.items() if names[kind])
    legend = (
        "*found in time*: a grasp within 3 s of processor time, as a fraction of all cases. *collision-free*, *closed*, *bear "
        "weight*: fractions of all grasps found, also of later ones. *all checks*: found in time and passed every check, as a "
        "fraction of all cases. The times are of all cases."
    )
    return "\n\n".join(
        [*about, objects, report_page.table(head, rows, text_columns=2), legend, "### Failures", _failures(records)]
    )


def _row(hand: str, name: str, records: Sequence[SearchRecord]) -> tuple[str, ...]:
    """Return the cells of a row."""
    found = [each for each in records if not each.fault]

    def share(count: int, whole: int) -> str:
        return f"{100.0 * count / whole:.0f} % ({count} of {whole})" if whole else ""

    times = np.array([each.seconds for each in records])
    return (
        *(hand, name, str(len(records)), share(sum(each.seconds <= BUDGET for each in found), len(records))),
        share(sum(each.penetration <= TOLERANCE for each in found), len(found)),
        share(sum(each.is_closed for each in found), len(found)),
        share(sum(each.directions == 6 for each in found), len(found)),
        share(sum(each.is_good for each in records), len(records)),
        *((f"{np.median(times):.2f}", f"{np.percentile(times, 95):.2f}") if len(records) else ("", "")),
    )


def _failures(records: Sequence[SearchRecord]) -> str:
    """Return a list of the reasons why cases failed, each with its number and the cases of hand and class."""
    cases: dict[str, Counter[str]] = {}
    for each in records:
        for reason in _reasons(each):
            cases.setdefault(reason, Counter())[f"{each.hand} {each.grasp_class}"] += 1
    ordered = sorted(cases.items(), key=lambda item: -item[1].total())
    lines = [f"- {found.total()} × {why}: {', '.join(f'{k} ({n})' for k, n in found.most_common())}" for why, found in ordered]
    return "\n".join(lines) or "None."


def _reasons(record: SearchRecord) -> list[str]:
    """Return why a case failed, without the figures of the single case; empty if it did not."""
    if record.fault:
        return [re.sub(r"\d+(\.\d+)?", "…", "best candidate: " + record.fault.rpartition("best candidate: ")[2])]
    checks = {
        "a grasp after more than 3 s": record.seconds > BUDGET,
        "penetration": record.penetration > TOLERANCE,
        "no force closure": not record.is_closed,
        "weight not borne in all directions": record.directions < 6,
    }
    return [reason for reason, is_failed in checks.items() if is_failed]

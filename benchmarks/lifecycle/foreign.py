"""Postures from elsewhere: grasps of a ball and a cylinder, perturbed and given to `Grasp.from_posture`.

Each posture is a found grasp whose joints are changed by normally distributed angles of 0.03 rad, and whose object is moved by
normally distributed distances of 1 mm along each axis. Fingertips up to 5 mm off the surface may be moved onto it. A repaired
posture is checked: MuJoCo finds no penetration above 0.1 mm, and a linear program finds it force-closed. A posture that cannot
be repaired must be refused with a reason.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks import report_page
from benchmarks.lifecycle.grasp_checks import is_closed, penetration
from graspforce.core.errors import InvalidInput
from graspforce.core.result_file import ResultFile, read_results
from graspforce.geometry import Cylinder, Solid, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.hand.hand import Hand

TITLE = "Postures from elsewhere"
SCHEMA = "graspforce/foreign_postures/1"
HANDS = ("dlr_hit2", "allegro_right", "leap_right", "four_finger")
OBJECTS: dict[str, Solid] = {"ball": Sphere(0.03), "cylinder": Cylinder(0.025, 0.08)}
MASS, ANGLE, DISTANCE = 0.05, 0.03, 0.001  # kg, rad, m
TOLERANCE = 1e-4  # m: largest penetration
_REASONS = {  # of refusals: description, and a part of the message
    "a tip is too far from the object": "from the object, more than",
    "a tip is too deep inside the object": "inside the object, more than",
    "the repair moves a tip too far": " moves ",
    "a tip cannot reach the surface": " stays ",
    "two links, or a link and the object, overlap": " overlap by ",
    "a last link passes through the object": " deep through the object",
    "a tip touches an edge or a corner": " an edge or a corner ",
    "the contacts are not force-closed": "not force-closed",
}


@dataclass(frozen=True, slots=True)
class PostureRecord:
    """The result of one posture.

    Args:
        hand: name of the hand.
        name: name of the object.
        fault: the reason of a refusal; empty for a repaired posture.
        moved: largest change of a joint by the repair, rad.
        penetration: deepest penetration that MuJoCo finds, m.
        is_closed: whether the check finds the contacts force-closed.
        contact_error: largest distance of a fingertip from its contact, m.
    """

    hand: str
    name: str
    fault: str
    moved: float = 0.0
    penetration: float = 0.0
    is_closed: bool = False
    contact_error: float = 0.0


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the section.

    Args:
        parser: the parser.
    """
    parser.add_argument("--postures", type=int, default=25, help="number of postures of each hand and object (default: 25)")


def run(path: Path, options: argparse.Namespace) -> None:
    """Run the pairs of hand and object that are missing in a file of results.

    Args:
        path: the file.
        options: of the section.
    """
    with ResultFile(path, SCHEMA, {"postures": options.postures, "angle": ANGLE, "distance": DISTANCE}) as results:
        known = [PostureRecord(**record) for record in results.records if isinstance(record, dict)]
        for hand in HANDS:
            for name, shape in OBJECTS.items():
                count = sum((each.hand, each.name) == (hand, name) for each in known)
                if count < options.postures:
                    grasp, rng = find_grasp(Hand.load(hand), Body.solid(shape, MASS)), np.random.default_rng(0)
                    records = [_repair(grasp, name, rng) for _ in range(options.postures)]
                    for record in records[count:]:
                        results.append(asdict(record))
                    print(f"{hand}, {name}: {sum(not each.fault for each in records)} repaired", flush=True)


def _repair(grasp: Grasp, name: str, rng: np.random.Generator) -> PostureRecord:
    """Perturb a grasp, repair it, and check it."""
    hand = grasp.hand
    q = np.clip(grasp.q + rng.normal(0.0, ANGLE, hand.n), hand.q_lower, hand.q_upper)
    p_HO = grasp.p_HO + rng.normal(0.0, DISTANCE, 3)
    try:
        found = Grasp.from_posture(hand, grasp.body, q, p_HO, grasp.R_HO)
    except InvalidInput as error:
        return PostureRecord(hand.name, name, str(error))
    moved, error = float(np.abs(found.q - q).max()), float(found.contact_errors().max())
    return PostureRecord(hand.name, name, "", moved, penetration(found), is_closed(found), error)


def page(path: Path) -> str:
    """Return the Markdown of the section.

    Args:
        path: the file of results.
    """
    records = [PostureRecord(**record) for record in read_results(path, SCHEMA)[1] if isinstance(record, dict)]
    rows = []
    for hand in (*HANDS, "**all**"):
        chosen = [each for each in records if hand in (each.hand, "**all**")]
        repaired = [each for each in chosen if not each.fault]
        if not chosen:
            continue
        good = [each for each in repaired if each.penetration <= TOLERANCE and each.is_closed]
        rows.append(
            (
                *(hand, str(len(chosen)), str(len(repaired)), str(len(chosen) - len(repaired)), str(len(good))),
                f"{max((each.moved for each in repaired), default=0.0):.3f}",
                f"{1e9 * max((each.contact_error for each in repaired), default=0.0):.2g}",
            )
        )
    head = ("hand", "postures", "repaired", "refused", "repaired, pass both checks", "largest joint change rad", "tip error nm")
    about = [" ".join(part.split()) for part in (__doc__ or "").split("\n\n")[1:]]
    refused = [each.fault for each in records if each.fault]
    reasons = [(text, sum(part in fault for fault in refused)) for text, part in _REASONS.items()]
    reasons.append(("other", sum(not any(part in fault for part in _REASONS.values()) for fault in refused)))
    lines = "\n".join(f"- {count} × {text}" for text, count in sorted(reasons, key=lambda item: -item[1]) if count)
    note = "A refused posture may have several reasons."
    return "\n\n".join([*about, report_page.table(head, rows), "### Reasons of refusals", note, lines or "None."])

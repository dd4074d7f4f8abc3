"""Full cycles: approach, close, squeeze, lift 50 mm, move, place, release, retract, in MuJoCo.

The object stands on a table, up to 10 mm and 10° from where the controller expects it. An ideal arm moves the hand's base.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np

from benchmarks import report_page
from graspforce.cli.controllers import REAL_ASSUMPTIONS, Assumptions
from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.core.errors import GraspForceError, InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.result_file import ResultFile, read_results
from graspforce.geometry import Box, Cylinder, Solid, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.simulation import World
from graspforce.simulation.cycle.cycle_outcome import CycleOutcome, judge_cycle
from graspforce.simulation.cycle.episode import PoseError, run_episode
from graspforce.simulation.cycle.plan_cycle import find_cycle, plan_cycle
from graspforce.simulation.cycle.table_scene import TableScene

TITLE = "Full cycle"
SCHEMA = "graspforce/full_cycle/1"
HANDS = ("dlr_hit2", "allegro_right", "dclaw", "shadow_right", "leap_right")
MASS, FRICTION = 0.1, 0.6  # kg, and coefficient
OBJECTS: dict[str, Solid] = {
    "cylinder 50 × 80": Cylinder(0.025, 0.08),
    "box 50 × 50 × 80": Box((0.05, 0.05, 0.08)),
    "ball 60": Sphere(0.03),
    "box 40 × 50 × 100": Box((0.04, 0.05, 0.1)),
    "can 60 × 60": Cylinder(0.03, 0.06),
    "cylinder 40 × 100": Cylinder(0.02, 0.1),
    "ball 70": Sphere(0.035),
    "cube 50": Box((0.05, 0.05, 0.05)),
    "can 50 × 50": Cylinder(0.025, 0.05),
    "box 60 × 40 × 80": Box((0.06, 0.04, 0.08)),
    "cylinder 60 × 100": Cylinder(0.03, 0.1),
    "box 45 × 45 × 120": Box((0.045, 0.045, 0.12)),
    "ball 50": Sphere(0.025),
    "cylinder 45 × 70": Cylinder(0.0225, 0.07),
    "box 55 × 55 × 60": Box((0.055, 0.055, 0.06)),
    "can 66 × 90": Cylinder(0.033, 0.09),
    "egg 50 × 70": Superquadric((0.025, 0.025, 0.035), (1.0, 1.0)),
    "cube 60": Box((0.06, 0.06, 0.06)),
    "cylinder 55 × 60": Cylinder(0.0275, 0.06),
    "box 35 × 60 × 90": Box((0.035, 0.06, 0.09)),
}
WORLDS = ("ideal", "real")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the section.

    Args:
        parser: the parser.
    """
    parser.add_argument("--hands", default=",".join(HANDS), help="names of the hands")
    parser.add_argument("--objects", type=int, default=len(OBJECTS), help="number of objects")
    parser.add_argument("--worlds", nargs="*", default=WORLDS, choices=WORLDS, help="kinds of worlds (default: all)")
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds of each world (default: 5)")


def run(path: Path, options: argparse.Namespace) -> None:
    """Run the episodes that are missing in a file of results.

    Args:
        path: the file.
        options: of the section.
    """
    with ResultFile(path, SCHEMA, {"mass": MASS, "friction": FRICTION}) as results:
        known = [record for record in results.records if isinstance(record, dict)]
        plans: dict[tuple[str, str], tuple[TableScene, CyclePlan] | None] = {}
        done = {(each["hand"], each["object"], each["world"], each["seed"]) for each in known if each["kind"] == "episode"}
        scenes = {(each["hand"], each["object"]): each for each in known if each["kind"] == "scene"}
        for seed in range(options.seeds):
            for name in list(OBJECTS)[: options.objects]:
                for hand in options.hands.split(","):
                    for world in options.worlds:
                        if (hand, name, world, seed) in done:
                            continue
                        if (hand, name) not in plans:
                            record = scenes.get((hand, name)) or find_scene(hand, name)
                            if (hand, name) not in scenes:
                                results.append(record)
                            plans[hand, name] = planned_cycle(hand, record)
                        found = plans[hand, name]
                        if found is not None:
                            results.append(_episode(found, hand, name, world, seed))


def find_scene(hand: str, name: str) -> JsonRecord:
    """Search the grasp of an object on a table, and return its record; with a fault if no grasp allows a cycle.

    Args:
        hand: name of the hand.
        name: one of `OBJECTS`.
    """
    start = time.perf_counter()
    print(f"{hand}: searching a grasp of {name}", flush=True)
    record: JsonRecord = {"kind": "scene", "hand": hand, "object": name, "fault": ""}
    try:
        control = REAL_ASSUMPTIONS.settings(GRAVITY_PALM_UP)
        scene, _ = find_cycle(Hand.load(hand), Body.solid(OBJECTS[name], MASS), friction=FRICTION, control=control)
    except InvalidInput as error:
        return {**record, "fault": str(error), "seconds": time.perf_counter() - start}
    found = {
        "grasp": scene.grasp.to_dict(),
        "gravity": scene.gravity_H.tolist(),
        "height": scene.height,
        "clearance": scene.clearance,
    }
    return {**record, **found, "seconds": time.perf_counter() - start}


def planned_cycle(hand: str, record: JsonRecord) -> tuple[TableScene, CyclePlan] | None:
    """Return the scene of a record with its plan; None if no grasp was found.

    Args:
        hand: name of the hand.
        record: of `find_scene`.
    """
    if record["fault"]:
        return None
    grasp = Grasp.from_dict(record["grasp"], Hand.load(hand))
    scene = TableScene(grasp, np.array(record["gravity"]), record["height"], record["clearance"])
    return scene, plan_cycle(scene)


def _episode(found: tuple[TableScene, CyclePlan], hand: str, name: str, kind: str, seed: int) -> JsonRecord:
    """Run an episode, and after a failure the controller with full knowledge, and return the record."""
    scene, plan = found
    is_real = kind == "real"
    world = World.real(seed, float(scene.grasp.hand.torque_upper.min())) if is_real else World(seed=seed)
    control = (REAL_ASSUMPTIONS if is_real else Assumptions()).settings(scene.gravity_H, world.sensors.rate)
    start = time.perf_counter()

    def outcome(knows_everything: bool) -> CycleOutcome | str:
        try:
            recording = run_episode(scene, plan, world, PoseError(), control, knows_everything=knows_everything)
        except GraspForceError as error:
            return str(error)
        return judge_cycle(recording)

    measured = outcome(False)
    succeeded = isinstance(measured, CycleOutcome) and measured.is_success
    exact = None if succeeded else outcome(True)
    seconds = time.perf_counter() - start
    print(f"{hand}, {name}, {kind} {seed}: {_status(measured)}, {seconds:.0f} s", flush=True)
    return {
        "kind": "episode",
        "hand": hand,
        "object": name,
        "world": kind,
        "seed": seed,
        "measured": _to_record(measured),
        "exact": None if exact is None else _to_record(exact),
        "seconds": seconds,
    }


def _status(outcome: CycleOutcome | str) -> str:
    return outcome if isinstance(outcome, str) else f"{outcome.status} {outcome.message}".strip()


def _to_record(outcome: CycleOutcome | str) -> JsonRecord:
    return {"error": outcome} if isinstance(outcome, str) else outcome.to_dict()


# ── page ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def page(path: Path) -> str:
    """Return the Markdown of the section.

    Args:
        path: the file of results.
    """
    records = [each for each in read_results(path, SCHEMA)[1] if isinstance(each, dict)]
    episodes = [each for each in records if each["kind"] == "episode"]
    scenes = [each for each in records if each["kind"] == "scene"]
    about = [" ".join(part.split()) for part in (__doc__ or "").split("\n\n")[1:]]
    head = ("world", "hand", "episodes", "done", "of possible", "moved mm", "turned °", "peak / planned", "worst peak")
    rows = []
    for kind in WORLDS:
        names = list(dict.fromkeys(each["hand"] for each in episodes))
        for hand in (*names, ""):
            chosen = [each for each in episodes if each["world"] == kind and hand in ("", each["hand"])]
            if chosen:
                rows.append((kind, hand or "**all**", *_figures(chosen)))
    explanation = (
        "*done*: lifted, moved, placed upright within 15 mm of the goal and released, judged by the true motion. "
        "*of possible*: the same as a fraction of the episodes that a controller with full knowledge completes; it runs after "
        "failures only. *moved*, *turned*: motion of the object before the squeeze, median. *peak / planned*: largest true "
        "normal force over the largest planned one, median of the episodes that are done; *worst peak*: its largest value."
    )
    objects = ", ".join(dict.fromkeys(each["object"] for each in scenes))
    missing = [f"{each['hand']} and {each['object']}" for each in scenes if each["fault"]]
    tried = len(scenes)
    parts = [
        *about,
        f"{tried - len(missing)} of {tried} pairs of hand and object have a grasp over the table that allows a cycle"
        + (f"; none for {', '.join(missing)}." if missing else "."),
        f"Objects of {1e3 * MASS:.0f} g with μ = {FRICTION:g}: {objects} (mm).",
        report_page.table(head, rows, text_columns=2),
        explanation,
        "### Failures",
        _failures(episodes),
    ]
    return "\n\n".join(parts)


def _figures(episodes: list[JsonRecord]) -> tuple[str, ...]:
    """Return the cells of a row."""
    outcomes = [CycleOutcome.from_dict(each["measured"]) for each in episodes if "error" not in each["measured"]]
    done = [each for each in outcomes if each.is_success]
    possible = [each for each in episodes if _is_done(each["measured"]) or _is_done(each["exact"])]
    moved = [1e3 * each.moved_before_squeeze for each in outcomes if not math.isnan(each.moved_before_squeeze)]
    turned = [math.degrees(each.turned_before_squeeze) for each in outcomes if not math.isnan(each.turned_before_squeeze)]
    peaks = [each.peak_ratio for each in done]
    share = f"{100.0 * len(done) / len(possible):.0f} %" if possible else ""
    cells = [_median(moved, 2), _median(turned, 1), _median(peaks, 2), f"{max(peaks):.2f}" if peaks else ""]
    return (str(len(episodes)), str(len(done)), share, *cells)


def _median(values: list[float], digits: int) -> str:
    return f"{float(np.median(values)):.{digits}f}" if values else ""


def _is_done(record: JsonRecord | None) -> bool:
    return record is not None and record.get("status") == "done"


def _failures(episodes: list[JsonRecord]) -> str:
    """Return the table of all failures."""
    head = ("hand", "object", "world", "seed", "controller from measurements", "full knowledge")
    rows = [
        (each["hand"], each["object"], each["world"], str(each["seed"]), _text(each["measured"]), _text(each["exact"]))
        for each in episodes
        if not _is_done(each["measured"])
    ]
    return report_page.table(head, rows, text_columns=len(head)) if rows else "None."


def _text(record: JsonRecord | None) -> str:
    if record is None:
        return ""
    if "error" in record:
        return str(record["error"])
    return f"{record['status']}: {record['message']}" if record["message"] else str(record["status"])

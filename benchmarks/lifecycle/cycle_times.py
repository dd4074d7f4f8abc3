"""Times of pick and place: fixed phase times against the fastest motions.

Each pair of hand and object runs the same cycle twice in the same world: with the fixed times of approach, lift, move and
place, and with those of `fastest_cycle`, within the hand's torques, forces and joint rates and the limits of the base.

Close, squeeze and release are guarded: contact ends them, at the speeds and times of `PhaseSettings`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks import report_page
from benchmarks.lifecycle.full_cycle import FRICTION, MASS, find_scene, planned_cycle
from graspforce.cli.controllers import REAL_ASSUMPTIONS, Assumptions
from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.core.json_text import JsonRecord
from graspforce.core.result_file import ResultFile, read_results
from graspforce.planning.failure import PlanFailure
from graspforce.planning.fastest_cycle import CycleLimits, fastest_cycle
from graspforce.simulation import World
from graspforce.simulation.cycle.cycle_outcome import judge_cycle
from graspforce.simulation.cycle.episode import PoseError, run_episode
from graspforce.simulation.cycle.table_scene import TableScene

TITLE = "Minimum-time pick and place"
SCHEMA = "graspforce/cycle_times/1"
HANDS = ("dlr_hit2", "allegro_right", "dclaw")
OBJECTS = ("cylinder 50 × 80", "box 50 × 50 × 80", "ball 60")
WORLDS = ("ideal", "real")
PHASES = ("approach", "lift", "move", "place")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the section.

    Args:
        parser: the parser.
    """
    parser.add_argument("--hands", default=",".join(HANDS), help="names of the hands")
    parser.add_argument("--objects", type=int, default=len(OBJECTS), help="number of objects")
    parser.add_argument("--worlds", default=",".join(WORLDS), help="ideal, real or both")


def run(path: Path, options: argparse.Namespace) -> None:
    """Run the cycles that are missing in a file of results.

    Args:
        path: the file.
        options: of the section.
    """
    with ResultFile(path, SCHEMA, {"mass": MASS, "friction": FRICTION}) as results:
        done = {(each["hand"], each["object"], each["world"]) for each in results.records if isinstance(each, dict)}
        for name in OBJECTS[: options.objects]:
            for hand in options.hands.split(","):
                missing = [world for world in options.worlds.split(",") if (hand, name, world) not in done]
                found = planned_cycle(hand, find_scene(hand, name)) if missing else None
                for world in missing if found is not None else ():
                    assert found is not None
                    results.append({"hand": hand, "object": name, "world": world, **_compare(found, world)})


def _compare(found: tuple[TableScene, CyclePlan], kind: str) -> JsonRecord:
    """Return the results of both cycles in a world."""
    scene, plan = found
    is_real = kind == "real"
    world = World.real(0, float(scene.grasp.hand.torque_upper.min())) if is_real else World(seed=0)
    control = (REAL_ASSUMPTIONS if is_real else Assumptions()).settings(scene.gravity_H, world.sensors.rate)
    fast = fastest_cycle(plan, control, CycleLimits())
    if isinstance(fast, PlanFailure):
        return {"fault": fast.reason}
    record: JsonRecord = {"fault": ""}
    for name, each in (("fixed", plan), ("fastest", fast)):
        recording = run_episode(scene, each, world, PoseError(), control)
        outcome = judge_cycle(recording)
        times = {part.phase: part.end - part.start for part in recording.records}
        print(f"{scene.grasp.hand.name}, {kind}, {name}: {outcome.status}, {sum(times.values()):.2f} s", flush=True)
        record[name] = {"outcome": outcome.to_dict(), "times": times}
    return record


# ── page ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def page(path: Path) -> str:
    """Return the Markdown of the section.

    Args:
        path: the file of results.
    """
    records = [each for each in read_results(path, SCHEMA)[1] if isinstance(each, dict)]
    about = [" ".join(part.split()) for part in (__doc__ or "").split("\n\n")[1:]]
    limits = CycleLimits()
    head = ("world", "hand", "object", *PHASES, "all phases", "faster by", "peak / planned", "outcome")
    text = (
        f"The base: at most {limits.speed:g} m/s, {limits.acceleration:g} m/s² and {limits.jerk:g} m/s³; lift 50 mm, "
        f"move 50 mm. Joints in the approach: at most {limits.joint_jerk:g} rad/s³. {100 * limits.torque_reserve:g} % of the "
        f"torques and the controller's reserves of friction and mass are left. Objects of {1e3 * MASS:.0f} g with "
        f"μ = {FRICTION:g}."
    )
    note = (
        "Times in s, fixed → fastest, with the settling times of the phases; *all phases* contains close, squeeze, release and "
        "retract, too. *peak / planned*: largest true normal force over the largest planned one."
    )
    return "\n\n".join([*about, text, report_page.table(head, [_row(each) for each in records], text_columns=3), note])


def _row(record: JsonRecord) -> tuple[str, ...]:
    """Return the cells of a row."""
    start = (record["world"], record["hand"], record["object"])
    if record["fault"]:
        return (*start, *("" for _ in PHASES), "", "", "", record["fault"])
    both = [record["fixed"], record["fastest"]]
    cells = [_pair([each["times"].get(name, np.nan) for each in both]) for name in PHASES]
    total = [sum(each["times"].values()) for each in both]
    saved = f"{100.0 * (1.0 - total[1] / total[0]):.0f} %"
    peaks = [each["outcome"]["peak_force"] / each["outcome"]["peak_planned"] for each in both]
    outcomes = [" ".join(filter(None, (each["outcome"]["status"], each["outcome"]["message"]))) for each in both]
    same = outcomes[0] if outcomes[0] == outcomes[1] else " → ".join(outcomes)
    return (*start, *cells, _pair(total), saved, _pair(peaks), same)


def _pair(values: list[float]) -> str:
    return " → ".join(f"{value:.2f}" for value in values)

"""Hold and move objects with every hand and its drives: python -m benchmarks.every_hand [--save FILE].

Each shipped hand holds a ball, a box and a cylinder of 50 g and moves them by 5 mm at 1 Hz, out and back, in a direction that
its fingers can move. The controller knows joint positions with 0.1 mrad noise (jaws: 10 µm), the drives of the description, and
how wrong their constants may be: 30 % in stiffness and damping, and 20 % in the torque constants, which position drives do not
have. The true drives differ by random amounts up to these errors. Hands whose description has no drives run with all modes:
servos with 5 N·m/rad (jaws: 5 N/mm) and half the critical damping, and torque constants of 1 N·m/A (jaws: 1 N/A) at the joint.

"RMS" is the root mean square distance of the object from its reference after the first second, and "ratio" that to the
same hand with ideal torque drives of the same rate and delay. "Margin kept" is the fraction of steps in which the true slip
margin of every contact is at least the guaranteed one of the command, which counts the stated errors of the drives. A run is
held if the object is not dropped, no fingertip slides by more than 1 mm or is without contact for 0.1 s, and certified forces
exist.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import time
import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks import every_hand_heat, report_page
from benchmarks.mujoco_loop import EARTH, PALM_UP
from graspforce import GraspForceError, Hand
from graspforce.contact import friction
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.control.friction.friction_compensation import FrictionSettings
from graspforce.core.arrays import Array
from graspforce.estimation import SensorModel
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp, relax_idle_fingers, travel_limits
from graspforce.hand.descriptions.description import shipped_hands
from graspforce.hand.descriptions.drive_description import DRIVE_MODES
from graspforce.hand.drives.drive import Drive
from graspforce.simulation import World, constant_reference, linear_reference, make_world_plant, simulate_measured
from graspforce.simulation.campaigns.outcome import judge_run

TITLE = "Every hand and its drives"
OBJECTS = {"ball": Sphere(0.03), "box": Box([0.05, 0.05, 0.05]), "cylinder": Cylinder(0.025, 0.08)}
MASS, FRICTION = 0.05, 0.7  # kg
TRAVEL, PERIOD = 0.005, 1.0  # m, and s
TORQUE_ERROR, STIFFNESS_ERROR = 0.2, 0.3
SERVO_STIFFNESS, JAW_STIFFNESS = 5.0, 5000.0  # N·m/rad and N/m
SERVO_DAMPING = 0.5  # part of the critical damping
ENCODER_NOISE, JAW_NOISE = 1e-4, 1e-5  # rad and m
MARGIN = 0.5  # N
HEAD = ("hand", "drive", "object", "result", "RMS, mm", "ratio", "margin kept")
Task = tuple[str, str, str]  # hand, mode ("ideal" for ideal torque drives), object


def main() -> None:
    """Run all combinations, print the tables, and save the page."""
    parser = report_page.parser("every_hand", __doc__)
    parser.add_argument("--hands", nargs="*", default=shipped_hands(), choices=shipped_hands(), help="hands (default: all)")
    parser.add_argument("--objects", nargs="*", default=list(OBJECTS), choices=OBJECTS, help="objects (default: all)")
    parser.add_argument("--duration", type=float, default=10.0, help="simulated time of a run, s (default: 10)")
    parser.add_argument(
        "--results", type=Path, default=Path("out/every_hand.jsonl"), help="file of results, which is continued"
    )
    parser.add_argument("--slice", type=float, default=math.inf, help="stop after this time, s (default: run to the end)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="number of processes")
    parser.add_argument("--heat", type=int, default=50, help="number of grasps in the comparison of heat; 0 for none")
    options = parser.parse_args()
    tasks = [task for hand in options.hands for task in product([hand], drive_modes(hand), options.objects)]
    results = run_tasks(tasks, options)
    rows = [table_row(task, results) for task in tasks if task in results]
    report_page.show(TITLE, HEAD, rows, width=170)
    summary = summary_lines(results)
    print("\n".join(summary))
    parts = ["\n".join(f"- {line}" for line in summary), report_page.table(HEAD, rows, 4)]
    if options.heat > 0:
        parts += every_hand_heat.sections(options.heat)
    if options.save:
        report_page.save(options.save, TITLE, __doc__, report_page.facts(f"MuJoCo {mujoco.__version__}"), "\n\n".join(parts))


def drive_modes(hand_name: str) -> list[str]:
    """Return the drives to run a hand with: "ideal", and those of its description or all modes."""
    return ["ideal", *(DRIVE_MODES[1:] if Hand.load(hand_name).drives.is_ideal else ["described"])]


def run_tasks(tasks: list[Task], options: argparse.Namespace) -> dict[Task, dict[str, Any]]:
    """Return the results of tasks by task: those in the file, and those that are run now and appended to it.

    Args:
        tasks: hand, drive and object of each run.
        options: of the command line.
    """
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    path: Path = options.results
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    results = {tuple(line["task"]): line for line in lines if line["duration"] == options.duration}
    missing = [task for task in tasks if task not in results]
    end = time.monotonic() + options.slice
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    context = multiprocessing.get_context("spawn")
    with Progress(*columns) as progress, ProcessPoolExecutor(options.workers, context) as pool, path.open("a") as file:
        bar = progress.add_task("runs", total=len(missing))
        for start in range(0, len(missing), options.workers):
            if time.monotonic() > end:
                break
            for result in pool.map(run_task, missing[start : start + options.workers], [options.duration] * options.workers):
                results[tuple(result["task"])] = result
                file.write(json.dumps(result) + "\n")
                file.flush()
                progress.advance(bar)
    return {task: results[task] for task in tasks if task in results}


def run_task(task: Task, duration: float) -> dict[str, Any]:
    """Run one hand with one drive and object, and return a plain record of the result.

    Args:
        task: hand, drive and object.
        duration: simulated time, s.
    """
    record: dict[str, Any] = {"task": task, "duration": duration}
    try:
        return {**record, **measure(task, duration)}
    except GraspForceError as error:
        return {**record, "result": "no grasp" if "grasp" in str(error) else "error", "message": str(error)[:200]}


def measure(task: Task, duration: float) -> dict[str, Any]:
    """Return the measured values of a run.

    Args:
        task: hand, drive and object.
        duration: simulated time, s.
    """
    hand_name, mode, object_name = task
    grasp, gravity_H = find_object_grasp(hand_name, object_name), gravity(hand_name)
    if mode == "ideal":  # as often and as late as the described ones
        ideal = [Drive(rate=drive.rate, delay=drive.delay) for drive in grasp.hand.drives.joints]
        grasp = replace(grasp, hand=grasp.hand.with_drives(ideal))
    elif mode == "described":
        grasp = replace(grasp, hand=grasp.hand.with_drives([with_errors(drive) for drive in grasp.hand.drives.joints]))
    else:
        grasp = replace(grasp, hand=grasp.hand.with_drives(generic_drives(grasp, mode)))
    slowest = float(grasp.hand.drives.values("rate").min())
    rate = 1000.0 / max(1, math.ceil(1000.0 / slowest))  # Hz, a part of the plant's rate
    sensors = SensorModel(encoder_noise=JAW_NOISE if has_jaws(grasp.hand) else ENCODER_NOISE, rate=rate)
    is_servo = "position" in grasp.hand.drives.modes
    errors = {} if mode == "ideal" else {"stiffness_error": STIFFNESS_ERROR, "torque_error": 0.0 if is_servo else TORQUE_ERROR}
    world = World(sensors=sensors, seed=zlib.crc32(hand_name.encode()), **errors)
    has_losses = bool((grasp.hand.drives.values("efficiency") < 1.0).any())
    base = ControlSettings(
        gravity_H=gravity_H, slip_margin=MARGIN, period=1.0 / rate, friction=FrictionSettings() if has_losses else None
    )
    settings = ControlSettings.for_sensors(sensors, base, drives=grasp.hand.drives)
    controller = OutputFeedbackController(grasp, settings.settings, sensors)
    kept: list[bool] = []

    def compare(plant: Any, command: Any) -> None:
        contacts = plant.true_contacts()
        margin = friction.slip_margin(contacts.f, contacts.mu, contacts.gamma)
        kept.append(bool((margin >= command.guaranteed_margin).all()))

    reference = free_reference(grasp)
    run = simulate_measured(make_world_plant(world, grasp, gravity_H), controller, reference, duration, world, on_step=compare)
    outcome = judge_run(run)
    first = np.searchsorted(run.truth.t, min(1.0, 0.5 * duration))
    error = np.linalg.norm(run.motion_error[first:], axis=1)
    rms = 1e3 * float(np.sqrt(np.mean(error**2))) if len(error) else math.inf
    return {
        "result": outcome.result,
        "mode": sorted(set(grasp.hand.drives.modes))[0],
        "rms": rms,
        "kept": float(np.mean(kept)),
        "steps": len(kept),
        "message": outcome.message,
    }


@cache
def find_object_grasp(hand_name: str, object_name: str) -> Grasp:
    """Return the grasp of a hand, always the same.

    Args:
        hand_name: name of a shipped hand.
        object_name: one of `OBJECTS`.
    """
    body = Body.solid(OBJECTS[object_name], MASS)
    return relax_idle_fingers(find_grasp(Hand.load(hand_name), body, friction=FRICTION, gravity_H=gravity(hand_name)))


def gravity(hand_name: str) -> Array:
    """Return gravity in H with the palm up, m/s².

    Args:
        hand_name: name of a shipped hand.
    """
    return PALM_UP if hand_name.startswith("allegro") else EARTH


def with_errors(drive: Drive) -> Drive:
    """Return a drive with the errors of its constants that the simulated one has.

    Args:
        drive: drive of a description.
    """
    torque_error = 0.0 if drive.mode == "position" else TORQUE_ERROR
    return replace(drive, torque_error=torque_error, stiffness_error=STIFFNESS_ERROR)


def generic_drives(grasp: Grasp, mode: Any) -> list[Drive]:
    """Return drives of one mode with servos of the same stiffness and relative damping at every joint.

    Args:
        grasp: the posture at which the joints' inertias are taken.
        mode: mode of all drives.
    """
    inertias = np.diag(grasp.hand.mass_matrix(grasp.q)).tolist()  # kg·m², for jaws kg
    stiffness = JAW_STIFFNESS if has_jaws(grasp.hand) else SERVO_STIFFNESS
    return [
        with_errors(
            Drive(
                mode,
                torque_constant=1.0,
                stiffness=stiffness,
                damping=2.0 * SERVO_DAMPING * math.sqrt(stiffness * M),
            )
        )
        for M in inertias
    ]


def has_jaws(hand: Hand) -> bool:
    """Return whether a joint of a hand is prismatic, so that its units are N and m."""
    return any(link.is_prismatic for link in hand.tree().links)


def free_reference(grasp: Grasp) -> Any:
    """Return a motion of 5 mm out and back in the direction with the longest travel; rest if the object cannot move.

    Args:
        grasp: the grasp.
    """
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    try:
        limit = max(travel_limits(grasp, TRAVEL), key=lambda each: each.distance, default=None)
    except GraspForceError:
        limit = None
    if limit is None or limit.distance < 1e-3:
        return constant_reference(start)
    return linear_reference(start, limit.distance * limit.direction, PERIOD)


def table_row(task: Task, results: dict[Task, dict[str, Any]]) -> tuple[str, ...]:
    """Return the row of a run.

    Args:
        task: hand, drive and object.
        results: of all runs.
    """
    hand, mode, object_name = task
    result, ideal = results[task], results.get((hand, "ideal", object_name), {})
    label = f"{result.get('mode', '')} (described)" if mode == "described" else mode
    if "rms" not in result:
        return hand, label, object_name, f"{result['result']}: {result['message'][:60]}", "–", "–", "–"
    ratio = f"{result['rms'] / ideal['rms']:.2f}" if ideal.get("rms") else "–"
    text = result["result"] + (f": {result['message'][:50]}" if result["result"] != "held" else "")
    return hand, label, object_name, text, f"{result['rms']:.4f}", ratio, f"{100 * result['kept']:.2f} %"


def summary_lines(results: dict[Task, dict[str, Any]]) -> list[str]:
    """Return sentences with the figures over all runs.

    Args:
        results: of all runs.
    """
    runs = [result for result in results.values() if "rms" in result]
    held = [result for result in runs if result["result"] == "held"]
    lines = [f"{len(held)} of {len(results)} runs are held; {len(results) - len(runs)} have no grasp or no run."]
    driven = [(task, result) for task, result in results.items() if task[1] != "ideal" and result["result"] == "held"]
    steps = sum(result["steps"] for _, result in driven)
    if steps:
        kept = sum(result["steps"] * result["kept"] for _, result in driven) / steps
        lines.append(f"The margin is at least the guaranteed one in {100 * kept:.3f} % of {steps} steps with drives.")
    for mode in DRIVE_MODES[1:]:
        ratios = [
            result["rms"] / results[task[0], "ideal", task[2]]["rms"]
            for task, result in driven
            if result["mode"] == mode and results.get((task[0], "ideal", task[2]), {}).get("rms")
        ]
        if ratios:
            lines.append(f"{mode}: RMS is {np.median(ratios):.2f} times that of torque drives, at most {max(ratios):.2f}.")
    return lines


if __name__ == "__main__":
    main()

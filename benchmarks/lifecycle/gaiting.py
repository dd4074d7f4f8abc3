"""Finger gaiting: objects turn by 360° in hands whose fingers step.

A ball turns about each of three axes, a cylinder and a box about their own. These are along y of H; in the hand four_finger,
the cylinder's is along z and the box's along x. A finger steps while the others hold. A start grasp is searched, then the
sequence of object moves and finger steps. Each plan is executed in closed loop in MuJoCo, with the contacts changed in the
running controller. The seeds of the searches are tried in order until the turn is complete.

The controller keeps a slip margin of 0.05 N with objects of 50 g and μ = 0.8. *uncertified* counts the control steps without a
certified solution. The planned margin is the least slip margin of the fingers that neither let go nor join. *apart* is the
least distance between bodies in the plan. Rows with 0 are runs of an earlier version, whose torques could step where contacts
change.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks import report_page
from graspforce.control import ControlSettings
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.result_file import ResultFile, read_results
from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.hand.hand import Hand
from graspforce.planning.regrasp import (
    PosePath,
    RegraspController,
    RegraspPlan,
    RegraspSettings,
    RegraspTask,
    StartOptions,
    find_regrasp_start,
    plan_regrasp,
)
from graspforce.simulation import Plant, build_scene
from graspforce.simulation.loops.regrasp_loop import simulate_regrasp
from graspforce.simulation.recordings.regrasp_plots import plot_regrasp
from graspforce.simulation.recordings.regrasp_run import RegraspRun
from graspforce.view.figures import save_figures

TITLE = "Finger gaiting"
PICTURES = Path("benchmarks/results/gaiting")  # of margins and errors, one a case
SCHEMA = "graspforce/gaiting/1"
HANDS = ("four_finger", "allegro_right", "allegro_left", "leap_right")
MASS = 0.05  # kg
FRICTION = 0.8
CONTROL = ControlSettings(slip_margin=0.05)
CLEARANCE = 0.0005  # m: of links, palm and object in plans; the execution is off by hundredths of a millimetre
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
BALL_RADII = {"four_finger": 0.03, "allegro_right": 0.035, "allegro_left": 0.035, "leap_right": 0.035}  # m
BOX_WIDTHS = {
    "four_finger": 0.054,
    "allegro_right": 0.056,
    "allegro_left": 0.056,
    "leap_right": 0.056,
}  # m: narrower ones are out of reach
CYLINDER_AXES = {"four_finger": "z", "allegro_right": "y", "allegro_left": "y", "leap_right": "y"}  # in H
BOX_AXES = {"four_finger": "x", "allegro_right": "y", "allegro_left": "y", "leap_right": "y"}  # in H


@dataclass(frozen=True, slots=True)
class CaseResult:
    """The result of one case.

    Args:
        hand: name of the hand.
        task: object and axis.
        seeds: number of seeds that were tried.
        outcome: "done", or what fell short.
        turned: largest turn of a plan, degrees.
        steps: number of finger steps.
        simulated: simulated time, s.
        search: time of the successful search, s.
        distance: of the object from the goal, m.
        angle: the same, rad.
        peak_distance: largest distance from the desired place in between, m.
        margin: least planned slip margin, N.
        true_margin: least true slip margin, N.
        uncertified: number of control steps without certified forces.
        torque_step: largest change of a torque in a period, N·m.
        collisions: pairs of bodies that touched and should not.
        clearance: least distance of bodies in the plan, m.
    """

    hand: str
    task: str
    seeds: int
    outcome: str
    turned: float
    steps: int = 0
    simulated: float = 0.0
    search: float = 0.0
    distance: float = 0.0
    angle: float = 0.0
    peak_distance: float = 0.0
    margin: float = 0.0
    true_margin: float = 0.0
    uncertified: int = 0
    torque_step: float = 0.0
    collisions: int = 0
    clearance: float = 0.0


def tasks(hand: str) -> dict[str, tuple[Solid, str]]:
    """Return object and axis of each task of a hand.

    Args:
        hand: name of the hand.
    """
    radius, width = BALL_RADII[hand], BOX_WIDTHS[hand]
    balls = {f"ball, {axis}": (Sphere(radius), axis) for axis in AXES}
    cylinder, box = Cylinder(radius, 2.0 * radius), Box([width, width, 2.0 * radius])
    return {**balls, "cylinder": (cylinder, CYLINDER_AXES[hand]), "box": (box, BOX_AXES[hand])}


def orientation(axis: str) -> Array:
    """Return the axes of an object whose z axis is along an axis of H, (3, 3).

    Args:
        axis: "x", "y" or "z".
    """
    z = np.array(AXES[axis])
    x = np.array(AXES["y" if axis == "z" else "z"])
    return np.stack([x, np.cross(z, x), z], axis=1)


def run_case(hand_name: str, task: str, seeds: int, budget: float, first_seed: int = 0) -> tuple[CaseResult, RegraspRun | None]:
    """Plan and execute a turn, with one seed after the other until it is complete.

    Args:
        hand_name: name of the hand.
        task: name of the task.
        seeds: largest number of seeds.
        budget: of each search, s.
        first_seed: the first seed.
    """
    hand, (shape, axis), turned, best = Hand.load(hand_name), tasks(hand_name)[task], 0.0, None
    around = CollisionSettings(CLEARANCE)
    for seed in range(first_seed, first_seed + seeds):
        start = StartOptions(friction=FRICTION, R_HO=orientation(axis), control=CONTROL, collisions=around, seed=seed)
        try:
            grasp = find_regrasp_start(hand, Body.solid(shape, MASS), start)
        except InvalidInput:
            continue
        path = PosePath.turn(grasp.p_HO, grasp.R_HO, AXES[axis], 2.0 * np.pi)
        began = time.perf_counter()
        plan = plan_regrasp(RegraspTask(grasp, path, CONTROL, around), RegraspSettings(budget=budget, seed=seed))
        search = time.perf_counter() - began
        if not isinstance(plan, RegraspPlan):
            turned = max(turned, 360.0 * (plan.s or 0.0))
            continue
        run = simulate_regrasp(Plant(build_scene(grasp, gravity_H=CONTROL.gravity_H)), RegraspController(plan), plan)
        result = judge(hand_name, task, seed - first_seed + 1, plan, run, search)
        if result.outcome == "done":
            return result, run
        best = best or (result, run)
    return best or (CaseResult(hand_name, task, seeds, "no plan", turned), None)


def judge(hand: str, task: str, seeds: int, plan: RegraspPlan, run: RegraspRun, search: float) -> CaseResult:
    """Return the result of a run.

    Args:
        hand: name of the hand.
        task: name of the task.
        seeds: number of seeds that were tried.
        plan: the plan.
        run: its execution.
        search: time of the search, s.
    """
    distance, angle = (float(np.linalg.norm(run.final_error[rows])) for rows in (slice(3), slice(3, 6)))
    return CaseResult(
        hand=hand,
        task=task,
        seeds=seeds,
        outcome="done" if run.is_complete else f"ended in {run.outcome.value}",
        turned=360.0,
        steps=plan.step_count,
        simulated=float(run.t[-1]),
        search=search,
        distance=distance,
        angle=angle,
        peak_distance=float(np.linalg.norm(run.error[:, :3], axis=1).max()),
        margin=float(run.planned_margin.min()),
        true_margin=float(run.true_margin.min()),
        uncertified=run.uncertified_count,
        torque_step=run.largest_torque_step,
        collisions=len(run.collisions),
        clearance=CLEARANCE,
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the section.

    Args:
        parser: the parser.
    """
    parser.add_argument("--hands", nargs="*", default=HANDS, choices=HANDS, help="hands (default: all)")
    parser.add_argument("--tasks", nargs="*", default=list(tasks(HANDS[0])), help="tasks, such as 'ball, x' (default: all)")
    parser.add_argument("--seeds", type=int, default=3, help="largest number of seeds (default: 3)")
    parser.add_argument("--budget", type=float, default=300.0, help="of each search, s (default: 300)")
    parser.add_argument("--plots", type=Path, default=PICTURES, help=f"folder of the plots (default: {PICTURES})")


def run(path: Path, options: argparse.Namespace) -> None:
    """Run the cases that are missing in a file of results, and plot margins and errors of each run.

    Args:
        path: the file.
        options: of the section.
    """
    with ResultFile(path, SCHEMA, {"seeds": options.seeds, "budget": options.budget}) as file:
        done = {(record["hand"], record["task"]) for record in file.records if isinstance(record, dict)}
        for hand, task in product(options.hands, options.tasks):
            if (hand, task) in done:
                continue
            result, recording = run_case(hand, task, options.seeds, options.budget)
            file.append(asdict(result))
            print(f"{hand}, {task}: {result.outcome}, {result.turned:.0f}°, {result.steps} steps", flush=True)
            if recording is not None:
                save_figures({_picture(hand, task): plot_regrasp(recording, f"{hand}, {task}")}, options.plots)


def page(path: Path) -> str:
    """Return the Markdown of the section.

    Args:
        path: the file of results.
    """
    results = [CaseResult(**record) for record in read_results(path, SCHEMA)[1] if isinstance(record, dict)]
    done = sum(each.outcome == "done" for each in results)
    head = ("hand", "task", "outcome", "seeds", "turn °", "finger steps", "time s", "search s", "off goal mm", "off goal °")
    head += ("peak error mm", "least margin N", "uncertified", "torque step N·m", "apart mm", "collisions")
    about = [" ".join(part.split()) for part in (__doc__ or "").split("\n\n")[1:]]
    found = {(each.hand, each.task) for each in results}
    missing = [f"{hand} and {task}" for hand, task in product(HANDS, tasks(HANDS[0])) if (hand, task) not in found]
    summary = f"{done} of {len(results)} turns are complete."
    summary += f" Without a result yet: {', '.join(missing)}." if missing else ""
    table = report_page.table(head, [_row(each) for each in results], text_columns=3)
    runs = [(each.hand, each.task) for each in results if each.steps]
    links = ", ".join(f"[{hand}, {task}]({PICTURES.name}/{_picture(hand, task)}.png)" for hand, task in runs)
    return "\n\n".join([*about, summary, table, f"Slip margins and pose errors over time: {links}."])


def _picture(hand: str, task: str) -> str:
    """Return the name of the picture of a case."""
    return f"{hand}-{task.replace(', ', '-')}"


def _row(result: CaseResult) -> tuple[str, ...]:
    """Return the cells of a row; a case without plan has no run."""
    start = (result.hand, result.task, result.outcome, str(result.seeds), f"{result.turned:.0f}")
    if not result.steps:
        return (*start, *[""] * 11)
    return (
        *start,
        *(str(result.steps), f"{result.simulated:.1f}", f"{result.search:.0f}", f"{1e3 * result.distance:.3f}"),
        *(f"{np.degrees(result.angle):.3f}", f"{1e3 * result.peak_distance:.3f}", f"{round(result.margin, 2) + 0.0:.2f}"),
        *(str(result.uncertified), f"{result.torque_step:.3f}", f"{1e3 * result.clearance:g}", str(result.collisions)),
    )

"""Time of a control step and of its parts: `python -m benchmarks.control_step [--save FILE]`.

Three fingers of the Allegro hand move a sphere 8 mm peak to peak at 1 Hz with rolling contacts. States come at 1 kHz, with
encoder noise. In each round all parts run on the same state in turn, so that a drift of the machine's speed affects them
equally. The solver's time is that of `Solver.solve` with all numbers changed, warm from the last round, as in the step. The
least distance of links, palm and object is no part of a step; its time is stated for a controller that reads it in one of 50.

The second table has steps in which no forces exist, each beside a normal one of the same state. The desired acceleration is a
multiple of the largest one that the grasp can give at the first state. "First" are steps that follow a normal one.
"""

from __future__ import annotations

import dataclasses
import os
import platform
import sys
import time
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.control_grasps import GRASP_NAMES, named_grasp

import graspforce
from benchmarks import report_page
from benchmarks.timing import pin
from graspforce import Solver
from graspforce.bench.conditions import processor
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.step_data import IntegralRule
from graspforce.core.compiled import native
from graspforce.grasp.grasp import Grasp

PERIOD, TRAVEL = 1e-3, np.array([0.0, -0.008, 0.0])  # s; m, peak to peak
TARGETS = "kinematics, contacts, accelerations and wrench"
DYNAMICS, RESULT = "inverse dynamics", "torques, slip and integral"
REFUSED = (
    "Steps in which no forces exist, beside normal ones of the same states, by desired acceleration over the largest one.\n"
    "*First*: a step without forces that follows a normal one."
)
CLEARANCE, CLEARANCE_STEPS = "clearance", 50
OVERLOADS = (1.01, 2.0, 10.0)  # desired over largest possible acceleration
OVERLOAD_HEADINGS = (
    "acceleration over the largest",
    "steps without forces",
    "normal µs",
    "without forces µs",
    "ratio",
    "first: ratio",
)
HEADINGS = ("part", "10 % µs", "median µs", "99 % µs", "share of the step")
NOISE = (1e-5, 1e-3, 1e-6, 1e-4)  # standard deviations: q, rad; v, rad/s; object position, m; object twist, m/s and rad/s


def motion(grasp: Grasp, t: float) -> BodyMotion:
    """Return the desired motion of the object at time t, s: `TRAVEL` and back at 1 Hz."""
    w = 2.0 * np.pi
    rest = np.zeros(3)
    p = grasp.p_HO + TRAVEL * (1.0 - np.cos(w * t)) / 2.0
    v, a = TRAVEL * w * np.sin(w * t) / 2.0, TRAVEL * w**2 * np.cos(w * t) / 2.0
    return BodyMotion(p, grasp.R_HO, np.append(v, rest), np.append(a, rest))


def states(grasp: Grasp, count: int) -> list[tuple[GraspState, BodyMotion]]:
    """Return measured states of fingers that roll on the moving object, and the desired motion at each."""
    law, rng, q = ObjectControlLaw(grasp, ControlSettings()), np.random.default_rng(0), np.array(grasp.q)
    memory, result = law.initial_memory(), []
    for i in range(count):
        now = motion(grasp, i * PERIOD)
        command, memory = law.step(memory, GraspState(q, np.zeros(grasp.hand.n), now), now)
        J = grasp.hand.contact_jacobian(q, grasp.fingers, command.contacts, now.p_HO, now.R_HO)
        v = np.linalg.lstsq(J, (command.contacts.R_OC.transpose(0, 2, 1) @ now.twist[:3]).ravel(), rcond=None)[0]
        noise = [scale * rng.normal(size=size) for scale, size in zip(NOISE, (len(q), len(q), 3, 6), strict=True)]
        measured = BodyMotion(now.p_HO + noise[2], now.R_HO, now.twist + noise[3])
        result.append((GraspState(q + noise[0], v + noise[1], measured), now))
        q = q + PERIOD * v
    return result


def measure(grasp: Grasp, rounds: int) -> tuple[dict[str, np.ndarray], int]:
    """Return the times of each part in each round, s, and the number of certified solutions."""
    law, hand = ObjectControlLaw(grasp, ControlSettings()), grasp.hand
    memory, solver, durations, certified = law.initial_memory(), None, {}, 0

    def timed(name: str, part: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        result = part()
        durations.setdefault(name, []).append(time.perf_counter() - start)
        return result

    for state, desired in states(grasp, rounds):
        before, (command, memory) = memory, timed("step", lambda: law.step(memory, state, desired))  # noqa: B023  # called at once
        certified += command.solution.found
        timed(CLEARANCE, lambda: command.clearance)  # noqa: B023
        targets = timed(TARGETS, lambda: law.compute_targets(before, state, desired, None))  # noqa: B023
        gravity, zero = law.settings.gravity_H, np.zeros(hand.n)
        timed(DYNAMICS, lambda: hand.model.inverse_dynamics(state.q, state.v, targets.joint_acceleration, gravity))  # noqa: B023
        timed(RESULT, lambda: law.compute_result(before, state, targets, zero, command.f, IntegralRule.UNLESS_SATURATED))  # noqa: B023
        problem = command.solution.problem
        assert problem is not None  # the step solved it
        assert problem.actuation is not None
        numbers = {"w": problem.w, "J": problem.actuation.J, "tau_u": problem.actuation.tau_u}
        numbers |= {"p": problem.contacts.p_OC, "R": problem.contacts.R_OC}
        solver = solver or Solver(problem, explain=False)
        timed("solver", lambda: solver.solve(**numbers))  # noqa: B023
    return {name: np.array(seconds[rounds // 10 :]) for name, seconds in durations.items()}, certified


def overloaded(desired: BodyMotion, acceleration: float) -> BodyMotion:
    """Return the desired motion with another vertical acceleration, m/s²."""
    return dataclasses.replace(desired, acceleration=np.array([0.0, 0.0, acceleration, 0.0, 0.0, 0.0]))


def largest_acceleration(grasp: Grasp, state: GraspState, desired: BodyMotion) -> float:
    """Return the vertical acceleration from which no forces exist at a state, m/s², by bisection."""
    low, high = 0.0, 1e3
    while high - low > 1e-4 * high:
        law, middle = ObjectControlLaw(grasp, ControlSettings()), 0.5 * (low + high)
        command, _ = law.step(law.initial_memory(), state, overloaded(desired, middle))
        low, high = (middle, high) if command.solution.found else (low, middle)
    return high


def refused_steps(grasp: Grasp, rounds: int) -> list[tuple[str, ...]]:
    """Return a row for each overload: medians of normal steps and of those without forces, and their ratios."""
    given, rows = states(grasp, rounds), []
    largest = largest_acceleration(grasp, *given[0])
    for factor in OVERLOADS:
        laws = [ObjectControlLaw(grasp, ControlSettings()) for _ in range(3)]  # normal, overloaded, and in turn
        memories, times = [law.initial_memory() for law in laws], [[], [], []]
        for i, (state, desired) in enumerate(given):
            high = overloaded(desired, factor * largest)
            for law, target in enumerate((desired, high, high if i % 2 else desired)):
                start = time.perf_counter()
                command, memories[law] = laws[law].step(memories[law], state, target)
                seconds = time.perf_counter() - start
                if i >= rounds // 10 and command.solution.found == (law == 0):
                    times[law].append(seconds)
        normal, without, first = (float(np.median(each)) if each else np.nan for each in times)
        numbers = (f"{1e6 * normal:.1f}", f"{1e6 * without:.1f}", f"{without / normal:.2f}", f"{first / normal:.2f}")
        rows.append((f"{factor:g}", f"{len(times[1])} of {rounds - rounds // 10}", *numbers))
    return rows


def shares(durations: dict[str, np.ndarray]) -> list[tuple[str, ...]]:
    """Return the step and its parts, slowest first: name, 10 %, median and 99 % in µs, and share of the step."""
    step, rows = np.median(durations["step"]), []
    parts = {name: seconds for name, seconds in durations.items() if name != CLEARANCE}
    for name, seconds in sorted(parts.items(), key=lambda item: -np.median(item[1])):
        times = [f"{1e6 * np.quantile(seconds, share):.1f}" for share in (0.1, 0.5, 0.99)]
        rows.append((name, *times, f"{np.median(seconds) / step:.0%}"))
    rest = step - sum(np.median(seconds) for name, seconds in parts.items() if name != "step")
    return [*rows, ("records and the rest", "", f"{1e6 * rest:.1f}", "", f"{rest / step:.0%}")]


def sentence(grasp_name: str, durations: dict[str, np.ndarray], certified: int, rounds: int) -> str:
    """Return the summary of the table."""
    step, ratio = np.median(durations["step"]), np.median(durations["step"]) / np.median(durations["solver"])
    clearance = np.median(durations[CLEARANCE]) / step
    laws = "The control laws ran compiled." if native is not None else "The control laws ran in Python, not compiled."
    return (
        f"{grasp_name}: a step takes {ratio:.2f} × the time of its solver; {certified} of {rounds} solutions certified. {laws} "
        f"The clearance takes {clearance:.1f} × the time of a step: {clearance / CLEARANCE_STEPS:.0%} if it is read in one of "
        f"{CLEARANCE_STEPS} steps."
    )


def page(rows: list[tuple[str, ...]], summary: str, refused: list[tuple[str, ...]]) -> str:
    """Return the tables as Markdown, with machine and versions."""
    lines = [
        "# Time of a control step and of its parts",
        "",
        f"graspforce {graspforce.__version__}, {date.today()}. {processor()}, {os.cpu_count()} cores, one of them used,",
        f"Python {platform.python_version()}. Load average of the machine: {os.getloadavg()[0]:.1f}.",
        f"Command: `{report_page.command()}`.",
        "",
        "| " + " | ".join(HEADINGS) + " |",
        "|---|---:|---:|---:|---:|",
    ]
    parts = [*lines, *("| " + " | ".join(row) + " |" for row in rows), "", summary, "", REFUSED, ""]
    return "\n".join([*parts, report_page.table(OVERLOAD_HEADINGS, refused), ""])


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("control_step", __doc__)
    parser.add_argument("--rounds", type=int, default=2000, help="control steps; the first tenth is not timed")
    parser.add_argument(
        "--grasp", default="allegro_right sphere", choices=GRASP_NAMES, metavar="NAME", help="a grasp of the control tests"
    )
    options = parser.parse_args()
    pin(None)
    durations, certified = measure(named_grasp(options.grasp), options.rounds)
    rows, summary = shares(durations), sentence(options.grasp, durations, certified, options.rounds)
    table = Table(*HEADINGS)
    for row in rows:
        table.add_row(*row)
    console = Console()
    console.print(table)
    console.print(summary)
    refused = refused_steps(named_grasp(options.grasp), options.rounds)
    report_page.show("Steps without forces", OVERLOAD_HEADINGS, refused)
    if options.save:
        options.save.write_text(page(rows, summary, refused))
        console.print(f"written to {options.save}")


if __name__ == "__main__":
    main()

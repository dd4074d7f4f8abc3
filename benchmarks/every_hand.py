"""Hold and move objects with every hand and its drives: python -m benchmarks.every_hand [--save FILE].

Each shipped hand holds a ball, a box and a cylinder of 50 g and moves them by 5 mm at 1 Hz, out and back, in the direction in
which its fingers can move them farthest. "Travel" is the distance commanded. It is shorter where the fingers cannot move the
object so far in this grasp, and zero where they cannot move it at all; the table below says why. The controller knows joint
positions with 0.1 mrad noise (jaws: 10 µm), the drives of the description, and how wrong their constants may be: 30 % in
stiffness and damping, and 20 % in the torque constants, which position drives do not have. The true drives differ by random
amounts up to these errors, and by up to 20 % in delay, backlash and the losses of their gears, of which the controller does not
know. Hands whose description has no drives run with all modes and 500 set-points a second. Their servos have 5 N·m/rad (jaws:
5 N/mm) and half the critical damping, and take positions up to 0.2 rad beyond the joint's limits; their torque constants are
1 N·m/A (jaws: 1 N/A) at the joint.

"RMS" is the root mean square distance of the object from its reference after the first second, and "ratio" that to the
same hand with ideal torque drives of the same rate and delay. "Margin kept" is the fraction of steps in which the true slip
margin of every contact is at least the guaranteed one of the command, which counts the stated errors of the drives. A run is
held if the object is not dropped, no fingertip slides by more than 1 mm or is without contact for 0.1 s, and certified forces
exist.
"""

from __future__ import annotations

import argparse
import math
import os
from itertools import product
from pathlib import Path

import mujoco
import numpy as np

from benchmarks import every_hand_drives, every_hand_heat, every_hand_kinds, link_gaps, own_hand, report_page
from benchmarks.every_hand_drives import OBJECTS, TRAVEL, drive_modes
from benchmarks.task_records import Record, Task, run_tasks
from graspforce.hand.descriptions.description import shipped_hands
from graspforce.hand.descriptions.drive_description import DRIVE_MODES

TITLE = "Every hand and its drives"
RECORDS = Path(__file__).parent / "results" / "records" / "every_hand.jsonl"
HEAD = ("hand", "drive", "object", "result", "travel, mm", "RMS, mm", "ratio", "margin kept")
PARTS = ("kinds", "drives", "gaps", "squeeze", "limit", "own")
Results = dict[Task, Record]

_FUNCTIONS = {
    "drives": every_hand_drives.measure,
    "gaps": link_gaps.measure_hand,
    "squeeze": every_hand_heat.compare_grasp,
    "limit": every_hand_heat.hold_at_limit,
    "wrist": every_hand_kinds.compare_wrists,
    "tendon": every_hand_kinds.compare_tendon,
    "breakaway": every_hand_kinds.open_breakaway,
    "jaws": every_hand_kinds.lift_with_jaws,
    "power": every_hand_kinds.hold_power_grasp,
    "lint": every_hand_kinds.check_lint,
    "own": own_hand.record_transcript,
}


def main() -> None:
    """Run all tasks that the file of results lacks, print the tables, and save the page."""
    parser = report_page.parser("every_hand", __doc__)
    parser.add_argument("--hands", nargs="*", default=shipped_hands(), choices=shipped_hands(), help="hands (default: all)")
    parser.add_argument("--parts", nargs="*", default=list(PARTS), choices=PARTS, help="parts of the page (default: all)")
    parser.add_argument("--duration", type=float, default=10.0, help="simulated time of a run, s (default: 10)")
    parser.add_argument("--records", type=Path, default=RECORDS, help="file of results, which is continued")
    parser.add_argument("--slice", type=float, default=math.inf, help="stop after this time, s (default: run to the end)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="number of processes")
    parser.add_argument("--grasps", type=int, default=6, help="grasps of each hand in the comparison of heat (default: 6)")
    options = parser.parse_args()
    tasks = all_tasks(options)
    results = run_tasks(run_task, tasks, options.records, options.workers, options.slice)
    parts = sections(tasks, results)
    print("\n\n".join(parts))
    if options.save:
        report_page.save(options.save, TITLE, __doc__, report_page.facts(f"MuJoCo {mujoco.__version__}"), "\n\n".join(parts))


def all_tasks(options: argparse.Namespace) -> list[Task]:
    """Return the tasks of the chosen parts: the part's function, and its arguments.

    Args:
        options: of the command line.
    """
    seeds = range(math.ceil(options.grasps / len(OBJECTS)))
    by_part: dict[str, list[Task]] = {
        "kinds": [
            *(("wrist", name) for name in every_hand_kinds.WRIST_HANDS),
            *(("tendon", seed) for seed in every_hand_kinds.TENDON_SEEDS),
            ("breakaway",),
            *(("jaws", name) for name in OBJECTS),
            *(("power", name) for name in every_hand_kinds.POWER_HANDS),
            ("lint",),
        ],
        "drives": [
            ("drives", hand, mode, name, options.duration)
            for hand in options.hands
            for mode, name in product(drive_modes(hand), OBJECTS)
        ],
        "gaps": [("gaps", hand, name) for hand, name in product(options.hands, link_gaps.OBJECTS)],
        "squeeze": [("squeeze", hand, name, seed) for hand, seed, name in product(options.hands, seeds, OBJECTS)],
        "limit": [("limit", name) for name in every_hand_heat.HOLD_HANDS],
        "own": [("own", case.name) for case in own_hand.CASES],
    }
    return [task for part in PARTS if part in options.parts for task in by_part[part]]


def run_task(task: Task) -> Record:
    """Return the result of a task.

    Args:
        task: the part's function, and its arguments.
    """
    return _FUNCTIONS[task[0]](*task[1:])


def sections(tasks: list[Task], results: Results) -> list[str]:
    """Return the sections of the page.

    Args:
        tasks: all tasks of the page.
        results: of those that have run.
    """
    missing = len(tasks) - len(results)
    note = f"{missing} of {len(tasks)} tasks have not run yet; the same command goes on." if missing else ""
    drives = [task for task in tasks if task[0] == "drives" and task in results]
    summary = "\n".join(f"- {line}" for line in summary_lines(drives, results))
    parts = [
        note,
        summary,
        report_page.table(HEAD, [drive_row(task, results) for task in drives], 4),
        travel_table(drives, results),
    ]
    kinds = every_hand_kinds.rows(results)
    if kinds:
        parts += ["## Wrists, tendons, jaws, inner links, lint", report_page.table(("what", "measured", "required"), kinds, 3)]
    parts += link_gaps.section({task[1:]: each for task, each in results.items() if task[0] == "gaps"})
    parts += every_hand_heat.sections(results)
    parts += own_hand.section([results[task] for task in tasks if task[0] == "own" and task in results])
    return [part for part in parts if part]


def drive_row(task: Task, results: Results) -> tuple[str, ...]:
    """Return the row of a run.

    Args:
        task: "drives", hand, drive, object and duration.
        results: of all tasks.
    """
    _, hand, mode, object_name, duration = task
    result, ideal = results[task], results.get(("drives", hand, "ideal", object_name, duration), {})
    label = f"{result.get('mode', '')} (described)" if mode == "described" else mode
    if "rms" not in result:
        return hand, label, object_name, f"error: {result['error'][:60]}", "–", "–", "–", "–"
    ratio = f"{result['rms'] / ideal['rms']:.2f}" if ideal.get("rms") else "–"
    text = result["result"] + (f": {result['message'][:50]}" if result["result"] != "held" else "")
    figures = f"{1e3 * result['travel']:.0f}", f"{result['rms']:.4f}", ratio, f"{100 * result['kept']:.2f} %"
    return hand, label, object_name, text, *figures


def travel_table(tasks: list[Task], results: Results) -> str:
    """Return the table of the grasps in which the object cannot be moved by 5 mm, with the reason.

    Args:
        tasks: of the drives.
        results: of all tasks.
    """
    table = {}
    for task in tasks:
        result = results[task]
        if "travel" in result and result["travel"] < TRAVEL:
            table[task[1], task[3]] = (task[1], task[3], f"{1e3 * result['travel']:.0f}", result["limit"])
    if not table:
        return ""
    head = ("hand", "object", "travel, mm", "why not farther")
    return f"Grasps with less travel than {1e3 * TRAVEL:.0f} mm:\n\n" + report_page.table(head, table.values(), 4)


def summary_lines(tasks: list[Task], results: Results) -> list[str]:
    """Return sentences with the figures over all runs.

    Args:
        tasks: of the drives.
        results: of all tasks.
    """
    runs = {task: results[task] for task in tasks if "rms" in results[task]}
    if not runs:
        return []
    held = [result for result in runs.values() if result["result"] == "held"]
    lines = [f"{len(held)} of {len(tasks)} runs are held; {len(tasks) - len(runs)} have no grasp or no run."]
    driven = {task: result for task, result in runs.items() if task[2] != "ideal" and result["result"] == "held"}
    steps = sum(result["steps"] for result in driven.values())
    if steps:
        kept = sum(result["steps"] * result["kept"] for result in driven.values()) / steps
        lines.append(f"The margin is at least the guaranteed one in {100 * kept:.3f} % of {steps} steps with drives.")
    for mode in DRIVE_MODES[1:]:
        ratios = {}
        for task, result in driven.items():
            ideal = results.get((*task[:2], "ideal", *task[3:]), {}).get("rms")
            if result["mode"] == mode and ideal:
                ratios[task] = result["rms"] / ideal
        if ratios:
            worst = max(ratios, key=ratios.__getitem__)
            median, most = np.median(list(ratios.values())), ratios[worst]
            lines.append(
                f"{mode}: RMS is {median:.2f} times that of torque drives in the median of {len(ratios)} runs, "
                f"at most {most:.2f} ({worst[1]}, {worst[3]})."
            )
    return lines


if __name__ == "__main__":
    main()

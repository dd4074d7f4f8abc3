"""The controller in C: torques against Python, time of a step: `python -m benchmarks.c_controller [--save FILE]`.

Torques of random states in sequence are compared with those of `ObjectController`. For the times, three fingers of Allegro
move a sphere 8 mm peak to peak at 1 Hz with rolling contacts, as in `benchmarks.control_step`. The time of the force kernel
is that of the calls of `gf_solve` in the same steps.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
from datetime import date
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support import cortex_m7
from support.c_controllers import (
    COMPILER,
    LIBRARY_SOURCES,
    SOURCES,
    build_loop,
    compile_objects,
    python_torques,
    random_records,
    run_loop,
)
from support.control_grasps import named_grasp

import graspforce
from benchmarks import report_page
from benchmarks.control_step import states
from benchmarks.timing import pin
from graspforce.bench.conditions import processor
from graspforce.control import write_controller
from graspforce.grasp.grasp import Grasp

COMPARED = ("allegro_right sphere", "dlr_hit2 sphere", "four_finger box")
FLAGS = ("-O3", "-fno-math-errno", "-fno-trapping-math")  # as CMakeLists.txt
PROGRAM = Path(__file__).with_name("controller_time.c")
SINGLE_HEADINGS = ("grasp", "steps", "status", "median N·m", "99.9 % N·m", "largest N·m", "largest torque N·m")
COUNTED = (  # figures on a microcontroller
    "flags",
    "instructions of a step, median",
    "instructions of a step, largest",
    "instructions of the first step, which starts cold",
    "iterations of the solver",
    "stack, bytes",
    "memory of the caller, bytes",
    "code and tables without C library, bytes",
    "calls of allocators",
    "calls of double arithmetic in software",
    "instructions counted of a known loop",
)
HEADINGS = ("part", "10 % µs", "median µs", "99 % µs", "99.99 % µs", "largest µs")


@cache
def reference(name: str, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random states of a grasp, (M, 2 n + 42), and the torques of Python for them, (M, n)."""
    grasp = named_grasp(name)
    records = random_records(grasp, steps, seed=11)
    return records, python_torques(grasp, records)[0]


def compare(folder: Path, library: list[Path], steps: int) -> list[tuple[str, ...]]:
    """Return a row for each grasp: steps, certified ones, median and largest difference of a torque, N·m."""
    rows = []
    for name in COMPARED:
        grasp = named_grasp(name)
        records, expected = reference(name, steps)
        program = build_loop(folder / name.replace(" ", "_"), "control_loop.c", grasp, library, *FLAGS)
        torques, report = run_loop(program, records, grasp.hand.n)
        difference = np.abs(torques - expected).max(axis=1)
        rows.append((name, str(steps), " ".join(report.split()), f"{np.median(difference):.1e}", f"{difference.max():.1e}"))
    return rows


def moving_records(grasp: Grasp, steps: int) -> np.ndarray:
    """Return the records of a moving object with sensor noise, (M, 2 n + 42)."""
    records = []
    for state, desired in states(grasp, steps):
        parts = (state.q, state.v, state.object.p_HO, state.object.R_HO.ravel(), state.object.twist)
        wanted = (desired.p_HO, desired.R_HO.ravel(), desired.twist, desired.acceleration)
        records.append(np.concatenate([*parts, *wanted]))
    return np.array(records)


def microcontroller(folder: Path, grasp: Grasp, steps: int, precision: tuple[str, ...]) -> tuple[str, ...]:
    """Return the column of the counts of steps on an emulated Cortex-M7, without the first ones, which start cold."""
    folder.mkdir(parents=True)
    counted, objects = cortex_m7.count_steps(folder, grasp, moving_records(grasp, steps), precision)
    warm = counted.instructions[steps // 10 :]
    allocators = cortex_m7.ALLOCATORS & cortex_m7.undefined_symbols(objects)
    calls = {name for name in cortex_m7.undefined_symbols(objects) if name.startswith("__aeabi_d")}
    return (
        " ".join(precision),
        f"{np.median(warm):.0f}",
        str(warm.max()),
        str(counted.instructions[0]),
        f"{np.median(counted.iterations[steps // 10 :]):.0f}",
        str(counted.stack.max()),
        str(counted.memory),
        str(counted.code),
        ", ".join(sorted(allocators)) or "none",
        ", ".join(sorted(calls)) or "none",
        f"{counted.loop[0]} of {counted.loop[1]}",
    )


def count_on_microcontroller(folder: Path, steps: int) -> str:
    """Return the counts of both precisions as text."""
    if cortex_m7.COMPILER is None or cortex_m7.EMULATOR is None:
        return f"Not counted on a Cortex-M7: {cortex_m7.MISSING}."
    grasp = named_grasp("allegro_right sphere")
    builds = {"float64": cortex_m7.FLOAT64, "float32": cortex_m7.FLOAT32}
    columns = [microcontroller(folder / name, grasp, steps, flags) for name, flags in builds.items()]
    rows = [(name, *cells) for name, *cells in zip(COUNTED, *columns, strict=True)]
    return (
        f"On a Cortex-M7, emulated by QEMU (arm-none-eabi-gcc {' '.join(cortex_m7.FLAGS)}), {steps - steps // 10} of the same "
        "steps, after as many as a tenth of them. The counter has a resolution of 40 instructions. The build with float32 uses "
        f"a single-precision unit only.\n\n{report_page.table(('', *builds), rows)}"
    )


def compare_single(folder: Path, steps: int) -> list[tuple[str, ...]]:
    """Return a row for each grasp, with the torques of the build with single precision on this machine."""
    library = compile_objects(folder / "float32", LIBRARY_SOURCES, *FLAGS, "-DGF_FLOAT32")
    rows = []
    for name in COMPARED:
        grasp = named_grasp(name)
        records, expected = reference(name, steps)
        loop = (folder / f"{name.replace(' ', '_')}32", "control_loop.c", grasp, library, *FLAGS, "-DGF_FLOAT32")
        torques, report = run_loop(build_loop(*loop), records, grasp.hand.n, np.float32)
        difference = np.abs(torques - expected).max(axis=1)
        figures = [f"{each:.1e}" for each in (*np.quantile(difference, (0.5, 0.999)), difference.max())]
        rows.append((name, str(steps), " ".join(report.split()), *figures, f"{np.abs(expected).max():.2f}"))
    return rows


def measure(folder: Path, library: list[Path], grasp: Grasp, steps: int, runs: int) -> tuple[np.ndarray, str]:
    """Return what each run gives for each step, (runs, M, 4), and what the program reports.

    The columns are the times of the step, of its kernel calls, and of fixed arithmetic, s, and the number of preemptions.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _, source, _, hand_source = write_controller(grasp, folder)
    include = [f"-I{SOURCES / 'include'}", f"-I{SOURCES}", f"-I{folder}"]
    sources = [PROGRAM, source, hand_source, *(path for path in library if path.stem != "controller")]
    command = [str(COMPILER), "-std=c11", *FLAGS, *include, *map(str, sources), "-lm", "-o", str(folder / "time")]
    subprocess.run(command, check=True)
    command, records = [str(folder / "time"), str(steps)], moving_records(grasp, steps).tobytes()
    results = [subprocess.run(command, input=records, capture_output=True, check=True) for _ in range(runs)]
    times = np.array([np.frombuffer(result.stdout).reshape(-1, 4)[steps // 10 :] for result in results])
    return times * [1e-9, 1e-9, 1e-9, 1.0], results[-1].stderr.decode().strip()


def time_rows(times: np.ndarray) -> list[tuple[str, ...]]:
    """Return a row for the step, the kernel, the rest of the step, the same step in all runs, and fixed arithmetic."""
    step, kernel, arithmetic = (times[..., k] for k in range(3))
    parts = {
        "step": step,
        "force kernel": kernel,
        "rest of the step": step - kernel,
        "step, median of the runs": np.median(step, axis=0),
        "fixed arithmetic": arithmetic,
        "fixed arithmetic, median of the runs": np.median(arithmetic, axis=0),
    }
    shares = (0.1, 0.5, 0.99, 0.9999, 1.0)
    return [(name, *(f"{1e6 * np.quantile(part, share):.1f}" for share in shares)) for name, part in parts.items()]


def main() -> None:
    """Compare, measure, print the tables and write the page."""
    parser = report_page.parser("c_controller", __doc__)
    parser.add_argument("--steps", type=int, default=10_000, help="random steps of each grasp that are compared with Python")
    parser.add_argument("--timed-steps", type=int, default=50_000, help="steps that are timed; the first tenth does not count")
    parser.add_argument("--runs", type=int, default=5, help="runs of the timed steps")
    parser.add_argument("--counted-steps", type=int, default=100, help="steps that are counted on an emulated Cortex-M7")
    options = parser.parse_args()
    if COMPILER is None:
        parser.error("needs a C compiler")
    pin(None)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        library = compile_objects(folder / "library", LIBRARY_SOURCES, *FLAGS)
        grasp = named_grasp("allegro_right sphere")
        times, report = measure(folder / "timed", library, grasp, options.timed_steps, options.runs)
        compared = compare(folder, library, options.steps)
        single = compare_single(folder, options.steps)
        counts = count_on_microcontroller(folder / "cortex_m7", options.counted_steps)
    preempted, timed = np.count_nonzero(times[..., 3]), times[..., 3].size
    ratio = np.median(times[..., 0]) / np.median(times[..., 1])
    lines = [
        "# The controller in C",
        "",
        f"graspforce {graspforce.__version__}, {date.today()}. {processor()}, {os.cpu_count()} cores, pinned to one of them,",
        f"Python {platform.python_version()}. Load average of the machine: {os.getloadavg()[0]:.1f}.",
        f"Command: `{report_page.command()}`.",
        "",
        "Time of a step with three fingers of the Allegro hand:",
        "",
        report_page.table(HEADINGS, time_rows(times)),
        "",
        f"{options.runs} runs of the same steps, one after the other. The slowest steps differ from run to run: the machine",
        "interrupts, as the fixed arithmetic after each step shows. The median of the runs is the time of a step alone.",
        f"Other processes took the core during {preempted} of {timed} steps.",
        f"The median step takes {ratio:.2f} × the median time of its force kernel, in the same steps. Status: {report}.",
        "",
        "Largest difference of a torque to Python's `ObjectController`, over random states in sequence:",
        "",
        report_page.table(("grasp", "steps", "status", "median N·m", "largest N·m"), compared),
        "",
        "The same with the library built for single precision (`GF_FLOAT32`):",
        "",
        report_page.table(SINGLE_HEADINGS, single),
        "",
        counts,
        "",
    ]
    print("\n".join(lines))
    if options.save:
        options.save.write_text("\n".join(lines))


if __name__ == "__main__":
    main()

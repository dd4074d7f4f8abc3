"""The controller in C on an emulated Cortex-M7: instructions, stack and memory of its steps."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graspforce.control import write_controller
from graspforce.core.c_tables import c_array
from graspforce.grasp.grasp import Grasp
from support.c_controllers import LIBRARY_SOURCES, SOURCES

COMPILER, EMULATOR = shutil.which("arm-none-eabi-gcc"), shutil.which("qemu-system-arm")
MISSING = "needs arm-none-eabi-gcc with newlib, and qemu-system-arm"
BOARD = Path(__file__).parents[1] / "csrc" / "cortex_m7"
FLAGS = ["-mcpu=cortex-m7", "-mfloat-abi=hard", "-mthumb", "-std=c11", "-O2"]
FLAGS += ["-fno-math-errno", "-fno-trapping-math", "-Wno-psabi", "-ffunction-sections", "-fdata-sections"]
FLOAT64 = ("-mfpu=fpv5-d16", "-DGF_LANES=1")
FLOAT32 = ("-mfpu=fpv5-sp-d16", "-DGF_FLOAT32", "-fsingle-precision-constant")  # no double-precision unit
ALLOCATORS = {"malloc", "calloc", "realloc", "free", "_malloc_r", "_sbrk"}


@dataclass(frozen=True)
class CountedSteps:
    """Counts of control steps.

    Attributes:
        loop: instructions that the counter states for a loop of known length, and its true number.
        memory: bytes that the controller needs.
        code: bytes of code and constants of the controller and the tables, without C library.
        statuses: status of each step.
        instructions: (M,) of each step, in multiples of 40.
        stack: (M,) bytes of each step.
        iterations: (M,) of the solver.
        torques: (M, n) N·m.
    """

    loop: tuple[int, int]
    memory: int
    code: int
    statuses: list[str]
    instructions: np.ndarray
    stack: np.ndarray
    iterations: np.ndarray
    torques: np.ndarray


def compile_library(folder: Path, sources: list[Path], include: Path, precision: tuple[str, ...]) -> list[Path]:
    """Return the object files of C sources for the Cortex-M7."""
    command = [str(COMPILER), *FLAGS, *precision, f"-I{SOURCES / 'include'}", f"-I{include}", "-c", *map(str, sources)]
    subprocess.run(command, check=True, cwd=folder, timeout=120)
    return [folder / f"{source.stem}.o" for source in sources]


def undefined_symbols(objects: list[Path]) -> set[str]:
    """Return the names that object files take from elsewhere."""
    command = ["arm-none-eabi-nm", "-u", *map(str, objects)]
    return set(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())


def count_steps(
    folder: Path, grasp: Grasp, records: np.ndarray, precision: tuple[str, ...] = FLOAT64
) -> tuple[CountedSteps, list[Path]]:
    """Return the counts of steps for records (M, 2 n + 42), and the object files of the controller."""
    _, source, _, hand_source = write_controller(grasp, folder)
    numbers = c_array("numbers", records)
    text = f"enum {{ RECORDS = {len(records)} }};\n{numbers}"
    text += f"static const gf_real (*const records)[{records.shape[1]}] = (const gf_real (*)[{records.shape[1]}])numbers;\n"
    (folder / "records.h").write_text(text)
    objects = compile_library(folder, [*LIBRARY_SOURCES, source, hand_source], folder, precision)
    sources = [str(BOARD / "startup.c"), str(BOARD / "count_steps.c"), *map(str, objects)]
    linking = ["--specs=rdimon.specs", "-nostartfiles", "-T", str(BOARD / "link.ld"), "-Wl,--gc-sections"]
    command = [str(COMPILER), *FLAGS, *precision, f"-I{SOURCES / 'include'}", f"-I{folder}", *linking, *sources, "-lm"]
    subprocess.run([*command, "-o", str(folder / "steps.elf")], check=True, timeout=120)
    machine = ["-M", "mps2-an500", "-nographic", "-icount", "shift=0", "-semihosting-config", "enable=on,target=native"]
    command = [str(EMULATOR), *machine, "-kernel", str(folder / "steps.elf")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True, stdin=subprocess.DEVNULL)
    loop, memory, *lines = [line.split() for line in result.stdout.splitlines()]
    counts = np.array([[int(number) for number in line[1:4]] for line in lines])
    torques = np.array([[float(number) for number in line[4:]] for line in lines])
    sizes = subprocess.run(["arm-none-eabi-size", *map(str, objects)], check=True, capture_output=True, text=True).stdout
    code = sum(int(line.split()[0]) for line in sizes.splitlines()[1:])
    counted = CountedSteps((int(loop[1]), int(loop[3])), int(memory[1]), code, [line[0] for line in lines], *counts.T, torques)
    return counted, objects

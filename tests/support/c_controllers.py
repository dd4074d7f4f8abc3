"""Programs around the controller in C: compiled loops, and the states that they read."""

from __future__ import annotations

import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import graspforce
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController, write_controller
from graspforce.grasp.grasp import Grasp

SOURCES = Path(graspforce.get_include()).parent
EXAMPLES = Path(__file__).parents[2] / "examples" / "c"
COMPILER, CPP_COMPILER = shutil.which("cc") or shutil.which("gcc"), shutil.which("c++") or shutil.which("g++")
LIBRARY_SOURCES = [
    *(SOURCES / "kernel" / f"{name}.c" for name in ("solve", "certify", "grasp_matrix", "strings")),
    *(SOURCES / "control" / f"{name}.c" for name in ("control_step", "contact_kinematics", "joint_accelerations")),
    *sorted((SOURCES / "controller").glob("*.c")),
]
WARNINGS = ["-Wall", "-Wextra", "-Werror", "-Wno-psabi"]


def compile_objects(folder: Path, sources: list[Path], *flags: str) -> list[Path]:
    """Return the object files of C sources."""
    assert COMPILER is not None
    folder.mkdir(exist_ok=True)
    command = [COMPILER, "-std=c11", *WARNINGS, *flags, f"-I{SOURCES / 'include'}", "-c", *map(str, sources)]
    subprocess.run(command, check=True, timeout=300, cwd=folder)
    return [folder / f"{source.stem}.o" for source in sources]


def build_loop(folder: Path, example: str, grasp: Grasp, library: list[Path], *flags: str, settings=None) -> Path:
    """Return the program of an example, for a grasp."""
    assert COMPILER is not None
    assert CPP_COMPILER is not None
    folder.mkdir(exist_ok=True)
    _, source, _, hand_source = write_controller(grasp, folder, settings or ControlSettings())
    tables = compile_objects(folder / "tables", [source, hand_source], *flags, f"-I{folder}")
    standard = ["-std=c++17"] if example.endswith(".cpp") else ["-std=c11"]
    program = folder / example.replace(".", "_")
    compiler = CPP_COMPILER if example.endswith(".cpp") else COMPILER
    command = [compiler, *standard, *WARNINGS, *flags, f"-I{SOURCES / 'include'}", f"-I{folder}", str(EXAMPLES / example)]
    subprocess.run([*command, *map(str, [*tables, *library]), "-lm", "-o", str(program)], check=True, timeout=300)
    return program


def run_loop(program: Path, records: np.ndarray, n: int, kind: type = np.float64) -> tuple[np.ndarray, str]:
    """Return the torques (M, n) for records (M, 2 n + 42), and what the program wrote to standard error.

    `kind` is the number type of the library.
    """
    result = subprocess.run([str(program)], input=records.astype(kind).tobytes(), capture_output=True, timeout=300, check=False)
    assert result.returncode == 0, result.stderr.decode()
    return np.frombuffer(result.stdout, dtype=kind).reshape(-1, n), result.stderr.decode()


def random_records(grasp: Grasp, count: int, seed: int, scale: float = 1.0) -> np.ndarray:
    """Return random states near a grasp, and motions near them: (count, 2 n + 42). `scale` multiplies deviations."""
    rng, n = np.random.default_rng(seed), grasp.hand.n
    rows = []
    for _ in range(count):
        q = grasp.q + rng.normal(scale=0.005 * scale, size=n)  # rad
        v = rng.normal(scale=0.05 * scale, size=n)  # rad/s
        poses = []
        for _ in range(2):
            turn = Rotation.from_rotvec(rng.normal(scale=0.003 * scale, size=3)).as_matrix()
            poses.append([grasp.p_HO + rng.normal(scale=3e-4 * scale, size=3), (turn @ grasp.R_HO).ravel()])
        twist, twist_d = rng.normal(scale=0.005 * scale, size=(2, 6))
        acceleration_d = rng.normal(scale=0.1 * scale, size=6)
        rows.append(np.concatenate([q, v, *poses[0], twist, *poses[1], twist_d, acceleration_d]))
    return np.array(rows)


def python_torques(grasp: Grasp, records: np.ndarray, settings=None) -> tuple[np.ndarray, list]:
    """Return the torques (M, n) of `ObjectController` for records, and its commands."""
    n, controller = grasp.hand.n, ObjectController(grasp, settings or ControlSettings())
    commands = []
    for record in records:
        parts = np.split(record, np.cumsum([n, n, 3, 9, 6, 3, 9, 6]))
        q, v, p, R, twist, p_d, R_d, twist_d, a_d = parts
        state = GraspState(q, v, BodyMotion(p, R.reshape(3, 3), twist))
        commands.append(controller.step(state, BodyMotion(p_d, R_d.reshape(3, 3), twist_d, a_d)))
    return np.array([command.tau for command in commands]), commands


@cache
def library_objects(folder: Path) -> list[Path]:
    """Return the object files of the library, compiled with little optimisation, which takes a third of the time."""
    return compile_objects(folder, LIBRARY_SOURCES, "-O1", "-fno-math-errno", "-fno-trapping-math")

"""Each floor imports only from floors below it, and each library enters by one door."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# Rooms of one row do not know each other. A folder is one room.
FLOORS = [
    ("errors",),
    ("arrays", "fields"),
    ("friction", "shapes"),
    ("contact", "actuation"),
    ("grasp", "hands", "body"),
    ("hand", "problem"),
    ("hold",),
    ("json_text",),
    ("solution", "scale"),
    ("program",),
    ("certificate", "infeasibility", "backends", "problems"),
    ("solve",),
    ("batch", "bench", "hold_search", "plotting"),
    ("control", "planning", "options"),
    ("tracking",),
    ("simulation", "service"),
    ("driver",),
    ("demo", "report", "closed_loop"),
    ("planned_move",),
    ("cli",),
    ("__main__",),
]
DOORS = {
    "pinocchio": ("hands/coupled_model",),
    "clarabel": ("backends/clarabel", "bench/solvers/clarabel"),
    "proxsuite": ("backends/proxqp", "bench/solvers/proxqp"),
    "qpsolvers": ("backends/qpsolvers",),
    "casadi": ("planning", "bench/casadi_conic"),
    "mujoco": ("simulation",),
    "zenoh": ("service/server", "service/client", "service/session"),
    "typer": ("cli",),
    **{name: (f"bench/solvers/{name}",) for name in ("daqp", "ecos", "osqp", "piqp", "qoco", "quadprog", "scs")},
    "highspy": ("bench/solvers/highs",),
    "matplotlib": ("demo", "plotting", "bench/figures", "planning/plots", "simulation/plots", "simulation/drawn"),
}


def rooms() -> list[tuple[str, Path]]:
    """(room, file) for every module of the package; graspforce/__init__ stands outside, as the list of public names."""
    found = []
    for top in ("graspforce", "service", "problems"):
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            inside = parts[1:] if top == "graspforce" else parts
            if inside != ("__init__",):
                found.append((inside[0], path))
    return found


def imports(path: Path) -> list[str]:
    """Dotted names that a file imports, wherever in it."""
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute, so that this test can read them"
            names.append(node.module)
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def floor_of(room: str) -> int:
    return next(level for level, names in enumerate(FLOORS) if room in names)


@pytest.mark.parametrize(("room", "path"), rooms(), ids=lambda value: value if isinstance(value, str) else value.stem)
def test_no_import_runs_upward(room, path):
    known = {name for names in FLOORS for name in names}
    assert room in known, f"{room} has no floor: give it one in DESIGN and here"
    for name in imports(path):
        parts = name.split(".")
        if parts[0] != "graspforce" or len(parts) == 1 or parts[1] == room or parts[1] not in known:
            continue
        assert floor_of(parts[1]) < floor_of(room), f"{path.relative_to(ROOT)} imports {name}, which is not below it"


@pytest.mark.parametrize(("room", "path"), rooms(), ids=lambda value: value if isinstance(value, str) else value.stem)
def test_each_library_enters_by_one_door(room, path):
    place = path.relative_to(ROOT).with_suffix("").as_posix().removeprefix("graspforce/")
    for name in imports(path):
        doors = DOORS.get(name.split(".")[0])
        if doors is not None:
            assert any(place.startswith(door) for door in doors), f"{place} imports {name}; only {doors} may"


def test_the_service_and_the_problem_library_do_not_know_each_other():
    for room, path in rooms():
        other = {"service": "graspforce.problems", "problems": "graspforce.service"}.get(room)
        assert other is None or not any(name.startswith(other) for name in imports(path))


def test_the_problem_library_never_imports_a_solver():
    for room, path in rooms():
        if room == "problems":
            assert not any(name.startswith(("graspforce.backends", "graspforce.solve")) for name in imports(path))


def test_the_certificate_needs_only_numpy():
    files = (ROOT / "graspforce/certificate.py", ROOT / "graspforce/scale.py")
    outside = {name.split(".")[0] for path in files for name in imports(path)}
    assert outside == {"__future__", "dataclasses", "graspforce", "math", "numpy"}

"""A plan as a file: JSON (the whole record), npz (arrays by name), CSV (one row a time, for spreadsheets and controllers)."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.planning.plan import Plan, Trajectory

FILE_SUFFIXES = (".json", ".csv", ".npz")  # of the files that `save` writes
_AXES = ("x", "y", "z")
_TANGENTS = ("t1", "t2", "n")


def save(plan: Plan, path: str | os.PathLike[str], step: float | None = None) -> None:
    """Write a plan; the file's ending says how.

    Args:
        plan: the plan.
        path: a file that ends in .json, .npz or .csv.
        step: write the states every ``step`` s, and the last one, instead of those at the knots; in .json beside them, as
            ``samples``.

    Raises:
        InvalidInput: another ending, or a step that is not positive.
    """
    path = Path(path)
    sampled = None if step is None else plan.at(sample_times(plan, step))
    trajectory = plan.knots if sampled is None else sampled
    if path.suffix == ".json":
        record = plan.to_dict() if sampled is None else {**plan.to_dict(), "samples": sampled.to_dict()}
        path.write_text(json.dumps(record, allow_nan=False))
    elif path.suffix == ".npz":
        names = [] if plan.task.hand is None else [joint.name for joint in plan.task.hand.joints]
        np.savez_compressed(
            path, joints=np.array(names, dtype=str), **{n: getattr(trajectory, n) for n in trajectory.__slots__}
        )
    elif path.suffix == ".csv":
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(csv_columns(plan))
            writer.writerows(_table(trajectory).tolist())
    else:
        raise InvalidInput("path", path.name, "a file name that ends in .json, .npz or .csv")


def sample_times(plan: Plan, step: float) -> Array:
    """(M,) times every ``step`` s from 0, and the end."""
    step = arrays.check_number(step, "step", above=0.0)
    times = np.arange(0.0, plan.duration, step)
    last = plan.duration - times[-1] <= 1e-9 * step  # the last step ends the move, but for rounding
    return np.append(times[:-1] if last and len(times) > 1 else times, plan.duration)


def csv_columns(plan: Plan) -> list[str]:
    """The names of the columns of a CSV file, with units."""
    task = plan.task
    joints = [] if task.hand is None else [joint.name for joint in task.hand.joints]
    names = ["time [s]"]
    for symbol, unit in (("q", "rad"), ("v", "rad/s"), ("a", "rad/s²"), ("tau", "N·m")):
        names += [f"{symbol} {joint} [{unit}]" for joint in joints]
    if task.contacts is not None:
        for i, model in enumerate(task.contacts.models):
            where = task.fingers[i] if task.fingers else f"contact {i}"
            names += [f"{_COMPONENTS[column]} {where} [{'N·m' if column == 3 else 'N'}]" for column in model.columns]
        names += [f"p_HO {axis} [m]" for axis in _AXES]
        names += [f"R_HO {row}{column}" for row in _AXES for column in _AXES]
        names += [f"velocity {axis} [m/s]" for axis in _AXES] + [f"omega {axis} [rad/s]" for axis in _AXES]
        names += [f"acceleration {axis} [m/s²]" for axis in _AXES] + [f"alpha {axis} [rad/s²]" for axis in _AXES]
        who = [task.fingers[i] if task.fingers else f"contact {i}" for i in range(len(task.contacts))]
        names += [f"p_OC {each} {axis} [m]" for each in who for axis in _AXES]
        names += [f"R_OC {each} {row}{column}" for each in who for row in _AXES for column in _TANGENTS]
    return names


_COMPONENTS = ("f_t1", "f_t2", "f_n", "m_n")


def _table(trajectory: Trajectory) -> Array:
    parts: list[Any] = [trajectory.times[:, None], trajectory.q, trajectory.v, trajectory.a, trajectory.tau, trajectory.f]
    if len(trajectory.p_HO):
        parts += [trajectory.p_HO, trajectory.R_HO.reshape(-1, 9), trajectory.twist, trajectory.acceleration]
        parts += [each.reshape(len(each), -1) for each in (trajectory.p_OC, trajectory.R_OC)]
    return np.hstack(parts)

"""Plans as files: JSON and npz, which can be loaded again, and CSV for other programs."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import numpy as np

from graspforce.core import arrays, fields, json_text
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.whole_file import replace_file, write_text
from graspforce.hand.hand import Hand
from graspforce.planning.plan import Plan
from graspforce.planning.task import HandTask, ObjectTask, task_from_dict
from graspforce.planning.trajectory import Trajectory

FILE_SUFFIXES = (".json", ".csv", ".npz")  # of the files that `save` writes
_LOADABLE_SUFFIXES = (".json", ".npz")
_RECORD, _JOINTS, _KNOTS = "record", "joints", "knots_"  # names of arrays in an npz file: text, names, and prefix
_COMPONENTS = ("f_t1", "f_t2", "f_n", "m_n")
_AXES = ("x", "y", "z")
_TANGENTS = ("t1", "t2", "n")


def save(plan: Plan, path: str | os.PathLike[str], step: float | None = None) -> None:
    """Write a plan to a file; `load` reads it again, except from CSV.

    Args:
        plan: the plan.
        path: the file: .json for the whole record, .npz for one array a quantity, .csv for one row a time. An existing file is
            replaced.
        step: time between the states in the file, s; the last state is included. JSON has them as ``samples``, npz and CSV in
            place of the states at the knots. By default the states at the knots.

    Raises:
        InvalidInput: another suffix, a step that is not positive, or an object whose shape is an implicit surface.
        OSError: the file cannot be written.
    """
    path = Path(path)
    fields.check_choice(path.suffix, "suffix of path", FILE_SUFFIXES)
    sampled = None if step is None else plan.at(sample_times(plan, step))
    if path.suffix == ".json":
        record = _plan_record(plan) | ({} if sampled is None else {"samples": sampled.to_dict()})
        write_text(path, json.dumps(record, allow_nan=False))
    elif path.suffix == ".npz":
        _save_arrays(plan, sampled, path)
    else:
        _save_table(plan, plan.knots if sampled is None else sampled, path)


def load(path: str | os.PathLike[str], hand: Hand | None = None) -> Plan:
    """Return the plan of a JSON or npz file that `save` wrote, with all numbers as they were.

    Args:
        path: the file.
        hand: the hand; by default it is loaded by the name in the file.

    Raises:
        InvalidInput: not such a file, a field is out of range, or the plan is of another hand. CSV files are for other programs
            and cannot be loaded.
        UnknownName: the hand in the file does not ship with graspforce, and ``hand`` is not given.
        OSError: the file cannot be read.
    """
    path = Path(path)
    if path.suffix == ".csv":
        raise InvalidInput("path", path.name, "a .json or .npz file; CSV files lack the task and the check")
    fields.check_choice(path.suffix, "suffix of path", _LOADABLE_SUFFIXES)
    record = json_text.read(path) if path.suffix == ".json" else _load_arrays(path)
    values = dict(fields.check_record(record, "", required=["task", "hand"], optional=None))
    task_record = values.pop("task")
    values.pop("samples", None)
    name = values["hand"]
    if hand is not None and hand.name != name:
        raise InvalidInput("hand", hand.name, f"{name}, the hand of the plan in {path}")
    if hand is None and name is not None:
        hand = Hand.load(fields.check_text(name, "hand"))
    return Plan.from_dict(values, task_from_dict(task_record, hand, "task"))


def sample_times(plan: Plan, step: float) -> Array:
    """Return times every ``step`` s from 0, and the end (M,), s.

    Args:
        plan: the plan.
        step: time between two, s.

    Raises:
        InvalidInput: a step that is not positive.
    """
    step = arrays.check_number(step, "step", above=0.0)
    times = np.arange(0.0, plan.duration, step)
    is_end = plan.duration - times[-1] <= 1e-9 * step  # the last step ends the move within rounding
    return np.append(times[:-1] if is_end and len(times) > 1 else times, plan.duration)


def csv_columns(plan: Plan) -> list[str]:
    """Return the names of the columns of a CSV file, with units.

    Args:
        plan: the plan.
    """
    task = plan.task
    names = ["time [s]"]
    for symbol, unit in (("q", "rad"), ("v", "rad/s"), ("a", "rad/s²"), ("tau", "N·m")):
        names += [f"{symbol} {joint} [{unit}]" for joint in _joint_names(plan)]
    if not isinstance(task, ObjectTask):
        return names
    for contact, model in zip(task.contact_names, task.contacts.models, strict=True):
        names += [f"{_COMPONENTS[column]} {contact} [{'N·m' if column == 3 else 'N'}]" for column in model.columns]
    names += [f"p_HO {axis} [m]" for axis in _AXES]
    names += [f"R_HO {row}{column}" for row in _AXES for column in _AXES]
    names += [f"velocity {axis} [m/s]" for axis in _AXES] + [f"omega {axis} [rad/s]" for axis in _AXES]
    names += [f"acceleration {axis} [m/s²]" for axis in _AXES] + [f"alpha {axis} [rad/s²]" for axis in _AXES]
    names += [f"p_OC {contact} {axis} [m]" for contact in task.contact_names for axis in _AXES]
    names += [f"R_OC {contact} {row}{column}" for contact in task.contact_names for row in _AXES for column in _TANGENTS]
    return names


def _joint_names(plan: Plan) -> list[str]:
    return [joint.name for joint in plan.task.hand.joints] if isinstance(plan.task, HandTask) else []


def _plan_record(plan: Plan) -> JsonRecord:
    """Return the plan as a record with its task."""
    return {**plan.to_dict(), "task": plan.task.to_dict()}


def _save_arrays(plan: Plan, sampled: Trajectory | None, path: Path) -> None:
    """Write an npz file: states at the knots or sampled, and the rest of the record as JSON text."""
    record = _plan_record(plan)
    del record["knots"]
    trajectory = plan.knots if sampled is None else sampled
    states = {name: getattr(trajectory, name) for name in Trajectory.__slots__}
    if sampled is not None:
        states |= {_KNOTS + name: getattr(plan.knots, name) for name in Trajectory.__slots__}
    states |= {_JOINTS: np.array(_joint_names(plan), dtype=str), _RECORD: np.array(json.dumps(record, allow_nan=False))}
    with replace_file(path) as temporary:
        np.savez_compressed(temporary, **states)


def _load_arrays(path: Path) -> JsonRecord:
    """Return the record of an npz file, with the states at the knots as arrays."""
    with np.load(path, allow_pickle=False) as states:
        if _RECORD not in states:
            raise InvalidInput("path", path.name, "a file that `planning.save` wrote")
        record = json_text.decode(str(states[_RECORD]).encode())
        prefix = _KNOTS if f"{_KNOTS}times" in states else ""
        knots = {name: states[prefix + name] for name in Trajectory.__slots__ if prefix + name in states}
    return {**fields.check_record(record, "", optional=None), "knots": knots}


def _save_table(plan: Plan, trajectory: Trajectory, path: Path) -> None:
    """Write a CSV file."""
    at = trajectory
    parts = [at.times[:, None], at.q, at.v, at.a, at.tau, at.f]
    if isinstance(plan.task, ObjectTask):
        parts += [at.p_HO, at.R_HO.reshape(-1, 9), at.twist, at.acceleration]
        parts += [each.reshape(len(each), -1) for each in (at.p_OC, at.R_OC)]
    with replace_file(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(csv_columns(plan))
        writer.writerows(np.hstack(parts).tolist())

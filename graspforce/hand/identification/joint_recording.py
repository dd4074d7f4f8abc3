"""Recordings of joint positions and torques, as files (.npz, .csv) or as text that a driver prints."""

from __future__ import annotations

import csv
import os
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import errors_of_file
from graspforce.core.records import set_fields

_LEAST_SAMPLES = 100  # for a filter window and several directions of motion


@dataclass(frozen=True, eq=False, slots=True)
class JointRecording:
    """Joint positions and motor torques over time.

    Args:
        t: (s,) times, s, increasing.
        q: (s, n) joint positions, rad.
        tau: (s, n) motor torques at the joints, N·m; measured, or commanded if the drives follow commands.
        v: (s, n) joint rates, rad/s; None if they are not measured.

    Raises:
        InvalidInput: lengths differ, a value is not finite, the times do not increase, or there are fewer than 100 samples.
    """

    t: Array
    q: Array
    tau: Array
    v: Array | None = None

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(self, t: npt.ArrayLike, q: npt.ArrayLike, tau: npt.ArrayLike, v: npt.ArrayLike | None = None) -> None: ...

    def __post_init__(self) -> None:
        t, q = arrays.check_array(self.t, "t", (None,)), arrays.check_array(self.q, "q", (None, None))
        if len(t) < _LEAST_SAMPLES:
            raise InvalidInput("t", len(t), f"at least {_LEAST_SAMPLES} samples")
        if (np.diff(t) <= 0.0).any():
            k = int(np.argmax(np.diff(t) <= 0.0)) + 1
            raise InvalidInput(f"t[{k}]", float(t[k]), "later than the sample before")
        shape = (len(t), q.shape[1])
        set_fields(self, t=t, q=arrays.check_array(q, "q", shape), tau=arrays.check_array(self.tau, "tau", shape))
        if self.v is not None:
            set_fields(self, v=arrays.check_array(self.v, "v", shape))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])


def load_joint_recording(path: str | os.PathLike[str], joints: Sequence[str]) -> JointRecording:
    """Load a recording from a file.

    An .npz file has the arrays `t`, `q`, `tau` and optionally `v`, as a saved simulation has them. Other files are
    text, see `read_joint_recording`.

    Args:
        path: the file.
        joints: names of the hand's actuated joints, which order the columns.

    Raises:
        InvalidInput: the file cannot be read, an array or a column is missing, or a value is not a number.
    """
    path = Path(path)
    try:
        if path.suffix == ".npz":
            with np.load(path) as file:
                missing = [name for name in ("t", "q", "tau") if name not in file.files]
                if missing:
                    raise InvalidInput("recording", str(path), f"an .npz file with the array {missing[0]!r}")
                return JointRecording(file["t"], file["q"], file["tau"], file["v"] if "v" in file.files else None)
        with path.open(encoding="utf-8", newline="") as lines, errors_of_file(path):
            return read_joint_recording(lines, joints)
    except (OSError, UnicodeDecodeError, zipfile.BadZipFile, ValueError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput("recording", str(path), f"a readable file: {error}") from None


def read_joint_recording(lines: Iterable[str], joints: Sequence[str]) -> JointRecording:
    """Read a recording from comma-separated lines, such as a driver's output.

    The first line names the columns: `t`, and for each joint `q_<joint>`, `tau_<joint>` and optionally `v_<joint>`, with the
    joint's name or its index from 0. Other columns are ignored.

    Args:
        lines: the lines.
        joints: names of the hand's actuated joints, which order the columns.

    Raises:
        InvalidInput: a column is missing, or a value is not a number; names the line.
    """
    reader = csv.reader(lines)
    header = [name.strip() for name in next(reader, [])]
    columns = {"t": [_column(header, ("t",))]}
    for quantity in ("q", "tau", "v"):
        names = [(f"{quantity}_{joint}", f"{quantity}_{i}") for i, joint in enumerate(joints)]
        if quantity == "v" and not any(name in header for pair in names for name in pair):
            continue
        columns[quantity] = [_column(header, pair) for pair in names]
    values: dict[str, list[list[float]]] = {quantity: [] for quantity in columns}
    for number, row in enumerate(reader, start=2):
        if not row:
            continue
        for quantity, indices in columns.items():
            values[quantity].append([_number(row, i, number, header) for i in indices])
    rates = values.get("v")
    return JointRecording(np.array(values["t"]).reshape(-1), values["q"] or np.zeros((0, 1)), values["tau"], rates)


def _number(row: Sequence[str], column: int, line: int, header: Sequence[str]) -> float:
    """Return the number in a column of a row."""
    if column >= len(row):
        raise InvalidInput(f"recording line {line}", ",".join(row), f"{len(header)} numbers")
    try:
        return float(row[column])
    except ValueError:
        raise InvalidInput(f"recording line {line}, column {header[column]}", row[column], "a number") from None


def _column(header: Sequence[str], names: Sequence[str]) -> int:
    """Return the index of the first of some columns that exists."""
    for name in names:
        if name in header:
            return header.index(name)
    raise InvalidInput("recording", ", ".join(header), f"a table with the column {' or '.join(names)}")

"""Grasp postures from files of other programs: dictionaries of BODex and DexGraspBench (.npy), and tables (.csv).

A .npy file holds one pickled dictionary. `load_postures` reads these of its fields, with poses as x, y, z, qw, qx, qy, qz:

- `grasp_qpos`: pose of the hand's root link and joint positions of one grasp, (7 + k,), or of several, (N, 7 + k). Or the joint
  positions alone, with the pose in `grasp_pose`.
- `robot_pose`, of raw files: (1, N, M, 7 + k) for M stages. The grasp is the second of three stages. More stages end with
  grasp, squeeze and lift.
- `obj_pose`: pose of the object, (7,). `obj_scale`: scale of the object's mesh. `joint_names`: names of the k joints.

The pickle is read by rules that admit arrays and plain values only, so a file cannot run code. Source: Chen, Ke and Wang
(2024), and the converters of DexGraspBench.
"""

from __future__ import annotations

import csv
import os
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, MissingField
from graspforce.core.json_text import errors_of_file
from graspforce.geometry.poses import pose_from_dict
from graspforce.hand.hand import Hand

_POSE_COLUMNS = ("x", "y", "z", "qw", "qx", "qy", "qz")
_UNPICKLED = {  # what arrays and their scalars are pickled with
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
    ("numpy._core.numeric", "_frombuffer"),
    ("_codecs", "encode"),
}


@dataclass(frozen=True, eq=False, slots=True)
class RecordedPosture:
    """A posture of a hand with an object, as a file states it; `Grasp.from_posture` makes a grasp of it.

    Attributes:
        q: (n,) joint positions, rad.
        p_HO: (3,) position of the object in H, m.
        R_HO: (3, 3) axes of the object in H.
        scale: scale of the object's mesh; None if the file states none.
    """

    q: Array
    p_HO: Array
    R_HO: Array
    scale: float | None = None


def load_postures(
    path: str | os.PathLike[str], hand: Hand, *, joints: Sequence[str] | None = None, root: str | None = None
) -> list[RecordedPosture]:
    """Load the postures of a file.

    A .csv file has a column for each joint, by name, and the columns x, y, z (m), qw, qx, qy, qz: the pose of the object in the
    frame of the root link. Each row is a posture. Other columns are ignored.

    Args:
        path: a .npy or .csv file.
        hand: the hand. The file may name further joints, such as those that follow others.
        joints: names of the joints in the order of the .npy file; by default its `joint_names`, or the hand's own order.
        root: URDF link whose pose the file states; by default the hand's base H.

    Raises:
        InvalidInput: not such a file, a field is missing or has another shape, or a joint of the hand is missing.
        UnknownName: the hand has no such link.
        OSError: the file cannot be read.
    """
    path = Path(path)
    if root is not None:
        hand.contact_frame_id(root, "root")
    if path.suffix.lower() == ".csv":
        with errors_of_file(path):
            return _read_table(path, hand, root)
    if path.suffix.lower() != ".npy":
        raise InvalidInput("path", str(path), "a .npy or .csv file")
    record = _load_dictionary(path)
    poses, positions = _grasp_fields(record)
    if "obj_pose" not in record:
        raise MissingField("obj_pose", "the pose of the object, x, y, z, qw, qx, qy, qz")
    object_pose = _array(record, "obj_pose").reshape(-1)
    names = joints if joints is not None else _names(record)
    order = _joint_order(hand, names, positions.shape[1], "joint_names" if joints is None else "joints")
    scale = None if record.get("obj_scale") is None else float(_array(record, "obj_scale").reshape(-1)[0])
    p_WO, R_WO = _pose(object_pose, "obj_pose")
    found = []
    for i, (pose, values) in enumerate(zip(poses, positions, strict=True)):
        p_WR, R_WR = _pose(pose, f"grasp_qpos[{i}]")
        q = freeze(values[order])
        found.append(RecordedPosture(q, *_from_root(hand, q, root, R_WR.T @ (p_WO - p_WR), R_WR.T @ R_WO), scale))
    return found


def _grasp_fields(record: Mapping[str, Any]) -> tuple[Array, Array]:
    """Return the root poses (N, 7) and joint positions (N, k) of the grasps."""
    if "robot_pose" in record:
        stages = _array(record, "robot_pose")
        if stages.ndim != 4 or stages.shape[0] != 1 or stages.shape[2] < 3 or stages.shape[3] < 8:
            allowed = "an array of shape (1, N, M, 7 + k) with at least three stages M"
            raise InvalidInput("robot_pose", stages.shape, allowed)
        grasps = stages[0, :, 1 if stages.shape[2] == 3 else -3]
        return grasps[:, :7], grasps[:, 7:]
    if "grasp_qpos" not in record:
        raise MissingField("grasp_qpos", "the pose of the hand's root link and its joint positions")
    values = _array(record, "grasp_qpos")
    if "grasp_pose" in record:
        return np.atleast_2d(_array(record, "grasp_pose")), np.atleast_2d(values)
    if values.ndim not in (1, 2) or values.shape[-1] < 8:
        raise InvalidInput("grasp_qpos", values.shape, "an array of shape (7 + k,) or (N, 7 + k)")
    rows = np.atleast_2d(values)
    return rows[:, :7], rows[:, 7:]


def _array(record: Mapping[str, Any], name: str) -> Array:
    """Return a field as an array of finite numbers."""
    try:
        values = np.asarray(record[name], dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidInput(name, record[name], "an array of numbers") from None
    if not np.isfinite(values).all():
        raise InvalidInput(name, values, "finite numbers")
    return values


def _names(record: Mapping[str, Any]) -> list[str] | None:
    names = record.get("joint_names")
    return None if names is None else [str(name) for name in np.asarray(names).reshape(-1).tolist()]


def _joint_order(hand: Hand, names: Sequence[str] | None, count: int, field: str) -> list[int]:
    """Return the column of each of the hand's joints."""
    own = [joint.name for joint in hand.joints]
    if names is None:
        if count != len(own):
            allowed = f"{len(own)} joint positions in the hand's order, or given with the names of the joints"
            raise InvalidInput("grasp_qpos", f"{count} joint positions", allowed)
        return list(range(count))
    if len(names) != count:
        raise InvalidInput(field, names, f"{count} names, one for each joint position")
    for name in own:
        if name not in names:
            raise InvalidInput(field, names, f"names with all joints of {hand.name}: {name} is missing")
    return [list(names).index(name) for name in own]


def _pose(values: Array, field: str) -> tuple[Array, Array]:
    """Return position and axes of x, y, z, qw, qx, qy, qz; a quaternion in single precision is normalised."""
    if values.shape != (7,):
        raise InvalidInput(field, values, "x, y, z, qw, qx, qy, qz")
    length = float(np.linalg.norm(values[3:]))
    if not 0.99 < length < 1.01:
        raise InvalidInput(field, values, f"a pose whose quaternion has length 1, not {length:.3g}")
    p, R, _ = pose_from_dict({"position": values[:3], "quaternion": values[3:] / length}, field)
    return p, R


def _from_root(hand: Hand, q: Array, root: str | None, p_RO: Array, R_RO: Array) -> tuple[Array, Array]:
    """Return the object's pose in H from its pose in the frame of a link."""
    if root is None:
        return freeze(p_RO), freeze(R_RO)
    p_HR, R_HR = hand.link_poses(q)[root]
    return freeze(p_HR + R_HR @ p_RO), freeze(R_HR @ R_RO)


def _read_table(path: Path, hand: Hand, root: str | None) -> list[RecordedPosture]:
    """Read the rows of a .csv file."""
    with path.open(encoding="utf-8", newline="") as lines:
        reader = csv.DictReader(lines)
        header = [name.strip() for name in reader.fieldnames or ()]
        reader.fieldnames = header
        needed = [*(joint.name for joint in hand.joints), *_POSE_COLUMNS]
        for name in needed:
            if name not in header:
                raise InvalidInput("columns", ", ".join(header), f"a table with the column {name}")
        found = []
        for row in reader:
            line = f"line {reader.line_num}"
            values = np.array([_number(row, name, line) for name in needed])
            q = arrays.check_array(values[: hand.n], line, (hand.n,))
            found.append(RecordedPosture(q, *_from_root(hand, q, root, *_pose(values[hand.n :], line))))
    return found


def _number(row: Mapping[str, Any], column: str, line: str) -> float:
    """Return the number in a column of a row; `line` names the row in errors."""
    try:
        return float(row[column])
    except (TypeError, ValueError):
        raise InvalidInput(f"{line}, column {column}", row[column], "a number") from None


def _load_dictionary(path: Path) -> Mapping[str, Any]:
    """Return the dictionary of a .npy file without running code of the file."""
    allowed = "a .npy file that holds one dictionary"
    try:
        with path.open("rb") as file:
            version = np.lib.format.read_magic(file)
            readers: dict[tuple[int, int], Callable[[IO[bytes]], tuple[tuple[int, ...], bool, Any]]] = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }
            shape, _, dtype = readers[version](file)
            if shape != () or not dtype.hasobject:
                raise InvalidInput("path", str(path), allowed)
            record = _ArrayUnpickler(file).load()
    except (ValueError, KeyError, EOFError, AttributeError, pickle.UnpicklingError, UnicodeDecodeError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput("path", str(path), f"{allowed}: {error}") from None
    while isinstance(record, np.ndarray) and record.shape == ():
        record = record.item()
    if not isinstance(record, Mapping):
        raise InvalidInput("path", str(path), allowed)
    return record


class _ArrayUnpickler(pickle.Unpickler):
    """Reads pickles of arrays and plain values, and refuses every other class or function."""

    def find_class(self, module: str, name: str) -> Any:
        module = module.replace("numpy.core.", "numpy._core.")  # the name before NumPy 2
        if (module, name) not in _UNPICKLED:
            raise pickle.UnpicklingError(f"{module}.{name} is not allowed in it")
        return super().find_class(module, name)

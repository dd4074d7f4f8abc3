"""Libraries of postures: joint positions by joint name, with the object's name and size, as CSV or Parquet files.

A table has a column for each joint, rad, and may have the columns `object` (its name) and `opposition`, `ventral`, `lateral`
(its size along these directions of the hand, m). Each row is a posture. Postures of grasps also have the columns x, y, z (m),
qw, qx, qy, qz: the pose of the object in H. Such a CSV file is also read by `graspforce.grasp.posture_files.load_postures`.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import errors_of_file
from graspforce.core.optional_libraries import optional_imports
from graspforce.core.records import set_fields
from graspforce.core.whole_file import replace_file, write_text
from graspforce.geometry import Solid
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search.batch_kinematics import BatchKinematics
from graspforce.grasp.search.goal import hull_points
from graspforce.hand.hand import Hand

SIZE_COLUMNS = ("opposition", "ventral", "lateral")
_POSE_COLUMNS = ("x", "y", "z", "qw", "qx", "qy", "qz")
_OBJECT_COLUMN = "object"
_ROUNDING = 1e-9  # s
_PARALLEL = 1e-6  # smaller part of a unit vector across another: they count as parallel
_RESERVED = (_OBJECT_COLUMN, *SIZE_COLUMNS, *_POSE_COLUMNS)


@dataclass(frozen=True, eq=False, slots=True)
class PostureLibrary:
    """Recorded postures of a hand.

    Args:
        joints: names of the n joints.
        q: (N, n) joint positions, rad; m of prismatic joints.
        objects: name of the object of each posture; empty if unknown.
        sizes: (N, 3) size of the object along opposition (between the opposed fingers), ventral (towards the palm) and lateral
            direction, m; None if unknown.
        poses: (N, 7) pose of the object in H: x, y, z (m), qw, qx, qy, qz; None if unknown.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    joints: tuple[str, ...]
    q: Array
    objects: tuple[str, ...] = ()
    sizes: Array | None = None
    poses: Array | None = None

    def __post_init__(self) -> None:
        joints = tuple(self.joints)
        if not joints or len(set(joints)) < len(joints) or set(joints) & set(_RESERVED):
            raise InvalidInput("joints", joints, f"different names, other than {', '.join(_RESERVED)}")
        q = arrays.check_array(self.q, "q", (None, len(joints)))
        N, objects = len(q), tuple(self.objects)
        if objects and len(objects) != N:
            raise InvalidInput("objects", f"{len(objects)} names", f"{N} names, one for each posture, or none")
        sizes = None if self.sizes is None else arrays.check_array(self.sizes, "sizes", (N, 3), minimum=0.0)
        poses = None if self.poses is None else arrays.check_array(self.poses, "poses", (N, 7))
        set_fields(self, joints=joints, q=q, objects=objects, sizes=sizes, poses=poses)

    def __len__(self) -> int:
        return len(self.q)

    @classmethod
    def from_grasps(cls, grasps: Iterable[Grasp], objects: Sequence[str] = ()) -> PostureLibrary:
        """Return the postures of grasps of one hand, with sizes and poses of their objects.

        Args:
            grasps: the grasps; their bodies have shapes.
            objects: name of each object, or none.

        Raises:
            InvalidInput: no grasp, grasps of hands with different joints, or a body without shape.
        """
        every = list(grasps)
        if not every:
            raise InvalidInput("grasps", every, "at least one grasp")
        names = [tuple(joint.name for joint in grasp.hand.joints) for grasp in every]
        if len(set(names)) > 1:
            raise InvalidInput("grasps", [grasp.hand.name for grasp in every], "grasps of one hand")
        sizes = np.array([object_size(grasp) for grasp in every])
        poses = np.array([_pose_row(grasp) for grasp in every])
        return cls(names[0], np.array([grasp.q for grasp in every]), tuple(objects), freeze(sizes), freeze(poses))

    @classmethod
    def from_motion(
        cls, joints: Sequence[str], t: npt.ArrayLike, q: npt.ArrayLike, every: float = 0.1, least_change: float = 0.02
    ) -> PostureLibrary:
        """Return postures of a recorded motion, such as that of a stream or a glove, without repetitions at rest.

        Args:
            joints: names of the n joints.
            t: (T,) times, s, in order.
            q: (T, n) joint positions, rad.
            every: least time between two postures, s, > 0.
            least_change: a posture is kept if a joint differs by more from the last kept one, rad, ≥ 0.

        Raises:
            InvalidInput: names the field and what is allowed.
        """
        times = arrays.check_array(t, "t", (None,))
        postures = arrays.check_array(q, "q", (len(times), len(tuple(joints))))
        every = arrays.check_number(every, "every", above=0.0)
        least_change = arrays.check_number(least_change, "least_change", minimum=0.0)
        kept: list[int] = []
        for i, now in enumerate(times.tolist()):
            if kept and now < times[kept[-1]] + every - _ROUNDING:
                continue
            if not kept or np.abs(postures[i] - postures[kept[-1]]).max() > least_change:
                kept.append(i)
        return cls(tuple(joints), freeze(postures[kept]))

    def for_hand(self, hand: Hand) -> PostureLibrary:
        """Return the library with the joints of a hand, in its order.

        Args:
            hand: the hand.

        Raises:
            InvalidInput: a joint of the hand is missing.
        """
        names = [joint.name for joint in hand.joints]
        for name in names:
            if name not in self.joints:
                raise InvalidInput("joints", self.joints, f"names with all joints of {hand.name}: {name} is missing")
        columns = [self.joints.index(name) for name in names]
        return PostureLibrary(tuple(names), freeze(self.q[:, columns]), self.objects, self.sizes, self.poses)

    def joined(self, other: PostureLibrary) -> PostureLibrary:
        """Return the postures of both libraries. Names, sizes and poses are kept if both have them.

        Args:
            other: a library with the same joints, in the same order.

        Raises:
            InvalidInput: the joints differ.
        """
        if other.joints != self.joints:
            raise InvalidInput("other.joints", other.joints, f"the joints {', '.join(self.joints)}")
        return PostureLibrary(
            self.joints,
            freeze(np.vstack([self.q, other.q])),
            self.objects + other.objects if self.objects and other.objects else (),
            _stacked(self.sizes, other.sizes),
            _stacked(self.poses, other.poses),
        )

    # ── files ──────────────────────────────────────────────────────────────────────────────────────────────────────────────

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a .csv or .parquet file.

        Args:
            path: the file. Parquet needs ``pip install "graspforce[learn]"``.

        Raises:
            InvalidInput: another suffix.
            MissingLibrary: pyarrow is not installed.
            OSError: the file cannot be written.
        """
        columns = self._columns()
        if _suffix(path) == ".csv":
            text = io.StringIO()
            writer = csv.writer(text, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
            write_text(path, text.getvalue())
            return
        pyarrow, parquet = _parquet_library()
        with replace_file(path) as temporary:
            parquet.write_table(pyarrow.table(columns), temporary)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> PostureLibrary:
        """Read a .csv or .parquet file. Columns with other names than those of objects, sizes and poses are joints.

        Args:
            path: the file.

        Raises:
            InvalidInput: another suffix, or values that are not numbers; names the column.
            MissingLibrary: pyarrow is not installed.
            OSError: the file cannot be read.
        """
        suffix = _suffix(path)
        with errors_of_file(path):
            return cls._read(path, suffix)

    @classmethod
    def _read(cls, path: str | os.PathLike[str], suffix: str) -> PostureLibrary:
        """Read a file with a suffix, as `load`."""
        lines: Sequence[int] | None = None
        if suffix == ".csv":
            with Path(path).open(encoding="utf-8", newline="") as text:
                reader = csv.DictReader(text)
                rows, lines = [], []
                for row in reader:
                    rows.append(row)
                    lines.append(reader.line_num)
                columns: Mapping[str, Sequence[Any]] = {
                    str(name).strip(): [row[name] for row in rows] for name in reader.fieldnames or ()
                }
        else:
            _, parquet = _parquet_library()
            try:
                columns = parquet.read_table(path).to_pydict()
            except ValueError as error:  # of pyarrow: not such a file
                raise InvalidInput("path", str(path), f"a Parquet file: {error}") from None
        joints = tuple(name for name in columns if name not in _RESERVED)
        names = tuple(str(name) for name in columns.get(_OBJECT_COLUMN, ()))
        sizes, poses = (_optional(columns, each, lines) for each in (SIZE_COLUMNS, _POSE_COLUMNS))
        return cls(joints, _numbers(columns, joints, lines), names, sizes, poses)

    def _columns(self) -> dict[str, list[Any]]:
        """Return the columns of the table."""
        columns: dict[str, list[Any]] = {}
        if self.objects:
            columns[_OBJECT_COLUMN] = list(self.objects)
        for names, values in ((self.joints, self.q), (SIZE_COLUMNS, self.sizes), (_POSE_COLUMNS, self.poses)):
            if values is not None:
                columns.update(zip(names, values.T.tolist(), strict=True))
        return columns


def object_size(grasp: Grasp) -> Array:
    """Return the size of a held object along opposition, ventral and lateral direction, (3,), m.

    The opposition direction leads to the contact furthest from the mean of the others, from that mean. The ventral direction
    is perpendicular to it and nearest to the mean direction from the fingers' bases to their tips in the neutral posture. The
    lateral direction is perpendicular to both. The size is the extent of the convex hull of the shape.

    Args:
        grasp: the grasp; its body has a shape.

    Raises:
        InvalidInput: the body has no such shape.
    """
    shape = grasp.body.shape
    if not isinstance(shape, Solid):
        raise InvalidInput("grasp.body.shape", shape, "a sphere, cylinder, box, superquadric or mesh")
    p = grasp.contacts.p_OC @ grasp.R_HO.T
    spread = [p[i] - np.delete(p, i, axis=0).mean(axis=0) for i in range(len(p))]
    opposition = max(spread, key=lambda v: float(np.linalg.norm(v)))
    opposition = opposition / np.linalg.norm(opposition)
    ventral = finger_direction(grasp.hand)
    ventral = ventral - (ventral @ opposition) * opposition
    if np.linalg.norm(ventral) < _PARALLEL:
        ventral = np.cross(opposition, np.eye(3)[np.abs(opposition).argmin()])
    ventral = ventral / np.linalg.norm(ventral)
    axes = np.column_stack([opposition, ventral, np.cross(opposition, ventral)])
    return freeze(np.ptp(hull_points(shape) @ grasp.R_HO.T @ axes, axis=0))


@lru_cache(maxsize=8)
def finger_direction(hand: Hand) -> Array:
    """Return the mean direction from the fingers' bases to their tips in the neutral posture, (3,), in H.

    Args:
        hand: the hand.
    """
    kinematics = BatchKinematics(hand)
    bases = hand.model.joint_origins(hand.neutral)[kinematics.first_links]
    direction = kinematics.evaluate(hand.neutral[None]).tip_centres[0].mean(axis=0) - bases.mean(axis=0)
    return freeze(direction / np.linalg.norm(direction))


def _pose_row(grasp: Grasp) -> list[float]:
    from scipy.spatial.transform import Rotation  # imported here to keep the package fast to import

    x, y, z, w = Rotation.from_matrix(grasp.R_HO).as_quat().tolist()
    return [*grasp.p_HO.tolist(), w, x, y, z]


def _stacked(a: Array | None, b: Array | None) -> Array | None:
    return None if a is None or b is None else freeze(np.vstack([a, b]))


def _suffix(path: str | os.PathLike[str]) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in (".csv", ".parquet"):
        raise InvalidInput("path", str(path), "a .csv or .parquet file")
    return suffix


def _parquet_library() -> tuple[Any, Any]:
    with optional_imports():
        import pyarrow
        from pyarrow import parquet
    return pyarrow, parquet


def _numbers(columns: Mapping[str, Sequence[Any]], names: Sequence[str], lines: Sequence[int] | None) -> Array:
    """Return columns of numbers as an array (N, k); `lines` are the numbers of their lines in a text file."""
    if not names:
        raise InvalidInput("columns", ", ".join(columns), "a table with a column for each joint")
    values = []
    for name in names:
        column = []
        for i, value in enumerate(columns[name]):
            try:
                column.append(float(value))
            except (TypeError, ValueError):
                place = f"row {i + 1}" if lines is None else f"line {lines[i]}"
                raise InvalidInput(f"{place}, column {name}", value, "a number") from None
        values.append(column)
    return freeze(np.array(values).T.reshape(-1, len(names)))


def _optional(columns: Mapping[str, Sequence[Any]], names: Sequence[str], lines: Sequence[int] | None) -> Array | None:
    """Return columns of numbers, or None if one of them is absent."""
    return _numbers(columns, names, lines) if all(name in columns for name in names) else None

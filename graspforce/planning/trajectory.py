"""States of a hand and an object, sampled over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.planning.task import FingerTask, Task


@dataclass(frozen=True, eq=False, slots=True)
class Trajectory:
    """States at M times. Arrays over joints have no columns without a hand; those of the object are empty without one.

    Args:
        times: (M,) times, s.
        q: (M, n) joint positions, rad.
        v: (M, n) joint velocities, rad/s.
        a: (M, n) joint accelerations, rad/s².
        tau: (M, n) motor torques, N·m.
        f: (M, k) stacked contact forces in the contact frames, N and N·m.
        p_HO: (M, 3) positions of the object in H, m; M = 0 without an object, here and below.
        R_HO: (M, 3, 3) its orientations.
        twist: (M, 6) its velocities (ṗ, ω) in H's axes, m/s and rad/s.
        acceleration: (M, 6) its accelerations (p̈, ω̇) in H's axes, m/s² and rad/s².
        p_OC: (M, N, 3) contact positions in O, m; they move where contacts roll.
        R_OC: (M, N, 3, 3) contact frames in O.
        p_OC_d: (M, N, 3) velocities of the contacts over the object, in O, m/s.
    """

    times: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    f: Array
    p_HO: Array
    R_HO: Array
    twist: Array
    acceleration: Array
    p_OC: Array
    R_OC: Array
    p_OC_d: Array

    def __repr__(self) -> str:
        span = f" from {self.times[0]:.4g} to {self.times[-1]:.4g} s" if len(self.times) else ""
        return f"<Trajectory: {len(self.times)} states{span}>"

    @classmethod
    def of_joints(cls, times: Array, q: Array, v: Array, a: Array) -> Trajectory:
        """Return states of fingers alone; their torques are zero.

        Args:
            times: (M,) times, s.
            q: (M, n) joint positions, rad.
            v: (M, n) joint velocities, rad/s.
            a: (M, n) joint accelerations, rad/s².
        """
        no_object = (np.zeros((0, *shape)) for shape in ((3,), (3, 3), (6,), (6,), (0, 3), (0, 3, 3), (0, 3)))
        return cls(times, q, v, a, np.zeros(q.shape), np.zeros((len(times), 0)), *no_object)

    @classmethod
    def from_dict(cls, record: object, task: Task, field: str = "") -> Trajectory:
        """Return the trajectory of a record.

        Args:
            record: mapping that `to_dict` made.
            task: the task, which gives the shapes of the arrays.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=cls.__slots__)
        path = f"{field}." if field else ""
        times = arrays.check_array(values["times"], f"{path}times", (None,))
        if len(times) < 2 or times[0] != 0.0 or (np.diff(times) <= 0.0).any():
            raise InvalidInput(f"{path}times", times, "at least two times, increasing from 0")
        shapes = _shapes(task, len(times))
        return cls(times, **{name: _check_table(values[name], f"{path}{name}", shape) for name, shape in shapes.items()})

    def to_dict(self) -> JsonRecord:
        """Return the trajectory as a record of lists."""
        return {name: getattr(self, name).tolist() for name in self.__slots__}

    def frozen(self) -> Trajectory:
        """Return the trajectory with read-only arrays."""
        return Trajectory(*(arrays.freeze(getattr(self, name)) for name in self.__slots__))


def _shapes(task: Task, count: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of a trajectory except the times."""
    n, M = task.joint_count, 0 if isinstance(task, FingerTask) else count
    N = len(task.contact_names)
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("q", "v", "a", "tau"), (count, n))
    shapes |= {"f": (count, task.force_size), "p_HO": (M, 3), "R_HO": (M, 3, 3), "twist": (M, 6), "acceleration": (M, 6)}
    return shapes | {"p_OC": (M, N, 3), "R_OC": (M, N, 3, 3), "p_OC_d": (M, N, 3)}


def _check_table(value: object, field: str, shape: tuple[int, ...]) -> Array:
    """Return an array of a shape. Lists without numbers do not state all dimensions, and are accepted for any of size zero."""
    if isinstance(value, np.ndarray) or 0 not in shape:
        return arrays.check_array(value, field, shape)
    if any(fields.check_sequence(value, field)):
        return arrays.check_array(value, field, shape)
    return arrays.freeze(np.zeros(shape))

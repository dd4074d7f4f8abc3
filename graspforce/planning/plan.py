"""A planned move: its states at the knots and between them, its check, and the statistics of its planning."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from dataclasses import fields as dataclass_fields
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.lazy import plot_with
from graspforce.core.text_table import Table
from graspforce.geometry.hermite import Ends, hermite, locate_intervals
from graspforce.planning.interpolation import Indices, hermite_cubic, hermite_rotation
from graspforce.planning.task import FingerTask, GraspTask, HandTask, ObjectTask, Task
from graspforce.planning.tip_contacts import contact_frames
from graspforce.planning.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "graspforce/plan/1"
LIMIT_WORDS = {  # names of the excesses of a check
    "slip": "friction",
    "normal": "normal force",
    "torque": "motor torque",
    "speed": "joint speed",
    "position": "joint position",
    "acceleration": "acceleration",
}
_DRIFT_TOLERANCE = 1e-6  # m: accuracy of the hand's inverse kinematics
_MAX_COUNT = 2**31


@dataclass(frozen=True, eq=False, slots=True)
class PlanCheck:
    """The check of a plan between its knots.

    Excesses are relative to the limit, the largest anywhere, and negative if all values stay inside. Forces are the plan's
    own, linear between knots, with the smallest correction that gives the wrench which the interpolated motion requires.

    Args:
        slip: load plus slip margin beyond μ f_n, relative to the largest friction of the contact in the move.
        normal: normal force beyond its limits.
        torque: motor torque beyond its limits.
        speed: joint speed beyond its limit.
        position: joint position beyond its limits, relative to its range.
        acceleration: acceleration or jerk of object or joints beyond its limit.
        drift: largest contact error, m: distance from the surface, slip, or distance from the planned contact.
        unmet: largest part of the wrench that the contacts cannot supply, relative to the largest wrench of the move.
        imbalance: wrench that the plan's own forces miss between knots, likewise; a controller supplies it. Not judged.
        samples: number of instants that were checked.
        tolerance: largest allowed excess.
    """

    slip: float
    normal: float
    torque: float
    speed: float
    position: float
    acceleration: float
    drift: float
    unmet: float
    imbalance: float
    samples: int
    tolerance: float

    @property
    def excess(self) -> float:
        """Return the largest of all excesses."""
        return max(self.slip, self.normal, self.torque, self.speed, self.position, self.acceleration)

    @property
    def verified(self) -> bool:
        """Return whether limits and wrenches hold within the tolerance, and contacts within a micrometre."""
        return max(self.excess, self.unmet) <= self.tolerance and self.drift <= _DRIFT_TOLERANCE

    @classmethod
    def not_made(cls, tolerance: float) -> PlanCheck:
        """Return the check of a plan that was not checked: all excesses are infinite.

        Args:
            tolerance: largest allowed excess.
        """
        return cls(*(np.inf,) * 9, samples=0, tolerance=tolerance)

    @classmethod
    def from_dict(cls, record: object, field: str = "") -> PlanCheck:
        """Return the check of a record.

        Args:
            record: mapping that `to_dict` made.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        names = list(cls.__slots__)
        required = [name for name in names if name != "acceleration"]  # records of 0.2 have no such field
        values = {"acceleration": None, **fields.check_record(record, field, required=["verified", *required], optional=names)}
        counts = _check_counts(values, field, ["samples"])
        given = {name: values[name] for name in names if values[name] is not None}
        missing = {name: -np.inf for name in names if values[name] is None}
        return cls(**{**missing, **_check_numbers(given, field), **counts})

    def to_dict(self) -> JsonRecord:
        """Return the check as a record for JSON; an excess without a limit is null, and that of accelerations is left out."""
        values = {name: getattr(self, name) for name in self.__slots__}
        if values["acceleration"] == -np.inf:  # readers of the first edition know no such field
            del values["acceleration"]
        return {"verified": self.verified, **{name: None if x == -np.inf else x for name, x in values.items()}}


@dataclass(frozen=True, slots=True)
class PlanningStatistics:
    """Time and work of planning.

    Args:
        path: time for the joints' path, s.
        dynamics: time for the equations of motion, s.
        building: time for the rows of the program, s.
        solver: time of the solver, s.
        check: time of the check, s.
        solves: number of programs that were solved.
        iterations: iterations of the last one.
    """

    path: float
    dynamics: float
    building: float
    solver: float
    check: float
    solves: int
    iterations: int

    @property
    def seconds(self) -> float:
        """Return the time of planning, s."""
        return self.path + self.dynamics + self.building + self.solver + self.check

    @classmethod
    def from_dict(cls, record: object, field: str = "") -> PlanningStatistics:
        """Return the statistics of a record.

        Args:
            record: mapping that `to_dict` made.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=[each.name for each in dataclass_fields(cls)])
        return cls(**{**_check_numbers(values, field), **_check_counts(values, field, ["solves", "iterations"])})

    def to_dict(self) -> JsonRecord:
        """Return the statistics as a record for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Plan:
    """A checked move from rest to rest.

    Args:
        task: the task.
        knots: states at the knots.
        check: the check between the knots.
        optimality_gap: bound on the possible reduction of the duration on this grid, relative to it; NaN for a local optimum,
            which has no such bound.
        statistics: time and work of planning.
        s: (K,) path parameters of the knots; empty if no path was given.
        stopped: True if the budget or the callback ended the search.
    """

    task: Task
    knots: Trajectory
    check: PlanCheck
    optimality_gap: float
    statistics: PlanningStatistics
    s: Array
    stopped: bool = False
    found: ClassVar[bool] = True

    def __repr__(self) -> str:
        return f"<{self._summary()}>"

    def __str__(self) -> str:
        return str(self._table())

    def _repr_html_(self) -> str:
        return self._table().to_html()

    @property
    def duration(self) -> float:
        """Return the duration T, s."""
        return float(self.knots.times[-1])

    def at(self, times: npt.ArrayLike) -> Trajectory:
        """Return the states at given times.

        Positions are quintic Hermite polynomials through the states at the knots, contact positions cubic ones. Forces and
        torques are linear between knots: cones and limits are convex, so that values between two allowed ones are allowed.

        Args:
            times: (M,) times from 0 to T, s.

        Raises:
            InvalidInput: a time outside this range.
        """
        times, knots = arrays.check_array(times, "times", (None,)), self.knots
        if len(times) and (times.min() < 0.0 or times.max() > self.duration * (1.0 + 1e-12)):
            raise InvalidInput("times", times, f"between 0 and the duration, {self.duration:.9g} s")
        i, u = locate_intervals(knots.times, times)
        step = knots.times[i + 1] - knots.times[i]

        q, v, a = hermite(u, step, _end_states(knots.q, knots.v, knots.a, i))
        tau, f = (x[i] + u[:, None] * (x[i + 1] - x[i]) for x in (knots.tau, knots.f))
        if isinstance(self.task, FingerTask):
            return replace(knots, times=times, q=q, v=v, a=a, tau=tau, f=f)
        p, p_d, p_dd = hermite(u, step, _end_states(knots.p_HO, knots.twist[:, :3], knots.acceleration[:, :3], i))
        R, omega, alpha = hermite_rotation(u, step, _end_states(knots.R_HO, *self._angular_rates, i))
        omega_H, alpha_H = ((R @ x[:, :, None])[:, :, 0] for x in (omega, alpha))
        p_OC, p_OC_d = hermite_cubic(u, step, (knots.p_OC[i], knots.p_OC_d[i], knots.p_OC[i + 1], knots.p_OC_d[i + 1]))
        twist, acceleration = np.hstack([p_d, omega_H]), np.hstack([p_dd, alpha_H])
        R_OC = contact_frames(self.task, p_OC)
        return Trajectory(times, q, v, a, tau, f, p, R, twist, acceleration, p_OC, R_OC, p_OC_d)

    def at_even_times(self, intervals: int) -> Trajectory:
        """Return the states at evenly spaced times from start to goal.

        Args:
            intervals: number of intervals K between the K + 1 times.
        """
        return self.at(self.duration * np.linspace(0.0, 1.0, intervals + 1))

    def _summary(self) -> str:
        """Return the plan in one line."""
        state = "verified" if self.check.verified else "not verified"
        return f"Plan: {1e3 * self.duration:.2f} ms, {len(self.knots.times)} knots, {state}. {self.task}"

    def _table(self) -> Table:
        """Return the largest excess of each kind of limit, with the summary as its title."""
        rows = [(words, _excess_text(getattr(self.check, name))) for name, words in LIMIT_WORDS.items()]
        return Table(("limit", "largest excess %"), tuple(rows), self._summary())

    @cached_property
    def _angular_rates(self) -> tuple[Array, Array]:
        """Return ω and α (K, 3) at the knots in O's axes."""
        knots = self.knots
        omega, alpha = (np.einsum("mji,mj->mi", knots.R_HO, x[:, 3:]) for x in (knots.twist, knots.acceleration))
        return omega, alpha

    @classmethod
    def from_dict(cls, record: object, task: Task, field: str = "") -> Plan:
        """Return the plan of a record.

        Args:
            record: mapping that `to_dict` made.
            task: the task, which the record does not contain.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range, or the plan is of another hand; names the field.
        """
        names = ("schema", "hand", "joints", "fingers", "contacts", "duration")
        results = ("check", "gap", "effort", "s", "stopped", "knots")
        values = fields.check_record(record, field, required=[*names, *results])
        path = f"{field}." if field else ""
        fields.check_choice(values["schema"], f"{path}schema", [SCHEMA])
        for name, expected in (("joints", _joint_names(task)), ("fingers", _finger_names(task))):
            if values[name] != expected:
                raise InvalidInput(f"{path}{name}", values[name], f"{expected}, those of the task")
        knots = Trajectory.from_dict(values["knots"], task, f"{path}knots")
        s = arrays.check_array(values["s"], f"{path}s", (None,))
        if len(s) not in (0, len(knots.times)):
            raise InvalidInput(f"{path}s", s, f"empty, or {len(knots.times)} numbers, one for each knot")
        return cls(
            task,
            knots,
            PlanCheck.from_dict(values["check"], f"{path}check"),
            np.nan if values["gap"] is None else arrays.check_number(values["gap"], f"{path}gap"),
            PlanningStatistics.from_dict(values["effort"], f"{path}effort"),
            s,
            fields.check_boolean(values["stopped"], f"{path}stopped"),
        )

    def plot(self) -> Figure:
        """Return a figure of speed and active limits over time."""
        figure: Figure = plot_with("plot_plan", self)
        return figure

    def to_dict(self) -> JsonRecord:
        """Return the plan as a record for JSON, without its task."""
        task = self.task
        contacts = task.contacts.contacts if isinstance(task, ObjectTask) else ()
        return {
            "schema": SCHEMA,
            "hand": task.hand.name if isinstance(task, HandTask) else None,
            "joints": _joint_names(task),
            "fingers": _finger_names(task),
            "contacts": [contact.to_dict() for contact in contacts],
            "duration": self.duration,
            "check": self.check.to_dict(),
            "gap": None if np.isnan(self.optimality_gap) else self.optimality_gap,
            "stopped": self.stopped,
            "s": self.s.tolist(),
            "knots": self.knots.to_dict(),
            "effort": self.statistics.to_dict(),
        }


def _excess_text(excess: float) -> str:
    """Return an excess in per cent of its limit; a dash if there is no limit."""
    return f"{100.0 * excess:.3f}" if np.isfinite(excess) else "–"


def _joint_names(task: Task) -> list[str]:
    return [joint.name for joint in task.hand.joints] if isinstance(task, HandTask) else []


def _finger_names(task: Task) -> list[str]:
    return list(task.fingers) if isinstance(task, GraspTask) else []


def _end_states(x: Array, v: Array, a: Array, i: Indices) -> Ends:
    """Return value, rate and acceleration at both ends of the intervals i."""
    return x[i], v[i], a[i], x[i + 1], v[i + 1], a[i + 1]


def _check_numbers(values: JsonRecord, field: str) -> JsonRecord:
    """Return finite numbers by name."""
    path = f"{field}." if field else ""
    return {name: arrays.check_number(value, f"{path}{name}") for name, value in values.items() if name != "verified"}


def _check_counts(values: JsonRecord, field: str, names: Iterable[str]) -> JsonRecord:
    """Return some numbers that are counts, by name."""
    path = f"{field}." if field else ""
    return {name: fields.check_integer(values[name], f"{path}{name}", minimum=0, maximum=_MAX_COUNT) for name in names}

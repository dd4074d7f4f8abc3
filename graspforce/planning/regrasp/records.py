"""Records of regrasping: the task, its settings, the stages of a plan, and the plan."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from graspforce.contact.contact import Contact
from graspforce.control.settings import ControlSettings
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.core.text_table import Table
from graspforce.geometry import Shape
from graspforce.grasp.collision.settings import DEFAULT_COLLISIONS, CollisionSettings
from graspforce.grasp.grasp import Grasp
from graspforce.hand.contact_tips import check_fingertips
from graspforce.planning.regrasp.pose_path import PosePath
from graspforce.planning.regrasp.rolling_motion import HeldObject


@dataclass(frozen=True, eq=False, slots=True)
class RegraspTask:
    """An object that a hand moves along a path beyond the reach of one grasp.

    Args:
        grasp: the grasp at the start, with all the fingers that may be used.
        path: path of the object; it begins at the object's pose in the grasp.
        control: settings of the controller; slip margin, friction reserve, errors of friction and normals, and gravity apply
            to the plan.
        collisions: obstacles and margin of the collision checks; None for no checks.

    Raises:
        InvalidInput: the object has no shape, or the path begins elsewhere.
    """

    grasp: Grasp
    path: PosePath
    control: ControlSettings = field(default_factory=ControlSettings)
    collisions: CollisionSettings | None = DEFAULT_COLLISIONS

    def __post_init__(self) -> None:
        _ = self.shape  # checks that there is one
        check_fingertips(self.grasp.hand, self.grasp.fingers, "regrasps")
        start = self.path.motion(0.0)
        for name, found, wanted in (("p_HO", start.p_HO, self.grasp.p_HO), ("R_HO", start.R_HO, self.grasp.R_HO)):
            if np.abs(found - wanted).max() > _START_TOLERANCE:
                raise InvalidInput(f"path.{name}[0]", found, "the pose of the object in the grasp")

    @property
    def shape(self) -> Shape:
        """The surface of the object."""
        shape = self.grasp.body.shape
        if shape is None:  # a task has checked it
            raise InvalidInput("grasp.body.shape", None, "a shape, because fingers need other places to touch")
        return shape


_START_TOLERANCE = 1e-6  # m, and of a rotation matrix


@dataclass(frozen=True, eq=False, slots=True)
class RegraspSettings:
    """Settings of the search for regrasps, and the speeds of a plan.

    Args:
        margin: least slip margin of all fingers, and of the others while one steps, N, > 0. None for 1.2 times that of the
            controller.
        spacing: least distance between two tips on the object, m, ≥ 0.
        advance: turn of the object that a finger should allow at its new place, rad, > 0.
        candidates: number of places that are compared in each step of a finger, ≥ 1.
        branches: number of them that are tried, best first, ≥ 1.
        budget: time after which the search ends without a plan, s, > 0.
        seed: of the random places.
        object_rate: largest rate of the object, rad/s, > 0.
        joint_rate: largest rate of joints of stepping fingers, rad/s, > 0; at most half of each joint's speed limit.
        torque_rate: largest rate of the torques that accelerate a stepping finger, N·m/s, > 0.

    Raises:
        InvalidInput: a value is out of range; names the field.
    """

    margin: float | None = None
    spacing: float = 0.002
    advance: float = 0.6
    candidates: int = 24
    branches: int = 4
    budget: float = 120.0
    seed: int = 0
    object_rate: float = 0.8
    joint_rate: float = 2.0
    torque_rate: float = 5.0

    def __post_init__(self) -> None:
        for name in ("advance", "budget", "object_rate", "joint_rate", "torque_rate"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        if self.margin is not None:
            set_fields(self, margin=arrays.check_number(self.margin, "margin", above=0.0))
        set_fields(
            self,
            spacing=arrays.check_number(self.spacing, "spacing", minimum=0.0),
            candidates=fields.check_integer(self.candidates, "candidates", minimum=1, maximum=1000),
            branches=fields.check_integer(self.branches, "branches", minimum=1, maximum=100),
            seed=fields.check_integer(self.seed, "seed", minimum=0, maximum=2**32 - 1),
        )

    def least_margin(self, control: ControlSettings) -> float:
        """Return the least slip margin of a plan, N.

        Args:
            control: settings of the controller.
        """
        return max(_MARGIN_FACTOR * control.slip_margin, _LEAST_MARGIN) if self.margin is None else self.margin


_MARGIN_FACTOR = 1.2  # of the controller's slip margin: for contacts that are not exactly where they were planned
_LEAST_MARGIN = 0.05  # N, for a controller without slip margin


@dataclass(frozen=True, eq=False, slots=True)
class ObjectStage:
    """All fingers move the object along a part of its path.

    Attributes:
        states: fingers and object at instants along the path.
        duration: of the stage, s.
        margin: least slip margin that forces can keep in these states, N.
    """

    states: tuple[HeldObject, ...]
    duration: float
    margin: float

    @property
    def end(self) -> HeldObject:
        """Fingers and object at the end."""
        return self.states[-1]


@dataclass(frozen=True, eq=False, slots=True)
class FingerStage:
    """One finger steps to another place of the object, which the others hold at rest.

    Attributes:
        finger: name of the finger.
        contact: its contact at the end, in O.
        postures: (K, n) postures of the step, rad.
        end: fingers and object at the end.
        duration: of the motion between lift and arrival, s.
        margin: the smaller of the slip margins of the others, and of all fingers at the end, N.
    """

    finger: str
    contact: Contact
    postures: Array
    end: HeldObject
    duration: float
    margin: float


Stage = ObjectStage | FingerStage


@dataclass(frozen=True, eq=False, slots=True)
class RegraspPlan:
    """A plan of object moves and finger steps; `RegraspController` executes it.

    Attributes:
        task: hand, object, path and settings of the controller.
        stages: object moves and finger steps, in order.
    """

    task: RegraspTask
    stages: tuple[Stage, ...]

    @property
    def margin(self) -> float:
        """Least slip margin of all stages, N."""
        return min(stage.margin for stage in self.stages)

    @property
    def step_count(self) -> int:
        """Number of finger steps."""
        return sum(isinstance(stage, FingerStage) for stage in self.stages)

    @property
    def duration(self) -> float:
        """Duration of all motions, s, without the times in which forces rise and fall."""
        return sum(stage.duration for stage in self.stages)

    def __str__(self) -> str:
        return str(self._table())

    def _repr_html_(self) -> str:
        return self._table().to_html()

    def _table(self) -> Table:
        """Return the table of the stages."""
        rows = []
        for stage in self.stages:
            if isinstance(stage, ObjectStage):
                what = f"object from {stage.states[0].u:.2f} to {stage.end.u:.2f}"
            else:
                what = f"{stage.finger} steps"
            rows.append((what, f"{stage.duration:.2f}", f"{stage.margin:.2f}"))
        title = f"Regrasp: {self.step_count} finger steps, {self.duration:.1f} s, least margin {self.margin:.2f} N"
        return Table(("stage", "time s", "margin N"), tuple(rows), title)

"""Paths to a goal pose, in the order in which a search tries them, and the search over them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from graspforce.control.settings import ControlSettings
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.geometry.rotations import rotation_exp, rotation_log
from graspforce.grasp.collision.settings import DEFAULT_COLLISIONS, CollisionSettings
from graspforce.grasp.grasp import Grasp
from graspforce.planning.failure import STOPPED, UNSOLVED, PlanFailure
from graspforce.planning.regrasp.plan_regrasp import plan_regrasp
from graspforce.planning.regrasp.pose_path import MAX_DISTANCE, PosePath
from graspforce.planning.regrasp.records import RegraspPlan, RegraspSettings, RegraspTask
from graspforce.planning.regrasp.search import RegraspCallback, RegraspProgress

_LEG = math.radians(90.0)  # largest turn of a leg
_LEAST_TURN = 1e-6  # rad
_LEAST_DISTANCE = 1e-6  # m
_ROUNDS = (0.25, 0.75)  # parts of the budget: all paths get an equal share of the first, and again of the second


@dataclass(frozen=True, eq=False, slots=True)
class RegraspGoal:
    """A goal pose of a held object, which may be beyond the reach of one grasp.

    Args:
        grasp: the grasp at the start, with all the fingers that may be used.
        p_HO: (3,) position of O in H at the goal, m, at most `MAX_DISTANCE` from that of the grasp.
        R_HO: (3, 3) axes of the object in H at the goal.
        control: as of `RegraspTask`.
        collisions: as of `RegraspTask`.

    Raises:
        InvalidInput: a value out of range, or the object is there already.
    """

    grasp: Grasp
    p_HO: Array
    R_HO: Array
    control: ControlSettings = field(default_factory=ControlSettings)
    collisions: CollisionSettings | None = DEFAULT_COLLISIONS

    def __post_init__(self) -> None:
        p_HO, R_HO = arrays.check_array(self.p_HO, "p_HO", (3,)), arrays.check_rotation(self.R_HO, "R_HO")
        set_fields(self, p_HO=p_HO, R_HO=R_HO)
        with np.errstate(over="ignore"):
            distance = np.linalg.norm(p_HO - self.grasp.p_HO)  # m
        if distance > MAX_DISTANCE:
            raise InvalidInput("p_HO", p_HO, f"at most {MAX_DISTANCE:g} m from that of the grasp")
        if not self.is_moved and not self.is_turned:
            raise InvalidInput("p_HO", p_HO, "a pose other than that of the grasp")

    @property
    def is_moved(self) -> bool:
        """Whether the goal has another position than the grasp."""
        return bool(np.linalg.norm(self.p_HO - self.grasp.p_HO) > _LEAST_DISTANCE)

    @property
    def is_turned(self) -> bool:
        """Whether the goal has another orientation than the grasp."""
        return bool(np.linalg.norm(self.turn) > _LEAST_TURN)

    @property
    def turn(self) -> Array:
        """(3,) rotation vector from the grasp to the goal in H, the shorter way, rad."""
        return np.array(rotation_log(self.R_HO @ self.grasp.R_HO.T))

    def paths(self) -> Iterator[PosePath]:
        """Yield the paths to the goal, with turns of at most 90° between two poses.

        Position and orientation change together, or one after the other. Then the same follows with the longer way round.
        """
        turn, here, there = self.turn, self.grasp.p_HO, self.p_HO
        size = float(np.linalg.norm(turn))
        turns = [turn] if not self.is_turned else [turn, turn * (1.0 - 2.0 * math.pi / size)]
        for each in turns:
            yield self._path([(there, 1.0)], each)
            if self.is_moved and self.is_turned:
                yield self._path([(there, 0.0), (there, 1.0)], each)
                yield self._path([(here, 1.0), (there, 1.0)], each)

    def _path(self, corners: list[tuple[Array, float]], turn: Array) -> PosePath:
        """Return the path from the grasp through corners: positions, m, with their parts of the turn."""
        p, R = [self.grasp.p_HO], [self.grasp.R_HO]
        last, part = self.grasp.p_HO, 0.0
        for place, share in corners:
            count = max(math.ceil(abs(share - part) * float(np.linalg.norm(turn)) / _LEG - 1e-9), 1)
            for k in range(1, count + 1):
                s = k / count
                p.append((1.0 - s) * last + s * place)
                R.append(rotation_exp(((1.0 - s) * part + s * share) * turn) @ self.grasp.R_HO)
            last, part = place, share
        if part == 1.0:
            R[-1] = self.R_HO  # exactly, after a turn by 2 π less too
        return PosePath(np.array(p), np.array(R))


def plan_regrasp_to(
    goal: RegraspGoal, settings: RegraspSettings | None = None, callback: RegraspCallback | None = None
) -> RegraspPlan | PlanFailure:
    """Plan object moves and finger steps that bring an object to a pose, on whichever path the search finds one.

    Args:
        goal: grasp and goal.
        settings: margins, speeds and budget of the search; the budget is that of all paths together.
        callback: called after each finger step that is tried; it returns False to end the search.

    Returns:
        The plan, or the reason why none was found on the path on which the object came farthest.
    """
    settings = RegraspSettings() if settings is None else settings
    stopped = False

    def watch(progress: RegraspProgress) -> bool:
        nonlocal stopped
        stopped = stopped or (callback is not None and callback(progress) is False)
        return not stopped

    farthest: PlanFailure | None = None
    paths = list(goal.paths())
    for i, part in enumerate(_ROUNDS):
        share = replace(settings, budget=part * settings.budget / len(paths), seed=settings.seed + i)
        for path in paths:
            plan = plan_regrasp(RegraspTask(goal.grasp, path, goal.control, goal.collisions), share, watch)
            if isinstance(plan, RegraspPlan):
                return plan
            if stopped:
                return PlanFailure(STOPPED, "The callback ended the search.")
            if farthest is None or (plan.s or 0.0) > (farthest.s or 0.0):
                farthest = plan
    return farthest or PlanFailure(UNSOLVED, "No path was tried.")


def goal_from_steps(grasp: Grasp, to: npt.ArrayLike, turn: npt.ArrayLike, control: ControlSettings) -> RegraspGoal:
    """Return the goal at a translation and a rotation from a grasp.

    Args:
        grasp: the grasp.
        to: (3,) translation in H, m.
        turn: (3,) rotation vector in H, rad.
        control: settings of the controller.
    """
    p_HO = grasp.p_HO + arrays.check_array(to, "to", (3,))
    return RegraspGoal(grasp, p_HO, rotation_exp(arrays.check_array(turn, "turn", (3,))) @ grasp.R_HO, control)

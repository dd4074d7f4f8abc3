"""The command ``graspforce plan --fingertips``: plan the fastest move of fingertips through given places, without an object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from graspforce.cli.options import parse_vector
from graspforce.cli.scene_options import collision_settings
from graspforce.core import arrays
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import Hand
from graspforce.planning import FingersMove, FingerTask, Plan
from graspforce.planning.acceleration_limits import UNLIMITED, AccelerationLimits
from graspforce.planning.limit_usage import limit_usage
from graspforce.planning.settings import SEARCH_INTERVALS

Tips = dict[str, tuple[float, ...]]

_MIN_ACTIVE_FRACTION = 0.01  # of the time: limits active for less are not listed
_SAMPLES = 400  # instants at which limits are evaluated


@dataclass(frozen=True, slots=True)
class FingerPlanOptions:
    """Options of a plan of fingers alone.

    Args:
        hand: name of a hand that ships, or a description file.
        tips: for each place of the move, the positions of fingertips in H, m; the last one is the goal.
        gravity: x, y, z in H, separated by commas, m/s².
        clearance: least distance of tips, links and obstacles, m.
        obstacles: as for `parse_obstacle`.
        intervals: number of intervals (default: 40).
        limits: limits of the joints' accelerations.
    """

    hand: str
    tips: tuple[Tips, ...]
    gravity: str = "0,0,-9.81"
    clearance: float = 0.0
    obstacles: tuple[str, ...] = ()
    intervals: int | None = None
    limits: AccelerationLimits = UNLIMITED

    def move(self) -> FingersMove:
        """Return the move, from the neutral posture.

        Raises:
            InvalidInput: a value out of range, or a place out of reach.
            UnknownName: no such hand, or no such finger.
        """
        gravity_H = arrays.check_array(parse_vector(self.gravity, "gravity"), "gravity", (3,))
        around = collision_settings(self.clearance, self.obstacles)
        task = FingerTask(Hand.load(self.hand), gravity_H, around, self.limits)
        move = FingersMove.through_tips(task, self.tips, clearance=self.clearance, obstacles=around.obstacles)
        intervals = SEARCH_INTERVALS if self.intervals is None else self.intervals
        return FingersMove(move.task, move.postures, move.clearance, move.obstacles, intervals)


def parse_tips(text: str) -> Tips:
    """Return the positions of an option such as index=0.1,0.02,0.08;thumb=0.08,0.06,0.03, by finger.

    Args:
        text: FINGER=X,Y,Z, separated by semicolons.

    Raises:
        InvalidInput: another form, or a finger twice.
    """
    tips: Tips = {}
    for part in text.split(";"):
        name, separator, numbers = part.strip().partition("=")
        if not separator or name in tips:
            raise InvalidInput("fingertips", text, "FINGER=X,Y,Z of different fingers, separated by semicolons")
        tips[name] = parse_vector(numbers, "fingertips")
    return tips


def print_plan(plan: Plan, console: Console) -> None:
    """Print the table of a plan of fingers alone.

    Args:
        plan: the plan.
        console: where it is printed.
    """
    shown = Table("figure", "value", title=f"fastest move of the fingers, {1e3 * plan.duration:.1f} ms")
    times = np.linspace(0.0, plan.duration, _SAMPLES)
    reached = [limit for limit in limit_usage(plan, times) if limit.active.mean() >= _MIN_ACTIVE_FRACTION]
    for i, limit in enumerate(reached[:6]):
        shown.add_row("active limits" if i == 0 else "", f"{limit} ({100 * limit.active.mean():.0f} % of the time)")
    words = "none" if plan.check.excess <= 0.0 else f"{100.0 * plan.check.excess:.3f} % of a limit"
    shown.add_row("violation between knots", f"{words} ({plan.check.samples} instants checked)")
    shown.add_row("planning time", f"{1e3 * plan.statistics.seconds:.0f} ms")
    console.print(shown)

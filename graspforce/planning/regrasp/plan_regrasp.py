"""The planner of regrasps."""

from __future__ import annotations

import math

from graspforce.planning.failure import UNSOLVED, PlanFailure
from graspforce.planning.regrasp.records import RegraspPlan, RegraspSettings, RegraspTask
from graspforce.planning.regrasp.search import RegraspCallback, RegraspSearch


def plan_regrasp(
    task: RegraspTask, settings: RegraspSettings | None = None, callback: RegraspCallback | None = None
) -> RegraspPlan | PlanFailure:
    """Plan object moves and finger steps that bring an object along a path beyond the reach of one grasp.

    Each finger steps while the others hold the object at rest. All states of the plan keep the slip margin within the motors'
    torques, every joint within its range, and links, palm, object and obstacles apart. Motions are slow: gravity alone loads
    the fingers.

    Args:
        task: grasp at the start, path, and settings of the controller.
        settings: margins, speeds and budget of the search.
        callback: called after each finger step that is tried; it returns False to end the search.

    Returns:
        The plan, or the reason why none was found. The search does not prove that there is none.
    """
    search = RegraspSearch(task, RegraspSettings() if settings is None else settings, callback)
    stages = search.run()
    if stages is not None:
        return RegraspPlan(task, stages)
    share = search.farthest / task.path.length
    cause = f" There, {search.obstacle}." if search.obstacle else ""
    reason = (
        f"No sequence of finger steps was found, which does not prove that there is none. The object came to "
        f"{math.floor(100.0 * share)} % of its path.{cause}"
    )
    return PlanFailure(UNSOLVED, reason, share)

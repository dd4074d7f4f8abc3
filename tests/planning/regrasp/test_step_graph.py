"""Sequences of finger steps out of the graph of grasps at one pose of the object."""

from __future__ import annotations

import pytest
from support.regrasp_plans import start_state, turn_task

from graspforce.planning.regrasp.records import RegraspSettings
from graspforce.planning.regrasp.step_graph import StepGraph
from graspforce.planning.regrasp.step_tools import StepTools

ADVANCE = 0.2  # rad


@pytest.mark.parametrize("name", ["four_finger sphere", "four_finger box"])
def test_after_a_sequence_every_finger_can_follow_the_object(name: str) -> None:
    """All grasps on the way keep the slip margin, also without the finger that steps."""
    task, tried = turn_task(1.0, name), list[int]()
    tools = StepTools(task, RegraspSettings(candidates=12), lambda: tried.append(1))
    at = start_state(task)
    sequence = next(StepGraph(tools, at, ADVANCE).sequences())
    assert 1 <= len(sequence) <= len(tried)
    for stage in sequence:
        assert stage.postures[0] == pytest.approx(at.q, abs=1e-9)
        assert min(tools.holding.find(stage.end), tools.holding.find_without(at, stage.finger)) >= tools.least
        assert tools.clearance(stage.end) >= 0.0
        at = stage.end
    assert min(tools.travel(at, finger, ADVANCE) for finger in at.fingers) > 0.95 * ADVANCE

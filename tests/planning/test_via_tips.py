"""Moves of fingertips through given positions, and moves of objects that are meshes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.meshes import box_mesh

from graspforce import InvalidInput
from graspforce.core.errors import UnknownName
from graspforce.geometry import Box, TriangleMesh
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.hand.hand import Hand
from graspforce.planning import FingersMove, FingerTask, GraspTask, Plan, PlanSettings, StraightPath, plan_along


@cache
def box_grasp(edges: tuple[float, float, float]) -> Grasp:
    return find_grasp(Hand.load("allegro_right"), Body.solid(Box(edges), 0.05), ["index", "ring", "thumb"], friction=0.7)


TASK = FingerTask(Hand.load("allegro_right"))
FINGER = "index"


def tip(q: np.ndarray) -> np.ndarray:
    return TASK.hand.tip_pose(q, FINGER)[0]


def test_fingertip_passes_all_positions() -> None:
    start = tip(TASK.hand.neutral)
    positions = start + np.array([[0.005, 0.0, 0.01], [0.0, 0.005, 0.02]])
    move = FingersMove.through_tips(TASK, [{FINGER: p} for p in positions])
    plan = move.plan()
    assert isinstance(plan, Plan)
    at = plan.at_even_times(1000)
    way = np.array([tip(q) for q in at.q])
    for p in positions:
        assert np.linalg.norm(way - p, axis=1).min() < 3e-4  # m, between two of the instants
    assert way[-1] == pytest.approx(positions[-1], abs=1e-6)
    others = [i for i in range(TASK.hand.n) if i not in TASK.hand.finger(FINGER).joints]
    assert np.abs(at.q[:, others] - TASK.hand.neutral[others]).max() < 1e-12


def test_wrong_positions_are_named() -> None:
    start = tip(TASK.hand.neutral)
    with pytest.raises(InvalidInput, match=r"tips\[1\]\.index"):
        FingersMove.through_tips(TASK, [{FINGER: p} for p in start + np.array([[0.0, 0.0, 0.01], [1.0, 0.0, 0.0]])])
    with pytest.raises(InvalidInput, match="tips"):
        FingersMove.through_tips(TASK, [])
    with pytest.raises(InvalidInput, match="nothing moves"):
        FingersMove.through_tips(TASK, [{FINGER: start}])
    with pytest.raises(UnknownName):
        FingersMove.through_tips(TASK, [{"sixth": start}])


@pytest.mark.parametrize("displacement", [(0.003, 0.0, 0.002), (0.0, 0.004, 0.0)])
def test_mesh_of_a_box_moves_like_the_box(displacement: tuple[float, float, float]) -> None:
    """The surface is the same, and so are the rolling contacts and the fastest motion."""
    edges = (0.05, 0.05, 0.05)
    grasp = box_grasp(edges)
    path = StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + displacement, grasp.R_HO)
    plans = []
    for shape in (Box(edges), TriangleMesh(*box_mesh(edges))):
        task = GraspTask(grasp.hand, replace(grasp.body, shape=shape), grasp.contacts, grasp.fingers)
        plan = plan_along(task, path, grasp.q, settings=PlanSettings(intervals=40))
        assert isinstance(plan, Plan)
        plans.append(plan)
    box, mesh = plans
    assert mesh.duration == pytest.approx(box.duration, rel=1e-6)
    assert mesh.knots.p_OC == pytest.approx(box.knots.p_OC, abs=1e-7)

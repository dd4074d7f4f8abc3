"""The search by sampling: it finds motions that exist, and none into the palm."""

from __future__ import annotations

import itertools

import numpy as np
from support.tracked_moves import MOVES, find_move_grasp

from benchmarks.lifecycle.sampled_search import Node, distance, find_path
from graspforce.planning import GraspTask
from graspforce.planning.collisions import scene_of_task

HAND = "allegro_right"


def start() -> Node:
    grasp = find_move_grasp(HAND)
    return Node(GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers), grasp.p_HO, grasp.R_HO, grasp.q)


def test_path_to_a_goal_in_reach_is_found_and_its_states_are_connected() -> None:
    first = start()
    goal = first.p_HO + MOVES[HAND][0]
    path = find_path(first, goal, first.R_HO, samples=30, seed=0)
    assert path[0] is first
    assert distance(path[-1], goal, first.R_HO) < 1e-9
    for before, after in itertools.pairwise(path):
        assert distance(before, after.p_HO, after.R_HO) < 0.0081  # m
        gap = scene_of_task(after.task).least_gap(after.q, after.p_HO, after.R_HO)  # type: ignore[union-attr]
        assert gap is None or gap.distance > -1e-5


def test_no_path_into_the_palm_is_found() -> None:
    first = start()
    goal = np.array([0.0, 0.0, 0.0])  # the palm's own frame
    assert find_path(first, goal, first.R_HO, samples=30, seed=0) == []

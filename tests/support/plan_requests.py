"""Moves of a shipped hand for the tests of planning over the wire."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.geometry import Sphere
from graspforce.hand.hand import Hand
from graspforce.planning import (
    FingersMove,
    FingerTask,
    FreeMove,
    Move,
    Obstacle,
    PathMove,
    Plan,
    PlanFailure,
    WorkspaceBounds,
    move_from_dict,
)
from graspforce.planning.moves.object_moves import SPLINE
from support.hands import load
from support.planning_cases import star_grasp

HAND = "four_finger"


@cache
def hand() -> Hand:
    return load(HAND)


@cache
def moves() -> dict[str, Move]:
    """Return one move of each kind, each planned quickly, with a tenth of the motor torque in reserve."""
    task, middle, q = star_grasp(hand())
    task = replace(task, hand=task.hand.derated(0.9), slip_margin=0.05, gravity_H=np.array([0.5, -0.2, -9.7]))
    p = middle + np.array([[0.0, 0.0, 0.0], [0.001, 0.0, 0.002], [0.002, -0.001, 0.004]])
    R = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.05, 0.03, 0.0]]).as_matrix()
    workspace = WorkspaceBounds(np.array([-np.inf, -np.inf, 0.0]), np.array([1.0, np.inf, np.inf]), 0.4)
    bent = np.tile(q, (3, 1))
    bent[1, 0], bent[2, 0] = bent[1, 0] + 0.05, bent[2, 0] + 0.1
    away = Obstacle(Sphere(0.01), np.array([0.3, 0.0, 0.0]), Rotation.from_rotvec([0.1, 0.0, 0.0]).as_matrix())
    alone = FingerTask(task.hand)
    return {
        "path": PathMove(task, p[[0, 2]], R[[0, 2]], q_start=q, intervals=20),
        "spline": PathMove(task, p, R, SPLINE, intervals=20, tolerance=2e-3),
        "free": FreeMove(task, p[[0, 2]], R[[0, 2]], q_start=q, intervals=10, workspace=workspace),
        "fingers": FingersMove(alone, bent[[0, 2]], clearance=1e-3, obstacles=(away,), intervals=10),
        "postures": FingersMove(alone, bent, intervals=20),
    }


def unreachable_move() -> PathMove:
    """Return a path that leaves the reach of the fingers."""
    near = moves()["path"]
    assert isinstance(near, PathMove)
    return replace(near, p_HO=near.p_HO + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]]))


def slow_move() -> FreeMove:
    """Return a move whose optimisation takes long, while its straight path is planned at once."""
    free = moves()["free"]
    assert isinstance(free, FreeMove)
    return replace(free, intervals=150)


def decoded_move(move: Move) -> Move:
    """Return the move after encoding and decoding."""
    return move_from_dict(move.to_dict(), hand())


def assert_same_plan(one: Plan | PlanFailure, other: Plan | PlanFailure) -> None:
    """Check that two plans are equal in all numbers but their planning time."""
    assert isinstance(one, Plan)
    assert isinstance(other, Plan)
    for name in one.knots.__slots__:
        np.testing.assert_array_equal(getattr(one.knots, name), getattr(other.knots, name))
    np.testing.assert_array_equal(one.s, other.s)
    np.testing.assert_equal((one.optimality_gap, one.stopped), (other.optimality_gap, other.stopped))
    assert one.check.to_dict() == other.check.to_dict()

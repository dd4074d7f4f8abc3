"""A search by sampling for a motion of a held object: a random tree of poses, which shares no search with the planners.

Each edge is a short straight motion of the object on which the fingertips roll; the joints follow, and the contacts with them.
An edge is kept if all joints stay within their limits and no two bodies collide. Forces and torques are not considered, so that
the search finds motions that the limits of forces exclude, too. Source: LaValle and Kuffner (2001).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.core.arrays import Array
from graspforce.planning import GraspTask, PlanFailure, StraightPath
from graspforce.planning.collisions import path_collision, scene_of_task
from graspforce.planning.given_points import METRES_PER_RADIAN
from graspforce.planning.path.joint_path import contact_points, follow_object_path
from graspforce.planning.tip_contacts import contacts_at

_GOAL_SHARE = 0.4  # of the samples: the goal itself
_STEP = 0.008  # m: longest edge; a radian counts as 5 cm
_INSTANTS = 9  # of an edge at which collisions and joint limits are checked
_LIMIT_TOLERANCE = 1e-6  # rad


@dataclass(frozen=True, eq=False, slots=True)
class Node:
    """A state that the tree reaches.

    Args:
        task: the task with the contacts in this state.
        p_HO: (3,) position of the object, m.
        R_HO: (3, 3) its orientation.
        q: (n,) posture, rad.
    """

    task: GraspTask
    p_HO: Array
    R_HO: Array
    q: Array


def distance(node: Node, p: Array, R: Array) -> float:
    """Return the distance of a state from a pose, m; a radian counts as 5 cm.

    Args:
        node: the state.
        p: (3,) position, m.
        R: (3, 3) orientation.
    """
    angle = Rotation.from_matrix(node.R_HO.T @ R).magnitude()
    return float(np.hypot(np.linalg.norm(p - node.p_HO), METRES_PER_RADIAN * angle))


def extend(node: Node, p: Array, R: Array) -> Node | None:
    """Return the state after a straight motion towards a pose, at most 8 mm far; None if the motion is not possible.

    Args:
        node: the state from which it starts.
        p: (3,) position, m.
        R: (3, 3) orientation.
    """
    share = min(_STEP / max(distance(node, p, R), 1e-12), 1.0)
    turn = Rotation.from_matrix(node.R_HO.T @ R).as_rotvec()
    p, R = node.p_HO + share * (p - node.p_HO), node.R_HO @ Rotation.from_rotvec(share * turn).as_matrix()
    path, s = StraightPath(node.p_HO, node.R_HO, p, R), np.linspace(0.0, 1.0, _INSTANTS)
    joints = follow_object_path(node.task, path, node.q)
    if isinstance(joints, PlanFailure):
        return None
    poses, at = path.points(s), joints.points(s)
    hand = node.task.hand
    if (at.q < hand.q_lower - _LIMIT_TOLERANCE).any() or (at.q > hand.q_upper + _LIMIT_TOLERANCE).any():
        return None
    if path_collision(scene_of_task(node.task), s, at.q, (poses.p, poses.R)) is not None:
        return None
    points = contact_points(node.task, poses, at)
    contacts = contacts_at(node.task.contacts, points.p_OC[-1], points.R_OC[-1])
    return Node(replace(node.task, contacts=contacts), poses.p[-1], poses.R[-1], at.q[-1])


def find_path(start: Node, p: Array, R: Array, samples: int, seed: int) -> list[Node]:
    """Return the states from the start to a goal pose; empty if the samples end before the goal is reached.

    Args:
        start: the state at the start.
        p: (3,) position of the goal, m.
        R: (3, 3) its orientation.
        samples: number of edges that are tried.
        seed: of the random numbers.
    """
    rng = np.random.default_rng(seed)
    tree, parents = [start], [-1]
    spread = 1.5 * max(distance(start, p, R), _STEP)  # m, around the start
    exhausted: set[int] = set()  # states whose edge towards the goal is not possible
    for _ in range(samples):
        target, toward = (p, R), [i for i in range(len(tree)) if i not in exhausted]
        to_goal = bool(toward) and rng.uniform() < _GOAL_SHARE
        if not to_goal:
            turn = Rotation.from_rotvec(rng.normal(size=3) * spread / METRES_PER_RADIAN / 3.0).as_matrix()
            target, toward = (start.p_HO + rng.uniform(-spread, spread, 3), turn @ start.R_HO), list(range(len(tree)))
        nearest = min(toward, key=lambda i: distance(tree[i], *target))
        node = extend(tree[nearest], *target)
        if node is None:
            exhausted |= {nearest} if to_goal else set()
            continue
        tree.append(node)
        parents.append(nearest)
        if to_goal and distance(node, p, R) < 1e-9:
            return _branch(tree, parents)
        exhausted |= {nearest} if to_goal else set()
    return []


def _branch(tree: list[Node], parents: list[int]) -> list[Node]:
    """Return the states from the root to the last one."""
    branch, i = [], len(tree) - 1
    while i >= 0:
        branch.append(tree[i])
        i = parents[i]
    return branch[::-1]

"""Poses of an object on a table with the largest errors, and grasps whose fingers then miss their faces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graspforce.contact.contact import Contact, ContactSet
from graspforce.geometry import Box
from graspforce.grasp.body import Body
from graspforce.simulation.cycle.pose_errors import count_missed_faces, displaced_pose, extreme_poses
from graspforce.simulation.cycle.table_scene import TableScene
from tests.support.table_scenes import ball_scene

TRAVEL = 0.03  # m, beyond the planned contacts


def box_scene(width: float, offset: float) -> TableScene:
    """Return two fingers that oppose each other on a box, at an offset along its faces from their middle.

    Args:
        width: of these faces along the table, m.
        offset: of both contacts, m.
    """
    hand, scene = ball_scene().grasp.hand, ball_scene()
    fingers = ("index", "thumb")
    centres = np.array([hand.tip_pose(scene.grasp.q, name)[0] for name in fingers])
    x = (centres[1] - centres[0]) / np.linalg.norm(centres[1] - centres[0])
    down = np.cross(x, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(x, [0.0, 0.0, 1.0]))
    R_HO = np.column_stack([x, np.cross(-down, x), -down])
    radii = [hand.finger(name).tip_radius for name in fingers]
    length = float(np.linalg.norm(centres[1] - centres[0])) - sum(radii)
    p_HO = centres[0] + (radii[0] + length / 2.0) * x - offset * R_HO[:, 1]
    sides = [np.array([-length / 2.0, offset, 0.0]), np.array([length / 2.0, offset, 0.0])]
    contacts = ContactSet.stack([Contact(p, -np.sign(p[0]) * np.eye(3)[0], 0.6) for p in sides])
    body = Body.solid(Box((length, width, 0.06)), 0.1)
    grasp = replace(scene.grasp, body=body, fingers=fingers, contacts=contacts, p_HO=p_HO, R_HO=R_HO)
    return TableScene(grasp, 9.81 * down, 0.03, 0.0)


def missed(scene: TableScene) -> int:
    return count_missed_faces(scene, np.full(2, 0.02), TRAVEL)


def test_poses_are_displaced_along_the_table_and_turned_about_the_vertical():
    scene = ball_scene()
    poses = extreme_poses(scene)
    for p, R in poses:
        assert (p - scene.grasp.p_HO) @ scene.down == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(R @ scene.grasp.R_HO.T @ scene.down, scene.down, rtol=0, atol=1e-12)
    distances = [np.linalg.norm(p - scene.grasp.p_HO) for p, _ in poses]
    assert max(distances) == pytest.approx(0.01)
    expected = displaced_pose(scene, (0.0, 0.0), 0.0)
    assert any(np.allclose(p, expected[0]) and np.allclose(R, expected[1]) for p, R in poses)


def test_fingers_at_the_middle_of_wide_faces_miss_none():
    assert missed(box_scene(0.1, 0.0)) == 0


def test_fingers_near_an_edge_miss_their_faces_on_its_side_only():
    """Displacements away from the edge are as many as those towards it."""
    scene = box_scene(0.06, 0.028)  # 2 mm from the edge; the object moves by up to 10 mm
    number = len(extreme_poses(scene))
    assert 0 < missed(scene) <= number // 2


def test_both_edges_count_alike():
    assert missed(box_scene(0.06, 0.026)) == missed(box_scene(0.06, -0.026)) > 0


def test_wider_faces_never_miss_more():
    counts = [missed(box_scene(width, 0.02)) for width in (0.044, 0.05, 0.06, 0.08, 0.1)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1] == 0

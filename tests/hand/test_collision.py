"""Distances between the links of a hand, and between its links and an object."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.hands import SHIPPED_HANDS, load, random_posture

from benchmarks.link_gaps import least_link_distance
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.hand.collision import HandCollision
from graspforce.hand.hand import Hand

# Two fingers of one link each, 20 mm apart: a box 10 mm thick, and a capsule of 4 mm radius; palm: a sphere below the joints.
TWO_FINGERS = """<robot name="two">
  <link name="palm"><collision><origin xyz="0 0 -0.03"/><geometry><sphere radius="0.02"/></geometry></collision></link>
  <joint name="left_joint" type="revolute">
    <parent link="palm"/><child link="left"/><axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>
  </joint>
  <link name="left"><collision><origin xyz="0 0 0.03"/><geometry><box size="0.01 0.01 0.04"/></geometry></collision></link>
  <joint name="left_end" type="fixed"><parent link="left"/><child link="left_tip"/><origin xyz="0 0 0.05"/></joint>
  <link name="left_tip"/>
  <joint name="right_joint" type="revolute">
    <parent link="palm"/><child link="right"/><origin xyz="0.02 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>
  </joint>
  <link name="right">
    <collision><origin xyz="0 0 0.03"/><geometry><capsule radius="0.004" length="0.03"/></geometry></collision>
    {more}
  </link>
  <joint name="right_end" type="fixed"><parent link="right"/><child link="right_tip"/><origin xyz="0 0 0.05"/></joint>
  <link name="right_tip"/>
</robot>"""


def write(folder: Path, more: str = "", **fields: object) -> Hand:
    """Return the hand of two fingers with more shapes on its right link, and further fields of its description."""
    (folder / "two.urdf").write_text(TWO_FINGERS.format(more=more))
    record = {
        "schema": "graspforce/hand/1",
        "name": "two",
        "title": "Two fingers",
        "source": "invented",
        "license": "none",
        "urdf": "two.urdf",
        "fingers": [{"name": side, "tip": f"{side}_tip", "tip_radius": 0.005} for side in ("left", "right")],
        "motors": [{"joints": ["*"], "torque": 1, "velocity": 3, "rotor_inertia": 1e-6, "source": "invented"}],
        **fields,
    }
    (folder / "two.json").write_text(json.dumps(record))
    return Hand.load(folder / "two.json")


def test_distance_of_parallel_links_is_their_spacing_less_their_thickness(tmp_path: Path) -> None:
    (gap,) = HandCollision(write(tmp_path)).link_gaps(np.zeros(2))
    assert (gap.first, gap.second) == ("right", "left")
    assert gap.distance == pytest.approx(0.02 - 0.005 - 0.004, abs=1e-7)


def test_crossed_links_have_a_negative_distance(tmp_path: Path) -> None:
    collision = HandCollision(write(tmp_path))
    assert collision.link_gaps(np.array([0.4, -0.4]))[0].distance < -1e-3


@pytest.mark.parametrize(
    ("shape", "thickness"),
    [(Sphere(0.01), 0.01), (Cylinder(0.01, 0.02), 0.01), (Box([0.02, 0.03, 0.02]), 0.01)],
    ids=["sphere", "cylinder", "box"],
)
def test_distance_of_an_object_beside_a_link(tmp_path: Path, shape: Sphere | Cylinder | Box, thickness: float) -> None:
    """Its centre is 30 mm beside the middle of the left link, whose face is 5 mm from its axis."""
    hand = write(tmp_path)
    gaps = HandCollision(hand).object_gaps(np.zeros(2), shape, np.array([-0.03, 0.0, 0.03]), np.eye(3))
    assert [gap.second for gap in gaps] == ["object"] * 3
    assert (gaps[0].first, gaps[0].distance) == ("left", pytest.approx(0.03 - 0.005 - thickness, abs=1e-7))
    skipped = HandCollision(hand).object_gaps(np.zeros(2), shape, np.array([-0.03, 0.0, 0.03]), np.eye(3), [0])
    assert "left" not in [gap.first for gap in skipped]


def test_missing_mesh_is_reported_and_left_out(tmp_path: Path) -> None:
    mesh = '<collision><geometry><mesh filename="package://nowhere/bar.stl"/></geometry></collision>'
    collision = HandCollision(write(tmp_path, mesh))
    assert len(collision.shapes) == 3
    assert len(collision.missing) == 1
    assert "bar.stl is not found" in collision.missing[0]


def test_mesh_counts_as_its_convex_hull(tmp_path: Path) -> None:
    """A tetrahedron whose corner is 6 mm beside the axis of the right link, towards the left one."""
    (tmp_path / "wedge.obj").write_text(
        "v -0.006 0 0.03\nv 0 -0.004 0.02\nv 0 0.004 0.02\nv 0 0 0.04\nf 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n"
    )
    hand = write(tmp_path, '<collision><geometry><mesh filename="wedge.obj"/></geometry></collision>')
    collision = HandCollision(hand)
    assert collision.missing == ()
    assert collision.link_gaps(np.zeros(2))[0].distance == pytest.approx(0.02 - 0.005 - 0.006, abs=1e-7)


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_distances_equal_those_of_another_reader(name: str) -> None:
    """Convex shapes: both readers place them at the same distances. Overlaps agree in sign only."""
    hand = load(name)
    collision = HandCollision(hand)
    assert collision.missing == ()
    for seed in range(4):
        q = random_posture(hand, seed)
        least, names = least_link_distance(hand, q)
        nearest = collision.link_gaps(q)[0]
        if least > 0.0:
            assert nearest.distance == pytest.approx(least, abs=1e-6), names
        else:
            assert nearest.distance < 1e-6, names


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_neutral_postures_of_shipped_hands_have_no_overlap(name: str) -> None:
    hand = load(name)
    assert HandCollision(hand).link_gaps(hand.neutral)[0].distance > 0.0


def test_pairs_that_the_description_allows_are_left_out(tmp_path: Path) -> None:
    allowed = [{"links": ["left*", "right"], "source": "invented"}]
    assert HandCollision(write(tmp_path, allowed_contacts=allowed)).link_gaps(np.zeros(2)) == []


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_link_poses_along_equal_those_of_the_hand(name: str) -> None:
    hand = load(name)
    q = np.array([random_posture(hand, seed) for seed in range(3)])
    p, R = hand.tree().poses_along(q @ hand.T.T + hand.q0)
    for k in range(len(q)):
        places = hand.model.link_motion(q[k], np.zeros(hand.n)).link_poses
        assert p[k] == pytest.approx(np.array(places[2::2]), abs=1e-12)
        assert R[k] == pytest.approx(np.array(places[3::2]), abs=1e-12)

"""Notes about postures within the limits in which links collide."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from support.hands import load

from graspforce.core.errors import InvalidInput
from graspforce.hand.collision import HandCollision
from graspforce.hand.hand import Hand
from graspforce.hand.lint.posture_checks import check_postures


def test_note_has_the_share_and_an_example_that_collides() -> None:
    """The example's posture is evaluated again, and the share counted again from the same seed."""
    hand = load("four_finger")
    (note,) = check_postures(hand, 60, seed=3)
    assert note.severity == "note"
    collision = HandCollision(hand)
    rng = np.random.default_rng(3)
    distances = [collision.link_gaps(q)[0].distance for q in rng.uniform(hand.q_lower, hand.q_upper, (60, hand.n))]
    assert f"in {100 * np.mean(np.array(distances) < -1e-4):.0f} % of 60" in note.problem
    found = re.search(r"q = \((.*)\) rad", note.problem)
    assert found is not None
    q = np.array([float(x) for x in found[1].split(",")])
    assert collision.link_gaps(q)[0].distance == pytest.approx(min(distances), abs=1e-3)  # the note has three digits


def test_hand_whose_links_never_meet_has_no_note() -> None:
    assert check_postures(load("parallel_jaws"), 50) == ()


def test_jaws_that_touch_have_no_note_and_jaws_that_overlap_have_one_in_metres(tmp_path: Path) -> None:
    """Two boxes of 20 mm slide together: their faces are 40 mm apart at the lower limit of 0."""
    for reach, expected in ((0.02 + 2e-5, ()), (0.025, ("m",))):
        notes = check_postures(Hand.load(write_jaws(tmp_path, reach)), 400, seed=1)
        assert tuple(note.problem.rpartition(" ")[2] for note in notes) == expected


def write_jaws(folder: Path, reach: float) -> Path:
    """Write two jaws that slide towards each other by up to a reach, m, and return the path of their description."""
    jaw = """
      <joint name="slide_{i}" type="prismatic"><parent link="palm"/><child link="jaw_{i}"/><origin xyz="{x} 0 0"/>
        <axis xyz="{axis} 0 0"/><limit lower="0" upper="{reach}" effort="20" velocity="0.1"/></joint>
      <link name="jaw_{i}"><inertial><mass value="0.05"/><origin xyz="0 0 0.02"/>
        <inertia ixx="8e-6" iyy="8e-6" izz="3e-6" ixy="0" ixz="0" iyz="0"/></inertial>
        <collision><origin xyz="0 0 0.02"/><geometry><box size="0.02 0.02 0.04"/></geometry></collision></link>
      <joint name="end_{i}" type="fixed"><parent link="jaw_{i}"/><child link="pad_{i}"/><origin xyz="0 0 0.035"/></joint>
      <link name="pad_{i}"/>"""
    jaws = "".join(jaw.format(i=i, x=-s * 0.03, axis=s, reach=reach) for i, s in ((1, 1), (2, -1)))
    (folder / "jaws.urdf").write_text(f'<robot name="jaws"><link name="palm"/>{jaws}</robot>')
    fingers = [{"name": f"jaw_{i}", "tip": f"pad_{i}", "tip_radius": 0.005} for i in (1, 2)]
    motor = {"joints": ["*"], "torque": 20.0, "velocity": 0.1, "rotor_inertia": 1e-3, "source": "invented"}
    record = {"schema": "graspforce/hand/1", "name": "jaws", "title": "Jaws", "source": "invented", "license": "none"}
    (folder / "jaws.json").write_text(json.dumps(record | {"urdf": "jaws.urdf", "fingers": fingers, "motors": [motor]}))
    return folder / "jaws.json"


def test_count_of_samples_is_checked() -> None:
    with pytest.raises(InvalidInput, match="samples"):
        check_postures(load("four_finger"), 0)

"""First descriptions of hands from URDFs as they are found: tips, couplings, inertias, and numbers to fill in."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.hands import SHIPPED_HANDS, load

from graspforce.core.errors import InvalidInput, ModelError, UnknownName
from graspforce.hand.authoring import AuthoringOptions, NewDescription, describe_urdf
from graspforce.hand.hand import Hand
from graspforce.hand.lint.lint_hand import lint_hand
from graspforce.hand.shapes.fingertips import find_fingertips

# An arm with a hand of two fingers. The index has a second joint that mimics the first; its tip frame, behind two fixed joints,
# is on the surface of the pad. The thumb has neither mass nor tip frame.
ROBOT = """<robot name="robot">
  <link name="floor"/>
  <joint name="elbow" type="revolute">
    <parent link="floor"/><child link="palm"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="100" velocity="1"/>
  </joint>
  <link name="palm"><collision><geometry><box size="0.08 0.08 0.02"/></geometry></collision></link>
  <joint name="r_index_1" type="revolute">
    <parent link="palm"/><child link="r_index_proximal"/><origin xyz="0.03 0 0.02"/><axis xyz="0 1 0"/>
    <limit lower="-0.4" upper="1.5" effort="0.6" velocity="4"/>
  </joint>
  <link name="r_index_proximal">
    <inertial>
      <origin xyz="0 0 0.02"/><mass value="0.03"/><inertia ixx="5e-6" iyy="5e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision><origin xyz="0 0 0.02"/><geometry><cylinder radius="0.008" length="0.04"/></geometry></collision>
  </link>
  <joint name="r_index_2" type="revolute">
    <parent link="r_index_proximal"/><child link="r_index_distal"/><origin xyz="0 0 0.04"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1.5" effort="0.6" velocity="4"/><mimic joint="{leader}" multiplier="0.8" offset="0.1"/>
  </joint>
  <link name="r_index_distal">
    <inertial>
      <origin xyz="0 0 0.015"/><mass value="0.02"/><inertia ixx="1e-6" iyy="9e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision><origin xyz="0 0 0.0115"/><geometry><cylinder radius="0.007" length="0.023"/></geometry></collision>
    <collision><origin xyz="0 0 0.023"/><geometry><sphere radius="0.007"/></geometry></collision>
  </link>
  <joint name="r_index_mount" type="fixed">
    <parent link="r_index_distal"/><child link="r_index_sensor"/><origin xyz="0 0 0.02" rpy="0 1.5707963267948966 0"/>
  </joint>
  <link name="r_index_sensor"/>
  <joint name="r_index_end" type="fixed">
    <parent link="r_index_sensor"/><child link="r_index_tip"/><origin xyz="{tip}"/>
  </joint>
  <link name="r_index_tip"/>
  <joint name="r_thumb_1" type="revolute">
    <parent link="palm"/><child link="r_thumb_distal"/><origin xyz="-0.03 0 0.02"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="0.4" effort="1000" velocity="4"/>
  </joint>
  <link name="r_thumb_distal">
    <visual><origin xyz="0 0 0.03"/><geometry><box size="0.02 0.014 0.06"/></geometry></visual>
  </link>
</robot>"""

SURFACE = "-0.010 0 0"  # of the index's sensor: on the surface of the pad, 7 mm from its centre
CENTRE = "-0.003 0 0"  # at the pad's centre, 23 mm from the joint


def describe(folder: Path, *, leader: str = "r_index_1", tip: str = SURFACE, **options: object) -> tuple[NewDescription, Path]:
    """Return the description of the hand, and where it was written."""
    (folder / "robot.urdf").write_text(ROBOT.format(leader=leader, tip=tip))
    target = folder / "my_hand.json"
    described = describe_urdf(folder / "robot.urdf", target, AuthoringOptions(**{"base": "palm", **options}))
    described.write(target)
    return described, target


def fill_in(path: Path) -> Hand:
    """Fill in the motors' numbers, and return the hand."""
    record = json.loads(path.read_text())
    for motor in record["motors"]:
        motor |= {"torque": motor["torque"] or 0.5, "rotor_inertia": 1e-7, "gear_ratio": 100.0}
    path.write_text(json.dumps(record))
    return Hand.load(path)


def test_new_description_loads_after_its_numbers_are_filled_in(tmp_path: Path) -> None:
    described, path = describe(tmp_path)
    assert described.unfilled == ("motors[0].rotor_inertia", "motors[1].torque", "motors[1].rotor_inertia")
    with pytest.raises(ModelError, match=r"fill in motors\[0\]\.rotor_inertia, motors\[1\]\.torque"):
        Hand.load(path)
    assert [finding.location for finding in lint_hand(path) if finding.severity == "error"] == list(described.unfilled)
    hand = fill_in(path)
    assert [finger.name for finger in hand.fingers] == ["index", "thumb"]
    assert [joint.name for joint in hand.joints] == ["r_index_1", "r_thumb_1"]
    assert hand.describe()["base"] == "palm"  # the arm is left out
    assert lint_hand(path) == ()


def test_inertias_in_another_unit_become_those_of_the_shapes(tmp_path: Path) -> None:
    """The proximal link's inertia in g·m², as if it were kg·m²: its radius of gyration is 32 times too large."""
    text = ROBOT.replace('ixx="5e-6" iyy="5e-6" izz="1e-6"', 'ixx="5e-3" iyy="5e-3" izz="1e-3"')
    (tmp_path / "robot.urdf").write_text(text.format(leader="r_index_1", tip=CENTRE))
    described = describe_urdf(tmp_path / "robot.urdf", tmp_path / "my_hand.json", AuthoringOptions(base="palm"))
    assert any("r_index_proximal has an inertia that is too large for its shapes" in remark for remark in described.remarks)
    (entry,) = [each for each in described.record["inertias"] if each["link"] == "r_index_proximal"]
    assert entry["mass"] == 0.03
    m, r, length = 0.03, 0.008, 0.04
    across, along = m * (3.0 * r**2 + length**2) / 12.0, m * r**2 / 2.0
    np.testing.assert_allclose(entry["inertia"], [across, across, along, 0.0, 0.0, 0.0], rtol=1e-4, atol=1e-12)


def test_tip_frames_are_at_the_centres_of_the_pads(tmp_path: Path) -> None:
    """The index ends in a hemisphere of 7 mm about z = 23 mm; the thumb in a box 14 mm thick up to z = 60 mm."""
    described, path = describe(tmp_path)
    hand = fill_in(path)
    index, thumb = hand.fingers
    assert (index.tip, thumb.tip) == ("index_pad", "thumb_pad")
    assert (index.tip_radius, thumb.tip_radius) == (pytest.approx(0.007, abs=2e-4), pytest.approx(0.007, abs=2e-4))
    _, p_index, _ = hand.model.carrier_of(index.tip)
    _, p_thumb, _ = hand.model.carrier_of(thumb.tip)
    np.testing.assert_allclose(p_index, [0, 0, 0.023], atol=5e-4)  # m: the hull is sampled at 200 points
    np.testing.assert_allclose(p_thumb, [0, 0, 0.053], atol=5e-4)
    (remark,) = (remark for remark in described.remarks if "the frame r_index_tip is" in remark)
    assert float(remark.split("r_index_tip is ")[1].split(" mm")[0]) == pytest.approx(7.0, abs=0.2)


def test_tip_frame_at_the_pad_s_centre_is_kept(tmp_path: Path) -> None:
    described, _ = describe(tmp_path, tip=CENTRE)
    assert described.record["fingers"][0]["tip"] == "r_index_tip"
    assert described.record["fingers"][1]["tip"] == "thumb_pad"


@pytest.mark.parametrize("leader", ["r_index_1", "index_1"])
def test_mimic_joints_become_couplings_even_without_their_prefix(tmp_path: Path, leader: str) -> None:
    described, path = describe(tmp_path, leader=leader)
    (coupling,) = described.record["couplings"]
    assert (coupling["follower"], coupling["leader"]) == ("r_index_2", "r_index_1")
    hand = fill_in(path)
    column = hand.T[:, 0]
    assert sorted(column) == [0.0, 0.8, 1.0]
    assert hand.q0[list(column).index(0.8)] == 0.1
    assert any("which does not exist" in remark for remark in described.remarks) == (leader == "index_1")


def test_missing_and_impossible_inertias_come_from_the_shapes(tmp_path: Path) -> None:
    """The thumb is a box of 16.8 cm³ at 1500 kg/m³; the index's last link keeps its mass of 20 g."""
    described, _ = describe(tmp_path)
    by_link = {each["link"]: each for each in described.record["inertias"]}
    assert set(by_link) == {"r_index_distal", "r_thumb_distal"}
    thumb = by_link["r_thumb_distal"]
    mass = 1500.0 * 0.02 * 0.014 * 0.06  # kg
    assert thumb["mass"] == pytest.approx(mass, rel=1e-5)
    np.testing.assert_allclose(thumb["com"], [0, 0, 0.03], atol=1e-9)
    box = mass / 12.0 * np.array([0.014**2 + 0.06**2, 0.02**2 + 0.06**2, 0.02**2 + 0.014**2])
    np.testing.assert_allclose(thumb["inertia"], [*box, 0, 0, 0], rtol=1e-5, atol=1e-15)
    assert thumb["source"] == "shapes at 1500 kg/m³"
    assert by_link["r_index_distal"]["mass"] == 0.02
    other = tmp_path / "other"
    other.mkdir()
    denser, _ = describe(other, density=3000.0)
    assert denser.record["inertias"][1]["mass"] == pytest.approx(2.0 * mass, rel=1e-5)


def test_neutral_posture_brings_the_tips_towards_each_other(tmp_path: Path) -> None:
    hand = fill_in(describe(tmp_path)[1])

    def opening(q: np.ndarray) -> float:
        return float(np.linalg.norm(np.subtract(*(hand.tip_pose(q, finger.name)[0] for finger in hand.fingers))))

    assert opening(hand.neutral) < 0.95 * opening(0.5 * (hand.q_lower + hand.q_upper)) or opening(hand.neutral) < 0.1
    assert (hand.neutral > hand.q_lower).all()
    assert (hand.neutral < hand.q_upper).all()


def test_given_urdf_serves_if_nothing_must_change(tmp_path: Path) -> None:
    source = load("four_finger").urdf_path
    described = describe_urdf(source, tmp_path / "hand.json", AuthoringOptions())
    assert described.urdf_text is None
    described.write(tmp_path / "hand.json")
    hand = fill_in(tmp_path / "hand.json")
    assert hand.urdf_path.samefile(source)
    assert [finger.tip for finger in hand.fingers] == [finger.tip for finger in load("four_finger").fingers]


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_fingertips_of_shipped_hands_are_found(name: str) -> None:
    """Every finger's tip frame is within 1.1 radii of the centre of its pad."""
    hand = load(name)
    tips = {tip.frame: tip for tip in find_fingertips(hand.urdf, hand.urdf_path)}
    assert set(tips) == {finger.tip for finger in hand.fingers}
    for finger in hand.fingers:
        assert tips[finger.tip].frame_offset <= 1.1 * (finger.tip_radius or 0.0)


def test_existing_files_are_kept_unless_they_are_to_be_replaced(tmp_path: Path) -> None:
    described, path = describe(tmp_path)
    for existing in (path, tmp_path / "my_hand.urdf"):
        before = existing.read_text()
        with pytest.raises(InvalidInput, match="a new file"):
            described.write(path)
        assert existing.read_text() == before
        existing.write_text("other")
        described.write(path, replace=True)
        assert existing.read_text() == before
        existing.unlink()


def test_errors_name_the_base_and_files_without_fingers(tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match="hull"):
        describe(tmp_path, base="hull")
    with pytest.raises(ModelError, match="mimics elbow_2, which is not in the file"):
        describe(tmp_path, leader="elbow_2")
    (tmp_path / "still.urdf").write_text('<robot name="still"><link name="base"/></robot>')
    with pytest.raises(ModelError, match="no moving link"):
        describe_urdf(tmp_path / "still.urdf", tmp_path / "still.json", AuthoringOptions())
    with pytest.raises(InvalidInput, match="density"):
        AuthoringOptions(density=0.0)

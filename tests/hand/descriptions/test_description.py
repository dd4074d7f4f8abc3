"""Own description files: coupled, locked and replaced values, and errors of descriptions and URDFs."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from graspforce.core.errors import InvalidInput, ModelError, UnknownName
from graspforce.hand.descriptions.description import MODELS_FOLDER
from graspforce.hand.hand import Hand

# A wrist and a finger of two joints, 40 mm and 30 mm long. Tests replace the parts in braces.
URDF = """<robot name="two">
  <link name="palm"/>
  <joint name="wrist" type="revolute">
    <parent link="palm"/><child link="carpus"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
  <link name="carpus">
    <inertial><mass value="0.1"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="near" type="revolute">
    <parent link="carpus"/><child link="first"/><axis xyz="0 1 0"/><limit lower="-0.5" upper="1.5" effort="1" velocity="1"/>
  </joint>
  <link name="first">
    <inertial>
      <origin xyz="0.02 0 0"/><mass value="0.03"/><inertia ixx="1e-6" iyy="4e-6" izz="4e-6" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="far" type="{far_type}">
    <parent link="first"/><child link="second"/><origin xyz="0.04 0 0"/><axis xyz="0 1 0"/>{far_limit}{mimic}
  </joint>
  <link name="second">
    <inertial>
      <origin xyz="0.015 0 0"/><mass value="0.02"/><inertia ixx="1e-6" iyy="2e-6" izz="2e-6" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="end" type="fixed"><parent link="second"/><child link="tip"/><origin xyz="0.03 0 0"/></joint>
  <link name="tip"/>
</robot>"""

FAR_LIMIT = '<limit lower="-0.2" upper="0.8" effort="1" velocity="1"/>'

MOTOR = {"joints": ["*"], "torque": 0.5, "velocity": 3.0, "rotor_inertia": 1e-8, "gear_ratio": 50.0, "source": "invented"}


def write(folder: Path, *, far_type: str = "revolute", far_limit: str = FAR_LIMIT, mimic: str = "", **changes: Any) -> Path:
    """Write a description and its URDF with changed fields, None for a missing one; return the description's path."""
    (folder / "two.urdf").write_text(URDF.format(far_type=far_type, far_limit=far_limit, mimic=mimic))
    record: dict[str, Any] = {
        "schema": "graspforce/hand/1",
        "name": "two",
        "title": "A finger of two joints",
        "source": "invented",
        "license": "none",
        "urdf": "two.urdf",
        "fingers": [{"name": "finger", "tip": "tip"}],
        "motors": [MOTOR],
        **changes,
    }
    path = folder / "two.json"
    path.write_text(json.dumps({name: value for name, value in record.items() if value is not None}))
    return path


def follows(ratio: float = 1.0, offset: float = 0.0) -> dict[str, Any]:
    """Return a coupling of the far joint to the near one."""
    return {"follower": "far", "leader": "near", "ratio": ratio, "offset": offset, "source": "invented"}


# ── own descriptions ───────────────────────────────────────────────────────────────────────────────────────────────────────


def test_pad_gives_the_torsional_friction_of_a_finger(tmp_path: Path) -> None:
    pad = {"torsional_friction": 0.003, "source": "measured"}
    hand = Hand.load(write(tmp_path, fingers=[{"name": "finger", "tip": "tip", "pad": pad}]))
    assert hand.finger("finger").torsional_friction == 0.003
    assert hand.describe()["fingers"][0]["torsional_friction"] == 0.003
    assert hand.with_pads(None).finger("finger").torsional_friction is None
    assert hand.with_pads(0.004).finger("finger").torsional_friction == 0.004
    for bad in (0.0, -1e-3, float("nan")):
        with pytest.raises(InvalidInput, match="torsional_friction"):
            hand.with_pads(bad)
    for change in ({"torsional_friction": 0.0}, {"source": None}, {"stiffness": 1.0}):
        broken = {"name": "finger", "tip": "tip", "pad": {**pad, **change}}
        with pytest.raises(ModelError, match="pad"):
            Hand.load(write(tmp_path, fingers=[broken]))
    assert Hand.load(write(tmp_path)).finger("finger").torsional_friction is None


def test_joints_have_the_order_of_the_finger_s_chain(tmp_path: Path) -> None:
    hand = Hand.load(write(tmp_path, fingers=[{"name": "finger", "tip": "tip", "tip_radius": 0.01}]))
    assert [joint.name for joint in hand.joints] == ["wrist", "near", "far"]
    assert repr(hand) == "<Hand two: 1 fingers, 3 motors>"
    assert hand.finger("finger").tip_radius == 0.01
    np.testing.assert_allclose(hand.tip_pose(np.zeros(3), "finger")[0], [0.07, 0, 0], atol=1e-15)
    np.testing.assert_allclose(hand.rotor_inertia, 1e-8 * 50**2)


def test_utilisation_weights_are_inverse_squares_of_the_limits(tmp_path: Path) -> None:
    weak = {**MOTOR, "joints": ["far"], "torque": 0.1}
    strong = {**MOTOR, "joints": ["wrist", "n*"]}
    hand = Hand.load(write(tmp_path, motors=[weak, strong], torque_weight="utilisation"))
    tau = hand.torque_upper
    np.testing.assert_allclose(hand.torque_weight * tau**2, 1.0)
    np.testing.assert_array_equal(Hand.load(write(tmp_path)).torque_weight, 1.0)


def test_limits_of_a_follower_narrow_those_of_its_leader(tmp_path: Path) -> None:
    """far = −0.5 near + 0.1 in [−0.2, 0.8] gives near in [−1.4, 0.6]; with its own limits, [−0.5, 0.6]."""
    hand = Hand.load(write(tmp_path, couplings=[follows(-0.5, 0.1)]))
    assert [(joint.name, joint.lower, joint.upper) for joint in hand.joints] == [
        ("wrist", -1, 1),
        ("near", -0.5, pytest.approx(0.6)),
    ]
    np.testing.assert_allclose(hand.T @ [0.3, 0.4] + hand.q0, [0.3, 0.4, -0.1])


def test_coupled_hand_equals_the_free_hand_at_q_full(tmp_path: Path) -> None:
    """With torques and inertias transformed by T (virtual work)."""
    free = Hand.load(write(tmp_path))
    coupled = Hand.load(write(tmp_path, couplings=[follows(0.5, 0.05)]))
    rng = np.random.default_rng(4)
    q, v, a = (rng.uniform(-0.4, 0.4, size=2) for _ in range(3))
    q_full, v_full, a_full = coupled.T @ q + coupled.q0, coupled.T @ v, coupled.T @ a
    rotor = np.zeros(3)
    links = free.inverse_dynamics(q_full, v_full, a_full) - free.rotor_inertia * a_full
    np.testing.assert_allclose(coupled.inverse_dynamics(q, v, a), coupled.T.T @ links + coupled.rotor_inertia * a, atol=1e-15)
    M_links = free.mass_matrix(q_full) - np.diag(free.rotor_inertia)
    np.testing.assert_allclose(
        coupled.mass_matrix(q), coupled.T.T @ M_links @ coupled.T + np.diag(coupled.rotor_inertia), atol=1e-17
    )
    np.testing.assert_allclose(coupled.tip_pose(q, "finger")[0], free.tip_pose(q_full, "finger")[0], atol=1e-15)
    np.testing.assert_allclose(coupled.energy(q, rotor[:2]), free.energy(q_full, rotor), atol=1e-15)


def test_locked_joint_keeps_its_position(tmp_path: Path) -> None:
    hand = Hand.load(write(tmp_path, locked=[{"joint": "wrist", "position": np.pi / 2, "source": "invented"}]))
    assert [joint.name for joint in hand.joints] == ["near", "far"]
    np.testing.assert_allclose(hand.tip_pose(np.zeros(2), "finger")[0], [0, 0.07, 0], atol=1e-15)


def test_description_inertia_replaces_that_of_the_urdf(tmp_path: Path) -> None:
    """Known answer for a horizontal finger: 30 g at 20 mm and 50 g at 65 mm."""
    override = {
        "link": "second",
        "mass": 0.05,
        "com": [0.025, 0, 0],
        "inertia": [1e-6, 3e-6, 3e-6, 0, 0, 0],
        "source": "invented",
    }
    hand = Hand.load(write(tmp_path, inertias=[override]))
    torque = hand.gravity_torque(np.zeros(3))
    np.testing.assert_allclose(torque, [0, -9.81 * (0.03 * 0.02 + 0.05 * 0.065), -9.81 * 0.05 * 0.025], atol=1e-15)
    M = hand.mass_matrix(np.zeros(3)) - np.diag(hand.rotor_inertia)
    assert M[2, 2] == pytest.approx(3e-6 + 0.05 * 0.025**2, rel=1e-12)


# ── errors ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_error_for_an_unknown_hand_lists_the_hands() -> None:
    with pytest.raises(UnknownName, match="ability_right, allegro_left, allegro_right, anthropomorphic15, "):
        Hand.load("five_finger")


def test_error_for_a_urdf_asks_for_a_description() -> None:
    with pytest.raises(ModelError, match="description file"):
        Hand.load(MODELS_FOLDER / "four_finger.urdf")


def test_error_for_missing_robot_data_names_the_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def missing(name: str) -> None:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "files", missing)
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    with pytest.raises(ModelError, match=r"pip install example-robot-data"):
        Hand.load("allegro_right")


def test_robot_data_is_found_below_the_interpreter_s_prefix(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As in conda, without a wheel: share/example-robot-data."""
    share = tmp_path / "share" / "example-robot-data" / "robots"
    share.mkdir(parents=True)
    path = write(tmp_path, urdf="package://example-robot-data/robots/two.urdf")
    (tmp_path / "two.urdf").rename(share / "two.urdf")

    def missing(name: str) -> None:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "files", missing)
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    assert Hand.load(path).urdf_path == share / "two.urdf"


MIMIC = '<mimic joint="near" multiplier="0.7"/>'

CONTRADICTIONS: dict[str, tuple[dict[str, Any], str]] = {
    "no such tip": ({"fingers": [{"name": "finger", "tip": "nail"}]}, "the tip of finger finger is nail"),
    "a fixed tip": ({"fingers": [{"name": "finger", "tip": "palm"}]}, "no joint moves the tip palm"),
    "the same finger twice": ({"fingers": [{"name": "a", "tip": "tip"}] * 2}, "two fingers are named a"),
    "a joint of no finger": ({"fingers": [{"name": "finger", "tip": "first"}]}, "joint far moves no finger's tip"),
    "no motor": (
        {"motors": [{**MOTOR, "joints": ["wrist"]}]},
        "joint near must match the joints of exactly one motor, not of 0",
    ),
    "two motors": ({"motors": [MOTOR, MOTOR]}, "exactly one motor, not of 2"),
    "an unknown follower": ({"couplings": [{**follows(), "follower": "farther"}]}, "the coupled joint farther"),
    "two leaders": ({"couplings": [follows(), {**follows(), "leader": "wrist"}]}, "follows two leaders"),
    "a chain of followers": (
        {"couplings": [follows(), {**follows(), "follower": "near", "leader": "wrist"}]},
        "itself a follower",
    ),
    "a coupling without range": ({"couplings": [follows(0.1, 3.0)]}, "leave no range"),
    "a mimic joint that is not coupled": ({"mimic": MIMIC}, "mimics near .*add it to the couplings"),
    "a mimic joint coupled otherwise": ({"mimic": MIMIC, "couplings": [follows(0.5)]}, "near × 0.5.*near × 0.7"),
    "an unknown lock": ({"locked": [{"joint": "elbow", "source": "invented"}]}, "the locked joint elbow"),
    "locked and coupled": (
        {"locked": [{"joint": "far", "source": "invented"}], "couplings": [follows()]},
        "both locked and coupled",
    ),
    "a locked leader": ({"locked": [{"joint": "near", "source": "invented"}], "couplings": [follows()]}, "near is both"),
    "a continuous joint": ({"far_type": "continuous"}, "far is continuous"),
    "a joint without limits": ({"far_limit": '<limit effort="1" velocity="1"/>'}, "far"),
    "a neutral posture outside": ({"neutral": {"far": 0.9}}, r"far = 0\.9 rad is outside"),
    "a neutral joint unknown": ({"neutral": {"elbow": 0.0}}, "the neutral posture has elbow"),
    "an inertia of no link": (
        {"inertias": [{"link": "nail", "mass": 1, "com": [0, 0, 0], "inertia": [1, 1, 1, 0, 0, 0], "source": "invented"}]},
        "has no link nail",
    ),
    "an unknown field": ({"thumbs": 1}, "thumbs"),
    "a field missing": ({"motors": None}, "motors"),
    "a motor without torque": ({"motors": [{**MOTOR, "torque": 0}]}, r"torque|> 0"),
    "another schema": ({"schema": "graspforce/hand/2"}, "graspforce/hand/2"),
    "no such urdf": ({"urdf": "three.urdf"}, "three.urdf"),
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_error_for_a_contradiction_names_it(case: str, tmp_path: Path) -> None:
    changes, said = CONTRADICTIONS[case]
    with pytest.raises(ModelError, match=said):
        Hand.load(write(tmp_path, **changes))


URDFS = {
    "not XML": ("<robot", "not XML"),
    "not a robot": ("<model/>", "not <robot>"),
    "an entity": ('<!DOCTYPE robot [<!ENTITY a "b">]><robot name="r"/>', "document type"),
    "no links": ('<robot name="r"/>', "exactly one root link"),
    "two roots": ('<robot name="r"><link name="a"/><link name="b"/></robot>', "exactly one root link"),
    "a name twice": ('<robot name="r"><link name="a"/><link name="a"/></robot>', "the name a of another"),
    "a loop": (
        '<robot name="r"><link name="a"/><link name="b"/>'
        '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
        '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint></robot>',
        "exactly one root link",
    ),
    "a loop apart": (
        '<robot name="r"><link name="root"/><link name="a"/><link name="b"/>'
        '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
        '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint></robot>',
        "loop of joints",
    ),
    "a link with two parents": (
        '<robot name="r"><link name="a"/><link name="b"/>'
        '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
        '<joint name="k" type="fixed"><parent link="a"/><child link="b"/></joint></robot>',
        "more than one joint",
    ),
    "a joint to nowhere": (
        '<robot name="r"><link name="a"/><joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint></robot>',
        "names the link b",
    ),
    "not a number": (
        URDF.format(far_type="revolute", far_limit=FAR_LIMIT.replace("0.8", "π"), mimic=""),
        "upper = 'π'",
    ),
    "an infinite number": (URDF.format(far_type="revolute", far_limit=FAR_LIMIT.replace("0.8", "1e999"), mimic=""), "finite"),
    "two coordinates": (
        URDF.format(far_type="revolute", far_limit=FAR_LIMIT, mimic="").replace("0.04 0 0", "0.04 0"),
        "three numbers",
    ),
}


@pytest.mark.parametrize("case", URDFS)
def test_error_for_an_invalid_urdf_states_the_reason(case: str, tmp_path: Path) -> None:
    path = write(tmp_path)
    text, said = URDFS[case]
    (tmp_path / "two.urdf").write_text(text)
    with pytest.raises(ModelError, match=said):
        Hand.load(path)


def test_description_that_is_not_text_is_a_model_error(tmp_path: Path) -> None:
    (tmp_path / "hand.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ModelError, match="cannot be read"):
        Hand.load(tmp_path / "hand.json")

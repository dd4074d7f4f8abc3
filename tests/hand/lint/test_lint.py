"""Checks of hand models: each fault in a sound URDF is found, and the sound URDF has none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.hands import SHIPPED_HANDS, load

from graspforce.core.errors import ModelError, UnknownName
from graspforce.hand.hand import Hand
from graspforce.hand.lint.findings import Finding
from graspforce.hand.lint.lint_hand import lint_hand

# A uniform bar of 60 × 16 × 16 mm and 40 g that rotates about one end.
BAR = '<collision><origin xyz="0.03 0 0"/><geometry><box size="0.06 0.016 0.016"/></geometry></collision>'
MESH = '<collision><geometry><mesh filename="package://nowhere/bar.stl"/></geometry></collision>'
LIMIT = '<limit lower="-0.5" upper="1" effort="0.5" velocity="3"/>'
SOUND = {"mass": "0.04", "com": "0.03 0 0", "I": (1.707e-6, 1.285e-5, 1.285e-5, 0.0), "shape": BAR, "limit": LIMIT, "more": ""}


def urdf(**faults: object) -> str:
    """Return the URDF of the bar with some values replaced by faults."""
    f = {**SOUND, **faults}
    ixx, iyy, izz, ixy = f["I"]  # type: ignore[misc]
    inertial = (
        f'<inertial><origin xyz="{f["com"]}"/><mass value="{f["mass"]}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="0" iyz="0"/></inertial>'
    )
    return f"""<robot name="one">
      <link name="palm"/>
      <joint name="knuckle" type="{f.get("type", "revolute")}">
        <parent link="palm"/><child link="bar"/><axis xyz="0 1 0"/>{f["limit"]}{f["more"]}
      </joint>
      <link name="bar">{f.get("inertial", inertial)}{f["shape"]}</link>
      <joint name="end" type="fixed"><parent link="bar"/><child link="tip"/><origin xyz="0.06 0 0"/></joint>
      <link name="tip">{f.get("tip", "")}</link>
    </robot>"""


def description(folder: Path, motor: dict[str, object] | None = None, **faults: object) -> Path:
    """Write a description and the URDF of the bar; return the description's path."""
    (folder / "one.urdf").write_text(urdf(**faults))
    record = {
        "schema": "graspforce/hand/1",
        "name": "one",
        "title": "A bar",
        "source": "invented",
        "license": "none",
        "urdf": "one.urdf",
        "fingers": [{"name": "bar", "tip": "tip"}],
        "motors": [
            {"joints": ["*"], "torque": 0.5, "velocity": 3, "rotor_inertia": 1e-8, "source": "invented", **(motor or {})}
        ],
    }
    (folder / "one.json").write_text(json.dumps(record))
    return folder / "one.json"


def only_finding(findings: tuple[Finding, ...], words: str) -> Finding:
    """Return the only finding whose problem contains words."""
    matching = [finding for finding in findings if words in finding.problem]
    assert len(matching) == 1, [finding.problem for finding in findings]
    return matching[0]


def test_sound_hand_has_no_findings(tmp_path: Path) -> None:
    assert lint_hand(description(tmp_path)) == ()
    # The centre of mass may be away from the centre of the shape, and the shape may be a mesh.
    assert lint_hand(description(tmp_path, com="0.038 0.001 0")) == ()
    assert lint_hand(description(tmp_path, shape=MESH)) == ()


LINK_FAULTS: dict[str, tuple[dict[str, object], str, str, str]] = {
    "triangle": (
        {"I": (1.707e-6, 0.5e-5, 1.285e-5, 0.0)},
        "error",
        "triangle inequality: 1.29e-05 > 1.71e-06 + 5e-06",
        "no body has this inertia",
    ),
    "indefinite": (
        {"I": (1.707e-6, 1.285e-5, 1.285e-5, 6e-6)},
        "error",
        "not positive definite",
        "accelerate against its torque",
    ),
    "no inertia": ({"I": (0.0, 0.0, 0.0, 0.0)}, "error", "not positive definite", "accelerate against its torque"),
    "about the joint": ({"I": (1.707e-6, 4.885e-5, 4.885e-5, 0.0)}, "error", "more than half", "too large"),
    "a point": ({"I": (1e-7, 1e-7, 1e-7, 0.0)}, "warning", "less than a twentieth", "too small"),
    "mass at the joint": (
        {"com": "0 0 0"},
        "warning",
        "at its origin, 30.0 mm from the centre of its shapes",
        "by up to 0.012 N·m",
    ),
    "mass far away": (
        {"com": "0.3 0 0"},
        "warning",
        "270.0 mm from the centre of its shapes, outside of them",
        "by up to 0.11 N·m",
    ),
    "mass at a mesh's joint": ({"com": "0 0 0", "shape": MESH}, "warning", "from the centre between its joints", "N·m"),
    "falls up": ({"mass": "-0.04"}, "error", "its mass is -0.04 kg", "wrong sign"),
    "weightless": ({"mass": "0"}, "error", "has mass 0, like everything fixed to it", "mass matrix M is singular"),
    "no inertial": ({"inertial": ""}, "error", "has no mass", "mass matrix M is singular"),
    "a weightless tip": ({"tip": BAR}, "warning", "has no mass", "missing in every torque"),
}


@pytest.mark.parametrize("case", LINK_FAULTS)
def test_link_fault_is_found_with_its_consequence(case: str, tmp_path: Path) -> None:
    faults, severity, what, consequence = LINK_FAULTS[case]
    path = tmp_path / "one.urdf"
    path.write_text(urdf(**faults))
    finding = only_finding(lint_hand(path), what)
    assert finding.severity == severity
    assert finding.location == ("link tip" if "tip" in faults else "link bar")
    assert consequence in finding.consequence
    assert finding.remedy


def test_inertia_is_compared_with_the_size_of_meshes(tmp_path: Path) -> None:
    """The bar as a mesh, with its inertia, and with one in g·m² that is taken for kg·m²."""
    corners = [(x, y, z) for x in (0.0, 0.06) for y in (-0.008, 0.008) for z in (-0.008, 0.008)]
    faces = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    triangles = [corner for a, b, c, d in faces for corner in ((a, b, c), (a, c, d))]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in triangles]
    (tmp_path / "bar.obj").write_text("\n".join(lines) + "\n")
    mesh = '<collision><geometry><mesh filename="bar.obj"/></geometry></collision>'
    assert lint_hand(description(tmp_path, shape=mesh)) == ()
    finding = only_finding(lint_hand(description(tmp_path, shape=mesh, I=(1.707e-3, 1.285e-2, 1.285e-2, 0.0))), "gyration")
    assert (finding.severity, finding.location) == ("error", "link bar")
    assert "566.79 mm, is more than half of its diagonal, 64.1 mm" in finding.problem


JOINT_FAULTS: dict[str, tuple[dict[str, object], str, str]] = {
    "no effort": ({"limit": '<limit lower="-0.5" upper="1" velocity="3"/>'}, "error", "effort limit is missing"),
    "zero effort": ({"limit": LIMIT.replace('0.5" v', '0" v')}, "error", "effort limit is 0"),
    "absurd effort": ({"limit": LIMIT.replace('0.5" v', '1000" v')}, "warning", "1000 N·m, more than a joint of a hand has"),
    "no limits": (
        {"type": "continuous", "limit": '<limit effort="0.5" velocity="3"/>'},
        "error",
        "is continuous with limits None",
    ),
    "limits the wrong way round": ({"limit": LIMIT.replace('upper="1"', 'upper="-1"')}, "error", "limits -0.5 and -1.0"),
    "mimic": ({"more": '<mimic joint="other" multiplier="0.7"/>'}, "warning", "mimics other × 0.7 + 0"),
    "stuck": ({"more": '<dynamics friction="10"/>'}, "warning", "static friction in the URDF is 10 N·m"),
    "half stuck": ({"more": '<dynamics friction="0.26"/>'}, "warning", "0.26 N·m, more than its motor can overcome"),
    "overdamped": ({"more": '<dynamics damping="0.2"/>'}, "warning", "damping in the URDF is 0.2 N·m·s/rad"),
    "negative friction": ({"more": '<dynamics friction="-0.1"/>'}, "warning", "static friction in the URDF is -0.1 N·m"),
}


@pytest.mark.parametrize("case", JOINT_FAULTS)
def test_joint_fault_is_found(case: str, tmp_path: Path) -> None:
    faults, severity, what = JOINT_FAULTS[case]
    path = tmp_path / "one.urdf"
    path.write_text(urdf(**faults))
    finding = only_finding(lint_hand(path), what)
    assert (finding.severity, finding.location) == (severity, "joint knuckle")


def test_sound_urdf_lacks_only_the_rotor_inertia(tmp_path: Path) -> None:
    (tmp_path / "one.urdf").write_text(urdf())
    (only,) = lint_hand(tmp_path / "one.urdf")
    assert (only.severity, only.problem) == ("warning", "a URDF has no rotor inertia")


@pytest.mark.parametrize(
    ("motor", "what"), [({"rotor_inertia": 0}, "the rotor inertia is zero"), ({"torque": 15}, "motor torque is 15 N·m")]
)
def test_motor_fault_is_found(motor: dict[str, object], what: str, tmp_path: Path) -> None:
    finding = only_finding(lint_hand(description(tmp_path, motor)), what)
    assert (finding.severity, finding.location) == ("warning", "joints *")


def test_plausible_dynamics_have_no_finding(tmp_path: Path) -> None:
    """0.25 N·m is half of the motor's torque, and 0.1 N·m·s/rad leaves 0.2 N·m at the largest rate."""
    assert lint_hand(description(tmp_path, more='<dynamics friction="0.25" damping="0.1"/>')) == ()


def test_large_friction_in_a_description_is_found(tmp_path: Path) -> None:
    path = description(tmp_path)
    record = json.loads(path.read_text())
    for coulomb, count in ((0.2, 0), (0.3, 1)):
        record["friction"] = [{"joints": ["*"], "coulomb": coulomb, "stribeck": 0.04, "source": "invented"}]
        path.write_text(json.dumps(record))
        assert len(lint_hand(path)) == count
    assert only_finding(lint_hand(path), "0.34 N·m, more than half of the motor's 0.5 N·m").severity == "warning"


def test_loading_error_is_the_first_finding(tmp_path: Path) -> None:
    path = description(tmp_path, com="0 0 0", more='<mimic joint="other"/>')
    first, *others = lint_hand(path)
    assert (first.severity, first.consequence) == ("error", "the hand cannot be loaded")
    assert [finding.severity for finding in others] == ["warning"]
    with pytest.raises(ModelError) as caught:
        Hand.load(path)
    assert str(caught.value) == first.problem


def test_torque_in_a_warning_is_the_missing_gravity_torque(tmp_path: Path) -> None:
    """The number in the consequence is the gravity torque of the horizontal bar, which the wrong model lacks."""
    wrong, right = tmp_path / "wrong", tmp_path / "right"
    wrong.mkdir()
    right.mkdir()
    finding = only_finding(lint_hand(description(wrong, com="0 0 0")), "at its origin")
    torques = [
        Hand.load(description(folder, **c)).gravity_torque([0.0])[0] for folder, c in ((wrong, {"com": "0 0 0"}), (right, {}))
    ]
    assert torques[0] == 0.0
    assert f"by up to {abs(torques[1]):.2g} N·m" in finding.consequence


def test_centre_of_mass_does_not_matter_on_a_sliding_joint(tmp_path: Path) -> None:
    """The weight's force along the slide is the same wherever the centre is."""
    fault: dict[str, object] = {"com": "0 0 0", "type": "prismatic", "limit": LIMIT}
    path = description(tmp_path, **fault)
    assert not [each for each in lint_hand(path) if "centre of mass" in each.problem]
    centred = Hand.load(path).model
    moved = Hand.load(description(tmp_path, **(fault | {"com": "0.03 0.01 0"}))).model
    zero, gravity = np.zeros(1), np.array([1.0, 9.81, 2.0])
    weights = [model.inverse_dynamics(zero, zero, zero, gravity) for model in (centred, moved)]
    np.testing.assert_allclose(weights[0], weights[1], rtol=1e-12)


def test_mass_matrix_of_a_massless_joint_is_singular(tmp_path: Path) -> None:
    path = description(tmp_path, {"rotor_inertia": 0}, inertial="")
    assert only_finding(lint_hand(path), "has no mass").severity == "error"
    np.testing.assert_array_equal(Hand.load(path).mass_matrix([0.3]), [[0.0]])
    geared = description(tmp_path, inertial="")
    assert only_finding(lint_hand(geared), "has no mass").severity == "warning"
    assert Hand.load(geared).mass_matrix([0.3])[0, 0] > 0


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_shipped_hands_have_no_errors(name: str) -> None:
    load(name)
    findings = lint_hand(name)
    assert [finding for finding in findings if finding.severity == "error"] == []
    if not name.startswith("allegro"):
        assert findings == ()


@pytest.mark.parametrize("side", ["right", "left"])
def test_allegro_description_corrects_the_faults_of_its_urdf(side: str) -> None:
    """The URDF has all centres of mass at the joints, four impossible inertias, 15 N·m, and too much static friction."""
    hand = load(f"allegro_{side}")
    urdf_findings = lint_hand(hand.urdf_path)
    count = {
        words: sum(words in finding.problem for finding in urdf_findings)
        for words in ("at its origin", "triangle", "15 N·m", "friction")
    }
    assert count == {"at its origin": 16, "triangle": 4, "15 N·m": 16, "friction": 16}
    findings = lint_hand(f"allegro_{side}")
    assert {finding.problem.split(" in ")[0] for finding in findings} == {"its static friction"}
    assert len(findings) == 16


def test_pads_that_are_too_large_or_cannot_follow_a_spin_are_found(tmp_path: Path) -> None:
    """The bar has one motor, and a tip of 9 mm radius, whose largest patch has γ = 6 mm."""
    path = description(tmp_path)
    record = json.loads(path.read_text())
    for gamma, sizes in ((0.0059, 0), (0.0061, 1)):
        pad = {"torsional_friction": gamma, "source": "invented"}
        record["fingers"] = [{"name": "bar", "tip": "tip", "tip_radius": 0.009, "pad": pad}]
        path.write_text(json.dumps(record))
        findings = lint_hand(path)
        assert [finding.severity for finding in findings] == ["warning"] * (1 + sizes)
        assert only_finding(findings, "only 1 motors").location == "finger bar"
        assert sum("two thirds of the tip's radius" in finding.problem for finding in findings) == sizes


def test_error_for_an_unknown_model_lists_the_hands() -> None:
    with pytest.raises(UnknownName, match="four_finger"):
        lint_hand("five_finger")

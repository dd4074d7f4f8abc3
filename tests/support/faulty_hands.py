"""A corpus of hand descriptions with one defect each, generated from a sound one, and of sound ones that look unusual."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Record = dict[str, Any]
Edit = Callable[[Record], Any]

_FINGER = """
  <joint name="{side}_knuckle" type="revolute">
    <parent link="palm"/><child link="{side}_near"/><origin xyz="0 {y} 0.02"/><axis xyz="0 1 0"/>
    <limit lower="-0.5" upper="1.2" effort="0.5" velocity="4"/>
  </joint>
  <link name="{side}_near">
    <inertial>
      <origin xyz="0 0 0.025"/><mass value="0.03"/>
      <inertia ixx="6.73e-06" iyy="6.73e-06" izz="9.8e-07" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision><origin xyz="0 0 0.025"/><geometry><box size="0.014 0.014 0.05"/></geometry></collision>
  </link>
  <joint name="{side}_middle" type="revolute">
    <parent link="{side}_near"/><child link="{side}_far"/><origin xyz="0 0 0.05"/><axis xyz="0 1 0"/>
    <limit lower="-0.2" upper="1.4" effort="0.5" velocity="4"/>
  </joint>
  <link name="{side}_far">
    <inertial>
      <origin xyz="0 0 0.017"/><mass value="0.015"/>
      <inertia ixx="1.69e-06" iyy="1.69e-06" izz="4.9e-07" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision><origin xyz="0 0 0.017"/><geometry><box size="0.014 0.014 0.034"/></geometry></collision>
  </link>
  <joint name="{side}_end" type="fixed">
    <parent link="{side}_far"/><child link="{side}_tip"/><origin xyz="0 0 0.027"/>
  </joint>
  <link name="{side}_tip"/>"""

URDF = (
    '<robot name="pair">\n  <link name="palm"><collision><geometry><box size="0.06 0.08 0.02"/></geometry></collision></link>'
    + "".join(_FINGER.format(side=side, y=y) for side, y in (("left", 0.025), ("right", -0.025)))
    + "\n</robot>\n"
)
MOTOR: Record = {
    "joints": ["*"],
    "torque": 0.5,
    "velocity": 4.0,
    "rotor_inertia": 1e-8,
    "gear_ratio": 100.0,
    "source": "invented",
}
DESCRIPTION: Record = {
    "schema": "graspforce/hand/1",
    "name": "pair",
    "title": "Two fingers",
    "source": "invented",
    "license": "none",
    "urdf": "pair.urdf",
    "fingers": [{"name": side, "tip": f"{side}_tip", "tip_radius": 0.007} for side in ("left", "right")],
    "motors": [MOTOR],
}


@dataclass(frozen=True)
class Defect:
    """A change of the sound hand, and words of the finding that it must give.

    Attributes:
        words: pattern in the finding.
        swap: text of the URDF and its replacement, for the first occurrence.
        edit: change of the description.
    """

    words: str
    swap: tuple[str, str] | None = None
    edit: Edit | None = None


def write_hand(folder: Path, *, swap: tuple[str, str] | None = None, edit: Edit | None = None) -> Path:
    """Write the sound hand with a change; return the path of its description."""
    text, record = URDF, json.loads(json.dumps(DESCRIPTION))
    if swap is not None:
        assert swap[0] in text, swap[0]
        text = text.replace(*swap, 1)
    if edit is not None:
        edit(record)
    (folder / "pair.urdf").write_text(text)
    path = folder / "pair.json"
    path.write_text(json.dumps(record))
    return path


def motor(**changes: Any) -> Edit:
    """Return the change of the motor's numbers."""
    return lambda record: record["motors"][0].update(changes)


def finger(**changes: Any) -> Edit:
    """Return the change of the first finger."""
    return lambda record: record["fingers"][0].update(changes)


def whole(**changes: Any) -> Edit:
    """Return the change of fields of the description; None removes one."""

    def edit(record: Record) -> None:
        record.update(changes)
        for name in [name for name, value in changes.items() if value is None]:
            del record[name]

    return edit


def coupling(**changes: Any) -> Record:
    """Return a coupling of the left finger's joints."""
    return {"follower": "left_middle", "leader": "left_knuckle", "source": "invented", **changes}


_I = 'ixx="6.73e-06" iyy="6.73e-06" izz="9.8e-07" ixy="0"'
_COM, _MASS = '<origin xyz="0 0 0.025"/><mass value="0.03"/>', '<mass value="0.03"/>'
_LIMIT = 'lower="-0.5" upper="1.2" effort="0.5"'
_AXIS = '<axis xyz="0 1 0"/>'
_BOX = '<geometry><box size="0.014 0.014 0.05"/></geometry>'
_INERTIAL_FAR = URDF[
    URDF.index("<inertial>", URDF.index('"left_far">')) : URDF.index("</inertial>", URDF.index('"left_far">')) + 11
]
_JOINT_END = 'effort="0.5" velocity="4"/>'
_LOCK = {"joint": "left_middle", "source": "invented"}
_INERTIA = {
    "link": "left_far",
    "mass": 0.015,
    "com": [0, 0, 0.017],
    "inertia": [1.69e-6, 1.69e-6, 4.9e-7, 0, 0, 0],
    "source": "x",
}

DEFECTS: dict[str, Defect] = {
    # masses and inertias of the URDF
    "triangle inequality": Defect("triangle inequality", (_I, 'ixx="6.73e-06" iyy="1e-06" izz="9.8e-07" ixy="0"')),
    "indefinite inertia": Defect("not positive definite", (_I, 'ixx="6.73e-06" iyy="6.73e-06" izz="9.8e-07" ixy="8e-06"')),
    "negative moment": Defect("not positive definite", (_I, 'ixx="6.73e-06" iyy="6.73e-06" izz="-9.8e-07" ixy="0"')),
    "zero inertia": Defect("not positive definite", (_I, 'ixx="0" iyy="0" izz="0" ixy="0"')),
    "inertia about the joint": Defect(
        "more than half of its diagonal", (_I, 'ixx="2.55e-05" iyy="2.55e-05" izz="9.8e-07" ixy="0"')
    ),
    "inertia in kg cm2": Defect("more than half of its diagonal", (_I, 'ixx="6.73e-02" iyy="6.73e-02" izz="9.8e-03" ixy="0"')),
    "inertia of a point": Defect("less than a twentieth", (_I, 'ixx="1e-08" iyy="1e-08" izz="1e-08" ixy="0"')),
    "centre of mass at the joint": Defect("at its origin", (_COM, _MASS)),
    "centre of mass in mm": Defect("outside of them", (_COM, f'<origin xyz="0 0 25"/>{_MASS}')),
    "centre of mass elsewhere": Defect("outside of them", (_COM, f'<origin xyz="0.08 0 0.025"/>{_MASS}')),
    "negative mass": Defect("its mass is -0.03 kg", (_MASS, '<mass value="-0.03"/>')),
    "no mass": Defect("has mass 0", (_MASS, '<mass value="0"/>')),
    "no inertial": Defect("has no mass", (_INERTIAL_FAR, "")),
    "mass in g": Defect("its density is 3.06e[+]06", (_MASS, '<mass value="30"/>')),
    "mass of feathers": Defect("its density is 3.06 kg", (_MASS, '<mass value="3e-05"/>')),
    "shape in cm": Defect("its density is 3.06 kg", (_BOX, '<geometry><box size="0.14 0.14 0.5"/></geometry>')),
    "mass that is no number": Defect("must be a finite number", (_MASS, '<mass value="thirty"/>')),
    "mass that is infinite": Defect("must be a finite number", (_MASS, '<mass value="inf"/>')),
    "inertial without mass": Defect("needs a <mass>", (_MASS, "")),
    "tip with a shape but no mass": Defect(
        "has no mass",
        (
            '<link name="left_tip"/>',
            '<link name="left_tip"><collision><geometry><sphere radius="0.007"/></geometry></collision></link>',
        ),
    ),
    # joints of the URDF
    "limits in degrees": Defect("these seem to be in degrees", (_LIMIT, 'lower="-28" upper="68" effort="0.5"')),
    "one limit in degrees": Defect("these seem to be in degrees", (_LIMIT, 'lower="0" upper="90" effort="0.5"')),
    "limits reversed": Defect("lower limit below its upper", (_LIMIT, 'lower="1.2" upper="-0.5" effort="0.5"')),
    "limits equal": Defect("lower limit below its upper", (_LIMIT, 'lower="0" upper="0" effort="0.5"')),
    "no limits": Defect("lower limit below its upper", (_LIMIT, 'effort="0.5"')),
    "axis zero": Defect("its axis is zero", (_AXIS, '<axis xyz="0 0 0"/>')),
    "axis of two numbers": Defect("must be three numbers", (_AXIS, '<axis xyz="0 1"/>')),
    "continuous joint": Defect("is continuous", ('type="revolute"', 'type="continuous"')),
    "floating joint": Defect("is floating", ('type="revolute"', 'type="floating"')),
    "friction that locks": Defect("static friction", (_JOINT_END, f'{_JOINT_END}<dynamics friction="2"/>')),
    "damping that locks": Defect("damping in the URDF", (_JOINT_END, f'{_JOINT_END}<dynamics damping="3"/>')),
    "negative friction": Defect("static friction", (_JOINT_END, f'{_JOINT_END}<dynamics friction="-0.1"/>')),
    "mimic without coupling": Defect("add it to the couplings", (_JOINT_END, f'{_JOINT_END}<mimic joint="right_knuckle"/>')),
    "joint to nowhere": Defect("which is not in the file", ('<child link="left_far"/>', '<child link="left_fur"/>')),
    "loop of links": Defect("more than one joint", ('<child link="left_tip"/>', '<child link="left_near"/>')),
    "two roots": Defect("exactly one root link", ("</robot>", '<link name="loose"/></robot>')),
    "two links of one name": Defect("the name left_tip of another", ("</robot>", '<link name="left_tip"/></robot>')),
    # tips
    "tip offset in mm": Defect("outside of the shapes", ('<origin xyz="0 0 0.027"/>', '<origin xyz="0 0 27"/>')),
    "tip beside the link": Defect("outside of the shapes", ('<origin xyz="0 0 0.027"/>', '<origin xyz="0.03 0 0.027"/>')),
    "tip at the joint": Defect("from the centre of the pad", None, finger(tip="left_far")),
    "tip in the middle of the link": Defect(
        "from the centre of the pad", ('<origin xyz="0 0 0.027"/>', '<origin xyz="0 0 0.012"/>')
    ),
    "tip radius in mm": Defect("its tip radius is 7e[+]03 mm", None, finger(tip_radius=7.0)),
    "tip radius a tenth": Defect("its tip radius is 0.7 mm", None, finger(tip_radius=0.0007)),
    "unknown tip": Defect("left_nail, which is no link", None, finger(tip="left_nail")),
    "tip that does not move": Defect("no joint moves the tip palm", None, finger(tip="palm")),
    "pad larger than the tip": Defect(
        "two thirds of the tip's radius", None, finger(pad={"torsional_friction": 0.02, "source": "invented"})
    ),
    # motors
    "torque in N mm": Defect("motor torque is 500 N·m", None, motor(torque=500.0)),
    "torque of the motor shaft": Defect("less than the weight", None, motor(torque=5e-4)),
    "torque zero": Defect("torque", None, motor(torque=0.0)),
    "rate in degrees": Defect("largest rate is 230 rad/s", None, motor(velocity=230.0)),
    "reflected inertia as rotor inertia": Defect("inertia at the joint is 1 kg·m²", None, motor(rotor_inertia=1e-4)),
    "rotor inertia in g cm2": Defect("inertia at the joint is 1e[+]03", None, motor(rotor_inertia=0.1)),
    "rotor inertia zero": Defect("rotor inertia is zero", None, motor(rotor_inertia=0.0)),
    "rotor inertia not filled in": Defect("is not filled in", None, motor(rotor_inertia=None)),
    "joints without motor": Defect("exactly one motor, not of 0", None, motor(joints=["left_*"])),
    "joints with two motors": Defect("exactly one motor, not of 2", None, whole(motors=[MOTOR, MOTOR])),
    # the description
    "unknown field": Defect("thumbs", None, whole(thumbs=1)),
    "field missing": Defect("motors", None, whole(motors=None)),
    "other schema": Defect("graspforce/hand/9", None, whole(schema="graspforce/hand/9")),
    "URDF missing": Defect("there is no file", None, whole(urdf="none.urdf")),
    "finger twice": Defect("two fingers are named left", None, whole(fingers=[DESCRIPTION["fingers"][0]] * 2)),
    "joint of no finger": Defect("moves no finger's tip", None, whole(fingers=[DESCRIPTION["fingers"][0]])),
    "neutral in degrees": Defect("is outside its limits", None, whole(neutral={"left_knuckle": 30.0})),
    "neutral of no joint": Defect("no actuated joint", None, whole(neutral={"elbow": 0.1})),
    "coupling of no joint": Defect("the coupled joint elbow", None, whole(couplings=[coupling(follower="elbow")])),
    "coupling of a follower": Defect(
        "itself a follower",
        None,
        whole(couplings=[coupling(), coupling(follower="left_knuckle", leader="right_knuckle")]),
    ),
    "coupling without range": Defect("leave no range", None, whole(couplings=[coupling(ratio=0.1, offset=5.0)])),
    "joint locked and coupled": Defect("both locked and coupled", None, whole(locked=[_LOCK], couplings=[coupling()])),
    "lock of no joint": Defect("the locked joint elbow", None, whole(locked=[{**_LOCK, "joint": "elbow"}])),
    "inertia of no link": Defect("has no link left_fur", None, whole(inertias=[{**_INERTIA, "link": "left_fur"}])),
    "inertia of the description impossible": Defect(
        "triangle inequality", None, whole(inertias=[{**_INERTIA, "inertia": [1.69e-6, 1e-7, 4.9e-7, 0, 0, 0]}])
    ),
    "friction above the motor's torque": Defect(
        "more than half of the motor's", None, whole(friction=[{"joints": ["*"], "coulomb": 0.4, "source": "invented"}])
    ),
}

_SENSOR = (
    '<link name="left_sensor"><inertial><mass value="0.001"/>'
    '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="left_sensor_mount" type="fixed"><parent link="left_far"/><child link="left_sensor"/>'
    '<origin xyz="0 0.007 0.01"/></joint></robot>'
)
_NESTED = (
    '<link name="a"/><link name="b"/>'
    '<joint name="to_a" type="fixed"><parent link="left_far"/><child link="a"/><origin xyz="0 0 0.01" rpy="1 0 0"/></joint>'
    '<joint name="to_b" type="fixed"><parent link="a"/><child link="b"/><origin xyz="0 0.3 0"/></joint></robot>'
)
_MESH = '<geometry><mesh filename="package://nowhere/near.stl"/></geometry>'

SOUND: dict[str, tuple[tuple[str, str] | None, Edit | None]] = {
    "as it is": (None, None),
    "a sensor of 1 g without moments": (("</robot>", _SENSOR), None),
    "frames without mass behind each other": (("</robot>", _NESTED), None),
    "a mesh that is not found": ((_BOX, _MESH), None),
    "a wrench-shaped offset of the centre of mass": ((_COM, f'<origin xyz="0.002 0 0.03"/>{_MASS}'), None),
    "axis against y": ((_AXIS, '<axis xyz="0 -1 0"/>'), None),
    "steel": ((_MASS, '<mass value="0.076"/>'), None),
    "coupled": (None, whole(couplings=[coupling(ratio=0.8)])),
    "locked": (None, whole(locked=[_LOCK])),
    "no tip radius": (None, finger(tip_radius=None)),
    "reflected inertia with gear ratio 1": (None, motor(rotor_inertia=1e-4, gear_ratio=1.0)),
    "friction of a tenth": (None, whole(friction=[{"joints": ["*"], "coulomb": 0.05, "source": "invented"}])),
}

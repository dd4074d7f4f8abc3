"""Shipped hands with a wrist or a lift in front of the palm, or with a fold of the palm that moves two fingers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import msgspec

from graspforce.hand.descriptions.description import motor_matches
from graspforce.hand.hand import Hand
from support.hands import load

WRIST_OFFSET = (0.0, 0.01, 0.05)  # m, of the palm from the forearm

Record = dict[str, Any]
WristKind = Literal["driven", "locked", "fixed"]


def with_wrist(name: str, kind: WristKind, folder: Path, torque: float = 10.0) -> Hand:
    """Return a shipped hand on a wrist that turns about y of its palm, at zero if it is locked or fixed.

    Args:
        name: name of the shipped hand.
        kind: whether the wrist has a motor, is locked by the description, or is a fixed joint of the URDF.
        folder: for the files.
        torque: of the wrist's motor, N·m.
    """
    base = load(name)
    root, xyz = base.describe()["base"], " ".join(map(str, WRIST_OFFSET))
    joint = (
        f'<link name="forearm"/><joint name="wrist" type="{"fixed" if kind == "fixed" else "revolute"}">'
        f'<parent link="forearm"/><child link="{root}"/><origin xyz="{xyz}"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="0.8" effort="10" velocity="3"/></joint></robot>'
    )
    motor = {"joints": ["wrist"], "torque": torque, "velocity": 3.0, "rotor_inertia": 1e-5, "source": "invented"}
    lock = {"joint": "wrist", "source": "invented"}
    return _write(base, joint, folder, motor if kind == "driven" else None, lock if kind == "locked" else None)


def with_lift(name: str, folder: Path) -> Hand:
    """Return a shipped hand on a lift that moves it by up to 0.2 m along z of its palm, both ways.

    Args:
        name: name of the shipped hand.
        folder: for the files.
    """
    base = load(name)
    joint = (
        '<link name="stand"/><joint name="lift" type="prismatic"><parent link="stand"/>'
        f'<child link="{base.describe()["base"]}"/><axis xyz="0 0 1"/>'
        '<limit lower="-0.2" upper="0.2" effort="200" velocity="0.5"/></joint></robot>'
    )
    motor = {"joints": ["lift"], "torque": 200.0, "velocity": 0.5, "rotor_inertia": 1e-5, "source": "invented"}
    return _write(base, joint, folder, motor, None)


def with_palm_fold(name: str, fingers: tuple[str, str], folder: Path) -> Hand:
    """Return a shipped hand whose palm folds about x of its base with two of the fingers.

    Args:
        name: name of the shipped hand, whose fingers start at its base.
        fingers: the two fingers beyond the fold.
        folder: for the files.
    """
    base = load(name)
    root, text = base.describe()["base"], base.urdf_path.read_text()
    for finger in fingers:  # their first joints hang on the fold instead of on the palm
        first = base.joints[base.finger(finger).joints[0]].name
        at = text.index(f'name="{first}"')
        text = text[:at] + text[at:].replace(f'<parent link="{root}"/>', '<parent link="fold"/>', 1)
    joint = (
        f'<link name="fold"/><joint name="palm_fold" type="revolute"><parent link="{root}"/><child link="fold"/>'
        '<axis xyz="1 0 0"/><limit lower="-0.3" upper="0.3" effort="10" velocity="3"/></joint></robot>'
    )
    motor = {"joints": ["palm_fold"], "torque": 5.0, "velocity": 3.0, "rotor_inertia": 1e-5, "source": "invented"}
    return _write(base, joint, folder, motor, None, text)


def _write(base: Hand, joint: str, folder: Path, motor: Record | None, lock: Record | None, text: str = "") -> Hand:
    record = msgspec.to_builtins(base.description)
    record |= {"name": f"{base.name}_jointed", "urdf": "hand.urdf", "locked": [*record["locked"], *([lock] if lock else [])]}
    if motor is not None:
        for each, described in zip(record["motors"], base.description.motors, strict=True):  # patterns that miss the new joint
            each["joints"] = [j.name for j in base.joints if motor_matches(described, j.name)]
        record["motors"] = [*record["motors"], motor]
    (folder / "hand.urdf").write_text((text or base.urdf_path.read_text()).replace("</robot>", joint))
    (folder / "hand.json").write_text(json.dumps(record))
    return Hand.load(folder / "hand.json")

"""A hand of one finger with two joints, written to a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def joint(name: str, parent: str, child: str, dynamics: str = "") -> str:
    return f"""<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><axis xyz="0 1 0"/>
      <limit lower="-1" upper="1" effort="1" velocity="5"/>{dynamics}</joint>"""


def write_hand(folder: Path, near: str = "", far: str = "", **changes: Any) -> Path:
    """Write a hand of one finger with a joint `near` and a joint `far`, and their <dynamics>; return its description."""
    inertial = '<inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in ("palm", "first", "tip"))
    text = f'<robot name="h">{links}{joint("near", "palm", "first", near)}{joint("far", "first", "tip", far)}</robot>'
    (folder / "h.urdf").write_text(text)
    motor = {"joints": ["*"], "torque": 0.5, "velocity": 3.0, "rotor_inertia": 1e-8, "source": "invented"}
    record: dict[str, Any] = {
        "schema": "graspforce/hand/1",
        "name": "h",
        "title": "A finger",
        "source": "invented",
        "license": "none",
        "urdf": "h.urdf",
        "fingers": [{"name": "finger", "tip": "tip"}],
        "motors": [motor],
        **changes,
    }
    (folder / "h.json").write_text(json.dumps(record))
    return folder / "h.json"

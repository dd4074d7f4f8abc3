"""A controller as C source: the numbers of a grasp and of its settings for `csrc/include/graspforce/controller.h`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from graspforce.contact.compiled_kinematics import primitive_parameters
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.settings import ControlSettings
from graspforce.core.c_tables import c_array, c_list, c_number, check_identifier
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.hand.contact_tips import check_fingertips
from graspforce.hand.model_source import write_hand_source

_DEFAULTS = ControlSettings()
_SURFACES = {
    "plane": "GF_PLANE",
    "sphere": "GF_SPHERE",
    "cylinder": "GF_CYLINDER",
    "box": "GF_BOX",
    "superquadric": "GF_SUPERQUADRIC",
}
_INTEGERS = {"tip_links": "int", "constraint_rows": "int", "force_rows": "int", "moves_tip": "unsigned char"}
_OUTSIDE_GRASP = ("surface", "tip_links")  # parameters that are no arrays or numbers of gf_controlled_grasp


def write_controller(
    grasp: Grasp, folder: Path, settings: ControlSettings = _DEFAULTS, name: str = "grasp"
) -> tuple[Path, Path, Path, Path]:
    """Write the controller of a grasp as C source, for a control loop without Python.

    NAME_controller.h and NAME_controller.c define `const gf_controller_setup NAME_controller`; NAME_hand.h and NAME_hand.c hold
    the hand. Compile both sources with the C library, see `get_cmake_dir`.

    Args:
        grasp: hand, object and contacts.
        folder: existing folder; files of the same names are replaced.
        settings: gains, margins, gravity and limits. Default: palm up, 1 kHz.
        name: C identifier of the grasp.

    Returns:
        Paths of the controller's header and source, and of the hand's header and source.

    Raises:
        InvalidInput: the name is no C identifier, the C code does not support the object's shape, the settings compensate joint
            friction, which the C controller does not, or a contact is not at a fingertip.
    """
    check_identifier(name, "name")
    check_fingertips(grasp.hand, grasp.fingers, "C controllers")
    if settings.friction is not None:
        raise InvalidInput("settings.friction", settings.friction, "None: the C controller does not compensate joint friction")
    if primitive_parameters(grasp.body.shape) is None:
        allowed = "a sphere, cylinder, box or superquadric, or no shape, for which each contact has a plane"
        raise InvalidInput("grasp.body.shape", grasp.body.shape, allowed)
    law = ObjectControlLaw(grasp, settings)
    hand_files = write_hand_source(grasp.hand, folder, name)
    header, source = folder / f"{name}_controller.h", folder / f"{name}_controller.c"
    header.write_text(_header(grasp, name), encoding="utf-8")
    source.write_text(_source(law, name), encoding="utf-8")
    return header, source, *hand_files


def _header(grasp: Grasp, name: str) -> str:
    guard, prefix, fingers = f"{name.upper()}_CONTROLLER_H", name.upper(), ", ".join(grasp.fingers)
    return f"""/* Controller of a grasp of {grasp.hand.name} with {fingers}. Written by graspforce. */
#ifndef {guard}
#define {guard}

#include "graspforce/controller.h"
#include "{name}_hand.h"

#ifdef __cplusplus
extern "C" {{
#endif

enum {{ {prefix}_CONTACT_COUNT = {len(grasp.contacts)}, {prefix}_FORCE_SIZE = {grasp.contacts.size} }};

extern const gf_controller_setup {name}_controller;

#ifdef __cplusplus
}}
#endif

#endif
"""


def _source(law: ObjectControlLaw, name: str) -> str:
    grasp, settings, parameters = law.grasp, law.settings, law.step_parameters()
    kind, *size = parameters["surface"]
    numbers = {key: value for key, value in parameters.items() if isinstance(value, (int, float))}
    arrays: dict[str, Any] = {
        key: value for key, value in parameters.items() if key not in numbers and key not in _OUTSIDE_GRASP
    }
    contacts = grasp.contacts
    setup: dict[str, Any] = {"components": np.bincount(contacts.columns // 4), "tip_links": parameters["tip_links"]}
    solver = law.force_solver
    for level, limits in zip(("nominal", "bare"), solver.limits, strict=True):
        (mu, gamma), (lower, upper) = limits.friction, limits.normal
        setup |= {f"{level}_mu": mu, f"{level}_gamma": gamma, f"{level}_min": lower, f"{level}_max": upper}
    tables = {**arrays, **setup, "tau_u_limits": law.free_torque_limits}
    definitions = [c_array(key, value, _INTEGERS.get(key, _c_type(value))) for key, value in tables.items()]
    fields = [
        f".contact_count = {len(contacts)}",
        f".motor_count = {grasp.hand.n}",
        f".joint_count = {len(grasp.hand.full_joints)}",
        f".constraint_count = {len(parameters['constraint_rows'])}",
        f".force_size = {contacts.size}",
        f".surface = {{{_SURFACES[kind]}, {c_list(np.array(size, dtype=float))}}}",
        *(f".{key} = {c_number(value)}" for key, value in numbers.items()),
        *(f".{key} = {key}" for key in arrays),
    ]
    inner = "".join(f"        {field},\n" for field in fields)
    limits_text = "".join(
        f"    .{level} = {{{level}_mu, {level}_gamma, {level}_min, {level}_max}},\n" for level in ("nominal", "bare")
    )
    definition = (
        f"const gf_controller_setup {name}_controller = {{\n    .hand = &{name}_hand,\n    .grasp = {{\n{inner}    }},\n"
        f"    .components = components,\n    .tip_links = tip_links,\n    .tau_u_limits = tau_u_limits,\n{limits_text}"
        f"    .margin = {c_number(solver.margin)},\n    .force_weight = {c_number(settings.force_weight)},\n}};\n"
    )
    head = f'/* Numbers of {name}_controller.h. */\n#include "{name}_controller.h"\n\n#include <math.h>\n'
    return "\n".join([head, *definitions, definition])


def _c_type(values: Any) -> str:
    return "int" if np.asarray(values).dtype.kind == "i" else "gf_real"

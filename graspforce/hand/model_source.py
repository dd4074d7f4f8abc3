"""A hand as C source: the table that `csrc/include/graspforce/hand_model.h` computes kinematics and dynamics from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from graspforce.core.c_tables import c_array, c_list, c_number, check_identifier
from graspforce.hand.hand import Hand


def write_hand_source(hand: Hand, folder: Path, name: str | None = None) -> tuple[Path, Path]:
    """Write NAME_hand.h and NAME_hand.c, which define `const gf_hand_model NAME_hand`.

    The table holds the links, the couplings q_full = T q + q0, rotor inertias, limits and torque weights. The files are the
    same for the same hand on every machine.

    Args:
        hand: the hand.
        folder: existing folder; files of the same names are replaced.
        name: C identifier. Default: the name of the hand.

    Returns:
        Paths of the header and of the source.

    Raises:
        InvalidInput: the name is no C identifier.
    """
    name = check_identifier(hand.name if name is None else name, "name")
    header, source = folder / f"{name}_hand.h", folder / f"{name}_hand.c"
    header.write_text(_header(hand, name), encoding="utf-8")
    source.write_text(_source(hand, name), encoding="utf-8")
    return header, source


def _header(hand: Hand, name: str) -> str:
    guard = f"{name.upper()}_HAND_H"
    return f"""/* {hand.title}. Written by graspforce.
 *
 * Source: {_one_line(hand.source)}
 * Licence: {_one_line(hand.license)} */
#ifndef {guard}
#define {guard}

#include "graspforce/hand_model.h"

#ifdef __cplusplus
extern "C" {{
#endif

enum {{ {name.upper()}_MOTOR_COUNT = {hand.n}, {name.upper()}_JOINT_COUNT = {len(hand.full_joints)} }};

extern const gf_hand_model {name}_hand;

#ifdef __cplusplus
}}
#endif

#endif
"""


def _one_line(text: str) -> str:
    return " ".join(text.split()).replace("*/", "* /")


def _source(hand: Hand, name: str) -> str:
    links = []
    for link in hand.model.tree(hand.fingers).links:
        pose = f"{c_list(link.p_PL)}, {c_list(link.R_PL)}, {c_list(link.axis)}"
        body = f"{c_number(link.mass)}, {c_list(link.p_LM)}, {c_list(link.inertia)}"
        links.append(f"    {{{link.parent}, {int(link.is_prismatic)}, {pose},\n     {body}}}, /* {link.joint} */")
    arrays = {
        "T": hand.T,
        "q0": hand.q0,
        "rotor_inertia": hand.rotor_inertia,
        "q_limits": np.array([hand.q_lower, hand.q_upper]),
        "torque_limits": np.array([hand.torque_lower, hand.torque_upper]),
        "velocity_limit": hand.velocity_limit,
        "torque_weight": hand.force_weight,
    }
    names = ", ".join(f'"{joint.name}"' for joint in hand.joints)
    parts = [
        f'#include "{name}_hand.h"\n\n#include <math.h>\n',
        "static const gf_link links[] = {\n" + "\n".join(links) + "\n};\n",
        *(c_array(field, values) for field, values in arrays.items()),
        f"static const char *const motor_names[] = {{{names}}};\n",
        f"const gf_hand_model {name}_hand = {{\n    .motor_count = {hand.n},\n    .joint_count = {len(hand.full_joints)},\n"
        "    .links = links,\n"
        + "".join(f"    .{field} = {field},\n" for field in arrays)
        + "    .motor_names = motor_names,\n};\n",
    ]
    return f"/* Numbers of {name}_hand.h. */\n" + "\n".join(parts)

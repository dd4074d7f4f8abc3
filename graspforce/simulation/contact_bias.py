"""What turning contacts take: the part of their acceleration, J̇ v, that MuJoCo leaves out.

MuJoCo asks of the constraints' rates J v that their derivative be near

    a_ref = − b J v − k r,       and takes  J v̇  for the derivative

(chapter "Computation", constraint model; `mj_referenceConstraint`). The derivative is J v̇ + J̇ v: contacts move over both
surfaces and their normals turn, and where a ball rolls fast over another one J̇ v is tens of m/s². Left out, it acts on every
contact like a force that draws the surfaces apart, J̇ v / k = 200 µm for 20 m/s² at a time constant of 4 ms, several times what
the fingers' pressing sinks in; and along the surface it makes what should roll slide, by J̇ v dt in every step. So it is taken
off a_ref before the engine solves.

J̇ v is the change of J v at the same v over the way that the bodies are about to go in one step, with the engine's own contacts
at both ends. A pair of geoms that touches at several places, or does not touch at both ends, is left as the engine has it.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from graspforce.core.arrays import Array


def step_engine(model: Any, data: Any, next_data: Any) -> None:
    """One step of the engine, its contacts' J̇ v counted.

    Args:
        model, data: MuJoCo's; the step's forces are set.
        ahead: another MjData of the model, to be overwritten.
    """
    mujoco.mj_step1(model, data)
    if data.ncon:
        data.efc_aref[:] -= contact_bias_acceleration(model, data, next_data)
    mujoco.mj_step2(model, data)


def contact_bias_acceleration(model: Any, data: Any, next_data: Any) -> Array:
    """J̇ v of each of the engine's constraints that is a contact, zero for others.

    Args:
        model, data: MuJoCo's, with contacts and rates as `mj_step1` leaves them.
        ahead: another MjData of the model, to be overwritten.

    Returns:
        (nefc,) m/s²; rad/s² in the rows of spin.
    """
    dt = model.opt.timestep
    next_data.qpos[:] = data.qpos
    mujoco.mj_integratePos(model, next_data.qpos, data.qvel, dt)
    mujoco.mj_fwdPosition(model, next_data)
    later = np.zeros(next_data.nefc)
    mujoco.mj_mulJacVec(model, next_data, later, data.qvel)
    there, bias = _single_contacts(next_data), np.zeros(data.nefc)
    for pair, c in _single_contacts(data).items():
        if pair not in there:
            continue
        now, then = data.contact[c], next_data.contact[there[pair]]
        i, j, rows = now.efc_address, then.efc_address, now.dim
        change = later[j : j + rows] - data.efc_vel[i : i + rows]  # m/s; along the normal, and of spin about it
        if rows >= 3:  # tangents: the frame's turn about its own normal is the engine's choice, and no motion
            before, after = now.frame.reshape(3, 3), then.frame.reshape(3, 3)
            change[1:3] = before[1:3] @ (after.T @ later[j : j + 3]) - data.efc_vel[i + 1 : i + 3]
        bias[i : i + rows] = change / dt
    return bias


def _single_contacts(data: Any) -> dict[tuple[int, int], int]:
    """The contacts that the engine bears, by their geoms, where two geoms touch in one place."""
    pairs = [(int(a), int(b)) for a, b in data.contact.geom]
    return {pair: c for c, pair in enumerate(pairs) if pairs.count(pair) == 1 and data.contact.efc_address[c] >= 0}

"""Bias acceleration of rolling contacts, J̇ v, which MuJoCo leaves out.

MuJoCo's constraint model ("Computation", `mj_referenceConstraint`) makes the acceleration of a constraint approach

    a_ref = − b J v − k r,

and computes that acceleration as J v̇. The full acceleration is J v̇ + J̇ v: contact points move over both surfaces, and
normals turn. In fast rolling, J̇ v reaches tens of m/s². Without it, contacts separate by J̇ v / k and slip by J̇ v dt in each
step. Therefore J̇ v is subtracted from a_ref before the engine solves.

J̇ v is computed as the change of J v, for the same v, along the bodies' motion in one step, with the engine's contacts at both
ends. Pairs of geoms with several contacts, or with a contact at one end only, get no correction.
"""

from __future__ import annotations

import mujoco
import numpy as np

from graspforce.core.arrays import Array
from graspforce.simulation.plants.surface_contacts import SurfaceContacts, begin_step, update_positions


def step_engine(
    model: mujoco.MjModel, data: mujoco.MjData, next_data: mujoco.MjData, surface: SurfaceContacts | None = None
) -> None:
    """Advance the engine by one step, with the bias acceleration of its contacts.

    Args:
        model: of MuJoCo.
        data: its data, with the forces of the step.
        next_data: scratch data of the same model; overwritten.
        surface: surface of a mesh; None for shapes that the engine knows.
    """
    begin_step(model, data, surface)
    if data.ncon:
        data.efc_aref[:] -= contact_bias_acceleration(model, data, next_data, surface)
    mujoco.mj_step2(model, data)


def contact_bias_acceleration(
    model: mujoco.MjModel, data: mujoco.MjData, next_data: mujoco.MjData, surface: SurfaceContacts | None = None
) -> Array:
    """Compute J̇ v of each constraint row that belongs to a contact; other rows get zero.

    Args:
        model: of MuJoCo.
        data: its data, with contacts and velocities as `mj_step1` leaves them.
        next_data: scratch data of the same model; overwritten.
        surface: as in `step_engine`.

    Returns:
        (nefc,) m/s²; rad/s² in rows of rotation.
    """
    dt = model.opt.timestep
    next_data.qpos[:] = data.qpos
    mujoco.mj_integratePos(model, next_data.qpos, data.qvel, dt)
    update_positions(model, next_data, surface)
    next_velocity = np.zeros(next_data.nefc)
    mujoco.mj_mulJacVec(model, next_data, next_velocity, data.qvel)
    next_contacts, bias = _single_contacts(next_data), np.zeros(data.nefc)
    velocity, sizes = data.efc_vel, data.contact.dim.tolist()
    frames, next_frames = data.contact.frame.reshape(-1, 3, 3), next_data.contact.frame.reshape(-1, 3, 3)
    for pair, (c, i) in _single_contacts(data).items():
        if pair not in next_contacts:
            continue
        (d, j), rows = next_contacts[pair], sizes[c]
        change = next_velocity[j : j + rows] - velocity[i : i + rows]  # m/s; rad/s in rows of rotation
        if rows >= 3:  # remove the tangents' arbitrary rotation about the normal
            change[1:3] = frames[c, 1:3] @ (next_frames[d].T @ next_velocity[j : j + 3]) - velocity[i + 1 : i + 3]
        bias[i : i + rows] = change / dt
    return bias


def _single_contacts(data: mujoco.MjData) -> dict[tuple[int, int], tuple[int, int]]:
    """Return index and first constraint row of each active contact, by its geoms, for pairs of geoms with one contact."""
    pairs = [(a, b) for a, b in data.contact.geom.tolist()]
    rows = data.contact.efc_address.tolist()
    return {pair: (c, rows[c]) for c, pair in enumerate(pairs) if rows[c] >= 0 and pairs.count(pair) == 1}

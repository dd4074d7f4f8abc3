"""Sliding of fingertips on the object in a recording, from true velocities."""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.recordings.recording import Recording

_ROWS = 1000  # steps whose Jacobians are in memory at the same time


def sliding_displacement(recording: Recording, grasp: Grasp) -> Array:
    """Return how far each fingertip has slid on the object since the start.

    The sliding velocity is the tangential velocity of the fingertip's material point at the contact, less that of the object's.
    Rolling does not count. Its integral over the time in contact is kept in the object's axes, so sliding there and back
    cancels, and so does the engine's noise.

    Args:
        recording: the simulation.
        grasp: its grasp; the hand gives the Jacobians.

    Returns:
        (s, N) distances at the end of each step, m.
    """
    r, hand = recording, grasp.hand
    frames = [hand.frame_id(name) for name in grasp.fingers]
    dt = np.diff(r.t, append=2.0 * r.t[-1] - r.t[-2] if len(r.t) > 1 else r.t[-1])  # s
    slid = np.zeros((len(r.t), len(frames), 3))  # m, in O
    for start in range(0, len(r.t), _ROWS):
        part = slice(start, start + _ROWS)
        p_HF, J = hand.model.frame_jacobians(r.q[part], frames)
        tip = np.einsum("sfij,sj->sfi", J, r.v[part])  # m/s and rad/s
        arm = np.einsum("sij,snj->sni", r.R_HO[part], r.p_OC[part])  # m, from O to the contact
        p_HC = r.p_HO[part, None] + arm
        v_tip = tip[:, :, :3] + np.cross(tip[:, :, 3:], p_HC - p_HF)
        v_object = r.twist[part, None, :3] + np.cross(r.twist[part, None, 3:], arm)
        v_O = np.einsum("sji,snj->sni", r.R_HO[part], v_tip - v_object)  # m/s
        n_O = r.R_OC[part, :, :, 2]
        tangential = v_O - np.sum(v_O * n_O, axis=-1, keepdims=True) * n_O
        slid[part] = tangential * (r.touching[part] > 0.0)[..., None] * dt[part, None, None]
    return freeze(np.linalg.norm(np.cumsum(slid, axis=0), axis=-1))

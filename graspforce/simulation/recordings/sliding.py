"""Sliding of fingertips on the object, from true velocities: in a recording, or during a run."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.control.state import GraspState
from graspforce.core.arrays import Array, freeze
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.plants.plant_interface import TrueContacts
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
    r = recording
    dt = np.diff(r.t, append=2.0 * r.t[-1] - r.t[-2] if len(r.t) > 1 else r.t[-1])  # s
    slid = np.zeros((len(r.t), len(grasp.fingers), 3))  # m, in O
    for start in range(0, len(r.t), _ROWS):
        part = slice(start, start + _ROWS)
        motion = r.p_HO[part], r.R_HO[part], r.twist[part]
        velocity = _sliding_velocity(grasp, r.q[part], r.v[part], motion, (r.p_OC[part], r.R_OC[part, :, :, 2]))
        slid[part] = velocity * (r.touching[part] > 0.0)[..., None] * dt[part, None, None]
    return freeze(np.linalg.norm(np.cumsum(slid, axis=0), axis=-1))


class SlidingMeter:
    """How far each fingertip has slid on the object, during a run; see `sliding_displacement`.

    Args:
        grasp: the grasp; the hand gives the Jacobians.
        dt: length of a step, s.
    """

    def __init__(self, grasp: Grasp, dt: float) -> None:
        self._grasp, self._dt = grasp, dt
        self._slid = np.zeros((len(grasp.fingers), 3))  # m, in O
        self._steps: list[tuple[npt.NDArray[Any], ...]] = []

    def add(self, state: GraspState, contacts: TrueContacts) -> None:
        """Add a step.

        Args:
            state: true state at the begin of the step.
            contacts: contacts of the step.
        """
        motion, n_O = state.object, contacts.R_OC[:, :, 2]
        row = state.q, state.v, motion.p_HO, motion.R_HO, motion.twist, contacts.p_OC, n_O, contacts.touching
        self._steps.append(row)

    def distances(self) -> Array:
        """Return the distance of each fingertip since the start, (N,), m."""
        if self._steps:
            q, v, p_HO, R_HO, twist, p_OC, n_O, touching = (np.array(rows) for rows in zip(*self._steps, strict=True))
            velocity = _sliding_velocity(self._grasp, q, v, (p_HO, R_HO, twist), (p_OC, n_O))
            self._slid += self._dt * np.sum(velocity * touching[..., None], axis=0)
            self._steps.clear()
        return np.asarray(np.linalg.norm(self._slid, axis=-1))


def _sliding_velocity(grasp: Grasp, q: Array, v: Array, motion: tuple[Array, ...], contacts: tuple[Array, ...]) -> Array:
    """Return the tangential velocities of fingertips relative to the object in s steps, (s, N, 3), in O, m/s.

    Args:
        grasp: the grasp.
        q: (s, n) joint positions, rad.
        v: (s, n) joint rates, rad/s.
        motion: (s, 3) position in m, (s, 3, 3) axes in H, and (s, 6) twist of the object in m/s and rad/s.
        contacts: (s, N, 3) contact points in m and (s, N, 3) inward normals, in O.
    """
    (p_HO, R_HO, twist), (p_OC, n_O) = motion, contacts
    p_HF, J = grasp.hand.model.frame_jacobians(q, [grasp.hand.frame_id(name) for name in grasp.fingers])
    tip = np.einsum("sfij,sj->sfi", J, v)  # m/s and rad/s
    arm = np.einsum("sij,snj->sni", R_HO, p_OC)  # m, from O to the contact
    v_tip = tip[:, :, :3] + np.cross(tip[:, :, 3:], p_HO[:, None] + arm - p_HF)
    v_object = twist[:, None, :3] + np.cross(twist[:, None, 3:], arm)
    v_O = np.einsum("sji,snj->sni", R_HO, v_tip - v_object)  # m/s
    return np.asarray(v_O - np.sum(v_O * n_O, axis=-1, keepdims=True) * n_O)

"""Preload: the posture in which the engine's contacts carry given forces at rest.

MuJoCo's contacts are compliant ("Computation", constraint model). At rest, a contact with penetration d carries

    R f_n = K I d,       R = (1 − I)/I Â,

with the impedance I at d and the approximate inverse mass Â of the contact; friction carries load without displacement. In a
posture with these penetrations, under the torques tau_g + Jᵀ f, the contacts carry the forces f from the first step. This
also holds for fingers whose structure carries part of the load.
"""

from __future__ import annotations

import mujoco
import numpy as np

from graspforce.core.arrays import Array
from graspforce.simulation.plants.scene import Scene, set_posture
from graspforce.simulation.plants.surface_contacts import update_forces

_MAX_ITERATIONS = 12  # of Newton's method; it needs about five
_DEPTH_TOLERANCE = 1e-10  # m; one newton penetrates 20 µm
_MAX_DISTANCE = 0.01  # m: fingertips farther from the object are not pressed against it
_INITIAL_DEPTH = 1e-6  # m: the engine gives the compliance of active contacts only
_RANK_TOLERANCE = 0.01  # singular values of the normals' Jacobian below this part of the largest count as zero


def preload_contacts(scene: Scene, model: mujoco.MjModel, data: mujoco.MjData, f_normal: Array) -> Array:
    """Move the hand so that its contacts carry normal forces; the object stays at its pose in `data`.

    Args:
        scene: the scene of the data.
        model: of MuJoCo; tips that no joint moves are moved along their normals instead.
        data: its data, with zero velocities; the hand is moved.
        f_normal: (N,) normal forces, N.

    Returns:
        (n,) posture, rad: the grasp's, with each tip displaced along its normal by the least joint motion.
    """
    grasp = scene.grasp
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)[grasp.contacts.normal_rows]
    inverse, is_fixed = np.linalg.pinv(J, rcond=_RANK_TOLERANCE), ~J.any(axis=1)
    q, v = np.array(grasp.q), np.zeros(grasp.hand.n)
    for _ in range(_MAX_ITERATIONS):
        set_posture(scene, data, q, v)
        update_forces(model, data, scene.surface)
        compliance = _contact_compliance(scene, data)
        distance = _tip_distances(scene, model, data)
        target_depth = np.where(np.isnan(compliance), _INITIAL_DEPTH, compliance * f_normal)  # m
        depth_error = np.where(distance < _MAX_DISTANCE, target_depth + distance, 0.0)
        if np.abs(depth_error).max() < _DEPTH_TOLERANCE:
            break
        q = q + inverse @ depth_error
        for i in np.flatnonzero(is_fixed):  # such as on the palm, which no joint presses onto the object
            geom = scene.tip_geoms[i]
            R_HB = data.xmat[model.geom_bodyid[geom]].reshape(3, 3)
            model.geom_pos[geom] += depth_error[i] * (R_HB.T @ grasp.R_HO @ grasp.contacts.R_OC[i, :, 2])
    return q


def _tip_distances(scene: Scene, model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return the distance of each fingertip from the object, (N,) m; negative inside."""
    if scene.surface is not None:
        return scene.surface.distances(model, data)
    furthest = 2.0 * _MAX_DISTANCE
    return np.array([mujoco.mj_geomDistance(model, data, tip, scene.object_geom, furthest, None) for tip in scene.tip_geoms])


def _contact_compliance(scene: Scene, data: mujoco.MjData) -> Array:
    """Return the penetration per normal force of each contact, (N,) m/N; NaN for fingertips without contact."""
    compliance = np.full(len(scene.tip_geoms), np.nan)
    for c in range(data.ncon):
        contact = data.contact[c]
        tip = scene.tip_index(contact)
        if tip is not None and contact.efc_address >= 0:
            row = contact.efc_address
            stiffness, _, impedance, _ = data.efc_KBIP[row]  # 1/s², 1/s, 1, 1/m
            compliance[tip] = data.efc_R[row] / (stiffness * impedance)
    return compliance

"""The posture in which the engine's contacts bear given forces while everything stands still.

A contact in MuJoCo is soft: at rest it bears f_n where it has sunk in by d, and friction as a stiff damper bears its part
without any way (chapter "Computation", constraint model):

    R f_n = K I d,       R = (1 − I)/I Â,       I the impedance at d, Â the inverse mass that the contact feels

so a posture with the balls deeper in the object by d each, under the torques tau_g + Jᵀ f, has the forces f from its first step
on, whatever bears them: motors, or the structure of fingers that cannot move across their planes. Pushing the fingers against
an object that is held fast until they stand does not do: there nothing but friction says what the structure bears, and where a
normal is out of a planar finger's plane the tip slides.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from graspforce.core.arrays import Array
from graspforce.simulation.scene import Scene, set_posture

_MAX_ITERATIONS = 12  # Newton's steps; some five are taken
_DEPTH_TOLERANCE = 1e-10  # m: a hundred thousandth of what a newton sinks in
_MAX_DISTANCE = 0.01  # m: a fingertip so far from the object is not meant to touch it
_INITIAL_DEPTH = 1e-6  # m: a contact has to be there before the engine says how soft it is
_RANK_TOLERANCE = 0.01  # singular values of the normals' Jacobian below this part of the largest count as zero


def preload_contacts(scene: Scene, model: Any, data: Any, f_normal: Array) -> Array:
    """Put the hand where its contacts bear normal forces, the object as it is in ``data``; the rates of ``data`` must be zero.

    Args:
        scene: what the data belongs to.
        model, data: MuJoCo's; the hand in ``data`` is moved.
        f_normal: (N,) N.

    Returns:
        (n,) the posture, rad: the hold's, each ball moved along its normal by the least joint motions.
    """
    grasp = scene.grasp
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)[grasp.contacts.normal_rows]
    inverse = np.linalg.pinv(J, rcond=_RANK_TOLERANCE)
    q, zero_rates = np.array(grasp.q), np.zeros(grasp.hand.n)
    for _ in range(_MAX_ITERATIONS):
        set_posture(scene, data, q, zero_rates)
        mujoco.mj_forward(model, data)
        softness = _contact_compliance(scene, data)
        distance = np.array(
            [mujoco.mj_geomDistance(model, data, tip, scene.object_geom, 2.0 * _MAX_DISTANCE, None) for tip in scene.tip_geoms]
        )
        target_depth = np.where(np.isnan(softness), _INITIAL_DEPTH, softness * f_normal)  # m
        depth_error = np.where(distance < _MAX_DISTANCE, target_depth + distance, 0.0)
        if np.abs(depth_error).max() < _DEPTH_TOLERANCE:
            break
        q = q + inverse @ depth_error
    return q


def _contact_compliance(scene: Scene, data: Any) -> Array:
    """(N,) how far each contact sinks in for a force, at its impedance now, m/N; NaN where the engine has no contact."""
    found = np.full(len(scene.tip_geoms), np.nan)
    for c in range(data.ncon):
        contact = data.contact[c]
        tip = scene.tip_index(contact)
        if tip is not None and contact.efc_address >= 0:
            row = contact.efc_address
            stiffness, _, impedance, _ = data.efc_KBIP[row]  # 1/s², 1/s, 1, 1/m
            found[tip] = data.efc_R[row] / (stiffness * impedance)
    return found

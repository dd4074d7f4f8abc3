"""Checks of grasps that use no code of the grasp search: penetration, force closure, and the weight.

MuJoCo computes the poses of the links and the distances of their collision shapes. Two linear programs over pyramids inside
the friction cones check force closure and forces within the motors' limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from scipy.optimize import linprog

from graspforce.contact.contact import ContactModel, ContactSet
from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.hand_contacts import HandContacts
from graspforce.grasp.link_grasp import LinkGrasp
from graspforce.hand.collision import hand_collision
from graspforce.simulation import build_scene
from graspforce.simulation.plants.link_geoms import LINK_PREFIX
from graspforce.simulation.plants.scene import set_posture
from graspforce.simulation.plants.scene_parts import OBJECT

_EDGES = 16  # of the pyramid inside a friction cone
_TILTS = np.radians([0.0, 22.5, -22.5, 45.0, -45.0, 67.5, -67.5])  # of edges inside the ellipsoid of a soft contact
_LEVER = 0.03  # m: moments count as forces at this lever


def penetration(grasp: Grasp | LinkGrasp, layers: Sequence[Array] = ()) -> float:
    """Return the deepest penetration that MuJoCo finds, m; 0 without one.

    Two links may not touch unless they are neighbours, nor the object and a link other than those of the touching fingertips.
    Contacts that the hand's description allows are left out.

    Args:
        grasp: the grasp.
        layers: vertices (M, 3) in O of convex parts of the object, m; by default the object's shape is one that MuJoCo has.
    """
    if isinstance(grasp, LinkGrasp):  # a scene needs one finger that touches
        first = ContactSet.stack([grasp.contacts.contacts[0]])
        grasp = Grasp(grasp.hand, grasp.body, (grasp.hand.fingers[0].name,), first, grasp.q, grasp.p_HO, grasp.R_HO)
    hand = grasp.hand
    scene = build_scene(replace(grasp, body=Body.solid(Sphere(1e-3), grasp.body.mass)) if layers else grasp)
    parts = [OBJECT]
    if layers:
        parts = [f"layer {k}" for k in range(len(layers))]
        for name, points in zip(parts, layers, strict=True):
            mesh = scene.spec.add_mesh(name=name, uservert=points.ravel().tolist())
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            geom = scene.spec.body(OBJECT).add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, name=name)
            geom.contype, geom.conaffinity, geom.mass = 0, 0, 0.0
    model = scene.spec.compile()
    data = mujoco.MjData(model)
    set_posture(scene, data, grasp.q, np.zeros(hand.n))
    mujoco.mj_kinematics(model, data)
    links = hand_collision(hand)
    geoms = [model.geom(f"{LINK_PREFIX}{i} {body.name}").id for i, body in enumerate(links.bodies)]
    pairs = [(geoms[i], geoms[j]) for i, j in links.pairs]
    for geom, body in zip(geoms, links.bodies, strict=True):
        is_allowed = any(each.covers(body.name, "object") for each in hand.description.allowed_contacts)
        if int(model.geom_bodyid[geom]) not in scene.tip_bodies and not is_allowed:
            pairs += [(geom, model.geom(name).id) for name in parts]
    return max(0.0, -min(mujoco.mj_geomDistance(model, data, i, j, 0.01, None) for i, j in pairs))


def is_closed(grasp: HandContacts) -> bool:
    """Return whether the contacts are force-closed.

    They are if the wrenches of all edges of the pyramids span all wrenches, and a combination with coefficients of at least 1
    is zero.

    Args:
        grasp: the grasp.
    """
    wrenches = _edges(grasp)[0] / np.array([1.0, 1.0, 1.0, _LEVER, _LEVER, _LEVER])[:, None]
    if np.linalg.matrix_rank(wrenches, tol=1e-6) < 6:
        return False
    count = wrenches.shape[1]
    return bool(linprog(np.zeros(count), A_eq=wrenches, b_eq=np.zeros(6), bounds=(1.0, None)).status == 0)


def bears_weight(grasp: HandContacts, gravity_H: Array) -> bool:
    """Return whether contact forces within the limits of motors and contacts bear the object at rest.

    Args:
        grasp: the grasp.
        gravity_H: (3,) acceleration of gravity in H, m/s².
    """
    W, forces = _edges(grasp)
    weight = grasp.body.mass * grasp.R_HO.T @ gravity_H
    load = np.concatenate([weight, np.cross(grasp.body.p_OM, weight)])
    actuation = grasp.actuation(gravity_H)
    used = np.concatenate([[4 * i + c for c in each.model.columns] for i, each in enumerate(grasp.contacts.contacts)])
    torque = actuation.J.T @ forces[used]
    rows, limits = [], []
    for sign, limit in ((1.0, actuation.upper), (-1.0, -actuation.lower)):
        is_limited = np.isfinite(limit)
        rows.append(sign * torque[is_limited])
        limits.append((limit - sign * actuation.tau_u)[is_limited])
    for i, contact in enumerate(grasp.contacts.contacts):
        normal = forces[4 * i + 2][None]
        rows.append(-normal)
        limits.append(np.array([-contact.min_normal]))
        if contact.max_normal is not None:
            rows.append(normal)
            limits.append(np.array([contact.max_normal]))
    scale = np.array([1.0, 1.0, 1.0, _LEVER, _LEVER, _LEVER])
    solution = linprog(
        np.zeros(W.shape[1]),
        A_ub=np.concatenate(rows),
        b_ub=np.concatenate(limits),
        A_eq=W / scale[:, None],
        b_eq=-load / scale,
    )
    return bool(solution.status == 0)


def _edges(grasp: HandContacts) -> tuple[Array, Array]:
    """Return the edges of the pyramids: wrenches about O in O (6, M), and padded forces of all contacts (4 N, M)."""
    angles = 2.0 * np.pi * np.arange(_EDGES) / _EDGES
    wrenches, forces = [], []
    for i, contact in enumerate(grasp.contacts.contacts):
        R, p, mu = grasp.contacts.R_OC[i], grasp.contacts.p_OC[i], float(contact.friction or 0.0)
        gamma = float(contact.torsional_friction or 0.0) if contact.model is ContactModel.SOFT else 0.0
        tilts = _TILTS if gamma > 0.0 else _TILTS[:1]  # between tangential forces and moments of a soft contact
        edges = [
            (mu * np.cos(tilt) * np.cos(angle), mu * np.cos(tilt) * np.sin(angle), 1.0, gamma * np.sin(tilt))
            for tilt in tilts
            for angle in angles
        ]
        edges += [(0.0, 0.0, 1.0, sign * gamma) for sign in (1.0, -1.0) if gamma > 0.0]
        for edge in edges:
            f = R @ edge[:3]
            wrenches.append(np.concatenate([f, np.cross(p, f) + edge[3] * R[:, 2]]))
            force = np.zeros((len(grasp.contacts), 4))
            force[i] = edge
            forces.append(force.ravel())
    return np.array(wrenches).T, np.array(forces).T

"""Start of `UrdfPlant`: fingers that press the object with given forces, at rest.

The fingertips are put on the object's surface. Then the engine runs with damped joints, without joint friction, under the
torques that carry the forces, until contacts and joints have settled. Meanwhile a damped spring holds the object in its pose,
and an external wrench balances the given forces.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.plants.urdf_model import UrdfModel

_DURATION = 0.2  # s; the joints' time constant is a tenth of the next
_TIME_CONSTANT = 0.01  # s, in which damping stops the joints
_SPRING_FREQUENCY = 200.0  # rad/s, of the critically damped spring that holds the object
_GAP_ITERATIONS = 8  # of Newton's method
_RANK_TOLERANCE = 0.01  # relative; smaller singular values of the normals' Jacobian count as zero


def settle_contacts(compiled: UrdfModel, grasp: Grasp, options: PlantOptions, forces: Array) -> tuple[Array, Array]:
    """Return qpos of a plant whose contacts carry forces, and the motor torques.

    Args:
        compiled: the model; it is not changed.
        grasp: gives posture, object pose and contact frames.
        options: give gravity and the place of the object's surface.
        forces: (N, 4) padded forces on the object, in the grasp's contact frames, N and N·m.
    """
    model = compiled.model.__copy__()
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    _close_gaps(compiled, grasp, options, data, model)
    bases = grasp.contacts.wrench_bases()
    w = np.einsum("nij,nj->i", bases, forces).reshape(2, 3) @ grasp.R_HO.T  # force and moment about O, in H
    momentum, tau = np.zeros(model.nv), np.zeros(grasp.hand.n)  # N·m·s, N·m
    for _ in range(round(_DURATION / options.dt)):
        mujoco.mj_step1(model, data)
        tau = _holding_torque(compiled, grasp, data, model, forces)
        mujoco.mj_mulM(model, data, momentum, data.qvel)
        data.qfrc_applied[compiled.joint_rows] = -momentum[compiled.joint_rows] / _TIME_CONSTANT
        data.qfrc_applied[compiled.v_rows] += tau
        data.xfrc_applied[compiled.object_body] = _holding_wrench(compiled, grasp, data, model, w)
        mujoco.mj_step2(model, data)
    q = data.qpos.copy()
    q[compiled.joint_rows] = compiled.T @ q[compiled.q_rows] + compiled.q0
    return q, tau


def _holding_wrench(compiled: UrdfModel, grasp: Grasp, data: mujoco.MjData, model: mujoco.MjModel, w: Array) -> Array:
    """Return the wrench at the object's centre of mass that balances weight and contact forces, with the spring's."""
    body, v = compiled.object_body, data.qvel[compiled.object_v :]
    R_HO = data.xmat[body].reshape(3, 3)
    arm = data.xipos[body] - data.xpos[body]  # m, from O to the centre of mass
    turn = Rotation.from_matrix(R_HO @ grasp.R_HO.T).as_rotvec()
    omega = R_HO @ v[3:6]
    pull = -(_SPRING_FREQUENCY**2) * (data.xpos[body] - grasp.p_HO) - 2.0 * _SPRING_FREQUENCY * v[:3]  # m/s²
    twist = -(_SPRING_FREQUENCY**2) * turn - 2.0 * _SPRING_FREQUENCY * omega  # rad/s²
    axes = data.ximat[body].reshape(3, 3)
    mass = model.body_mass[body]
    moment = axes @ (model.body_inertia[body] * (axes.T @ twist)) - w[1] + np.cross(arm, w[0])
    return np.concatenate([mass * (pull - model.opt.gravity) - w[0], moment])


def _close_gaps(compiled: UrdfModel, grasp: Grasp, options: PlantOptions, data: mujoco.MjData, model: mujoco.MjModel) -> None:
    """Put the fingertips on the object's surface, by the least motion of the joints from the grasp's posture."""
    body = options.body or grasp.body
    shape = body.shape or grasp.body.shape
    if shape is None:  # the model was compiled with a shape
        raise InvalidInput("grasp.body.shape", None, "a shape")
    R_HS = grasp.R_HO @ Rotation.from_rotvec(options.shape_turn.tolist()).as_matrix()  # axes of the surface
    p_HS = grasp.p_HO + grasp.R_HO @ options.shape_offset
    q = np.array(grasp.q)
    for _ in range(_GAP_ITERATIONS):
        data.qpos[compiled.joint_rows] = compiled.T @ q + compiled.q0
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        centers = data.geom_xpos[list(compiled.tip_geoms)]
        surface = shape.project_to_surface((centers - p_HS) @ R_HS) @ R_HS.T + p_HS
        distances = np.linalg.norm(surface - centers, axis=1)
        normals = (surface - centers) / distances[:, None]  # a ball touches along them, also on an edge or a corner
        gaps = distances - model.geom_size[list(compiled.tip_geoms), 0]
        if np.abs(gaps).max() < 1e-9:
            break
        rows = [
            normal @ _point_jacobian(compiled, data, model, geom, center)[0]
            for geom, center, normal in zip(compiled.tip_geoms, centers, normals, strict=True)
        ]
        q = q + np.linalg.pinv(np.array(rows), rcond=_RANK_TOLERANCE) @ gaps


def _point_jacobian(
    compiled: UrdfModel, data: mujoco.MjData, model: mujoco.MjModel, geom: int, point: Array
) -> tuple[Array, Array]:
    """Return the Jacobians (3, n) of a point on a geom's body: velocity and angular velocity, in H, of the actuated rates."""
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, linear, angular, point, model.geom_bodyid[geom])
    return linear[:, compiled.joint_rows] @ compiled.T, angular[:, compiled.joint_rows] @ compiled.T


def _holding_torque(compiled: UrdfModel, grasp: Grasp, data: mujoco.MjData, model: mujoco.MjModel, forces: Array) -> Array:
    """Return the motor torques that carry the hand's weight and contact forces, (n,), N·m."""
    tau = compiled.T.T @ data.qfrc_bias[compiled.joint_rows]
    axes = grasp.R_HO @ grasp.contacts.R_OC
    for i, geom in enumerate(compiled.tip_geoms):
        n = axes[i, :, 2]
        point = data.geom_xpos[geom] + model.geom_size[geom, 0] * n
        linear, angular = _point_jacobian(compiled, data, model, geom, point)
        tau += linear.T @ (axes[i] @ forces[i, :3]) + angular.T @ (n * forces[i, 3])
    return np.asarray(tau)

"""The display model: a copy of a scene with looks, light and camera, which follows a plant and never acts on it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.core.errors import ModelError
from graspforce.hand.contact_tips import own_fingers
from graspforce.hand.kinematics.kinematic_tree import KinematicTree
from graspforce.simulation.plants.link_geoms import HIDDEN_GROUP
from graspforce.simulation.plants.scene import Scene, set_posture
from graspforce.simulation.plants.scene_parts import FLOOR, OBJECT
from graspforce.simulation.rendering import hand_geoms, stage
from graspforce.simulation.rendering.camera import FIELD_OF_VIEW, CameraOptions, CameraView, place_camera, vertical_frame
from graspforce.simulation.rendering.marks import SceneState

Image = npt.NDArray[np.uint8]  # (height, width, 3)

CAMERA = "view"

_CONE = "cone"
_CONE_SIDES = 48
_INSIDE = 0.003  # m: depth below the object's surface of the points that the camera should see
_SIGNS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)


class DisplayModel:
    """A MuJoCo model that shows a scene.

    Args:
        scene: the scene to show.
        show_meshes: draw the meshes of the hand's URDF if it has any; otherwise links are modelled.
        directories: directories to search for mesh files, as in `Hand.meshes`.
        camera: frame and motion of the camera.
        shows_object: draw the object; without it, the picture frames the hand alone.

    Attributes:
        model: of MuJoCo.
        data: of MuJoCo.
        camera: the camera's motion.
        up: (3,) unit vector against gravity, in H.
        description: how the hand is shown.
        cone_id: index of the mesh of a cone of height 1 m and radius 1 m.
        follows_hand: whether the camera moves with the hand's base, and not with the floor.

    Raises:
        ModelError: a directory was given and a mesh is not there, or MuJoCo cannot read a mesh.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        show_meshes: bool = True,
        directories: Sequence[str | os.PathLike[str]] = (),
        camera: CameraOptions | None = None,
        shows_object: bool = True,
    ) -> None:
        self.scene, self._shows_object, self.follows_hand = scene, shows_object, False
        hand, spec = scene.grasp.hand, scene.spec.copy()
        tree = hand.model.tree(own_fingers(hand))
        stage.add_materials(spec)
        self.description = self._add_hand_geoms(spec, tree, show_meshes, directories)
        for name in scene.grasp.fingers:
            spec.geom(f"tip {name}").group = HIDDEN_GROUP  # the fingertip's collision shape
        spec.geom(OBJECT).material = OBJECT
        if not shows_object:
            spec.geom(OBJECT).group = HIDDEN_GROUP
        vertices, faces = _unit_cone()
        spec.add_mesh(name=_CONE, uservert=vertices.ravel().tolist(), userface=faces.ravel().tolist())
        spec.worldbody.add_camera(name=CAMERA, fovy=FIELD_OF_VIEW)
        gravity_H = scene.gravity_H
        vertical = vertical_frame(gravity_H)
        try:
            points, bare, data = self._corners(spec)
            self.up = vertical[2]
            self.camera = place_camera(bare, data, vertical, self.contact_points, points, camera or CameraOptions())
            stage.add_stage(spec, self.up, self.camera.towards(), _palm_middle(tree), points, bool(np.any(gravity_H != 0.0)))
            position, axes = self.camera.pose(0.0)
            quaternion = np.zeros(4)
            mujoco.mju_mat2Quat(quaternion, axes.ravel())
            spec.camera(CAMERA).pos, spec.camera(CAMERA).quat = position, quaternion
            self.model: mujoco.MjModel = spec.compile()
        except ValueError as error:
            raise ModelError(f"{hand.name}: MuJoCo cannot display it: {error}") from None
        self.data: mujoco.MjData = mujoco.MjData(self.model)
        self.cone_id = int(self.model.mesh(_CONE).id)
        self._floor_body = 0 if scene.floor_geom is None else int(self.model.body(FLOOR).id)

    def update(self, state: SceneState) -> None:
        """Take over the positions of joints and object, and move the camera.

        Args:
            state: state of a plant with the same scene.
        """
        self.data.qpos[:] = state.qpos
        self.data.mocap_pos[:] = state.mocap
        self.data.time = state.t
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        position, axes = self.camera.pose(state.t)
        if len(state.mocap) and not self.follows_hand:  # the camera stands on the floor
            position = position + state.mocap[0] - self.model.body_pos[self._floor_body]
        self.data.cam_xpos[0], self.data.cam_xmat[0] = position, axes.ravel()

    def view(self, width: int, height: int) -> CameraView:
        """Return the camera of the last update.

        Args:
            width: of the images, pixels.
            height: of the images, pixels.
        """
        return CameraView(np.array(self.data.cam_xpos[0]), np.array(self.data.cam_xmat[0]).reshape(3, 3), width, height)

    def cone_pose(self, apex: Array, R_HC: Array, height: float, mu: float) -> tuple[Array, Array]:
        """Return position (3,), m, and transform (3, 3) of the cone mesh that show a friction cone.

        The compiler has centred and rotated the mesh; the transform contains the inverse.

        Args:
            apex: (3,) contact point in H, m.
            R_HC: (3, 3) contact frame in H.
            height: of the cone, m.
            mu: coefficient of friction.
        """
        scaled = R_HC @ np.diag([mu * height, mu * height, height])
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, self.model.mesh_quat[self.cone_id])
        return apex + scaled @ self.model.mesh_pos[self.cone_id], scaled @ turned.reshape(3, 3)

    def _add_hand_geoms(
        self, spec: mujoco.MjSpec, tree: KinematicTree, show_meshes: bool, directories: Sequence[str | os.PathLike[str]]
    ) -> str:
        """Add the geoms of the hand, and return how it is shown."""
        hand, bodies = self.scene.grasp.hand, [spec.body(link.joint) for link in tree.links]
        reason = ""
        if show_meshes:
            try:
                meshes = hand.meshes(directories)
            except ModelError as error:
                if directories:
                    raise
                meshes, reason = (), f": {error}"
            if meshes:
                hand_geoms.add_mesh_geoms(spec, bodies, meshes, {finger.tip for finger in hand.fingers})
                return "meshes of the hand's URDF"
        hand_geoms.add_modelled_geoms(spec, bodies, tree)
        return f"links modelled from the hand's kinematics{reason}"

    def _corners(self, spec: mujoco.MjSpec) -> tuple[Array, mujoco.MjModel, mujoco.MjData]:
        """Return the corners of the boxes around the visible geoms in the grasp, and the model and data they are from."""
        model = spec.compile()
        data = mujoco.MjData(model)
        grasp = self.scene.grasp
        set_posture(self.scene, data, grasp.q, np.zeros(grasp.hand.n))
        mujoco.mj_kinematics(model, data)
        corners = []
        for i in range(model.ngeom):
            name = model.geom(i).name
            if (name == OBJECT and self._shows_object) or name.startswith(hand_geoms.HAND_PREFIX):
                centre, half = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
                corners.append(data.geom_xpos[i] + (centre + half * _SIGNS) @ data.geom_xmat[i].reshape(3, 3).T)
        return np.concatenate(corners), model, data

    @property
    def contact_points(self) -> Array:
        """Points (N, 3) just inside the object at its contacts in the grasp, in H, m."""
        grasp = self.scene.grasp
        inside = grasp.contacts.p_OC + _INSIDE * grasp.contacts.R_OC[:, :, 2]
        return np.asarray(grasp.p_HO + inside @ grasp.R_HO.T)


def _palm_middle(tree: KinematicTree) -> Array:
    """Return the mean of H's origin and the fingers' bases, in H, m."""
    return np.asarray(np.mean([np.zeros(3), *(link.p_PL for link in tree.links if link.parent < 0)], axis=0))


def _unit_cone() -> tuple[Array, np.ndarray[Any, np.dtype[np.intp]]]:
    """Return vertices and triangles of a cone with its apex at the origin, about the third axis."""
    angles = np.linspace(0.0, 2.0 * np.pi, _CONE_SIDES, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.ones(_CONE_SIDES)])
    vertices = np.concatenate([rim, [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    i = np.arange(_CONE_SIDES)
    j = (i + 1) % _CONE_SIDES
    apex, base = np.full_like(i, _CONE_SIDES), np.full_like(i, _CONE_SIDES + 1)
    return vertices, np.concatenate([np.column_stack([apex, j, i]), np.column_stack([base, i, j])])

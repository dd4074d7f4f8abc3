"""A hand's rigid bodies in Pinocchio, in the coordinates of its motors, without checks of the arguments.

The URDF's joints are the full coordinates, a constant affine map of the actuated ones:

    q_full = T q + q0,    v_full = T v,    tau = Tᵀ tau_full + D a,

where D contains the rotor inertias at the joints. `Hand` checks arguments and documents the functions; inner loops call this
module directly.

Pinocchio's own mimic joints are not used, because some of its algorithms do not support them. T covers all couplings.
"""

from __future__ import annotations

import copy
import os
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from graspforce.contact.motion import TipMotion
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import ModelError
from graspforce.hand.kinematics.coordinates import Finger, JointCoordinates
from graspforce.hand.kinematics.kinematic_tree import KinematicTree, Link, Tip
from graspforce.hand.kinematics.motion import LinkMotion

_LOCAL_ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED  # at the frame's origin, in H's axes

_Indices = np.ndarray[Any, np.dtype[np.intp]]


def read_urdf(text: str, path: str | os.PathLike[str]) -> pin.Model:
    """Return Pinocchio's model of a URDF.

    Args:
        text: the URDF.
        path: its file, for error messages.

    Raises:
        ModelError: Pinocchio cannot build the model.
    """
    try:
        return pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise ModelError(f"{path}: Pinocchio cannot build the model: {error}") from None


class CoupledModel:
    """The bodies of a hand and their couplings. It is immutable, and each thread has its own workspace.

    Frames are given by Pinocchio's index; see `frame_id`. q, v and a are float64 arrays. Products with T are x.dot(T), which is
    faster than @ for short vectors.

    Args:
        model: Pinocchio's model of the URDF.
        coordinates: the actuated joints.
    """

    def __init__(self, model: pin.Model, coordinates: JointCoordinates) -> None:
        self._model, self._threads = model, threading.local()
        self._T, self._Tt, self._q0 = coordinates.T, coordinates.T.T, coordinates.q0
        self._rotors = coordinates.rotor_inertia  # kg·m²
        self._motor_of_joint, self._joint_of_motor = _permutations(self._T, self._q0)
        order = self._joint_of_motor
        # places of the motors in the mass matrix of all joints
        self._mass_order = None if order is None else order[:, None] * len(order) + order

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the workspaces, so that a hand can be pickled."""
        return {name: value for name, value in vars(self).items() if name != "_threads"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _threads=threading.local())

    def with_displaced_frames(self, offsets: Mapping[str, Array]) -> CoupledModel:
        """Return the model with links' frames at other places. Joints and inertias stay.

        Args:
            offsets: (3,) displacement of each URDF link's frame, by name, in the frame's axes, m.
        """
        displaced = copy.copy(self)
        displaced._model = pin.Model(self._model)
        for link, offset in offsets.items():
            frame = displaced._model.frames[self.frame_id(link)]
            frame.placement = frame.placement * pin.SE3(np.eye(3), np.array(offset))
        return displaced

    def with_frames(self, places: Mapping[str, tuple[str, Array]]) -> CoupledModel:
        """Return the model with further frames, which have the axes of the links that carry them.

        Args:
            places: URDF link and (3,) position in its frame, m, of each new frame, by name.
        """
        extended = copy.copy(self)
        extended._model = pin.Model(self._model)
        for name, (link, p) in places.items():
            index = self.frame_id(link)
            carrier = self._model.frames[index]
            place = carrier.placement * pin.SE3(np.eye(3), np.array(p))
            extended._model.addFrame(pin.Frame(name, carrier.parentJoint, index, place, pin.FrameType.OP_FRAME))
        return extended

    def in_coordinates(self, coordinates: JointCoordinates) -> CoupledModel:
        """Return the model of the same bodies in other coordinates.

        Args:
            coordinates: the actuated joints.
        """
        return CoupledModel(self._model, coordinates)

    # ── facts ──────────────────────────────────────────────────────────────────────────────────────────────────────────────

    def frame_id(self, link: str) -> int:
        """Return Pinocchio's index of a link's frame.

        Args:
            link: name of the URDF link, or of a frame of `with_frames`.
        """
        is_link = self._model.existFrame(link, pin.FrameType.BODY)
        return int(self._model.getFrameId(link, pin.FrameType.BODY if is_link else pin.FrameType.OP_FRAME))

    def carrier_of(self, link: str) -> tuple[int, Array, Array]:
        """Return the moving link that carries a URDF link, and the URDF link's pose on it.

        Args:
            link: name of the URDF link.

        Returns:
            Index of the moving link, -1 for the base; position (3,), m; and axes (3, 3).
        """
        frame = self._model.frames[self.frame_id(link)]
        return frame.parentJoint - 1, freeze(frame.placement.translation), freeze(frame.placement.rotation)

    def joints_moving(self, link: str) -> Array:
        """Return an array (n_full,) with 1 for the joints that move a URDF link, 0 for the others.

        Args:
            link: name of the URDF link.
        """
        moves = np.zeros(self._model.nv)
        moves[[joint - 1 for joint in self._model.supports[self.carrier_of(link)[0] + 1] if joint > 0]] = 1.0
        return freeze(moves)

    @property
    def T(self) -> Array:
        """(n_full, n) rates of all joints per rate of the actuated joints."""
        return self._T

    def masses(self) -> list[float]:
        """Return the mass that each moving joint carries directly, with all fixed links, kg."""
        return [float(inertia.mass) for inertia in self._model.inertias][1:]

    def tree(self, fingers: Sequence[Finger]) -> KinematicTree:
        """Return the links, and the tips of fingers, as plain numbers.

        Args:
            fingers: the fingers.
        """
        links, anywhere = [], np.zeros(self._model.nq)  # Pinocchio reads the joint's part without a check of the size
        for i in range(1, self._model.njoints):
            joint, place, inertia = self._model.joints[i], self._model.jointPlacements[i], self._model.inertias[i]
            data = joint.createData()
            joint.calc(data, anywhere)
            is_prismatic = not np.any(data.S[3:])  # S: unit twist of the joint, linear first
            links.append(
                Link(
                    joint=self._model.names[i],
                    parent=self._model.parents[i] - 1,
                    p_PL=freeze(place.translation),
                    R_PL=freeze(place.rotation),
                    axis=freeze(data.S[:3] if is_prismatic else data.S[3:]),
                    is_prismatic=is_prismatic,
                    mass=float(inertia.mass),
                    p_LM=freeze(inertia.lever),
                    inertia=freeze(inertia.inertia),
                    lower=float(self._model.lowerPositionLimit[i - 1]),
                    upper=float(self._model.upperPositionLimit[i - 1]),
                )
            )
        tips = []
        for finger in fingers:
            tips.append(Tip(finger.name, *self.carrier_of(finger.tip), finger.tip_radius))
        return KinematicTree(tuple(links), tuple(tips))

    # ── kinematics ─────────────────────────────────────────────────────────────────────────────────────────────────────────

    def frame_pose(self, q: Array, frame: int) -> tuple[Array, Array]:
        """Return the pose of a frame in H as views of the workspace.

        Args:
            q: (n,) joint positions, rad.
            frame: index of the frame.

        Returns:
            Position (3,), m, and axes (3, 3).
        """
        model, data = self._workspace()
        pin.framesForwardKinematics(model, data, self._full(q))
        placement = data.oMf[frame]
        return placement.translation, placement.rotation

    def link_poses(self, q: Array) -> dict[str, tuple[Array, Array]]:
        """Return the poses in H of all URDF links by name, as views of the workspace.

        Args:
            q: (n,) joint positions, rad.
        """
        model, data = self._workspace()
        pin.framesForwardKinematics(model, data, self._full(q))
        return {
            frame.name: (placement.translation, placement.rotation)
            for frame, placement in zip(model.frames, data.oMf, strict=True)
            if frame.type == pin.FrameType.BODY
        }

    def joint_poses(self, q: Array) -> Array:
        """Return the poses (n_full, 4, 4) in H of the frames of all moving links, as homogeneous matrices.

        Args:
            q: (n,) joint positions, rad.
        """
        model, data = self._workspace()
        pin.forwardKinematics(model, data, self._full(q))
        return np.array([placement.homogeneous for placement in data.oMi[1:]])

    def joint_origins(self, q: Array) -> Array:
        """Return the (n_full, 3) positions in H of the origins of all joints, m.

        Args:
            q: (n,) joint positions, rad.
        """
        model, data = self._workspace()
        pin.forwardKinematics(model, data, self._full(q))
        return freeze([placement.translation for placement in data.oMi[1:]])

    def frame_jacobians(self, q: Array, frames: Sequence[int]) -> tuple[Array, Array]:
        """Return origins and Jacobians of frames in K postures.

        Args:
            q: (K, n) joint positions, rad.
            frames: indices of F frames.

        Returns:
            Origins (K, F, 3) in H, m, and Jacobians (K, F, 6, n) there, in H's axes.
        """
        model, data = self._workspace()
        places, J_full = np.empty((len(q), len(frames), 4, 4)), np.empty((len(q), len(frames), 6, model.nv))
        for k, posture in enumerate(self._full(q)):
            pin.computeJointJacobians(model, data, posture)
            _update_frames(model, data, frames, places[k], J_full[k])
        return places[:, :, :3, 3], J_full @ self._T

    def point_jacobians(self, q: Array, frames: Sequence[int], p_H: Array) -> Array:
        """Return Jacobians at points that are fixed to links, in K postures.

        Args:
            q: (K, n) joint positions, rad.
            frames: index of a frame on the link of each of N points.
            p_H: (K, N, 3) current positions of the points in H, m.

        Returns:
            (K, N, 6, n) in H's axes.
        """
        p_tip, J = self.frame_jacobians(q, frames)
        x, y, z = np.moveaxis(p_H - p_tip, -1, 0)[..., None]  # m, from the tip's origin to the point
        omega = J[:, :, 3:]
        J[:, :, 0] += omega[:, :, 1] * z - omega[:, :, 2] * y  # v_P = v_tip + ω × lever
        J[:, :, 1] += omega[:, :, 2] * x - omega[:, :, 0] * z
        J[:, :, 2] += omega[:, :, 0] * y - omega[:, :, 1] * x
        return J

    def tip_motion(self, q: Array, v: Array, frames: Sequence[int]) -> TipMotion:
        """Return poses, Jacobians, twists and drifts of frames; see `Hand.tip_motion`.

        Args:
            q: (n,) joint positions, rad.
            v: (n,) joint rates, rad/s.
            frames: indices of the frames.
        """
        model, data = self._workspace()
        v_full = self._rates(v)
        full, n = len(v_full), len(v)
        pin.forwardKinematics(model, data, self._full(q), v_full, self._threads.rest)
        pin.computeJointJacobians(model, data)
        places, J_full = np.empty((len(frames), 4, 4)), np.empty((len(frames), 6, full + 1))
        _update_frames(model, data, frames, places, J_full[:, :, :full])
        for i, frame in enumerate(frames):
            J_full[i, :, full] = pin.getFrameClassicalAcceleration(model, data, frame, _LOCAL_ALIGNED).vector
        selection = self._threads.selection  # [J_full, drift] to [J, twist, drift]
        selection[:full, n] = v_full
        rates = J_full.reshape(-1, full + 1).dot(selection).reshape(len(frames), 6, n + 2)
        return TipMotion(places[:, :3, 3], places[:, :3, :3], rates)

    def link_motion(self, q: Array, v: Array) -> LinkMotion:
        """Return the motion of all links in one pass, as views of the workspace; `tip_motion` can be computed from it.

        It is computed once if a thread asks twice for the same state and uses no other method in between.

        Args:
            q: (n,) joint positions, rad.
            v: (n,) joint rates, rad/s.
        """
        own, state = self._threads, (q.tobytes(), v.tobytes())
        if getattr(own, "moved_state", None) == state:
            unchanged: LinkMotion = own.moved_links
            return unchanged
        model, data = self._workspace()
        pin.computeJointJacobiansTimeVariation(model, data, self._full(q), self._rates(v))
        motion: LinkMotion = own.link_motion or _link_motion_views(data)
        own.moved_state, own.moved_links = state, motion
        return motion

    # ── dynamics ───────────────────────────────────────────────────────────────────────────────────────────────────────────

    def mass_matrix(self, q: Array) -> Array:
        """Return M = Tᵀ M_full T + D, (n, n), kg·m².

        Args:
            q: (n,) joint positions, rad.
        """
        model, data = self._workspace()
        M = pin.crba(model, data, self._full(q))  # symmetric
        if self._mass_order is None:
            return np.asarray(self._Tt @ M @ self._T + np.diag(self._rotors))
        M = M.take(self._mass_order)
        M.ravel()[:: len(M) + 1] += self._rotors
        return np.asarray(M)

    def gravity_torque(self, q: Array, gravity_H: Array) -> Array:
        """Return g(q), (n,), N·m.

        Args:
            q: (n,) joint positions, rad.
            gravity_H: (3,) acceleration of gravity in H, m/s².
        """
        model, data = self._workspace(gravity_H)
        return np.asarray(pin.computeGeneralizedGravity(model, data, self._full(q)) @ self._T)

    def inverse_dynamics(self, q: Array, v: Array, a: Array, gravity_H: Array) -> Array:
        """Return M(q) a + c(q, v) + g(q), N·m, of one state or of K states.

        Args:
            q: (n,) or (K, n) joint positions, rad.
            v: (n,) or (K, n) joint rates, rad/s.
            a: (n,) or (K, n) joint accelerations, rad/s².
            gravity_H: (3,) acceleration of gravity in H, m/s².
        """
        model, data = self._workspace(gravity_H)
        state = self._full(q), self._rates(v), self._rates(a)
        if q.ndim == 1:
            tau_full = pin.rnea(model, data, *state)
        else:
            tau_full = np.empty((len(q), model.nv))
            for k, one in enumerate(zip(*state, strict=True)):
                tau_full[k] = pin.rnea(model, data, *one)
        tau = tau_full.dot(self._T) if self._joint_of_motor is None else tau_full.take(self._joint_of_motor, axis=-1)
        return np.asarray(tau + self._rotors * a)

    def energy(self, q: Array, v: Array, gravity_H: Array) -> tuple[float, float]:
        """Return the kinetic and the potential energy, J.

        Args:
            q: (n,) joint positions, rad.
            v: (n,) joint rates, rad/s.
            gravity_H: (3,) acceleration of gravity in H, m/s².
        """
        model, data = self._workspace(gravity_H)
        q_full = self._full(q)
        kinetic = pin.computeKineticEnergy(model, data, q_full, v @ self._Tt) + 0.5 * float(v @ (self._rotors * v))
        return float(kinetic), float(pin.computePotentialEnergy(model, data, q_full))

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _full(self, q: Array) -> Array:
        return np.asarray(q.dot(self._Tt) + self._q0) if self._motor_of_joint is None else q.take(self._motor_of_joint, axis=-1)

    def _rates(self, v: Array) -> Array:
        return np.asarray(v.dot(self._Tt)) if self._motor_of_joint is None else v.take(self._motor_of_joint, axis=-1)

    def _workspace(self, gravity_H: Array | None = None) -> tuple[pin.Model, pin.Data]:
        """Return this thread's model and workspace with gravity set. Pinocchio keeps gravity in the model."""
        own = self._threads
        own.moved_state = None  # bytes of q and v of the motion in the workspace, which the caller now overwrites
        if not hasattr(own, "model"):
            own.model = pin.Model(self._model)
            own.data = own.model.createData()
            own.gravity = b""  # bytes of the gravity set last: setting it is slow
            own.rest = np.zeros(own.model.nv)
            # views are made once if Pinocchio shares its memory
            own.link_motion = _link_motion_views(own.data) if np.shares_memory(own.data.J, own.data.J) else None
            own.selection = np.zeros((own.model.nv + 1, self._T.shape[1] + 2))
            own.selection[:-1, :-2], own.selection[-1, -1] = self._T, 1.0
        if gravity_H is not None and own.gravity != gravity_H.tobytes():
            own.model.gravity.linear = gravity_H
            own.gravity = gravity_H.tobytes()
        return own.model, own.data


def _permutations(T: Array, q0: Array) -> tuple[_Indices | None, _Indices | None]:
    """Return the motor of each joint and the joint of each motor if T is a permutation, which makes products indexing."""
    order = T.argmax(axis=1)
    if T.shape[0] != T.shape[1] or q0.any() or not np.array_equal(T, np.eye(len(T))[order]):
        return None, None
    return order, np.argsort(order)


def _link_motion_views(data: pin.Data) -> LinkMotion:
    """Return views of the results of a pass over the joints; copies if Pinocchio does not share its memory."""
    motion = LinkMotion(data.J, data.dJ, tuple(part for place in data.oMi for part in (place.translation, place.rotation)))
    for view in (motion.J, motion.J_rate, *motion.link_poses):
        view.setflags(write=False)
    return motion


def _update_frames(model: pin.Model, data: pin.Data, frames: Sequence[int], places: Array, J_full: Array) -> None:
    """Write poses in H (N, 4, 4) and Jacobians (N, 6, n_full) of frames; the joints' Jacobians must be up to date."""
    for i, frame in enumerate(frames):
        places[i] = pin.updateFramePlacement(model, data, frame).homogeneous
        J_full[i] = pin.getFrameJacobian(model, data, frame, _LOCAL_ALIGNED)

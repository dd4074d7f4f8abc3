"""The plant: a scene in motion. Motor torques in; true state and true contact forces out.

A step simulates one control period. The torque is limited to the motors' range and held while MuJoCo advances by dt, with the
bias acceleration of `contact_bias`. Afterwards the plant returns the state at the step's end; `true_contacts` returns the
contact forces during the step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import mujoco
import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control.state import GraspState
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import make_unchecked
from graspforce.force.problem import ForceProblem
from graspforce.force.solver import solve
from graspforce.geometry.vectors import cross
from graspforce.grasp.grasp import Grasp
from graspforce.hand.motor import MotorModel
from graspforce.simulation.plants.contact_bias import step_engine
from graspforce.simulation.plants.link_geoms import collision_names, read_collision
from graspforce.simulation.plants.plant_interface import TrueContacts
from graspforce.simulation.plants.preload import preload_contacts
from graspforce.simulation.plants.scene import Scene, set_posture
from graspforce.simulation.plants.scene_parts import FLOOR, OBJECT
from graspforce.simulation.plants.surface_contacts import update_forces
from graspforce.simulation.plants.tendon_parts import Clutches, find_free_differentials

_AT_REST = freeze(np.zeros(6))
_INITIAL_FRICTION = 0.8  # part of the friction that the initial forces may use


class Disturbance(Protocol):
    """A change of the plant; see `graspforce.simulation.plants.disturbance` for records."""

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Change the plant for the next step, and return the joint torques of that step.

        Args:
            plant: the plant.
            t: begin of the step, s.
            tau: (n,) joint torques without this disturbance, N·m.
        """
        ...  # pragma: no cover


class Plant:
    """A hand and an object in MuJoCo, initially at rest in the grasp.

    Args:
        scene: the scene.
        motors: model of the motors, from commands to joint torques. Default: the commands, limited to the hand's torques.
        disturbances: changes of the plant, applied in this order.

    Attributes:
        scene: the scene.
        model: of MuJoCo; a copy of the scene's, which disturbances change.
        data: of MuJoCo.
        gear_friction: (n,) Coulomb friction of the joints beside that of the model, N·m.
        clutches: breakaways of the hand.
        external_wrench: (6,) force in N and moment in N·m on the object at its centre of mass, in H, in each step.

    Raises:
        InvalidInput: the number of motors differs from the hand's, or the hand cannot hold the object's weight.
    """

    def __init__(self, scene: Scene, *, motors: MotorModel | None = None, disturbances: Sequence[Disturbance] = ()) -> None:
        self.scene = scene
        if motors is not None and motors.n != scene.grasp.hand.n:
            allowed = f"{scene.grasp.hand.n} motors, one for each joint of {scene.grasp.hand.name}"
            raise InvalidInput("motors", motors.n, allowed)
        self._motors = motors
        self._disturbances = tuple(disturbances)
        self._tip_of_geom = {geom: i for i, geom in enumerate(scene.tip_geoms)}
        floor = {} if scene.floor_geom is None else {"floor": scene.floor_geom}
        self._collision_names = collision_names(scene.model, object=scene.object_geom, **floor)
        self._motor_q = scene.q_address[scene.motor_joints]
        self._motor_v = scene.v_address[scene.motor_joints]
        self._has_tendons = bool(find_free_differentials(scene.grasp.hand))
        self._pairs = np.array(scene.contact_pairs)
        self._force = np.zeros(6)  # of one contact
        self._p_OC = scene.grasp.contacts.p_OC.tolist()  # last contact point of each finger, m
        self._axes = scene.grasp.contacts.R_OC.transpose(0, 2, 1).tolist()  # its tangents and normal
        self.reset()

    # ── state ──────────────────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def grasp(self) -> Grasp:
        """The grasp in which the plant starts."""
        return self.scene.grasp

    @property
    def t(self) -> float:
        """Time since the reset, s."""
        return float(self.data.time)

    @property
    def dt(self) -> float:
        """Length of a step, s."""
        return float(self.model.opt.timestep)

    def state(self) -> GraspState:
        """Return the true state: joint positions and rates of the motors, pose and twist of the object in H."""
        q, v = self._motor_motion()
        return make_unchecked(GraspState, q=freeze(q), v=freeze(v), object=self.object_motion())

    def _motor_motion(self) -> tuple[Array, Array]:
        """Return positions and rates of the motors, (n,) rad and rad/s."""
        scene, data = self.scene, self.data
        if self._has_tendons:
            q = scene.motor_map @ (data.qpos[scene.q_address] - scene.q0)
            v = scene.motor_map @ data.qvel[scene.v_address]
        else:
            q, v = data.qpos[self._motor_q], data.qvel[self._motor_v]
        self.clutches.correct_state(data, q, v)
        return q, v

    def _apply_torques(self, tau: Array) -> None:
        """Apply the torques of the motors to the joints, (n,), N·m."""
        if self._has_tendons:
            self.data.qfrc_applied[self.scene.v_address] = tau @ self.scene.motor_map
        else:
            self.data.qfrc_applied[self._motor_v] = tau
        self.clutches.apply_torques(self.data, tau)

    def object_motion(self) -> BodyMotion:
        """Return the object's true pose and twist in H; the acceleration is zero."""
        a, b = self.scene.object_q_address, self.scene.object_v_address
        q, v = self.data.qpos[a : a + 7], self.data.qvel[b : b + 6]
        mujoco.mju_quat2Mat(R := np.empty(9), q[3:])
        R_HO = R.reshape(3, 3)
        twist = np.concatenate([v[:3], R_HO @ v[3:]])
        return make_unchecked(BodyMotion, p_HO=freeze(q[:3]), R_HO=freeze(R_HO), twist=freeze(twist), acceleration=_AT_REST)

    def coupling_error(self) -> float:
        """Return the largest violation of a joint coupling, rad; m for prismatic joints."""
        q = self.data.qpos[self.scene.q_address]
        motors = self.scene.motor_map @ (q - self.scene.q0)
        return float(np.abs(self.scene.T @ motors + self.scene.q0 - q).max())

    # ── simulation ─────────────────────────────────────────────────────────────────────────────────────────────────────────

    def reset(self, f: npt.ArrayLike | None = None) -> GraspState:
        """Return to rest in the grasp, with contacts that carry the forces f; see `preload`.

        Args:
            f: (k,) stacked contact forces, N and N·m. Default: minimum-torque forces that hold the object's weight with 80 %
                of the friction.

        Returns:
            The true state.

        Raises:
            InvalidInput: f has another shape, or is None and no forces hold the weight.
        """
        scene, grasp = self.scene, self.scene.grasp
        f = self._weight_bearing_forces() if f is None else arrays.check_array(f, "f", (grasp.contacts.size,))
        self.model = scene.model.__copy__()  # disturbances change it
        self.data, self._next_data = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self._current = np.zeros(grasp.hand.n)  # A
        self.gear_friction = np.zeros(grasp.hand.n)
        self.external_wrench = np.zeros(6)
        self.clutches = Clutches(grasp.hand, self.model)
        q = preload_contacts(scene, self.model, self.data, f[grasp.contacts.normal_rows])
        J = grasp.hand.contact_jacobian(q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
        tau = grasp.hand.gravity_torque(q, scene.gravity_H) + J.T @ f
        self._apply_torques(tau)
        update_forces(self.model, self.data, scene.surface)
        self._true_contacts = self._read_contacts(tau)
        return self.state()

    def step(self, tau: npt.ArrayLike) -> GraspState:
        """Advance by dt under a torque command.

        Args:
            tau: (n,) commanded torques, N·m.

        Returns:
            The true state at the end of the step.

        Raises:
            InvalidInput: tau has another shape or is not finite.
        """
        hand, data = self.scene.grasp.hand, self.data
        command = arrays.check_array(tau, "tau", (hand.n,))
        if self._motors is None:
            applied_torque = np.clip(command, hand.torque_lower, hand.torque_upper)
        else:
            motors = self._motors.step(self._current, command, self._motor_motion()[1], self.dt)
            applied_torque, self._current = motors.tau, motors.current
        data.xfrc_applied[:] = 0.0
        data.xfrc_applied[self.scene.object_body] = self.external_wrench
        for disturbance in self._disturbances:
            applied_torque = disturbance.apply(self, self.t, applied_torque)
        self._apply_torques(applied_torque)
        step_engine(self.model, data, self._next_data, self.scene.surface)
        if self.clutches.stops:
            self.clutches.switch(self.model, data, self._motor_motion()[0], applied_torque)
        self._true_contacts = self._read_contacts(applied_torque)
        return self.state()

    def place(self, q: npt.ArrayLike, p_HO: npt.ArrayLike, R_HO: npt.ArrayLike) -> GraspState:
        """Put the hand in a posture and the object at a pose, at rest and without torques, and return the true state.

        Args:
            q: (n,) joint positions, rad.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.

        Raises:
            InvalidInput: a value is not finite, or of the wrong shape.
        """
        scene, data = self.scene, self.data
        n = scene.grasp.hand.n
        data.qvel[:] = 0.0
        set_posture(scene, data, arrays.check_array(q, "q", (n,)), np.zeros(n))
        a = scene.object_q_address
        data.qpos[a : a + 3] = arrays.check_array(p_HO, "p_HO", (3,))
        mujoco.mju_mat2Quat(quaternion := np.zeros(4), np.ravel(arrays.check_rotation(R_HO, "R_HO")))
        data.qpos[a + 3 : a + 7] = quaternion
        data.qfrc_applied[:] = 0.0
        update_forces(self.model, data, scene.surface)
        self._true_contacts = self._read_contacts(np.zeros(n))
        return self.state()

    def move_base(self, displacement: npt.ArrayLike, acceleration: npt.ArrayLike) -> None:
        """Move the base of the hand relative to the floor, from the next step on.

        The world frame of the plant stays H: the floor moves by −d, and gravity becomes g − a, with the base's acceleration a.
        The base does not rotate. The engine's floor has no velocity that its friction could transfer. So an object that touches
        nothing else moves with it, as static friction would make it.

        Args:
            displacement: (3,) d, of the base from its place at the reset, in H, m.
            acceleration: (3,) a, in H, m/s².

        Raises:
            InvalidInput: the scene has no floor, or a value is not three finite numbers.
        """
        if self.scene.floor_geom is None:
            raise InvalidInput("floor", None, "given in build_scene: the base moves relative to it")
        d = arrays.check_array(displacement, "displacement", (3,))
        body = int(self.model.geom_bodyid[self.scene.floor_geom])
        mocap = int(self.model.body_mocapid[body])
        place = self.model.body_pos[body] - d
        if self._rests_on_floor():
            a = self.scene.object_q_address
            self.data.qpos[a : a + 3] += place - self.data.mocap_pos[mocap]
        for data in (self.data, self._next_data):
            data.mocap_pos[mocap] = place
        self.model.opt.gravity[:] = self.scene.gravity_H - arrays.check_array(acceleration, "acceleration", (3,))

    def set_gear_friction(self, friction: npt.ArrayLike) -> None:
        """Set Coulomb friction of the joints beside that of the model, from the next step on, such as of loaded gears.

        Args:
            friction: (n,) N·m, ≥ 0.
        """
        new = arrays.check_array(friction, "friction", (self.scene.grasp.hand.n,), minimum=0.0)
        self.model.dof_frictionloss[self._motor_v] += new - self.gear_friction
        self.gear_friction = new

    def add_wrench(self, body: int, force: npt.ArrayLike, moment: npt.ArrayLike) -> None:
        """Add a wrench at a body's centre of mass for the next step. Disturbances call it.

        Args:
            body: index of the body in the model.
            force: (3,) in H, N.
            moment: (3,) in H, N·m.
        """
        self.data.xfrc_applied[body] += np.append(force, moment)

    def true_contacts(self) -> TrueContacts:
        """Return the contacts of the last step."""
        return self._true_contacts

    def _rests_on_floor(self) -> bool:
        """Return whether the floor is all that touches the object."""
        contacts = self._true_contacts
        others = [{each.first, each.second} - {OBJECT} for each in contacts.collisions if OBJECT in (each.first, each.second)]
        return bool(others) and not contacts.touching.any() and all(other == {FLOOR} for other in others)

    # ── contacts ───────────────────────────────────────────────────────────────────────────────────────────────────────────

    def _weight_bearing_forces(self) -> Array:
        """Return forces that hold the weight inside narrowed friction cones."""
        grasp = self.scene.grasp
        contacts = grasp.contacts
        narrow = ContactSet(
            contacts.p_OC, contacts.R_OC, contacts.models, _INITIAL_FRICTION * contacts.mu, _INITIAL_FRICTION * contacts.gamma,
            contacts.min_normal, contacts.max_normal,
        )  # fmt: skip
        w = grasp.body.wrench(BodyMotion(grasp.p_HO, grasp.R_HO), self.scene.gravity_H)
        actuation = grasp.hand.actuation(grasp.q, grasp.fingers, narrow, grasp.p_HO, grasp.R_HO, gravity_H=self.scene.gravity_H)
        solution = solve(ForceProblem(narrow, w, actuation))
        if not solution.found:
            raise InvalidInput("f", None, "given, because the hand cannot hold the object's weight in this grasp")
        return solution.f

    def _read_contacts(self, tau: Array) -> TrueContacts:
        """Return the engine's contacts, in frames on the object at its pose when they were computed.

        Scalar arithmetic: NumPy's overhead dominates for a few contacts.
        """
        scene, model, data = self.scene, self.model, self.data
        N = len(scene.tip_geoms)
        touching, depth, f = [False] * N, [0.0] * N, [[0.0] * 4] * N
        collisions = []
        if data.ncon:
            found = data.contact
            p_HO, R_HO = data.xpos[scene.object_body].tolist(), data.xmat[scene.object_body].tolist()
            frames, points, distances = found.frame.tolist(), found.pos.tolist(), found.dist.tolist()
            excluded = found.exclude.tolist()
            for c, geoms in enumerate(found.geom.tolist()):
                tip = next((self._tip_of_geom[geom] for geom in geoms if geom in self._tip_of_geom), None)
                if tip is None:
                    collisions.append(read_collision(data, c, self._collision_names))
                if tip is None or excluded[c]:
                    continue
                mujoco.mj_contactForce(model, data, c, self._force)
                force, frame = self._force.tolist(), frames[c]  # frame: rows, in H, from the first geom to the second
                sign = 1.0 if geoms[1] == scene.object_geom else -1.0  # the engine's force acts on the second geom
                n = _rotate_back(R_HO, [sign * x for x in frame[:3]])
                self._p_OC[tip] = _rotate_back(R_HO, [x - y for x, y in zip(points[c], p_HO, strict=True)])
                self._axes[tip] = axes = _contact_axes(n)
                on_object = _rotate_back(R_HO, [sign * x for x in _rotate_back(frame, force[:3])])  # N, in O
                moment = _rotate_back(R_HO, [sign * x for x in _rotate_back(frame, force[3:])])  # N·m, in O
                f[tip] = [*(_dot(axis, on_object) for axis in axes), _dot(n, moment)]
                touching[tip], depth[tip] = force[0] > 0.0, -distances[c]
        friction, condim = model.pair_friction[self._pairs], model.pair_dim[self._pairs]  # disturbances change them
        return make_unchecked(
            TrueContacts,
            t=self.t - self.dt,
            touching=np.array(touching),
            f=freeze(f),
            p_OC=freeze(self._p_OC),
            R_OC=freeze(np.array(self._axes).transpose(0, 2, 1)),
            mu=freeze(friction[:, 0] * (condim >= 3)),
            gamma=freeze(friction[:, 2] * (condim >= 4)),
            depth=freeze(depth),
            tau=freeze(tau),
            collisions=tuple(each for each in collisions if each is not None),
        )


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _rotate_back(R: list[float], v: list[float]) -> list[float]:
    """Return Rᵀ v, with R as nine numbers row by row."""
    x, y, z = v
    return [R[0] * x + R[3] * y + R[6] * z, R[1] * x + R[4] * y + R[7] * z, R[2] * x + R[5] * y + R[8] * z]


def _contact_axes(n: list[float]) -> list[list[float]]:
    """Return t₁, t₂ and n of the frame that `Contact` has by default for a unit normal."""
    x, y, z = cross(n, (0.0, 1.0, 0.0) if abs(n[0]) >= 0.9 else (1.0, 0.0, 0.0))
    length = math.sqrt(x * x + y * y + z * z)
    t = [x / length, y / length, z / length]
    return [t, cross(n, t), n]

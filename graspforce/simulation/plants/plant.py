"""The plant: a scene in motion. Motor torques in; true state and true contact forces out.

A step simulates one control period. The torque is limited to the motors' range and held while MuJoCo advances by dt, with the
bias acceleration of `contact_bias`. Afterwards the plant returns the state at the step's end; `true_contacts` returns the
contact forces during the step.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import mujoco
import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import Contact, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control.state import GraspState
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.force.problem import ForceProblem
from graspforce.force.solver import solve
from graspforce.grasp.grasp import Grasp
from graspforce.hand.motor import MotorModel
from graspforce.simulation.plants.contact_bias import step_engine
from graspforce.simulation.plants.plant_interface import TrueContacts
from graspforce.simulation.plants.preload import preload_contacts
from graspforce.simulation.plants.scene import Scene

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
        self._R_OC = np.array(scene.grasp.contacts.R_OC)
        self._p_OC = np.array(scene.grasp.contacts.p_OC)
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
        scene, data = self.scene, self.data
        j = scene.motor_joints
        return GraspState(data.qpos[scene.q_address[j]], data.qvel[scene.v_address[j]], self.object_motion())

    def object_motion(self) -> BodyMotion:
        """Return the object's true pose and twist in H; the acceleration is zero."""
        a, b = self.scene.object_q_address, self.scene.object_v_address
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, self.data.qpos[a + 3 : a + 7])
        R_HO = R.reshape(3, 3)
        twist = np.concatenate([self.data.qvel[b : b + 3], R_HO @ self.data.qvel[b + 3 : b + 6]])
        return BodyMotion(self.data.qpos[a : a + 3], R_HO, twist)

    def coupling_error(self) -> float:
        """Return the largest violation of a joint coupling, rad; m for prismatic joints."""
        q = self.data.qpos[self.scene.q_address]
        return float(np.abs(self.scene.T @ q[self.scene.motor_joints] + self.scene.q0 - q).max())

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
        q = preload_contacts(scene, self.model, self.data, f[grasp.contacts.normal_rows])
        J = grasp.hand.contact_jacobian(q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
        tau = grasp.hand.gravity_torque(q, scene.gravity_H) + J.T @ f
        self.data.qfrc_applied[scene.v_address[scene.motor_joints]] = tau
        mujoco.mj_forward(self.model, self.data)
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
        scene, hand, data = self.scene, self.scene.grasp.hand, self.data
        command = arrays.check_array(tau, "tau", (hand.n,))
        rows = scene.v_address[scene.motor_joints]
        if self._motors is None:
            applied_torque = np.clip(command, hand.torque_lower, hand.torque_upper)
        else:
            motors = self._motors.step(self._current, command, data.qvel[rows], self.dt)
            applied_torque, self._current = motors.tau, motors.current
        data.xfrc_applied[:] = 0.0
        for disturbance in self._disturbances:
            applied_torque = disturbance.apply(self, self.t, applied_torque)
        data.qfrc_applied[rows] = applied_torque
        step_engine(self.model, data, self._next_data)
        self._true_contacts = self._read_contacts(applied_torque)
        return self.state()

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
        """Return the engine's contacts, in frames on the object at its pose when they were computed."""
        scene, model, data = self.scene, self.model, self.data
        N = len(scene.tip_geoms)
        touching, f, depth = np.zeros(N, dtype=np.bool_), np.zeros((N, 4)), np.zeros(N)
        p_HO, R_HO = data.xpos[scene.object_body], data.xmat[scene.object_body].reshape(3, 3)
        force = np.zeros(6)
        for c in range(data.ncon):
            contact = data.contact[c]
            tip = scene.tip_index(contact)
            if tip is None or contact.exclude:
                continue
            mujoco.mj_contactForce(model, data, c, force)
            frame = contact.frame.reshape(3, 3)  # rows, in H: normal from the first geom to the second, two tangents
            sign = 1.0 if contact.geom[1] == scene.object_geom else -1.0  # the engine's force acts on the second geom
            n = R_HO.T @ (sign * frame[0])
            p_OC = R_HO.T @ (contact.pos - p_HO)
            R_OC = Contact(p_OC, n, 0.0).R_OC
            self._p_OC[tip], self._R_OC[tip] = p_OC, R_OC
            on_object = sign * (R_HO.T @ (frame.T @ force[:3]))  # N, in O
            moment = sign * (R_HO.T @ (frame.T @ force[3:]))  # N·m, in O
            f[tip] = [*(R_OC.T @ on_object), R_OC[:, 2] @ moment]
            touching[tip], depth[tip] = force[0] > 0.0, -contact.dist
        pairs = list(scene.contact_pairs)
        mu, gamma = model.pair_friction[pairs, 0], model.pair_friction[pairs, 2]
        has_friction, has_torsion = model.pair_dim[pairs] >= 3, model.pair_dim[pairs] >= 4
        return TrueContacts(
            self.t - self.dt, touching, freeze(f), freeze(self._p_OC), freeze(self._R_OC), freeze(mu * has_friction),
            freeze(gamma * has_torsion), freeze(depth), freeze(tau),
        )  # fmt: skip

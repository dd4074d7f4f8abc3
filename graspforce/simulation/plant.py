"""The plant: a scene that runs. Motor torques in, the true state and the true contact forces out.

A step is the physics of one control period: the torque is cut to the motors' limits and held, MuJoCo advances by dt (with what
it leaves out of contacts that turn, `turning`), and what is read afterwards is the state at the step's end and the contact
forces that acted during it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np

from graspforce.contact.contact import Contact, ContactModel, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control.state import GraspState
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.force.problem import ForceProblem
from graspforce.force.solver import solve
from graspforce.hand.motor import MotorModel
from graspforce.simulation.contact_bias import step_engine
from graspforce.simulation.preload import preload_contacts
from graspforce.simulation.scene import Scene


class Disturbance(Protocol):
    """Something that happens to the plant: records of `graspforce.simulation.disturbance`."""

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Change the plant for the step that begins at t, and return the joints' torques, changed or not."""
        ...  # pragma: no cover


@dataclass(frozen=True, eq=False, slots=True)
class TrueContacts:
    """The true contacts of one step, one row a finger of the hold, zeros and the last frame where a finger does not touch.

    Attributes:
        t: when the step began, s.
        touching: (N,) whether the fingertip touches.
        f: (N, 4) what the finger does to the object, (f_t1, f_t2, f_n, m_n) in the contact frame, N and N·m.
        p_OC: (N, 3) where, in O, m.
        R_OC: (N, 3, 3) the contact frames in O: t₁, t₂ by the rule of `Contact`, n into the object.
        mu, gamma: (N,) the plant's own friction in this step.
        depth: (N,) how far the engine let the surfaces sink into each other, m.
        tau: (n,) the torque that acted at the joints, N·m.
    """

    t: float
    touching: np.ndarray[Any, np.dtype[np.bool_]]
    f: Array
    p_OC: Array
    R_OC: Array
    mu: Array
    gamma: Array
    depth: Array
    tau: Array


class Plant:
    """A hand and an object in MuJoCo, at rest in the hold until the first step.

    Args:
        scene: what to run.
        motors: what makes joint torques of commands, winding, back-EMF and friction included; by default the commands
            themselves, cut at the torque limits of the hand.
        disturbances: what happens to it, in this order.

    Raises:
        InvalidInput: another number of motors than the hand has, or the hand cannot bear the object's weight.
    """

    def __init__(self, scene: Scene, *, motors: MotorModel | None = None, disturbances: Sequence[Disturbance] = ()) -> None:
        self.scene = scene
        if motors is not None and motors.n != scene.grasp.hand.n:
            raise InvalidInput(
                "motors", motors.n, f"{scene.grasp.hand.n} motors, one for each joint of {scene.grasp.hand.name}"
            )
        self._motors = motors
        self._disturbances = tuple(disturbances)
        self._R_OC = np.array(scene.grasp.contacts.R_OC)
        self._p_OC = np.array(scene.grasp.contacts.p_OC)
        self.reset()

    # ── state ──────────────────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def t(self) -> float:
        """s since the reset."""
        return float(self.data.time)

    @property
    def dt(self) -> float:
        """The length of a step, s."""
        return float(self.model.opt.timestep)

    def state(self) -> GraspState:
        """The true state: joints in the motors' coordinates, the object's pose and twist in H."""
        scene, data = self.scene, self.data
        j = scene.motor_joints
        return GraspState(data.qpos[scene.q_address[j]], data.qvel[scene.v_address[j]], self.object_motion())

    def object_motion(self) -> BodyMotion:
        """The object's true pose and twist in H; its acceleration is left at zero."""
        a, b = self.scene.object_q_address, self.scene.object_v_address
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, self.data.qpos[a + 3 : a + 7])
        R_HO = R.reshape(3, 3)
        twist = np.concatenate([self.data.qvel[b : b + 3], R_HO @ self.data.qvel[b + 3 : b + 6]])
        return BodyMotion(self.data.qpos[a : a + 3], R_HO, twist)

    def coupling_error(self) -> float:
        """How far the worst follower is from where its leader puts it, rad (sliding: m)."""
        q = self.data.qpos[self.scene.q_address]
        return float(np.abs(self.scene.T @ q[self.scene.motor_joints] + self.scene.q0 - q).max())

    # ── running ────────────────────────────────────────────────────────────────────────────────────────────────────────────

    def reset(self, f: Any = None) -> GraspState:
        """Back to the hold, at rest, pressing: the object in its place, the balls sunk in until the contacts bear the forces f.

        Args:
            f: (k,) stacked contact forces to begin with, N and N·m; by default the least torques that bear the object's
                weight with four fifths of the friction.

        Raises:
            InvalidInput: no f given, and the motors cannot bear the weight.
        """
        scene, grasp = self.scene, self.scene.grasp
        f = self._weight_bearing_forces() if f is None else arrays.check_array(f, "f", (grasp.contacts.size,))
        self.model = scene.model.__copy__()  # disturbances change it
        self.data, self._next_data = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self._current = np.zeros(grasp.hand.n)  # A
        rest = preload_contacts(scene, self.model, self.data, f[grasp.contacts.normal_rows])
        J = grasp.hand.contact_jacobian(rest, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
        tau = grasp.hand.gravity_torque(rest, scene.gravity_H) + J.T @ f
        self.data.qfrc_applied[scene.v_address[scene.motor_joints]] = tau
        mujoco.mj_forward(self.model, self.data)
        self._true_contacts = self._read_contacts(tau)
        return self.state()

    def step(self, tau: Any) -> GraspState:
        """Advance by dt under a torque command.

        Args:
            tau: (n,) N·m.

        Returns:
            The true state at the end of the step.
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

    def pull(self, body: int, force: Any, moment: Any) -> None:
        """For disturbances: add a force and a moment, (3,) each, in H, at a body's centre of mass, in the step that begins."""
        self.data.xfrc_applied[body] += [*force, *moment]

    def true_contacts(self) -> TrueContacts:
        """The true contacts of the last step."""
        return self._true_contacts

    # ── inside ─────────────────────────────────────────────────────────────────────────────────────────────────────────────

    def _weight_bearing_forces(self) -> Array:
        """Forces that bear the weight inside four fifths of the friction cones."""
        grasp = self.scene.grasp
        contacts = grasp.contacts
        narrow = ContactSet(
            contacts.p_OC, contacts.R_OC, contacts.models, 0.8 * contacts.mu, 0.8 * contacts.gamma, contacts.min_normal,
            contacts.max_normal,
        )  # fmt: skip
        w = grasp.body.wrench(BodyMotion(grasp.p_HO, grasp.R_HO), self.scene.gravity_H)
        actuation = grasp.hand.actuation(grasp.q, grasp.fingers, narrow, grasp.p_HO, grasp.R_HO, gravity_H=self.scene.gravity_H)
        answer = solve(ForceProblem(narrow, w, actuation))
        if not answer.found:
            raise InvalidInput("f", None, "given: the hand cannot bear the object's weight in this hold")
        return answer.f

    def _read_contacts(self, tau: Array) -> TrueContacts:
        """What the engine's last contacts say, in frames that stand on the object as it stood then."""
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
            frame = contact.frame.reshape(3, 3)  # rows: normal from the first geom into the second, two tangents, in H
            sign = 1.0 if contact.geom[1] == scene.object_geom else -1.0  # the engine's force acts on the second geom
            n = R_HO.T @ (sign * frame[0])
            where = R_HO.T @ (contact.pos - p_HO)
            R_OC = Contact(where, n, 0.0).R_OC
            self._p_OC[tip], self._R_OC[tip] = where, R_OC
            on_object = sign * (R_HO.T @ (frame.T @ force[:3]))  # N, in O
            twist = sign * (R_HO.T @ (frame.T @ force[3:]))  # N·m, in O
            f[tip] = [*(R_OC.T @ on_object), R_OC[:, 2] @ twist]
            touching[tip], depth[tip] = force[0] > 0.0, -contact.dist
        friction = model.pair_friction[list(scene.contact_pairs)]
        models = scene.grasp.contacts.models
        mu = [friction[i, 0] * (model is not ContactModel.FRICTIONLESS) for i, model in enumerate(models)]
        gamma = [friction[i, 2] * (model is ContactModel.SOFT) for i, model in enumerate(models)]
        return TrueContacts(
            self.t - self.dt, touching, freeze(f), freeze(self._p_OC), freeze(self._R_OC), freeze(mu), freeze(gamma),
            freeze(depth), freeze(tau),
        )  # fmt: skip

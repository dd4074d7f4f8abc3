"""A hand: its kinematics and dynamics through Pinocchio, seen in the coordinates of its motors.

The URDF's joints are the full coordinates. Couplings, and joints that are locked, make them a constant affine map of the
actuated ones,

    q_full = T q + q0,    v_full = T v,    tau = Tᵀ tau_full + D a,

with D the rotors' inertias as the joints feel them. Everything that a caller sees is in the actuated coordinates q. H is the
hand's base frame, the URDF's root link; twists are linear first.

Pinocchio's own mimic joints are not used: they leave parts of its algorithms unavailable and some silently wrong, while T
covers all of them.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import repeat
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from graspforce import arrays
from graspforce.actuation import Actuation
from graspforce.arrays import Array, frozen
from graspforce.contact import ContactSet
from graspforce.errors import InvalidInput, ModelError
from graspforce.hands import description as descriptions
from graspforce.hands import inverse_kinematics
from graspforce.hands.coordinates import Coordinates, resolve
from graspforce.hands.motion import TipMotion
from graspforce.hands.tree import Link, Tip, Tree

EARTH = (0.0, 0.0, -9.81)  # m/s², gravity in H when the palm looks up

_AT_TIP = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED  # at the tip frame's origin, in H's axes


@dataclass(frozen=True, eq=False, repr=False)
class Hand(Coordinates):
    """A hand, loaded. Make one with `Hand.load`; it never changes and may be used from several threads.

    Attributes:
        name, title, source, license: what the description file says.
        And all of `Coordinates`: fingers, joints, limits, and T and q0 of q_full = T q + q0.
    """

    name: str
    title: str
    source: str
    license: str
    _files: descriptions.HandFiles
    _model: pin.Model
    _threads: threading.local = field(default_factory=threading.local)

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str]) -> Hand:
        """A shipped hand by name ("four_finger", "allegro_right", …), or any hand by the path of its description file.

        Raises:
            UnknownName: neither a shipped hand nor a file; lists the shipped hands.
            ModelError: the description or its URDF cannot be read, or they contradict each other.
        """
        files = descriptions.read(name_or_path)
        said = files.description
        try:
            model = pin.buildModelFromXML(files.urdf_text)
        except (ValueError, RuntimeError) as error:
            raise ModelError(f"{files.urdf_path}: Pinocchio cannot build it: {error}") from None
        coordinates = resolve(files, tuple(model.names[1:]))
        return cls(
            **vars(coordinates),
            name=said.name,
            title=said.title,
            source=said.source,
            license=said.license,
            _files=files,
            _model=model,
        )

    def __repr__(self) -> str:
        return f"<Hand {self.name}: {len(self.fingers)} fingers, {self.n} motors>"

    # ── facts ──────────────────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def urdf_path(self) -> Path:
        """The URDF file that the hand was built from; a description's better inertias are not in it."""
        return self._files.urdf_path

    def describe(self) -> dict[str, Any]:
        """What the hand is, as a record that JSON can hold: fingers, joints, limits, couplings, masses, and their sources."""
        described = self._files.description
        masses = [float(inertia.mass) for inertia in self._model.inertias][1:]
        return {
            "name": self.name,
            "title": self.title,
            "source": self.source,
            "license": self.license,
            "notes": list(described.notes),
            "base": self._files.urdf.root,
            "fingers": [{**asdict(finger), "joints": [self.joints[i].name for i in finger.joints]} for finger in self.fingers],
            "joints": [asdict(joint) for joint in self.joints],
            "neutral": self.neutral.tolist(),
            "torque_weight": self.torque_weight.tolist(),
            "couplings": [msgspec.to_builtins(coupling) for coupling in described.couplings],
            "locked": [msgspec.to_builtins(lock) for lock in described.locked],
            "moving_masses": dict(zip(self.full_joints, masses, strict=True)),  # kg, of all that is fixed to each joint
            "replaced_inertias": [{"link": better.link, "source": better.source} for better in described.inertias],
        }

    def tree(self) -> Tree:
        """The links and fingertips as plain numbers, a description's better inertias included, to build the hand elsewhere."""
        links = []
        for i in range(1, self._model.njoints):
            joint, place, inertia = self._model.joints[i], self._model.jointPlacements[i], self._model.inertias[i]
            data = joint.createData()
            joint.calc(data, np.zeros(1))
            slides = not np.any(data.S[3:])  # S: the joint's unit twist, linear first
            links.append(
                Link(
                    joint=self._model.names[i],
                    parent=self._model.parents[i] - 1,
                    p_PL=frozen(place.translation),
                    R_PL=frozen(place.rotation),
                    axis=frozen(data.S[:3] if slides else data.S[3:]),
                    slides=slides,
                    mass=float(inertia.mass),
                    p_LM=frozen(inertia.lever),
                    inertia=frozen(inertia.inertia),
                    lower=float(self._model.lowerPositionLimit[i - 1]),
                    upper=float(self._model.upperPositionLimit[i - 1]),
                )
            )
        tips = []
        for finger in self.fingers:
            frame = self._model.frames[self._frame(finger.name)]
            p_LF, R_LF = frozen(frame.placement.translation), frozen(frame.placement.rotation)
            tips.append(Tip(finger.name, frame.parentJoint - 1, p_LF, R_LF, finger.tip_radius))
        return Tree(tuple(links), tuple(tips))

    # ── kinematics ─────────────────────────────────────────────────────────────────────────────────────────────────────────

    def tip_pose(self, q: Any, finger: str) -> tuple[Array, Array]:
        """The pose of a finger's tip frame F in H.

        Args:
            q: (n,) joint positions, rad.
            finger: its name.

        Returns:
            p_HF (3,) in m and R_HF (3, 3), whose columns are F's axes in H.
        """
        model, data, frame = *self._work(), self._frame(finger)
        pin.framesForwardKinematics(model, data, self._full(q))
        placement = data.oMf[frame]
        return frozen(placement.translation), frozen(placement.rotation)

    def point_jacobian(self, q: Any, finger: str, p_H: Any) -> Array:
        """The twist, at a point that moves with a finger's last link, for each unit actuated rate.

        Args:
            q: (n,) joint positions, rad.
            finger: the finger's name.
            p_H: (3,) where the point is now, in H, m.

        Returns:
            (6, n): rows 0–2 the velocity of the point, m/rad, rows 3–5 the angular velocity, both in H's axes.
        """
        p_H = arrays.array(p_H, "p_H", (3,))
        return frozen(self._point_jacobians(self._full(q), [finger], p_H[None])[0])

    def contact_jacobian(self, q: Any, fingers: Sequence[str], contacts: ContactSet, p_HO: Any, R_HO: Any) -> Array:
        """J, with J v the fingers' velocities at the contacts, row by row as the contact forces are stacked.

        J = H_c [R_OCᵀ R_HOᵀ (velocity of the finger's point at the contact); nᵀ (its angular velocity)], H_c keeping the rows
        that the contact's model has. The motors bear f with tau = Jᵀ f. Source: 001 (16).

        Args:
            q: (n,) joint positions, rad.
            fingers: the finger at each contact, by name.
            contacts: the N contacts, in O.
            p_HO: (3,) the object's position in H, m.
            R_HO: (3, 3) the object's axes in H.

        Returns:
            (k, n), m/rad, a soft contact's row about its normal 1.
        """
        p_HO, R_HO = _contacts_place(fingers, contacts, p_HO, R_HO)
        points = self._point_jacobians(self._full(q), fingers, p_HO + contacts.p_OC @ R_HO.T)
        R_CH = (R_HO @ contacts.R_OC).transpose(0, 2, 1)
        padded = np.empty((len(contacts), 4, self.n))  # rows t₁, t₂, n, and the turn about n
        padded[:, :3] = R_CH @ points[:, :3]
        padded[:, 3] = (R_CH[:, 2:3] @ points[:, 3:])[:, 0]
        return frozen(padded.reshape(-1, self.n)[contacts.columns])

    def tip_motion(self, q: Any, v: Any, fingers: Sequence[str]) -> TipMotion:
        """Where fingertips are, how they move, and how they would accelerate by themselves, in one pass over the joints.

        The drift is J̇ v: the classical acceleration of the tip frame where v̇ = 0; the coupling T is constant and adds none.

        Args:
            q, v: (n,) joint positions, rad, and rates, rad/s.
            fingers: their names.
        """
        q_full, v_full = self._full(q), self.T @ arrays.array(v, "v", (self.n,))
        model, data = self._work()
        pin.forwardKinematics(model, data, q_full, v_full, np.zeros(len(q_full)))
        pin.computeJointJacobians(model, data)
        N = len(fingers)
        p, R, J_full, drift = np.empty((N, 3)), np.empty((N, 3, 3)), np.empty((N, 6, len(q_full))), np.empty((N, 6))
        for i, finger in enumerate(fingers):
            frame = self._frame(finger)
            place = pin.updateFramePlacement(model, data, frame)
            p[i], R[i] = place.translation, place.rotation
            J_full[i] = pin.getFrameJacobian(model, data, frame, _AT_TIP)
            drift[i] = pin.getFrameClassicalAcceleration(model, data, frame, _AT_TIP).vector
        return TipMotion(p, R, J_full @ self.T, J_full @ v_full, drift)

    def inverse_kinematics(self, finger: str, p_H: Any, q_start: Any = None) -> Array:
        """The joint positions of one finger that bring its tip frame's origin to a point, within the joint limits.

        Damped Newton steps on the finger's own actuated coordinates, couplings included, from ``q_start`` and, where that
        fails, from the neutral posture and from spread postures. Where several postures reach the point, the one that the
        search meets first is the answer: give the last posture as the start to follow a path without jumps.

        Args:
            finger: its name.
            p_H: (3,) the point in H, m.
            q_start: (n,) the hand's posture to start from, rad; by default neutral.

        Returns:
            (number of the finger's joints,) in the order of ``finger.joints``, rad.

        Raises:
            InvalidInput: the point is out of reach; says how far away the nearest point is that the search found.
        """
        p_H = arrays.array(p_H, "p_H", (3,))
        chosen = list(self.finger(finger).joints)
        q = np.array(self.neutral if q_start is None else arrays.array(q_start, "q_start", (self.n,)))

        frame = self._frame(finger)

        def tip(q_finger: Array) -> tuple[Array, Array]:
            q[chosen] = q_finger
            J, p = self._tip_jacobian(self.T @ q + self.q0, frame)
            return p, J[:3, chosen]

        starts = [q[chosen], self.neutral[chosen]]
        found = inverse_kinematics.solve(tip, p_H, self.q_lower[chosen], self.q_upper[chosen], starts)
        if found.distance > inverse_kinematics.REACHED:
            near = ", ".join(f"{x:.4f}" for x in found.p)
            allowed = f"within reach of {finger}: the nearest point found is [{near}], {1e3 * found.distance:.2f} mm away"
            raise InvalidInput("p_H", p_H, allowed)
        return frozen(found.q)

    def grasp_posture(self, fingers: Sequence[str], contacts: ContactSet, p_HO: Any, R_HO: Any, q_start: Any = None) -> Array:
        """The posture in which the named fingers touch the object at the contacts.

        A round tip of radius r touches at its foot, so its middle stands at p_HO + R_HO (p_OC − r n), n the inward normal; a
        tip without a radius stands at the contact itself. Fingers that are not named stay as they start.

        Args:
            fingers: the finger at each contact, by name, each once.
            contacts, p_HO, R_HO: as in `contact_jacobian`.
            q_start: (n,) the posture to start from, rad; by default neutral.

        Returns:
            (n,), rad.

        Raises:
            InvalidInput: a contact is out of its finger's reach, or a finger is named twice.
        """
        p_HO, R_HO = _contacts_place(fingers, contacts, p_HO, R_HO)
        if len(set(fingers)) < len(fingers):
            raise InvalidInput("fingers", fingers, "different fingers: a tip touches at one place")
        q = np.array(self.neutral if q_start is None else arrays.array(q_start, "q_start", (self.n,)))
        for i, name in enumerate(fingers):
            finger = self.finger(name)
            middle = contacts.p_OC[i] - (finger.tip_radius or 0.0) * contacts.R_OC[i, :, 2]  # m, in O
            try:
                q[list(finger.joints)] = self.inverse_kinematics(name, p_HO + R_HO @ middle, q)
            except InvalidInput as error:
                raise error.inside(f"contacts[{i}]") from None
        return frozen(q)

    # ── dynamics ───────────────────────────────────────────────────────────────────────────────────────────────────────────

    def mass_matrix(self, q: Any) -> Array:
        """M = Tᵀ M_full T + D, (n, n), kg·m², symmetric and positive definite. ``q``: (n,), rad."""
        model, data = self._work()
        M = pin.crba(model, data, self._full(q))
        M = np.triu(M) + np.triu(M, 1).T
        return frozen(self.T.T @ M @ self.T + np.diag(self.rotor_inertia))

    def gravity_torque(self, q: Any, gravity_H: Any = EARTH) -> Array:
        """The motor torques that hold the hand still against gravity, (n,), N·m: the gradient of the potential energy.

        Args:
            q: (n,) joint positions, rad.
            gravity_H: (3,) the acceleration of gravity in H, m/s².
        """
        model, data = self._work(gravity_H)
        return frozen(self.T.T @ pin.computeGeneralizedGravity(model, data, self._full(q)))

    def inverse_dynamics(self, q: Any, v: Any, a: Any, gravity_H: Any = EARTH) -> Array:
        """The motor torques of a motion without contact: M a + c(q, v) + g(q), (n,), N·m.

        Args:
            q, v, a: (n,) joint positions, rad, rates, rad/s, and accelerations, rad/s².
            gravity_H: (3,) the acceleration of gravity in H, m/s².
        """
        v, a = arrays.array(v, "v", (self.n,)), arrays.array(a, "a", (self.n,))
        model, data = self._work(gravity_H)
        tau_full = pin.rnea(model, data, self._full(q), self.T @ v, self.T @ a)
        return frozen(self.T.T @ tau_full + self.rotor_inertia * a)

    def energy(self, q: Any, v: Any, gravity_H: Any = EARTH) -> tuple[float, float]:
        """The kinetic energy ½ vᵀ M v and the potential energy (zero where the masses lie in H's origin), J.

        Args:
            q, v: (n,) joint positions, rad, and rates, rad/s.
            gravity_H: (3,) the acceleration of gravity in H, m/s².
        """
        v = arrays.array(v, "v", (self.n,))
        model, data = self._work(gravity_H)
        q_full = self._full(q)
        kinetic = pin.computeKineticEnergy(model, data, q_full, self.T @ v) + 0.5 * float(v @ (self.rotor_inertia * v))
        return float(kinetic), float(pin.computePotentialEnergy(model, data, q_full))

    def actuation(
        self,
        q: Any,
        fingers: Sequence[str],
        contacts: ContactSet,
        p_HO: Any,
        R_HO: Any,
        *,
        v: Any = None,
        a: Any = None,
        gravity_H: Any = EARTH,
    ) -> Actuation:
        """What this hand, in this state, brings to a force problem: J, tau_u, the motor limits and the cost's weight.

        Args:
            q, fingers, contacts, p_HO, R_HO: as in `contact_jacobian`.
            v, a: (n,) joint rates, rad/s, and accelerations, rad/s²; zeros by default.
            gravity_H: (3,) the acceleration of gravity in H, m/s².
        """
        rest = np.zeros(self.n)
        J = self.contact_jacobian(q, fingers, contacts, p_HO, R_HO)
        tau_u = self.inverse_dynamics(q, rest if v is None else v, rest if a is None else a, gravity_H)
        return Actuation(J, tau_u, self.torque_lower, self.torque_upper, self.torque_weight)

    # ── along a path ───────────────────────────────────────────────────────────────────────────────────────────────────────

    def tips_along(self, q: Any, fingers: Sequence[str]) -> tuple[Array, Array]:
        """Where tips are in many postures, and how they move.

        Args:
            q: (K, n) postures, rad.
            fingers: F names.

        Returns:
            p_HF (K, F, 3), m, and the Jacobians (K, F, 3, n) of the tip frames' origins, in H, m/rad.
        """
        q_full = self._full_along(q)
        model, data = self._work()
        frames = [self._frame(finger) for finger in fingers]
        p = np.empty((len(q_full), len(frames), 3))
        J = np.empty((len(q_full), len(frames), 3, model.nv))
        for k, posture in enumerate(q_full):
            pin.computeJointJacobians(model, data, posture)
            for i, frame in enumerate(frames):
                p[k, i] = pin.updateFramePlacement(model, data, frame).translation
                J[k, i] = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3]
        return p, np.asarray(J @ self.T)

    def contact_jacobian_along(self, q: Any, fingers: Sequence[str], contacts: ContactSet, p_HO: Any, R_HO: Any) -> Array:
        """`contact_jacobian` in many postures: q (K, n), p_HO (K, 3), R_HO (K, 3, 3) → (K, k, n)."""
        q_full = self._full_along(q)
        p_HO, R_HO = arrays.array(p_HO, "p_HO", (len(q_full), 3)), arrays.array(R_HO, "R_HO", (len(q_full), 3, 3))
        points = p_HO[:, None] + contacts.p_OC @ R_HO.transpose(0, 2, 1)  # m
        twists = np.stack([self._point_jacobians(*each) for each in zip(q_full, repeat(fingers), points, strict=False)])
        R_CH = (R_HO[:, None] @ contacts.R_OC).transpose(0, 1, 3, 2)
        padded = np.concatenate([R_CH @ twists[:, :, :3], R_CH[:, :, 2:3] @ twists[:, :, 3:]], axis=2)
        return np.asarray(padded.reshape(len(q_full), -1, self.n)[:, contacts.columns])

    def inverse_dynamics_along(self, q: Any, v: Any, a: Any, gravity_H: Any = EARTH) -> Array:
        """`inverse_dynamics` in many states: q, v, a (K, n) → (K, n), N·m."""
        q_full = self._full_along(q)
        shape = (len(q_full), self.n)
        v, a = arrays.array(v, "v", shape), arrays.array(a, "a", shape)
        model, data = self._work(gravity_H)
        states = zip(q_full, v @ self.T.T, a @ self.T.T, strict=True)
        tau_full = np.array([pin.rnea(model, data, *state) for state in states])
        return np.asarray(tau_full @ self.T + self.rotor_inertia * a)

    def _full_along(self, q: Any) -> Array:
        return np.asarray(arrays.array(q, "q", (None, self.n)) @ self.T.T + self.q0)

    # ── inside ─────────────────────────────────────────────────────────────────────────────────────────────────────────────

    def _full(self, q: Any) -> Array:
        """q_full = T q + q0."""
        return np.asarray(self.T @ arrays.array(q, "q", (self.n,)) + self.q0)

    def _work(self, gravity_H: Any = None) -> tuple[pin.Model, pin.Data]:
        """This thread's own model and workspace, gravity set: Pinocchio keeps gravity in the model and results in the data."""
        if not hasattr(self._threads, "model"):
            self._threads.model = pin.Model(self._model)
            self._threads.data = self._threads.model.createData()
        if gravity_H is not None:
            self._threads.model.gravity.linear = arrays.array(gravity_H, "gravity_H", (3,))
        return self._threads.model, self._threads.data

    def _frame(self, finger: str) -> int:
        return self._tip_frames[self.finger(finger).name]

    @cached_property
    def _tip_frames(self) -> dict[str, int]:
        return {finger.name: self._model.getFrameId(finger.tip, pin.FrameType.BODY) for finger in self.fingers}

    def _tip_jacobian(self, q_full: Array, frame: int) -> tuple[Array, Array]:
        """The (6, n) Jacobian of a tip frame at its own origin, in H's axes, and that origin (3,), m."""
        model, data = self._work()
        J = pin.computeFrameJacobian(model, data, q_full, frame, _AT_TIP)
        return J @ self.T, data.oMf[frame].translation.copy()

    def _point_jacobians(self, q_full: Array, fingers: Sequence[str], p_H: Array) -> Array:
        """(N, 6, n): `point_jacobian` of N points (N, 3), each with its finger; one pass over the joints for all."""
        model, data = self._work()
        frames = [self._frame(finger) for finger in fingers]
        pin.computeJointJacobians(model, data, q_full)
        J_full, p_tip = np.empty((len(frames), 6, len(q_full))), np.empty((len(frames), 3))
        for i, frame in enumerate(frames):
            p_tip[i] = pin.updateFramePlacement(model, data, frame).translation
            J_full[i] = pin.getFrameJacobian(model, data, frame, _AT_TIP)
        J = np.asarray(J_full @ self.T)
        x, y, z = (p_H - p_tip).T[:, :, None]  # m, from the tip's origin to the point
        omega = J[:, 3:]
        J[:, 0] += omega[:, 1] * z - omega[:, 2] * y  # v_P = v_tip + ω × lever
        J[:, 1] += omega[:, 2] * x - omega[:, 0] * z
        J[:, 2] += omega[:, 0] * y - omega[:, 1] * x
        return J


def _contacts_place(fingers: Sequence[str], contacts: ContactSet, p_HO: Any, R_HO: Any) -> tuple[Array, Array]:
    """The object's pose, checked: a matrix that is a rotation to within rounding; and one finger's name for each contact."""
    if isinstance(fingers, str) or len(fingers) != len(contacts):
        raise InvalidInput("fingers", fingers, f"a list of {len(contacts)} finger names, one for each contact")
    return arrays.array(p_HO, "p_HO", (3,)), arrays.rotation(R_HO, "R_HO")

"""A hand: its kinematics and dynamics through Pinocchio, seen in the coordinates of its motors.

The URDF's joints are the full coordinates. Couplings, and joints that are locked, make them a constant affine map of the
actuated ones,

    q_full = T q + q0,    v_full = T v,    tau = Tᵀ tau_full + D a,

with D the rotors' inertias as the joints feel them. Everything that a caller sees is in the actuated coordinates q. H is the
hand's base frame, the URDF's root link; twists are linear first. Here numbers are checked; `hands.coupled_model` computes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import contact_jacobians
from graspforce.contact.motion import TipMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.hand import description as descriptions
from graspforce.hand import inverse_kinematics, meshes
from graspforce.hand.actuation import Actuation
from graspforce.hand.coordinates import JointCoordinates, resolve_coordinates
from graspforce.hand.coupled_model import CoupledModel, read_urdf
from graspforce.hand.kinematic_tree import KinematicTree, Mesh

GRAVITY_PALM_UP = (0.0, 0.0, -9.81)  # m/s², gravity in H when the palm looks up


@dataclass(frozen=True, eq=False, repr=False)
class Hand(JointCoordinates):
    """A hand, loaded. Make one with `Hand.load`; it never changes and may be used from several threads.

    Attributes:
        name, title, source, license: what the description file says.
        model: the same computations without checks, for inner loops whose numbers are right already.
        And all of `JointCoordinates`: fingers, joints, limits, and T and q0 of q_full = T q + q0.
    """

    name: str
    title: str
    source: str
    license: str
    model: CoupledModel
    _files: descriptions.HandSource

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str]) -> Hand:
        """A shipped hand by name ("four_finger", "allegro_right", …), or any hand by the path of its description file.

        Raises:
            UnknownName: neither a shipped hand nor a file; lists the shipped hands.
            ModelError: the description or its URDF cannot be read, or they contradict each other.
        """
        files = descriptions.read(name_or_path)
        said = files.description
        model = read_urdf(files.urdf_text, files.urdf_path)
        coordinates = resolve_coordinates(files, tuple(model.names[1:]))
        return cls(
            **vars(coordinates),
            name=said.name,
            title=said.title,
            source=said.source,
            license=said.license,
            model=CoupledModel(model, coordinates),
            _files=files,
        )

    def __repr__(self) -> str:
        return f"<Hand {self.name}: {len(self.fingers)} fingers, {self.n} motors>"

    def derated(self, torque: float) -> Hand:
        """The same hand with motors that give only a part of their largest torque: what a planner leaves to a controller.

        Args:
            torque: the part, > 0.
        """
        part = arrays.check_number(torque, "torque", above=0.0)
        return replace(self, joints=tuple(replace(joint, torque=part * joint.torque) for joint in self.joints))

    # ── facts ──────────────────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def urdf_path(self) -> Path:
        """The URDF file that the hand was built from; a description's better inertias are not in it."""
        return self._files.urdf_path

    def describe(self) -> dict[str, Any]:
        """What the hand is, as a record that JSON can hold: fingers, joints, limits, couplings, masses, and their sources."""
        described = self._files.description
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
            "moving_masses": dict(
                zip(self.full_joints, self.model.masses(), strict=True)
            ),  # kg, of all that is fixed to each joint
            "replaced_inertias": [{"link": override.link, "source": override.source} for override in described.inertias],
        }

    def tree(self) -> KinematicTree:
        """The links and fingertips as plain numbers, a description's better inertias included, to build the hand elsewhere."""
        return self.model.tree(self.fingers)

    def meshes(self, directories: Sequence[str | os.PathLike[str]] = ()) -> tuple[Mesh, ...]:
        """The meshes by which the URDF says that the hand looks, to draw it elsewhere.

        Args:
            directories: where packages, or the files themselves, are looked for, beside the places of `meshes.locate`.

        Raises:
            ModelError: a file that is not there; says where it was looked for.
        """
        return meshes.visual_meshes(self._files, self.model.carrier_of, directories)

    def tip_mesh(self, finger: str, directories: Sequence[str | os.PathLike[str]] = ()) -> Mesh:
        """The mesh of a finger's tip link: the one that touches, and where that is a primitive the one by which it looks.

        Args:
            finger: its name.
            directories: as in `meshes`.

        Raises:
            UnknownName: no such finger.
            ModelError: the link has no mesh, or several, or the file is not there.
        """
        return meshes.contact_mesh(self._files, self.finger(finger).tip, self.model.carrier_of, directories)

    def frame_id(self, finger: str) -> int:
        """The number by which `model` knows a finger's tip frame.

        Raises:
            UnknownName: no such finger.
        """
        return self._tip_frames[self.finger(finger).name]

    # ── kinematics ─────────────────────────────────────────────────────────────────────────────────────────────────────────

    def tip_pose(self, q: Any, finger: str) -> tuple[Array, Array]:
        """The pose of a finger's tip frame F in H.

        Args:
            q: (n,) joint positions, rad.
            finger: its name.

        Returns:
            p_HF (3,) in m and R_HF (3, 3), whose columns are F's axes in H.
        """
        p_HF, R_HF = self.model.frame_pose(self._checked(q), self.frame_id(finger))
        return freeze(p_HF), freeze(R_HF)

    def point_jacobian(self, q: Any, finger: str, p_H: Any) -> Array:
        """The twist, at a point that moves with a finger's last link, for each unit actuated rate.

        Args:
            q: (n,) joint positions, rad.
            finger: the finger's name.
            p_H: (3,) where the point is now, in H, m.

        Returns:
            (6, n): rows 0–2 the velocity of the point, m/rad, rows 3–5 the angular velocity, both in H's axes.
        """
        p_H = arrays.check_array(p_H, "p_H", (3,))
        return freeze(self.model.point_jacobians(self._checked(q)[None], [self.frame_id(finger)], p_H[None, None])[0, 0])

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
        return freeze(self._contact_jacobians(self._checked(q)[None], fingers, contacts, p_HO[None], R_HO[None])[0])

    def tip_motion(self, q: Any, v: Any, fingers: Sequence[str]) -> TipMotion:
        """Where fingertips are, how they move, and how they would accelerate by themselves, in one pass over the joints.

        The drift is J̇ v: the classical acceleration of the tip frame where v̇ = 0; the coupling T is constant and adds none.

        Args:
            q, v: (n,) joint positions, rad, and rates, rad/s.
            fingers: their names.
        """
        return self.model.tip_motion(
            self._checked(q), arrays.check_array(v, "v", (self.n,)), [self.frame_id(name) for name in fingers]
        )

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
        p_H = arrays.check_array(p_H, "p_H", (3,))
        chosen = list(self.finger(finger).joints)
        q = np.array(self.neutral if q_start is None else arrays.check_array(q_start, "q_start", (self.n,)))

        frame_id = self.frame_id(finger)

        def tip(q_finger: Array) -> tuple[Array, Array]:
            q[chosen] = q_finger
            p, J = self.model.tips(q[None], [frame_id])
            return p[0, 0], J[0, 0, :3, chosen].T

        starts = [q[chosen], self.neutral[chosen]]
        found = inverse_kinematics.solve(tip, p_H, self.q_lower[chosen], self.q_upper[chosen], starts)
        if found.distance > inverse_kinematics.REACH_TOLERANCE:
            near = ", ".join(f"{x:.4f}" for x in found.p)
            allowed = f"within reach of {finger}: the nearest point found is [{near}], {1e3 * found.distance:.2f} mm away"
            raise InvalidInput("p_H", p_H, allowed)
        return freeze(found.q)

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
        q = np.array(self.neutral if q_start is None else arrays.check_array(q_start, "q_start", (self.n,)))
        for i, name in enumerate(fingers):
            finger = self.finger(name)
            middle = contacts.p_OC[i] - (finger.tip_radius or 0.0) * contacts.R_OC[i, :, 2]  # m, in O
            try:
                q[list(finger.joints)] = self.inverse_kinematics(name, p_HO + R_HO @ middle, q)
            except InvalidInput as error:
                raise error.with_prefix(f"contacts[{i}]") from None
        return freeze(q)

    # ── dynamics ───────────────────────────────────────────────────────────────────────────────────────────────────────────

    def mass_matrix(self, q: Any) -> Array:
        """M = Tᵀ M_full T + D, (n, n), kg·m², symmetric and positive definite. ``q``: (n,), rad."""
        return freeze(self.model.mass_matrix(self._checked(q)))

    def gravity_torque(self, q: Any, gravity_H: Any = GRAVITY_PALM_UP) -> Array:
        """The motor torques that hold the hand still against gravity, (n,), N·m: the gradient of the potential energy.

        Args:
            q: (n,) joint positions, rad.
            gravity_H: (3,) the acceleration of gravity in H, m/s².
        """
        return freeze(self.model.gravity_torque(self._checked(q), arrays.check_array(gravity_H, "gravity_H", (3,))))

    def inverse_dynamics(self, q: Any, v: Any, a: Any, gravity_H: Any = GRAVITY_PALM_UP) -> Array:
        """The motor torques of a motion without contact: M a + c(q, v) + g(q), (n,), N·m.

        Args:
            q, v, a: (n,) joint positions, rad, rates, rad/s, and accelerations, rad/s².
            gravity_H: (3,) the acceleration of gravity in H, m/s².
        """
        v, a = arrays.check_array(v, "v", (self.n,)), arrays.check_array(a, "a", (self.n,))
        gravity_H = arrays.check_array(gravity_H, "gravity_H", (3,))
        return freeze(self.model.inverse_dynamics(self._checked(q), v, a, gravity_H))

    def energy(self, q: Any, v: Any, gravity_H: Any = GRAVITY_PALM_UP) -> tuple[float, float]:
        """The kinetic energy ½ vᵀ M v and the potential energy (zero where the masses lie in H's origin), J.

        Args:
            q, v: (n,) joint positions, rad, and rates, rad/s.
            gravity_H: (3,) the acceleration of gravity in H, m/s².
        """
        v = arrays.check_array(v, "v", (self.n,))
        return self.model.energy(self._checked(q), v, arrays.check_array(gravity_H, "gravity_H", (3,)))

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
        gravity_H: Any = GRAVITY_PALM_UP,
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
        p, J = self.model.tips(self._checked_along(q), [self.frame_id(finger) for finger in fingers])
        return p, J[:, :, :3]

    def contact_jacobian_along(self, q: Any, fingers: Sequence[str], contacts: ContactSet, p_HO: Any, R_HO: Any) -> Array:
        """`contact_jacobian` in many postures: q (K, n), p_HO (K, 3), R_HO (K, 3, 3) → (K, k, n)."""
        q = self._checked_along(q)
        p_HO, R_HO = arrays.check_array(p_HO, "p_HO", (len(q), 3)), arrays.check_array(R_HO, "R_HO", (len(q), 3, 3))
        return self._contact_jacobians(q, fingers, contacts, p_HO, R_HO)

    def inverse_dynamics_along(self, q: Any, v: Any, a: Any, gravity_H: Any = GRAVITY_PALM_UP) -> Array:
        """`inverse_dynamics` in many states: q, v, a (K, n) → (K, n), N·m."""
        q = self._checked_along(q)
        v, a = arrays.check_array(v, "v", q.shape), arrays.check_array(a, "a", q.shape)
        return self.model.inverse_dynamics(q, v, a, arrays.check_array(gravity_H, "gravity_H", (3,)))

    # ── inside ─────────────────────────────────────────────────────────────────────────────────────────────────────────────

    @cached_property
    def _tip_frames(self) -> dict[str, int]:
        return {finger.name: self.model.frame_id(finger.tip) for finger in self.fingers}

    def _checked(self, q: Any) -> Array:
        return arrays.check_array(q, "q", (self.n,))

    def _checked_along(self, q: Any) -> Array:
        return arrays.check_array(q, "q", (None, self.n))

    def _contact_jacobians(self, q: Array, fingers: Sequence[str], contacts: ContactSet, p_HO: Array, R_HO: Array) -> Array:
        """(K, k, n): `contact_jacobian` in K postures, of arguments that were checked."""
        p_H = p_HO[:, None] + contacts.p_OC @ R_HO.transpose(0, 2, 1)  # m
        twists = self.model.point_jacobians(q, [self.frame_id(finger) for finger in fingers], p_H)
        return contact_jacobians(contacts, twists, R_HO, contacts.R_OC)


def _contacts_place(fingers: Sequence[str], contacts: ContactSet, p_HO: Any, R_HO: Any) -> tuple[Array, Array]:
    """The object's pose, checked: a matrix that is a rotation to within rounding; and one finger's name for each contact."""
    if isinstance(fingers, str) or len(fingers) != len(contacts):
        raise InvalidInput("fingers", fingers, f"a list of {len(contacts)} finger names, one for each contact")
    return arrays.check_array(p_HO, "p_HO", (3,)), arrays.check_rotation(R_HO, "R_HO")

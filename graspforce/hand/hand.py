"""A hand: its description, kinematics and dynamics in the coordinates of its motors, through Pinocchio.

The URDF's joints are the full coordinates. Couplings and locked joints make them a constant affine map of the actuated ones:

    q_full = T q + q0,    v_full = T v,    tau = Tᵀ tau_full + D a,

where D contains the rotor inertias at the joints. Every argument and result uses the actuated coordinates q. H is the hand's
base frame, the URDF's root link. Twists are linear first.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.text_table import Table
from graspforce.geometry.poses import pose_to_dict
from graspforce.hand.actuation import Actuation
from graspforce.hand.descriptions import description as descriptions
from graspforce.hand.descriptions.urdf import Urdf
from graspforce.hand.drives.drive import Drive, Drives
from graspforce.hand.kinematics.coupled_model import CoupledModel, read_urdf
from graspforce.hand.kinematics.joint_locks import lock_joints
from graspforce.hand.kinematics.kinematic_tree import KinematicTree, Mesh
from graspforce.hand.kinematics.kinematics import HandKinematics
from graspforce.hand.kinematics.resolution import resolve_coordinates, torque_weight
from graspforce.hand.shapes import meshes

GRAVITY_PALM_UP = (0.0, 0.0, -9.81)  # m/s², in H


@dataclass(frozen=True, eq=False, repr=False)
class Hand(HandKinematics):
    """A loaded hand. It is immutable and may be used from several threads. Load one with `Hand.load`.

    Attributes:
        name: name of the hand in its description.
        title: one line about the hand.
        source: where its geometry and masses come from.
        license: of its description and URDF.

    Further attributes: those of `JointCoordinates` and `HandKinematics`.
    """

    name: str
    title: str
    source: str
    license: str
    _files: descriptions.HandSource

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str]) -> Hand:
        """Load a hand.

        Args:
            name_or_path: name of a shipped hand, such as "four_finger" or "allegro_right", or path of a description file.

        Raises:
            UnknownName: neither a shipped hand nor a file; lists the shipped hands.
            ModelError: the description or its URDF cannot be read, or they contradict each other.
        """
        files = descriptions.read(name_or_path)
        described = files.description
        model = read_urdf(files.urdf_text, files.urdf_path)
        coordinates = resolve_coordinates(files, tuple(model.names[1:]))
        return cls(
            **vars(coordinates),
            model=CoupledModel(model, coordinates),
            name=described.name,
            title=described.title,
            source=described.source,
            license=described.license,
            _files=files,
        )

    def __repr__(self) -> str:
        return f"<Hand {self.name}: {len(self.fingers)} fingers, {self.n} motors>"

    def __str__(self) -> str:
        return str(self._table())

    def _repr_html_(self) -> str:
        return self._table().to_html()

    def derated(self, torque_fraction: float) -> Hand:
        """Return the hand with reduced motor torques: a planner leaves the rest to a controller.

        Args:
            torque_fraction: fraction of the motors' largest torques, > 0.

        Raises:
            InvalidInput: not a finite number > 0.
        """
        fraction = arrays.check_number(torque_fraction, "torque_fraction", above=0.0)
        return replace(self, joints=tuple(replace(joint, torque=fraction * joint.torque) for joint in self.joints))

    def with_pads(self, torsional_friction: float | None) -> Hand:
        """Return the hand with soft pads of one kind on all fingertips.

        Args:
            torsional_friction: torsional friction length γ of the pads, m, > 0; None for tips without pads.

        Raises:
            InvalidInput: not a finite number > 0.
        """
        gamma = torsional_friction
        if gamma is not None:
            gamma = arrays.check_number(gamma, "torsional_friction", above=0.0)
        return replace(self, fingers=tuple(replace(finger, torsional_friction=gamma) for finger in self.fingers))

    def with_drives(self, drives: Sequence[Drive] | Drive) -> Hand:
        """Return the hand with other drives. Torque limits above those of the drives' currents are reduced to them.

        Args:
            drives: one for each actuated joint, in their order, or one for all.

        Raises:
            InvalidInput: another number of drives.
        """
        each = (drives,) * self.n if isinstance(drives, Drive) else tuple(drives)
        if len(each) != self.n:
            raise InvalidInput("drives", f"{len(each)} drives", f"one for each of the {self.n} actuated joints")
        pairs = zip(self.joints, each, strict=True)
        joints = tuple(replace(joint, torque=min(joint.torque, drive.largest_torque)) for joint, drive in pairs)
        new = Drives(each)
        weight = torque_weight(self.description.torque_weight, joints, new)
        return replace(self, drives=new, joints=joints, torque_weight=weight)

    def with_torque_limits(self, largest: npt.ArrayLike, weight: npt.ArrayLike | None = None) -> Hand:
        """Return the hand with smaller torque limits, such as those of hot motors.

        Args:
            largest: (n,) largest torques in both directions, N·m, > 0. The limits of the description remain.
            weight: (n,) diagonal of W in the default cost ½ tauᵀ W tau, ≥ 0; unchanged by default.

        Raises:
            InvalidInput: not n numbers in their range.
        """
        limits = arrays.check_array(largest, "largest", (self.n,), above=0.0).tolist()
        pairs = zip(self.joints, limits, strict=True)
        joints = tuple(replace(joint, torque=min(joint.torque, limit)) for joint, limit in pairs)
        if weight is not None:
            weight = arrays.check_array(weight, "weight", (self.n,), minimum=0.0)
        return replace(self, joints=joints, torque_weight=self.torque_weight if weight is None else weight)

    def with_torque_weight(self, kind: descriptions.TorqueWeight) -> Hand:
        """Return the hand with another default cost ½ tauᵀ W tau.

        Args:
            kind: "unit" for least torque, "utilisation" for torques relative to their limits, "copper_loss" for least heat in
                the windings: tauᵀ W tau is the heat in W.

        Raises:
            InvalidInput: another kind, or a drive without resistance or torque constant for the copper loss.
        """
        kind = fields.check_choice(kind, "kind", get_args(descriptions.TorqueWeight))
        return replace(self, torque_weight=torque_weight(kind, self.joints, self.drives))

    def with_tip_offsets(self, offsets: Mapping[str, npt.ArrayLike]) -> Hand:
        """Return the hand with displaced fingertips: a hand that differs from its description by its calibration.

        Args:
            offsets: (3,) displacement of the tip frame of each finger, by name, in the axes of the tip frame, m.

        Raises:
            UnknownName: the hand has no finger of that name.
            InvalidInput: an offset is not three finite numbers.
        """
        frames = {
            self.finger(name).tip: arrays.check_array(offset, f"offsets.{name}", (3,)) for name, offset in offsets.items()
        }
        return replace(self, model=self.model.with_displaced_frames(frames))

    def with_locked_joints(self, positions: Mapping[str, float]) -> Hand:
        """Return the hand with some actuated joints fixed, as if its description locked them.

        Args:
            positions: position of each locked joint by name, rad. Its followers keep their positions, too.

        Raises:
            UnknownName: the hand has no actuated joint of that name.
            InvalidInput: a position is outside the joint's limits, or a finger keeps no joint.
        """
        coordinates = lock_joints(self, positions)
        return replace(self, **vars(coordinates), model=self.model.in_coordinates(coordinates))

    # ── description ────────────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def file(self) -> str:
        """Name of the shipped hand, or path of the description file, from which `Hand.load` loads it."""
        path = self._files.path
        return path.stem if path.parent == descriptions.MODELS_FOLDER else str(path.absolute())

    @property
    def urdf_path(self) -> Path:
        """Path of the URDF file, without the inertias that the description replaces."""
        return self._files.urdf_path

    @property
    def urdf(self) -> Urdf:
        """Links and joints of the URDF, with the inertias of the description."""
        return self._files.urdf

    @property
    def description(self) -> descriptions.HandDescription:
        """The description file, as read."""
        return self._files.description

    @cached_property
    def palm(self) -> str:
        """Name of the last URDF link that carries all fingers: the base, or the link beyond a wrist."""
        model = self.urdf
        chains = [model.chain(finger.tip) for finger in self.fingers if finger.tip in model.links]
        common = [joint for joint in chains[0] if all(joint in chain for chain in chains)]
        if len(chains) == 1:
            common = common[: next(i for i, joint in enumerate(common) if joint.is_moving)]
        return common[-1].child if common else model.root

    def describe(self, q: npt.ArrayLike | None = None) -> JsonRecord:
        """Return a record of the hand: the reply to the key `hands/<hand>`.

        Its field `frames` lists every link of the URDF. Each has its `position` (m) and `rotation` in H at the posture
        `posture`, and in `tip_of` the names of the fingers whose tip frame it is.

        Args:
            q: (n,) joint positions for `frames`, rad; neutral by default.

        Raises:
            InvalidInput: not n finite numbers.
        """
        described = self._files.description
        posture = self.neutral if q is None else self._checked(q)
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
            "friction": self.friction.to_dict(),
            "drives": self.drives.to_list(),
            "couplings": [msgspec.to_builtins(coupling) for coupling in described.couplings],
            "tendons": [tendon.to_dict() for tendon in self.tendons],
            "locked": [msgspec.to_builtins(lock) for lock in described.locked],
            "moving_masses": dict(zip(self.full_joints, self.model.masses(), strict=True)),  # kg, with all fixed links
            "replaced_inertias": [{"link": override.link, "source": override.source} for override in described.inertias],
            "posture": posture.tolist(),
            "frames": [
                {"name": name, "tip_of": [each.name for each in self.fingers if each.tip == name], **pose_to_dict(p, R)}
                for name, (p, R) in self.link_poses(posture).items()
            ],
        }

    def tree(self) -> KinematicTree:
        """Return links and fingertips as plain numbers, with the inertias of the description."""
        return self.model.tree(self.fingers)

    def meshes(self, directories: Sequence[str | os.PathLike[str]] = ()) -> tuple[Mesh, ...]:
        """Return the visual meshes of the URDF.

        Args:
            directories: directories to search for packages or files, before the places of `meshes.find_mesh_file`.

        Raises:
            ModelError: a file is not found; lists the places searched.
        """
        return meshes.visual_meshes(self._files, self.model.carrier_of, directories)

    def tip_mesh(self, finger: str, directories: Sequence[str | os.PathLike[str]] = ()) -> Mesh:
        """Return the collision mesh of a finger's tip link, or its visual mesh if no collision shape is a mesh.

        Args:
            finger: name of the finger.
            directories: as in `meshes`.

        Raises:
            UnknownName: no such finger.
            ModelError: the link has no mesh or more than one, or the file is not found.
        """
        return meshes.contact_mesh(self._files, self.finger(finger).tip, self.model.carrier_of, directories)

    # ── dynamics ───────────────────────────────────────────────────────────────────────────────────────────────────────────

    def mass_matrix(self, q: npt.ArrayLike) -> Array:
        """Return the joint-space mass matrix M = Tᵀ M_full T + D.

        Args:
            q: (n,) joint positions, rad.

        Returns:
            (n, n), kg·m².
        """
        return freeze(self.model.mass_matrix(self._checked(q)))

    def gravity_torque(self, q: npt.ArrayLike, gravity_H: npt.ArrayLike = GRAVITY_PALM_UP) -> Array:
        """Return the motor torques g(q) that hold the hand against gravity: the gradient of the potential energy.

        Args:
            q: (n,) joint positions, rad.
            gravity_H: (3,) acceleration of gravity in H, m/s².

        Returns:
            (n,), N·m.
        """
        return freeze(self.model.gravity_torque(self._checked(q), arrays.check_array(gravity_H, "gravity_H", (3,))))

    def inverse_dynamics(
        self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike, gravity_H: npt.ArrayLike = GRAVITY_PALM_UP
    ) -> Array:
        """Return the motor torques of a motion without contact, M(q) a + c(q, v) + g(q).

        Args:
            q: (n,) joint positions, rad.
            v: (n,) joint rates, rad/s.
            a: (n,) joint accelerations, rad/s².
            gravity_H: (3,) acceleration of gravity in H, m/s².

        Returns:
            (n,), N·m.
        """
        v, a = arrays.check_array(v, "v", (self.n,)), arrays.check_array(a, "a", (self.n,))
        gravity_H = arrays.check_array(gravity_H, "gravity_H", (3,))
        return freeze(self.model.inverse_dynamics(self._checked(q), v, a, gravity_H))

    def inverse_dynamics_along(
        self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike, gravity_H: npt.ArrayLike = GRAVITY_PALM_UP
    ) -> Array:
        """Return `inverse_dynamics` in K states.

        Args:
            q: (K, n) joint positions, rad.
            v: (K, n) joint rates, rad/s.
            a: (K, n) joint accelerations, rad/s².
            gravity_H: (3,) acceleration of gravity in H, m/s².

        Returns:
            (K, n), N·m.
        """
        q = self._checked_along(q)
        v, a = arrays.check_array(v, "v", q.shape), arrays.check_array(a, "a", q.shape)
        return self.model.inverse_dynamics(q, v, a, arrays.check_array(gravity_H, "gravity_H", (3,)))

    def energy(self, q: npt.ArrayLike, v: npt.ArrayLike, gravity_H: npt.ArrayLike = GRAVITY_PALM_UP) -> tuple[float, float]:
        """Return the kinetic energy ½ vᵀ M v and the potential energy, which is zero for masses at H's origin.

        Args:
            q: (n,) joint positions, rad.
            v: (n,) joint rates, rad/s.
            gravity_H: (3,) acceleration of gravity in H, m/s².

        Returns:
            Both energies, J.
        """
        v = arrays.check_array(v, "v", (self.n,))
        return self.model.energy(self._checked(q), v, arrays.check_array(gravity_H, "gravity_H", (3,)))

    def actuation(
        self,
        q: npt.ArrayLike,
        fingers: Sequence[str],
        contacts: ContactSet,
        p_HO: npt.ArrayLike,
        R_HO: npt.ArrayLike,
        *,
        tau_u: npt.ArrayLike | None = None,
        gravity_H: npt.ArrayLike = GRAVITY_PALM_UP,
    ) -> Actuation:
        """Return the actuation of a force problem: J, tau_u, the torque limits and the weight of the cost.

        At rest, gears that cannot be driven back hold the load up to their own limits, at little cost.

        Args:
            q: (n,) joint positions, rad.
            fingers: name of the finger at each contact, or of the link that touches.
            contacts: the N contacts, in O.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.
            tau_u: (n,) motor torques without contact, N·m, such as `inverse_dynamics` of a motion; by default the torques at
                rest under `gravity_H`.
            gravity_H: (3,) acceleration of gravity in H, m/s²; not used if `tau_u` is given.
        """
        J = self.contact_jacobian(q, fingers, contacts, p_HO, R_HO)
        if tau_u is None:
            tau_u = self.inverse_dynamics(q, np.zeros(self.n), np.zeros(self.n), gravity_H)
            limit = self.rest_torque_limit
            return Actuation(J, tau_u, -limit, limit, self.rest_torque_weight)
        return Actuation(J, tau_u, self.torque_lower, self.torque_upper, self.force_weight)

    def _table(self) -> Table:
        position, torque = " or ".join(self.position_units), " or ".join(self.torque_units)
        header = ("finger", "joint", f"from {position}", f"to {position}", f"{position}/s", torque)
        rows, last = [], ""
        for joint in self.joints:
            numbers = (f"{x:.4g}" for x in (joint.lower, joint.upper, joint.velocity, joint.torque))
            rows.append((joint.finger if joint.finger != last else "", joint.name, *numbers))
            last = joint.finger
        return Table(header, tuple(rows), f"{self.name}: {self.title}")

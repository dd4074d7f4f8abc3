"""Kinematics of a hand: poses, Jacobians and inverse kinematics, of one posture and of many.

Frames: H hand base (the URDF's root link), O object, F tip frame of a finger, C contact. Twists are linear first. This module
checks its arguments; `coupled_model` computes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import contact_jacobians
from graspforce.contact.motion import TipMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.hand.kinematics import inverse_kinematics
from graspforce.hand.kinematics.coordinates import JointCoordinates
from graspforce.hand.kinematics.coupled_model import CoupledModel
from graspforce.hand.kinematics.three_joint_arm import find_three_joint_arm


@dataclass(frozen=True, eq=False, repr=False)
class HandKinematics(JointCoordinates):
    """The kinematics of a hand in its actuated coordinates.

    Attributes:
        model: the same computations without checks of the arguments, for inner loops.
    """

    model: CoupledModel

    def frame_id(self, finger: str) -> int:
        """Return the index of a finger's tip frame in `model`.

        Args:
            finger: name of the finger.

        Raises:
            UnknownName: no such finger.
        """
        return self._tip_frames[self.finger(finger).name]

    def contact_frame_id(self, name: str, field: str = "link") -> int:
        """Return the index in `model` of the frame that a contact is fixed to.

        Args:
            name: name of a finger, for its tip, or of any link of the URDF, such as an inner link or the palm.
            field: path of the name, for error messages.

        Raises:
            UnknownName: neither a finger nor a link; lists both.
        """
        frame = self._tip_frames.get(name, self._link_frames.get(name))
        if frame is None:
            raise UnknownName(field, name, [*self._tip_frames, *self._link_frames])
        return frame

    def link_poses(self, q: npt.ArrayLike) -> dict[str, tuple[Array, Array]]:
        """Return the poses of all links of the URDF, the base and the tip frames included.

        Args:
            q: (n,) joint positions, rad.

        Returns:
            For each link its position p_HL (3,), m, and its axes R_HL (3, 3), in H.
        """
        return {name: (freeze(p), freeze(R)) for name, (p, R) in self.model.link_poses(self._checked(q)).items()}

    def tip_pose(self, q: npt.ArrayLike, finger: str) -> tuple[Array, Array]:
        """Return the pose of a finger's tip frame F in H.

        Args:
            q: (n,) joint positions, rad.
            finger: name of the finger.

        Returns:
            p_HF (3,), m, and R_HF (3, 3), whose columns are F's axes in H.
        """
        p_HF, R_HF = self.model.frame_pose(self._checked(q), self.frame_id(finger))
        return freeze(p_HF), freeze(R_HF)

    def point_jacobian(self, q: npt.ArrayLike, finger: str, p_H: npt.ArrayLike) -> Array:
        """Return the Jacobian of the twist at a point that is fixed to a finger's last link.

        Args:
            q: (n,) joint positions, rad.
            finger: name of the finger.
            p_H: (3,) current position of the point in H, m.

        Returns:
            (6, n) in H's axes: velocity of the point, m/rad, and angular velocity.
        """
        p_H = arrays.check_array(p_H, "p_H", (3,))
        return freeze(self.model.point_jacobians(self._checked(q)[None], [self.frame_id(finger)], p_H[None, None])[0, 0])

    def contact_jacobian(
        self, q: npt.ArrayLike, fingers: Sequence[str], contacts: ContactSet, p_HO: npt.ArrayLike, R_HO: npt.ArrayLike
    ) -> Array:
        """Return the hand Jacobian J: J v are the fingers' velocities at the contacts, in the rows of the stacked forces f.

            J = H_c [R_OCᵀ R_HOᵀ J_v; nᵀ J_ω]

        J_v and J_ω are the Jacobians of the finger's velocity at the contact and of its angular velocity. H_c selects the
        components of the contact model. The motors balance f with tau = Jᵀ f. Source: Al-Gallaf, equation (16); Murray, Li
        and Sastry (1994), chapter 5.

        Args:
            q: (n,) joint positions, rad.
            fingers: name of the finger at each contact, or of the link that touches; names may repeat.
            contacts: the N contacts, in O.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.

        Returns:
            (k, n), m/rad; 1 in the rows of moments.
        """
        p_HO, R_HO = _check_grasp_pose(fingers, contacts, p_HO, R_HO)
        return freeze(self._contact_jacobians(self._checked(q)[None], fingers, contacts, p_HO[None], R_HO[None])[0])

    def tip_motion(self, q: npt.ArrayLike, v: npt.ArrayLike, fingers: Sequence[str]) -> TipMotion:
        """Return poses, Jacobians, twists and drifts of fingertips, in one pass over the joints.

        The drift is J̇ v: the classical acceleration of the tip frame for v̇ = 0. The coupling T is constant and adds nothing.

        Args:
            q: (n,) joint positions, rad.
            v: (n,) joint rates, rad/s.
            fingers: names of the fingers.
        """
        frames = [self.frame_id(name) for name in fingers]
        return self.model.tip_motion(self._checked(q), arrays.check_array(v, "v", (self.n,)), frames)

    # ── inverse ────────────────────────────────────────────────────────────────────────────────────────────────────────────

    def inverse_kinematics(self, finger: str, p_H: npt.ArrayLike, q_start: npt.ArrayLike | None = None) -> Array:
        """Return the joint positions of one finger for a position of its tip frame, within the joint limits.

        Damped Newton steps on the finger's actuated joints start from `q_start`, then from the postures of a closed form if
        the finger has three joints, from the neutral posture and from random postures. The first posture that reaches the
        point is the result. To follow a path without jumps, start from the previous posture.

        Args:
            finger: name of the finger.
            p_H: (3,) target of the tip frame's origin in H, m.
            q_start: (n,) posture to start from, rad; neutral by default.

        Returns:
            (m,) joint positions in the order of the finger's `joints`, rad.

        Raises:
            InvalidInput: the point is out of reach; gives the nearest point found.
        """
        q_start = self.neutral if q_start is None else arrays.check_array(q_start, "q_start", (self.n,))
        return self._reach(finger, self.finger(finger).joints, arrays.check_array(p_H, "p_H", (3,)), q_start)

    def _reach(self, finger: str, joints: Sequence[int], p_H: Array, q_start: Array, place: str = "p_H") -> Array:
        """Return the positions (m,) of some joints of a finger for a position p_H of its tip frame; others keep q_start.

        Raises:
            InvalidInput: p_H is out of reach; names it by `place`.
        """
        chosen, q = list(joints), np.array(q_start)
        frame_id = self.frame_id(finger)

        def tip(q_finger: Array) -> tuple[Array, Array]:
            q[chosen] = q_finger
            p, J = self.model.frame_jacobians(q[None], [frame_id])
            return p[0, 0], J[0, 0, :3, chosen].T

        start = q[chosen]  # a copy: `tip` writes to q
        starts = chain([start], self._closed_form_postures(finger, chosen, p_H, q_start), [self.neutral[chosen]])
        result = inverse_kinematics.solve(tip, p_H, self.q_lower[chosen], self.q_upper[chosen], starts)
        if result.distance > inverse_kinematics.REACH_TOLERANCE:
            near = ", ".join(f"{x:.4f}" for x in result.p)
            allowed = f"within reach of {finger}: the nearest point found is [{near}], {1e3 * result.distance:.2f} mm away"
            raise InvalidInput(place, p_H, allowed)
        return freeze(result.q)

    def _closed_form_postures(self, finger: str, joints: list[int], p_H: Array, q_start: Array) -> Iterator[Array]:
        """Yield postures (3,) of a finger with three joints that reach a point, in closed form; see `ThreeJointArm`."""
        frame_id, q = self.frame_id(finger), np.array(q_start)

        def tip(q_finger: Array) -> tuple[Array, Array]:
            q[joints] = q_finger
            p, J = self.model.frame_jacobians(q[None], [frame_id])
            return p[0, 0], J[0, 0][:, joints]

        lower, upper = self.q_lower[joints], self.q_upper[joints]
        arm = find_three_joint_arm(tip, (lower + upper) / 2.0)
        yield from [] if arm is None else arm.postures(p_H, lower, upper)

    def grasp_posture(
        self,
        fingers: Sequence[str],
        contacts: ContactSet,
        p_HO: npt.ArrayLike,
        R_HO: npt.ArrayLike,
        q_start: npt.ArrayLike | None = None,
    ) -> Array:
        """Return the posture in which fingers touch an object at contacts.

        A spherical tip of radius r touches with the centre at p_HO + R_HO (p_OC − r n), n the inward normal. A tip without
        radius has its tip frame at the contact. Other fingers keep their start, and so do joints that move several of the
        named fingers, such as a wrist.

        Args:
            fingers: name of the finger at each contact, each once.
            contacts: the N contacts, in O.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.
            q_start: (n,) posture to start from, rad; neutral by default.

        Returns:
            (n,) joint positions, rad.

        Raises:
            InvalidInput: a contact is out of its finger's reach, or a finger is named twice.
        """
        p_HO, R_HO = _check_grasp_pose(fingers, contacts, p_HO, R_HO)
        if len(set(fingers)) < len(fingers):
            raise InvalidInput("fingers", fingers, "different fingers: a tip has one contact")
        radii = np.array([self.finger(name).tip_radius or 0.0 for name in fingers])  # m
        centres = contacts.p_OC - radii[:, None] * contacts.R_OC[:, :, 2]  # m, in O
        places = [f"contacts[{i}].p_H" for i in range(len(fingers))]
        return self._posture(fingers, p_HO + centres @ R_HO.T, q_start, places)

    def tip_posture(self, tips: Mapping[str, npt.ArrayLike], q_start: npt.ArrayLike | None = None) -> Array:
        """Return the posture in which the tip frames of fingers are at given positions.

        Other fingers keep their start, and so do joints that move several of the named fingers, such as a wrist.

        Args:
            tips: for each finger the (3,) target of its tip frame's origin in H, m.
            q_start: (n,) posture to start from, rad; neutral by default.

        Returns:
            (n,) joint positions, rad.

        Raises:
            InvalidInput: a target is out of its finger's reach; gives the nearest point found.
            UnknownName: no such finger.
        """
        fingers = [self.finger(name).name for name in tips]
        places = [f"tips.{name}" for name in fingers]
        targets = [arrays.check_array(p, place, (3,)) for p, place in zip(tips.values(), places, strict=True)]
        return self._posture(fingers, targets, q_start, places)

    def _posture(
        self, fingers: Sequence[str], targets: Array | Sequence[Array], q_start: npt.ArrayLike | None, places: Sequence[str]
    ) -> Array:
        """Return a posture in which tip frames are at targets, (3,) in H, m; `places` names them in errors."""
        q = np.array(self.neutral if q_start is None else arrays.check_array(q_start, "q_start", (self.n,)))
        moved = [j for name in fingers for j in self.finger(name).joints]
        for name, p_H, place in zip(fingers, targets, places, strict=True):
            own = [j for j in self.finger(name).joints if moved.count(j) == 1]
            q[own] = self._reach(name, own, p_H, q, place)
        return freeze(q)

    # ── many postures ──────────────────────────────────────────────────────────────────────────────────────────────────────

    def tips_along(self, q: npt.ArrayLike, fingers: Sequence[str]) -> tuple[Array, Array]:
        """Return positions and Jacobians of fingertips in K postures.

        Args:
            q: (K, n) joint positions, rad.
            fingers: names of F fingers.

        Returns:
            p_HF (K, F, 3), m, and the Jacobians (K, F, 3, n) of the tip frames' origins, in H, m/rad.
        """
        p, J = self.model.frame_jacobians(self._checked_along(q), [self.frame_id(finger) for finger in fingers])
        return p, J[:, :, :3]

    def contact_jacobian_along(
        self, q: npt.ArrayLike, fingers: Sequence[str], contacts: ContactSet, p_HO: npt.ArrayLike, R_HO: npt.ArrayLike
    ) -> Array:
        """Return `contact_jacobian` in K postures.

        Args:
            q: (K, n) joint positions, rad.
            fingers: name of the finger at each contact.
            contacts: the N contacts, in O.
            p_HO: (K, 3) positions of the object in H, m.
            R_HO: (K, 3, 3) axes of the object in H.

        Returns:
            (K, k, n), m/rad; 1 in the rows of moments.
        """
        q = self._checked_along(q)
        p_HO, R_HO = arrays.check_array(p_HO, "p_HO", (len(q), 3)), arrays.check_array(R_HO, "R_HO", (len(q), 3, 3))
        return self._contact_jacobians(q, fingers, contacts, p_HO, R_HO)

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    @cached_property
    def _tip_frames(self) -> dict[str, int]:
        return {finger.name: self.model.frame_id(finger.tip) for finger in self.fingers}

    @cached_property
    def _link_frames(self) -> dict[str, int]:
        return {link: self.model.frame_id(link) for link in self.model.link_poses(np.zeros(self.model.T.shape[1]))}

    def _checked(self, q: npt.ArrayLike) -> Array:
        return arrays.check_array(q, "q", (self.n,))

    def _checked_along(self, q: npt.ArrayLike) -> Array:
        return arrays.check_array(q, "q", (None, self.n))

    def _contact_jacobians(self, q: Array, fingers: Sequence[str], contacts: ContactSet, p_HO: Array, R_HO: Array) -> Array:
        """Return `contact_jacobian` in K postures, (K, k, n), without checks."""
        p_H = p_HO[:, None] + contacts.p_OC @ R_HO.transpose(0, 2, 1)  # m
        twists = self.model.point_jacobians(q, [self.contact_frame_id(name) for name in fingers], p_H)
        return contact_jacobians(contacts, twists, R_HO, contacts.R_OC)


def _check_grasp_pose(
    fingers: Sequence[str], contacts: ContactSet, p_HO: npt.ArrayLike, R_HO: npt.ArrayLike
) -> tuple[Array, Array]:
    """Return the pose of an object, checked, and check that there is one finger name for each contact.

    Args:
        fingers: name of the finger at each contact.
        contacts: the N contacts.
        p_HO: (3,) position of the object in H, m.
        R_HO: (3, 3) axes of the object in H, a rotation to within rounding.
    """
    if isinstance(fingers, str) or len(fingers) != len(contacts):
        raise InvalidInput("fingers", fingers, f"a list of {len(contacts)} finger names, one for each contact")
    return arrays.check_array(p_HO, "p_HO", (3,)), arrays.check_rotation(R_HO, "R_HO")

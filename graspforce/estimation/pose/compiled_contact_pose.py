"""Pose from the contacts in C (`csrc/include/graspforce/contact_pose.h`), for an object whose shape it supports.

`contact_pose.ContactPoseTracker` is the reference implementation. The C code writes a pose to one block of memory, which the
next step reads. Fields that are seldom needed become arrays at their first access.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from graspforce.contact.compiled_kinematics import primitive_parameters
from graspforce.contact.kinematics import TipContactState
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block, native, new_block
from graspforce.estimation.pose.contact_pose import (
    ARM,
    FREE,
    ContactPose,
    ContactPoseTracker,
    ContactReference,
    PoseUncertainty,
)
from graspforce.grasp.grasp import Grasp


def make_tracker(grasp: Grasp, period: float) -> ContactPoseTracker:
    """Return a tracker of the object's pose: compiled if possible, the reference implementation elsewhere.

    Args:
        grasp: hand, object and contacts.
        period: time between two steps, s.
    """
    if native is None or primitive_parameters(grasp.body.shape) is None:
        return ContactPoseTracker(grasp, period)
    return CompiledTracker(grasp, period)


def _block_field(name: str) -> cached_property[Array]:
    """Return a field of the block that becomes an array at its first access."""
    return cached_property(lambda pose: pose.block[name])


class CompiledContactPose(ContactPose):
    """Pose in the block that the C code wrote.

    Attributes:
        block: all fields of the pose.
        arms: (N, 1) 30 mm for contacts with torsional friction, zero for the others.
    """

    block: Block
    arms: Array
    R_OC, spin = _block_field("R_OC"), _block_field("spin")
    tip_contacts = cached_property(lambda pose: TipContactState(pose.block["p_OF"], pose.block["R_OF"], pose.block["p_OC"]))
    A = cached_property(lambda pose: _with_spins(pose.block["A"], pose.arms * pose.block["spin_A"]))
    B = cached_property(lambda pose: _with_spins(pose.block["B"], pose.arms * pose.block["spin_B"]))

    def __init__(self, block: Block, arms: Array) -> None:
        block.setflags(write=False)
        vars(self).update(
            block=block,
            arms=arms,
            p_HO=block["p_HO"],
            R_HO=block["R_HO"],
            twist=block["twist"],
            slip=block["slip"],
            gap=block["gap"],
        )


class CompiledTracker(ContactPoseTracker):
    """Tracks the pose of the object in a grasp by compiled code.

    Args:
        grasp: hand, object and contacts. The C code supports the object's shape.
        period: time between two steps, s.
    """

    def __init__(self, grasp: Grasp, period: float) -> None:
        super().__init__(grasp, period)
        hand, contacts = grasp.hand, grasp.contacts
        tips = [hand.finger(name).tip for name in grasp.fingers]
        links, p_LF, R_LF = zip(*(hand.model.carrier_of(tip) for tip in tips), strict=True)
        T = hand.model.T
        self._surface = primitive_parameters(grasp.body.shape)
        self._tip_links = np.array(links, dtype=np.intc) + 1  # the model counts links after the base
        self._moves_tip = np.array([hand.model.joints_moving(tip) for tip in tips], dtype=np.bool_)
        self._model, self._arms = hand.model, ARM * self._has_torsion[:, None]
        self._numbers = new_block(np.dtype(native.tracked_grasp_layout(len(contacts), hand.n, len(T))))
        values = {"period": period, "least_eigenvalue": FREE * len(contacts), "radii": self._radii, "p_OC": contacts.p_OC}
        values |= {"R_OC": contacts.R_OC, "p_LF": p_LF, "R_LF": R_LF, "T": T}
        for name, value in values.items():
            self._numbers[name] = value
        self._dtype: np.dtype[np.void] = np.dtype(native.contact_pose_layout(len(contacts), hand.n))

    def start(self, q: Array, encoder_variance: float, contact_error: float) -> tuple[ContactPose, ContactReference]:
        """Return the pose at the start and the reference of the contacts; see `ContactPoseTracker.start`.

        Args:
            q: (n,) joint positions, rad.
            encoder_variance: variance of each joint position, rad².
            contact_error: standard deviation of the coordinates of the contacts, m.
        """
        pose, reference = super().start(q, encoder_variance, contact_error)
        return self._compiled(pose), reference

    def restart(
        self, last: ContactPose, p_HO: Array, R_HO: Array, q: Array, joint_variance: float
    ) -> tuple[ContactPose, ContactReference]:
        """Return another pose at the same instant, and its reference; see `ContactPoseTracker.restart`.

        Args:
            last: pose before.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.
            q: (n,) joint positions, rad.
            joint_variance: variance of each joint position, rad².
        """
        pose, reference = super().restart(last, p_HO, R_HO, q, joint_variance)
        return self._compiled(pose), reference

    def _with_slip(self, pose: ContactPose, slip: Array, spin: Array) -> CompiledContactPose:
        """Return a pose with another slip (N, 2), m, and spin (N,), rad."""
        assert isinstance(pose, CompiledContactPose)  # `start` and `step` make no other
        block = pose.block.copy()
        block["slip"], block["spin"] = slip, spin
        return CompiledContactPose(block, self._arms)

    def _compiled(self, pose: ContactPose) -> CompiledContactPose:
        """Return a pose of the reference implementation in a block."""
        block, count = new_block(self._dtype), len(self._radii)
        for name in ("p_HO", "R_HO", "twist", "slip", "spin", "R_OC", "gap"):
            block[name] = getattr(pose, name)
        for name in ("p_OF", "R_OF", "p_OC"):
            block[name] = getattr(pose.tip_contacts, name)
        for name, rows in (("A", pose.A), ("B", pose.B)):
            by_contact = rows.reshape(count, 4, -1)
            block[name] = by_contact[:, :3].reshape(3 * count, -1)
            block[f"spin_{name}"] = by_contact[:, 3] / ARM
        return CompiledContactPose(block, self._arms)

    def step(self, last: ContactPose, reference: ContactReference, q: Array, v: Array, weights: Array) -> ContactPose:
        """Return the pose after a period; see `ContactPoseTracker.step`.

        Args:
            last: pose of the last period, of this tracker.
            reference: reference of the contacts.
            q: (n,) joint positions, rad.
            v: (n,) joint rates, rad/s.
            weights: (N, 4) weights of the residuals along t₁, t₂ and n, and about n.
        """
        assert isinstance(last, CompiledContactPose)  # `start` makes no other
        motion = self._model.link_motion(q, v)
        block = new_block(self._dtype)
        iterations = native.track_contacts(
            surface=self._surface,
            tip_links=self._tip_links,
            moves_tip=self._moves_tip,
            grasp=self._numbers,
            v=v,
            joint_twists=motion.J,
            joint_twist_rates=motion.J_rate,
            link_poses=motion.link_poses,
            gap=reference.gap,
            weights=weights,
            last=last.block,
            next=block,
        )
        return CompiledContactPose(block, self._arms) if iterations > 0 else last  # numbers overflowed

    def uncertainty(
        self, pose: ContactPose, reference: ContactReference, joint_variance: float, contact_noise: float
    ) -> PoseUncertainty:
        """Return the uncertainty of the pose; see `ContactPoseTracker.uncertainty`.

        Args:
            pose: the pose, of this tracker.
            reference: reference of the contacts.
            joint_variance: variance of each estimated joint position, rad².
            contact_noise: standard deviation of each momentary residual, m.
        """
        assert isinstance(pose, CompiledContactPose)  # `start` and `step` make no other
        covariance, free_motions = np.empty((6, 6)), np.empty((6, 6))
        is_finite = native.pose_uncertainty(
            motor_count=self._model.T.shape[1],
            least_eigenvalue=FREE * len(self._radii),
            joint_variance=joint_variance,
            contact_variance=contact_noise**2,
            weights=self.weights,
            reference=reference.covariance,
            pose=pose.block,
            covariance=covariance,
            free_motions=free_motions,
        )
        if not is_finite:  # numbers overflowed
            return super().uncertainty(pose, reference, joint_variance, contact_noise)
        return PoseUncertainty(covariance, free_motions)


def _with_spins(points: Array, spins: Array) -> Array:
    """Return the rows of each contact along t₁, t₂ and n (3 N, w), followed by that of its spin (N, w)."""
    count, width = spins.shape
    rows = np.empty((count, 4, width))
    rows[:, :3], rows[:, 3] = points.reshape(count, 3, width), spins
    return rows.reshape(-1, width)

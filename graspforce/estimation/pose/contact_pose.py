"""Pose and twist of the held object from the fingertips, whose contacts roll without slip.

The pose T_HO keeps what the contacts have kept since the start of the grasp. For each contact i, in its frame C,

    s_i = 0      the accumulated slip along t₁ and t₂ (`contact.kinematics.slip_displacement_reference`),
    g_i = g₀     the gap, along n,
    σ_i = 0      the accumulated spin of the finger about n, for contacts with torsional friction.

A change ξ of the pose, a twist in O, changes these residuals r = (s, g₀ − g, σ) by −B ξ. A period's change is a few degrees at
most, so one Gauss–Newton step from the predicted pose is enough:

    ξ = (Bᵀ W B)⁺ Bᵀ W r.

Slip is a displacement, computed from poses and accumulated, so errors of a step do not add up. It is the mean of two
separations: of the material points that touched before, and of those that touch now. In rolling with spin, this mean is zero to
third order in the step.

The twist V of the object is the one that fits the velocities A v of the fingers best: V = (Bᵀ W B)⁺ Bᵀ W A v. The
pseudo-inverse treats small eigenvalues as zero. So along motions that the contacts leave free, the object is at rest.

At the start, pose and posture are given. Their residuals come from errors of the contacts, which stay, and from encoder noise,
which does not. Their expected parts follow from the variances: o = C (C + A Σ_q Aᵀ)⁻¹ r with the covariance C of the contacts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.contact.compiled_kinematics import rolling_contacts, slip_displacement
from graspforce.contact.kinematics import RollingContacts, TipContactState
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array, freeze
from graspforce.core.records import unchecked_constructor
from graspforce.geometry.rotations import rotation_exp, rotation_log
from graspforce.grasp.grasp import Grasp

ARM = 0.03  # m: converts angles to displacements at this distance, the radius of a small object
FREE = 1e-3  # eigenvalues of Bᵀ W B / N below this belong to motions that the contacts leave free: errors would grow 30-fold
_CLOSE = 1e-4  # m: a correction of this size has an error of its square over the radius of a fingertip, about 1 µm
_MAX_ITERATIONS = 10  # only after gaps in the measurements
_ZERO_TWIST = freeze(np.zeros(6))
_make_motion = unchecked_constructor(BodyMotion)

_UNIT = np.array([1.0, 1.0, 1.0, 1.0 / ARM, 1.0 / ARM, 1.0 / ARM])  # twist per displacement, for scaling


@dataclass(frozen=True, eq=False)
class ContactPose:
    """Pose of an object that follows from the fingertips at one instant, and the state of the contacts.

    Attributes:
        p_HO: (3,) position of the object in H, m.
        R_HO: (3, 3) axes of the object in H.
        twist: (6,) velocity of the origin, m/s, and angular velocity, rad/s, in H.
        R_OC: (N, 3, 3) contact frames in O.
        tip_contacts: poses of the fingertips on the object.
        slip: (N, 2) slip of each fingertip along t₁ and t₂ since the start that no motion of the object explains, m.
        spin: (N,) the same for the spin about n, rad; zero for contacts without torsional friction.
        gap: (N,) distances of the fingertips from the surface, m; negative in penetration.
        A: (4 N, n) joint rates to the velocities of the fingers along t₁, t₂ and n, and their spins at 30 mm, in m/rad. The
            spins of contacts without torsional friction are zero.
        B: (4 N, 6) twist of the object in O to the same velocities of the object.
    """

    p_HO: Array
    R_HO: Array
    twist: Array
    R_OC: Array
    tip_contacts: TipContactState
    slip: Array
    spin: Array
    gap: Array
    A: Array
    B: Array

    @property
    def motion(self) -> BodyMotion:
        """Pose and twist of the object in H; the acceleration is zero."""
        return _make_motion(self.p_HO, self.R_HO, self.twist, _ZERO_TWIST)


class ContactStart(NamedTuple):
    """Residuals at the start of the grasp.

    Attributes:
        q: (n,) joint positions for which they were computed, rad.
        r: (4 N,) residuals at the pose of the grasp, m.
        A: (4 N, n) joint rates to the velocities of the fingers, as in `ContactPose`.
        offset: (4 N,) part of the residuals that counts as error of the contacts, m.
    """

    q: Array
    r: Array
    A: Array
    offset: Array


class ContactReference(NamedTuple):
    """Gaps of the contacts at the start of the grasp, and the covariance of the start.

    Attributes:
        gap: (N,) gap g₀ of each fingertip that counts as touching, m.
        covariance: (4 N, 4 N) covariance of the errors that the residuals keep from the start, m².
        start: residuals at the start; None if the contacts started anew since.
    """

    gap: Array
    covariance: Array
    start: ContactStart | None = None


class PoseUncertainty(NamedTuple):
    """Uncertainty of a pose from the contacts, in O.

    Attributes:
        covariance: (6, 6) covariance of p, m², and of the rotation vector, rad², from noise.
        free_motions: (6, f) unit displacements that the contacts leave free, as `ContactPoseTracker.free_motions`. Other
            matrices F with the same F Fᵀ may stand for them.
    """

    covariance: Array
    free_motions: Array


class ContactPoseTracker:
    """Tracks the pose of the object in a grasp.

    Args:
        grasp: hand, object and contacts.
        period: time between two steps, s.
    """

    def __init__(self, grasp: Grasp, period: float) -> None:
        hand, contacts = grasp.hand, grasp.contacts
        self._grasp, self._period = grasp, period
        self._radii = np.array([hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])  # m
        self._tips = [hand.frame_id(name) for name in grasp.fingers]
        has_friction = (contacts.mu > 0.0).astype(np.float64)
        self._has_torsion = (contacts.gamma > 0.0).astype(np.float64)
        self.weights = freeze(np.column_stack([has_friction, has_friction, np.ones(len(contacts)), self._has_torsion]))

    def start(self, q: Array, encoder_variance: float, contact_error: float) -> tuple[ContactPose, ContactReference]:
        """Return the pose at the start, which is the grasp's, and the reference of the contacts.

        Args:
            q: (n,) joint positions, rad.
            encoder_variance: variance of each joint position, rad².
            contact_error: standard deviation of the coordinates of the contacts, m.
        """
        grasp, contacts = self._grasp, self._grasp.contacts
        motion = BodyMotion(grasp.p_HO, grasp.R_HO)
        rolling = self._contacts(motion.p_HO, motion.R_HO, q, np.zeros(len(q)), contacts.R_OC)
        A, B = self._rows(rolling)
        count = len(contacts)
        centres = contacts.p_OC - self._radii[:, None] * contacts.R_OC[:, :, 2]  # m, in O: of tips that touch at the contacts
        r = np.zeros((count, 4))
        r[:, :2] = ((rolling.tip_contacts.p_OF - centres)[:, None, :] @ rolling.R_OC[:, :, :2])[:, 0]
        r[:, 2] = -rolling.gap
        offset, covariance = _contact_offset(r.ravel(), A, encoder_variance, contact_error)
        pose = ContactPose(
            motion.p_HO, motion.R_HO, _ZERO_TWIST, rolling.R_OC, rolling.tip_contacts,
            freeze((r.ravel() - offset).reshape(-1, 4)[:, :2]), freeze(np.zeros(count)), rolling.gap, A, B,
        )  # fmt: skip
        return pose, ContactReference(freeze(-offset[2::4]), covariance, ContactStart(np.array(q), r.ravel(), A, offset))

    def improve_start(
        self, pose: ContactPose, reference: ContactReference, q: Array, encoder_variance: float, contact_error: float
    ) -> tuple[ContactPose, ContactReference]:
        """Return pose and reference after a better estimate of the joint positions at the start.

        The pose itself stays until the next step.

        Args:
            pose: the present pose.
            reference: reference with the residuals at the start.
            q: (n,) joint positions at the start, rad.
            encoder_variance: variance of each of them, rad².
            contact_error: standard deviation of the coordinates of the contacts, m.
        """
        start = reference.start
        assert start is not None  # the caller checks it
        r = start.r + start.A.dot(q - start.q)
        offset, covariance = _contact_offset(r, start.A, encoder_variance, contact_error)
        change = (offset - start.offset).reshape(-1, 4)
        turned = start.A[3::4].dot(q - start.q) / ARM  # rad
        reference = ContactReference(freeze(-offset[2::4]), covariance, start._replace(q=q, r=r, offset=offset))
        return self._with_slip(pose, freeze(pose.slip - change[:, :2]), freeze(pose.spin - turned)), reference

    def restart(
        self, last: ContactPose, p_HO: Array, R_HO: Array, q: Array, joint_variance: float
    ) -> tuple[ContactPose, ContactReference]:
        """Return another pose at the same instant, from which the contacts start anew, and their reference.

        Args:
            last: pose before.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.
            q: (n,) joint positions, rad.
            joint_variance: variance of each joint position, rad².
        """
        frames = R_HO.T @ last.R_HO @ last.R_OC  # the contact frames keep their directions in H
        rolling = self._contacts(p_HO, R_HO, q, np.zeros(len(q)), frames)
        A, B = self._rows(rolling)
        count = len(self._radii)
        pose = ContactPose(
            freeze(p_HO), freeze(R_HO), last.twist, rolling.R_OC, rolling.tip_contacts,
            freeze(np.zeros((count, 2))), freeze(np.zeros(count)), rolling.gap, A, B,
        )  # fmt: skip
        return pose, ContactReference(rolling.gap, freeze(joint_variance * A @ A.T))

    def step(self, last: ContactPose, reference: ContactReference, q: Array, v: Array, weights: Array) -> ContactPose:
        """Return the pose after a period.

        Args:
            last: pose of the last period.
            reference: reference of the contacts.
            q: (n,) joint positions, rad.
            v: (n,) joint rates, rad/s.
            weights: (N, 4) weights of the residuals along t₁, t₂ and n, and about n; `weights` of this object by default. With
                zero weight a residual starts anew.
        """
        twist_O = (last.twist.reshape(2, 3) @ last.R_HO).ravel()
        p, R = _moved(last.p_HO, last.R_HO, self._period * twist_O)
        slip, spin = last.slip * (weights[:, :2] > 0.0), last.spin * (weights[:, 3] > 0.0)
        w = weights.ravel()
        for _ in range(_MAX_ITERATIONS):
            rolling = self._contacts(p, R, q, v, last.R_OC)
            _, B = self._rows(rolling)
            r = self._residuals(last, rolling, reference.gap, slip, spin)
            xi = self._gain(B, w) @ r.ravel()  # m and rad, in O
            p, R = _moved(p, R, xi)
            if np.abs(xi / _UNIT).max() <= _CLOSE:
                break
        rolling = self._contacts(p, R, q, v, last.R_OC)
        A, B = self._rows(rolling)
        r = self._residuals(last, rolling, reference.gap, slip, spin)
        twist = (self._gain(B, w) @ (A @ v)).reshape(2, 3) @ R.T
        kept = weights > 0.0
        return ContactPose(
            freeze(p), freeze(R), freeze(twist.ravel()), rolling.R_OC, rolling.tip_contacts,
            freeze(r[:, :2] * kept[:, :2]), freeze(r[:, 3] / ARM * kept[:, 3]), rolling.gap, A, B,
        )  # fmt: skip

    def reduced_weights(self, slipping: npt.NDArray[np.bool_], apart: npt.NDArray[np.bool_]) -> Array:
        """Return the (N, 4) weights without the residuals along the surface of slipping fingers, and of fingers that are apart.

        Args:
            slipping: (N,) whether each fingertip slips.
            apart: (N,) whether each fingertip does not touch.
        """
        weights = np.array(self.weights)
        weights[slipping] *= (0.0, 0.0, 1.0, 0.0)
        weights[apart] = 0.0
        return weights

    def covariance(self, pose: ContactPose, reference: ContactReference, joint_variance: float, contact_noise: float) -> Array:
        """Return the (6, 6) covariance of the pose in O from noise: of p in O, m², and of the rotation vector in O, rad².

        Args:
            pose: the pose.
            reference: reference of the contacts.
            joint_variance: variance of each estimated joint position, rad².
            contact_noise: standard deviation of each momentary residual, m.
        """
        K = self._gain(pose.B, self.weights.ravel())
        return np.asarray(K @ self._residual_noise(pose, reference, joint_variance, contact_noise) @ K.T)

    def uncertainty(
        self, pose: ContactPose, reference: ContactReference, joint_variance: float, contact_noise: float
    ) -> PoseUncertainty:
        """Return the covariance of the pose from noise, and the motions that the contacts leave free.

        Args:
            pose: the pose.
            reference: reference of the contacts.
            joint_variance: variance of each estimated joint position, rad².
            contact_noise: standard deviation of each momentary residual, m.
        """
        return PoseUncertainty(self.covariance(pose, reference, joint_variance, contact_noise), self.free_motions(pose))

    def slip_covariance(
        self, pose: ContactPose, reference: ContactReference, joint_variance: float, contact_noise: float
    ) -> Array:
        """Return the (N, 2, 2) covariance of the slip of each contact along t₁ and t₂ from noise, m².

        Args:
            pose: the pose.
            reference: reference of the contacts.
            joint_variance: variance of each estimated joint position, rad².
            contact_noise: standard deviation of each momentary residual, m.
        """
        noise, count = self._residual_noise(pose, reference, joint_variance, contact_noise), len(self._radii)
        left = np.eye(4 * count) - pose.B @ self._gain(pose.B, self.weights.ravel())  # residuals that no motion explains
        covariance = (left @ noise @ left.T).reshape(count, 4, count, 4)
        return np.array([covariance[i, :2, i, :2] for i in range(count)])

    def twist_covariance(self, pose: ContactPose, rate_variance: float) -> Array:
        """Return the (6, 6) covariance of the twist in O from noise, m²/s² and rad²/s².

        Args:
            pose: the pose.
            rate_variance: variance of each estimated joint rate, rad²/s².
        """
        joints = self._gain(pose.B, self.weights.ravel()) @ pose.A
        return np.asarray(rate_variance * joints @ joints.T)

    def free_motions(self, pose: ContactPose) -> Array:
        """Return unit displacements (6, f) in O that the contacts leave free; rotations as displacements at 30 mm.

        Args:
            pose: the pose.
        """
        rows = pose.B * _UNIT * np.sqrt(self.weights.ravel())[:, None]
        eigenvalues, vectors = np.linalg.eigh(rows.T @ rows / len(self.weights))
        return np.asarray(_UNIT[:, None] * vectors[:, eigenvalues <= FREE])

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _with_slip(self, pose: ContactPose, slip: Array, spin: Array) -> ContactPose:
        """Return a pose with another slip (N, 2), m, and spin (N,), rad."""
        return replace(pose, slip=slip, spin=spin)

    def _contacts(self, p: Array, R: Array, q: Array, v: Array, R_OC_last: Array) -> RollingContacts:
        grasp = self._grasp
        tips = grasp.hand.model.tip_motion(q, v, self._tips)
        motion = _make_motion(p, R, _ZERO_TWIST, _ZERO_TWIST)
        return rolling_contacts(tips, self._radii, motion, grasp.body.shape, grasp.contacts, R_OC_last)

    def _rows(self, rolling: RollingContacts) -> tuple[Array, Array]:
        """Return A (4 N, n) and B (4 N, 6)."""
        count, n = len(self._radii), rolling.A.shape[1]
        A, B = np.zeros((count, 4, n)), np.zeros((count, 4, 6))
        A[:, :3], B[:, :3] = rolling.A.reshape(count, 3, n), rolling.B.reshape(count, 3, 6)
        if rolling.spin is not None:
            arms = ARM * self._has_torsion[:, None]
            A[:, 3], B[:, 3] = arms * rolling.spin.A, arms * rolling.spin.B
        return A.reshape(-1, n), B.reshape(-1, 6)

    def _residuals(self, last: ContactPose, now: RollingContacts, gap: Array, slip: Array, spin: Array) -> Array:
        """Return the residuals (N, 4) of a pose, m; the spin at 30 mm from n."""
        r = np.zeros((len(gap), 4))
        since = slip_displacement(last.tip_contacts, now.tip_contacts, now.R_OC)
        until = slip_displacement(now.tip_contacts, last.tip_contacts, last.R_OC)
        r[:, :2] = slip + 0.5 * (since - until)
        r[:, 2] = gap - now.gap
        if now.spin is not None:
            before, after = last.tip_contacts.R_OF, now.tip_contacts.R_OF
            turns = [rotation_log(R_now @ R_last.T) for R_last, R_now in zip(before, after, strict=True)]  # rad, in O
            r[:, 3] = ARM * (spin + (np.array(turns) * now.R_OC[:, :, 2]).sum(axis=1))
        return r

    def _residual_noise(self, pose: ContactPose, reference: ContactReference, joint_variance: float, contact: float) -> Array:
        """Return the (4 N, 4 N) covariance of the residuals at the true pose, m²."""
        noise = joint_variance * pose.A @ pose.A.T + reference.covariance
        return np.asarray(noise + contact**2 * np.eye(len(noise)))

    def _gain(self, B: Array, w: Array) -> Array:
        """Return (Bᵀ W B)⁺ Bᵀ W, (6, 4 N), with rotations as displacements at 30 mm."""
        weighted = (B * _UNIT).T * w
        eigenvalues, vectors = np.linalg.eigh(weighted @ (B * _UNIT))
        is_fixed = eigenvalues > FREE * len(self._radii)
        inverse = (vectors[:, is_fixed] / eigenvalues[is_fixed]) @ vectors[:, is_fixed].T
        return np.asarray(_UNIT[:, None] * (inverse @ weighted))


def _contact_offset(r: Array, A: Array, encoder_variance: float, contact_error: float) -> tuple[Array, Array]:
    """Return the part (4 N,) of residuals that counts as error of the contacts, m, and its covariance (4 N, 4 N), m²."""
    prior = contact_error**2 * np.eye(len(r))
    share = np.linalg.lstsq((prior + encoder_variance * A @ A.T).T, prior.T, rcond=None)[0].T  # C (C + A Σ_q Aᵀ)⁻¹
    return np.asarray(share @ r), freeze(prior - share @ prior)


def _moved(p: Array, R: Array, xi: Array) -> tuple[Array, Array]:
    """Return a pose after a small motion ξ (6,), given in its own frame."""
    return np.asarray(p + R @ xi[:3]), np.asarray(R @ rotation_exp(xi[3:]))

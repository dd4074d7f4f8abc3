"""What a hold must be and what it should be, as numbers that a least-squares search can push down.

Of a posture q, an object's pose and the weights λ of the normal forces:

    must    distance of the ball's middle from its face = r          the tip touches
            room to the face's edge, gaps between fingers, gap to the links and to the palm ≥ what is asked for
            the joints' way to their limits ≥ what ± the travel takes     the object can be moved
    should  Σ λ_i n_i = 0,  Σ λ_i p_i × n_i / L = 0,  Σ λ_i = 1       normal forces alone balance: closure for any friction
            joints near rest, ‖J_i⁺ n_i‖ and 1/σ_min(J_i) small       the joints can press, and move the object
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry.vectors import skew
from graspforce.grasp.search.batch_kinematics import BatchKinematics, PostureKinematics, rotations
from graspforce.grasp.search.faces import ClosedFormShape, Faces, faces
from graspforce.hand.hand import Hand

_MILLIMETRE = 1e-3  # m: a miss of this size counts as one
_PAD = 3e-4  # m: more than is asked for, because a least-squares search stops just inside what it penalises
_BALANCE = 10.0  # a tenth of the squeeze that does not balance counts as one
_REST = 0.3  # half a joint's range away from rest
_PRESS = 0.3  # a finger that presses half as readily as it could well
_MOVE = 0.1  # a finger that moves its tip half as readily as it could well, in the worst direction
_REACH = 0.05  # m/rad, how fast a finger's tip moves where it stands well
_SINGULAR = 0.005  # m/rad: where a direction counts as one that the finger cannot move in
_SPARE = 0.06  # rad: left of a joint's way to its limit at the end of the travel; more than the estimate's second order
_STOP = 0.03  # rad: a joint that lacks so much counts as one
_DAMPED = 1e-3  # m/rad: bends the estimate of the joints' way near singular postures
_FAR = 1.0  # m: from here the nearest points of a shape are its hull's


@dataclass(frozen=True, eq=False, slots=True)
class GeometryRequirements:
    """What is asked of a hold.

    Args:
        clearance: between fingers, and from object to palm and links, m.
        edge: from the contact to the face's edge, over the ball's radius.
        out_H: (3,) the unit vector out of the palm, in H; the palm's surface passes through H's origin.
        travel: how far the fingers must be able to move the object, to and fro along each of their ways, m.
    """

    clearance: float
    edge: float
    out_H: Array
    travel: float


@dataclass(frozen=True, eq=False, slots=True)
class Candidates:
    """B searches' variables x (B, n + 6 + N), and what stays fixed in each.

    x holds the posture q, rad, the object's position, m, its turn from R_start as a rotation vector, rad, and λ.

    Attributes:
        x: the variables.
        R_start: (B, 3, 3) the object's axes in H at the start.
        face: (B, N) the face that each finger is to touch.
    """

    x: Array
    R_start: Array
    face: np.ndarray[tuple[int, ...], np.dtype[np.intp]]


@dataclass(frozen=True, eq=False, slots=True)
class CandidateMeasures:
    """B guesses, measured. Lengths in m, negative gaps are overlaps.

    Attributes:
        q, p_HO, R_HO: (B, n), (B, 3), (B, 3, 3).
        tips: (B, N, 3) the middles of the touching fingers' balls, in O.
        touch: (B, N) distance of each ball from its face.
        room: (B, N) from the contact to the edge of its face.
        normal: (B, N, 3) inward normals in O.
        press: (B, N) ‖J⁺ n‖, joint rate per tip speed along the normal, rad/m.
        left: (B, n_used) the least that the touching fingers' joints keep to their limits on the travel, to first order, rad.
        slowest: (B, N) the tip's speed per joint rate in the slowest direction that the finger's joints can move it in, m/rad.
        links: (B, F) least gap between each finger's links and the object, the ball that touches left out.
        fingers: (B, F(F−1)/2) least gap between each two fingers.
        palm: (B,) from the palm to the object's lowest point.
    """

    q: Array
    p_HO: Array
    R_HO: Array
    tips: Array
    contact_distance: Array
    edge_distance: Array
    normal: Array
    normal_gain: Array
    limit_margin: Array
    min_tip_speed: Array
    links: Array
    fingers: Array
    palm: Array


class SearchGoal:
    """A hand, a shape and the fingers that are to hold it.

    Args:
        hand, skeleton: the hand, twice.
        shape: the object's surface.
        fingers: indices of the N fingers that touch.
        demands: what is asked.
    """

    def __init__(
        self,
        hand: Hand,
        kinematics: BatchKinematics,
        shape: ClosedFormShape,
        fingers: tuple[int, ...],
        requirements: GeometryRequirements,
    ) -> None:
        self.hand, self.fingers, self.requirements = hand, fingers, requirements
        self._kinematics, self._shape = kinematics, shape
        self.radii = kinematics.radii[list(fingers)]
        self.hull = np.asarray(shape.project_to_surface(_FAR * _directions(400)))
        self.length = float(np.linalg.norm(self.hull, axis=1).mean())  # m, the object's size
        used_joints = np.zeros(hand.n, dtype=bool)
        for f in fingers:
            used_joints[list(hand.fingers[f].joints)] = True
        self.used_joints = np.flatnonzero(used_joints)
        self.travel_directions = kinematics.travel_directions(fingers)
        stretched = np.clip(0.0, hand.q_lower, hand.q_upper)
        self.rest = np.where(used_joints, hand.neutral, stretched)  # rad
        # what touches leaves the object at the contact: its last link has no gap there, but must not cut into the surface
        touching = np.isin(kinematics.sphere_finger, fingers)
        self._allowed_overlap = np.where(touching & kinematics.on_last_link, requirements.clearance, 0.0)  # m
        self._allowed_overlap[touching & kinematics.tip] = np.inf
        # fingers that hold move with the object; the others and the palm stay where they are
        outward = float(np.abs(self.travel_directions @ requirements.out_H).max(initial=0.0))
        idle = np.ones(len(kinematics.radii))
        idle[list(fingers)] = 0.0
        pairs = np.zeros(len(idle) * (len(idle) - 1) // 2)
        self._gaps = requirements.clearance + requirements.travel * np.concatenate(
            [idle if len(self.travel_directions) else 0.0 * idle, pairs, [outward]]
        )
        self._half = (hand.q_upper - hand.q_lower) / 2.0  # rad

    def unpack(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """q, p_HO, the turn and λ of variables (B, ·)."""
        n = self.hand.n
        return x[:, :n], x[:, n : n + 3], x[:, n + 3 : n + 6], x[:, n + 6 :]

    def evaluate_faces(self, p_O: Array) -> Faces:
        """The faces of the object as points (M, 3) in O see them."""
        return faces(self._shape, p_O)

    def tips(self, q: Array) -> Array:
        """(B, N, 3) the middles of the touching balls in H, m, of postures (B, n)."""
        return self._kinematics.postures(q).tips[:, list(self.fingers)]

    def measure(self, candidates: Candidates) -> CandidateMeasures:
        """Everything that is asked of the guesses, and what they should be."""
        q, p_HO, turn, _ = self.unpack(candidates.x)
        R_HO = candidates.R_start @ rotations(turn)
        postures = self._kinematics.postures(q)
        tips = (postures.tips[:, list(self.fingers)] - p_HO[:, None]) @ R_HO
        B, N = tips.shape[:2]
        seen, row, face = self.evaluate_faces(tips.reshape(-1, 3)), np.arange(B * N), candidates.face.ravel()
        normal = seen.normal[row, face].reshape(B, N, 3)
        sk = self._kinematics
        inside = ((postures.sphere_centres - p_HO[:, None]) @ R_HO).reshape(-1, 3)
        gaps = self._shape.phi(inside).reshape(B, -1) - sk.radii[sk.sphere_finger] + self._allowed_overlap
        J = postures.jacobians[:, list(self.fingers)]
        n_H = (R_HO[:, None] @ normal[..., None])[..., 0]
        sigma = np.asarray(np.linalg.svd(J, compute_uv=False), dtype=np.float64)  # m/rad
        lowest = ((self.hull @ R_HO.transpose(0, 2, 1)) @ self.requirements.out_H).min(axis=1)
        return CandidateMeasures(
            q=q,
            p_HO=p_HO,
            R_HO=R_HO,
            tips=tips,
            contact_distance=seen.face_distance[row, face].reshape(B, N) - self.radii,
            edge_distance=seen.edge_distance[row, face].reshape(B, N),
            normal=normal,
            normal_gain=_normal_gain(J, n_H),
            limit_margin=self._limit_margin(q, self._contact_jacobians(postures, n_H)),
            min_tip_speed=np.take_along_axis(sigma, sk.directions[None, list(self.fingers), None] - 1, axis=2)[..., 0],
            links=np.minimum.reduceat(gaps, sk.first, axis=1),
            fingers=self._finger_gaps(postures),
            palm=p_HO @ self.requirements.out_H + lowest,
        )

    def residuals(self, candidates: Candidates, preference_weight: float = 1.0) -> Array:
        """(B, M) all that is missing, each in units in which one is bad; ``wishes`` weighs what only should be."""
        m = self.measure(candidates)
        lam = self.unpack(candidates.x)[3]
        edge = self.requirements.edge * self.radii
        force = (lam[..., None] * m.normal).sum(axis=1)
        moment = (lam[..., None] * np.cross(m.tips, m.normal)).sum(axis=1) / self.length
        gaps = np.concatenate([m.links, m.fingers, m.palm[:, None]], axis=1)
        return np.concatenate(
            [
                m.contact_distance / _MILLIMETRE,
                _shortfall(m.edge_distance, edge),
                _shortfall(gaps, self._gaps),
                np.maximum(0.0, _SPARE - m.limit_margin) / _STOP,
                _BALANCE * force,
                _BALANCE * moment,
                _BALANCE * (lam.sum(axis=1, keepdims=True) - 1.0),
                preference_weight * _REST * (m.q - self.rest) / self._half,
                preference_weight * _PRESS * _REACH * m.normal_gain,
                preference_weight * _MOVE * _REACH / np.maximum(m.min_tip_speed, _SINGULAR),
                0.01 * self.unpack(candidates.x)[2],  # a ball has no turn to find: it stays where it is
            ],
            axis=1,
        )

    def contact_jacobians(
        self, q: Array, p_HO: Array, R_HO: Array, face: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
    ) -> tuple[Array, Array]:
        """Joint rates to what moves at the contacts, of postures (B, n), the object at (B, 3) and turned by R_HO.

        Args:
            q, p_HO: rad and m.
            R_HO: (1, 3, 3), for all.
            face: (1, N) the faces that are touched.

        Returns:
            (B, N, 3, n) the contact points' velocities in H, m/rad, and (B, N, n) the fingers' spin about the normals.
        """
        postures = self._kinematics.postures(q)
        tips = (postures.tips[:, list(self.fingers)] - p_HO[:, None]) @ R_HO
        B, N = tips.shape[:2]
        normal = self.evaluate_faces(tips.reshape(-1, 3)).normal[np.arange(B * N), np.tile(face[0], B)].reshape(B, N, 3)
        n_H = normal @ R_HO.swapaxes(1, 2)
        spin = (n_H[:, :, None] @ postures.spins[:, list(self.fingers)])[:, :, 0]
        return self._contact_jacobians(postures, n_H), spin

    def _contact_jacobians(self, postures: PostureKinematics, n_H: Array) -> Array:
        """(B, N, 3, n) joint rates to the velocities of the fingers' points at the contacts, in H, m/rad: a ball rolls."""
        chosen = list(self.fingers)
        arm = skew(self.radii[:, None] * n_H)
        return np.asarray(postures.jacobians[:, chosen] - arm @ postures.spins[:, chosen])

    def _limit_margin(self, q: Array, J: Array) -> Array:
        """What ± the travel leaves of the joints' ways to their limits, by the least joint motions: room − |J⁺ d|."""
        J = J[..., self.used_joints]
        A = J @ J.swapaxes(-1, -2) + _DAMPED**2 * np.eye(3)
        taken = np.abs(
            J.swapaxes(-1, -2)
            @ np.linalg.solve(A, np.broadcast_to(self.travel_directions.T, (*A.shape[:2], 3, len(self.travel_directions))))
        )
        joint_margin = np.minimum(q - self.hand.q_lower, self.hand.q_upper - q)[:, self.used_joints]
        return np.asarray(joint_margin - self.requirements.travel * taken.max(axis=(1, 3), initial=0.0))

    def _finger_gaps(self, postures: PostureKinematics) -> Array:
        """(B, F(F−1)/2) least gap between the spheres of each two fingers, m."""
        s, sk = postures.sphere_centres, self._kinematics
        square = np.square(s).sum(axis=2)
        apart = square[:, :, None] + square[:, None] - 2.0 * s @ s.swapaxes(1, 2)  # m²
        least = np.minimum.reduceat(np.minimum.reduceat(apart, sk.first, axis=1), sk.first, axis=2)
        i, j = np.tril_indices(len(sk.radii), -1)
        return np.asarray(np.sqrt(np.maximum(least[:, i, j], 0.0)) - sk.radii[i] - sk.radii[j])


def _shortfall(value: Array, wanted: Array | float) -> Array:
    """How much is missing to what is wanted, and a little beyond, in millimetres."""
    return np.asarray(np.maximum(0.0, wanted + _PAD - np.minimum(value, 1.0)) / _MILLIMETRE)


def _normal_gain(J: Array, n_H: Array) -> Array:
    """(B, N) √(nᵀ (J Jᵀ + ε² 1)⁻¹ n), rad/m: large along directions in which the finger cannot move its tip."""
    A = J @ J.swapaxes(-1, -2) + _SINGULAR**2 * np.eye(3)
    return np.asarray(np.sqrt((n_H * np.linalg.solve(A, n_H[..., None])[..., 0]).sum(axis=-1)))


def _directions(count: int) -> Array:
    """(count, 3) unit vectors spread evenly: points on a sphere along a golden spiral."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.column_stack([np.sqrt(1.0 - z * z) * np.cos(angle), np.sqrt(1.0 - z * z) * np.sin(angle), z])

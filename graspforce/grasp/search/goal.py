"""Residuals of a grasp candidate: requirements and preferences, for least squares.

The variables are a posture q, a pose of the object, and weights λ of the normal forces. Required:

- each tip has distance 0 from its face,
- edge distances and gaps are at least their least values,
- joint limit margins cover the joint motion of ± the travel,
- the normal forces alone balance: Σ λ_i n_i = 0, Σ λ_i p_i × n_i / L = 0, Σ λ_i = 1.

Preferred:

- joints near rest,
- ‖J_i⁺ n_i‖ small: the fingers can press,
- 1/σ_min(J_i) small: the fingers can move the object,
- joints without motor, of free differentials, do not move the contacts along the normals: the tendon balances normal forces.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from functools import cached_property

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import Solid
from graspforce.geometry.vectors import skew
from graspforce.grasp.search.batch_kinematics import BatchKinematics, PostureKinematics, rotations
from graspforce.grasp.search.candidates import CandidateMeasures, Candidates, GeometryRequirements, Indices
from graspforce.grasp.search.faces import FaceDistances, face_distances, face_tangents, rough_face_distances
from graspforce.grasp.search.pair_distances import Pair, PairDistances
from graspforce.hand.descriptions.contact_description import HELD_OBJECT
from graspforce.hand.hand import Hand
from graspforce.hand.shapes.collision_body import CollisionBody, object_geometry

# Each residual is divided by the violation that counts as 1.
_MILLIMETRE = 1e-3  # m, of distances and gaps
_LIMIT_SCALE = 0.03  # rad, of joint limit margins
_BALANCE_WEIGHT = 10.0  # an imbalance of a tenth of the squeeze counts as 1
_REST_WEIGHT = 0.3  # of a joint half its range away from rest
_PRESS_WEIGHT = 0.3  # of a tip that moves along the normal at _TIP_SPEED
_MOVE_WEIGHT = 0.1  # of a tip that moves in its slowest direction at _TIP_SPEED
_UNDRIVEN_SPEED = 0.005  # m/rad: such a speed along the normal per rate of a joint without motor counts as 1
_TIP_SPEED = 0.05  # m/rad, of a tip per joint rate in a good posture

_DISTANCE_SLACK = 3e-4  # m, required in addition, because least squares stops slightly inside a penalty
_LIMIT_SLACK = 0.06  # rad, of a joint limit margin at the end of the travel; covers the second order of the estimate
_SINGULAR_SPEED = 0.005  # m/rad: regularisation of tip speeds near singular postures
_TRAVEL_DAMPING = 1e-3  # m/rad: regularisation of the joint motion of the travel near singular postures
_SLIDE_SCALE = 0.05  # m, of a prismatic joint: counts as one radian of a revolute joint
_NEAR = 1e-4  # m: far above the displacements of difference steps
_FAR = 1.0  # m: the closest points to points this far away lie on the convex hull of a shape


class SearchGoal:
    """The least-squares problem of one set of fingers.

    Attributes:
        hand: the hand.
        shape: the object's surface.
        fingers: indices of the N touching fingers.
        requirements: the geometric requirements.
        radii: (N,) radii of the touching tips, m.
        rest: (n,) preferred posture, rad: neutral for touching fingers, stretched for the others unless that overlaps the palm.
        used_joints: indices of the joints of the touching fingers.
        joint_scale: (n,) 1 rad, or 50 mm for a prismatic joint: positions that are compared with angles are divided by it.
        travel_directions: (K, 3) unit vectors in H along which these fingers can move an object.
        collision: the collision shapes of the hand.
        tip_links: (F,) index of the link that carries each finger's tip.
        pairs: pairs of bodies whose exact distances are required in addition; none at first.
    """

    def __init__(
        self,
        hand: Hand,
        kinematics: BatchKinematics,
        shape: Solid,
        fingers: tuple[int, ...],
        requirements: GeometryRequirements,
        hull: Array | None = None,
    ) -> None:
        self.hand, self.shape, self.fingers, self.requirements = hand, shape, fingers, requirements
        self._kinematics, self.collision, self.tip_links = kinematics, kinematics.collision, kinematics.tip_links
        self.radii = kinematics.tip_radii[list(fingers)]
        self._hull = hull_points(shape) if hull is None else hull
        self._length = float(np.linalg.norm(self._hull, axis=1).mean())  # m, the object's size
        used = np.zeros(hand.n, dtype=bool)
        for f in fingers:
            used[list(hand.fingers[f].joints)] = True
        self.used_joints = np.flatnonzero(used)
        self._undriven = np.flatnonzero(used & (hand.torque_upper == 0.0))
        self.joint_scale = np.array([_SLIDE_SCALE if joint.is_prismatic else 1.0 for joint in hand.joints])
        self.travel_directions = kinematics.travel_directions(fingers)
        self.rest = np.where(used | kinematics.blocked_joints, hand.neutral, np.clip(0.0, hand.q_lower, hand.q_upper))  # rad
        self._half_range = (hand.q_upper - hand.q_lower) / 2.0  # rad
        # The last link of a touching finger leaves the object at the contact: it has no gap, but must not penetrate.
        touching, excess = np.isin(kinematics.sphere_finger, fingers), kinematics.last_link_excess
        allowed = np.where(np.isinf(excess), np.maximum(excess, 0.0), requirements.clearance + np.maximum(excess, 0.0))  # m
        self._allowed_overlap = np.where(touching, allowed, 0.0)
        self._least_gaps = self._gaps_with_travel(requirements)
        self.pairs = PairDistances(())

    @cached_property
    def forbidden_pairs(self) -> PairDistances:
        """The pairs of bodies that must not overlap: links, and the object with links that carry no touching tip."""
        bodies, held = self.collision.bodies, object_geometry(self.shape)
        touching = [self.tip_links[f] for f in self.fingers]
        others = [(i, len(bodies)) for i, body in enumerate(bodies) if body.frame not in touching]
        frame = len(self._kinematics.links)
        thing = CollisionBody.of_geometry(HELD_OBJECT, frame, held, np.zeros(3), np.eye(3))
        return PairDistances((*bodies, thing), (*self.collision.pairs, *others))

    def with_pairs(self, pairs: Iterable[Pair]) -> SearchGoal:
        """Return the same goal with the distances of further pairs of bodies.

        Args:
            pairs: some of the forbidden pairs.
        """
        goal = copy.copy(self)
        goal.pairs = PairDistances(self.forbidden_pairs.bodies, tuple(dict.fromkeys((*self.pairs.pairs, *pairs))))
        return goal

    def forbidden_distances(self, candidates: Candidates) -> Array:
        """Compute the distances of the forbidden pairs of one candidate, (P,), m.

        Args:
            candidates: the candidate.
        """
        q, p_HO, turn, _ = self.unpack(candidates.x)
        frames = self._frames(self._kinematics.evaluate(q), p_HO, candidates.R_start @ rotations(turn))
        return np.asarray(self.forbidden_pairs.near_first(*frames)[0])

    def _gaps_with_travel(self, requirements: GeometryRequirements) -> Array:
        """Return the least gaps of links, fingers and palm at the start of the travel, m.

        Touching fingers move with the object. Idle fingers and the palm do not.
        """
        outward = float(np.abs(self.travel_directions @ requirements.palm_normal_H).max(initial=0.0))
        idle = np.ones(len(self.hand.fingers))
        idle[list(self.fingers)] = 0.0
        pairs = np.zeros(len(idle) * (len(idle) - 1) // 2)
        approach = np.concatenate([idle if len(self.travel_directions) else 0.0 * idle, pairs, [outward]])
        return np.asarray(requirements.clearance + requirements.travel * approach)

    def unpack(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Split variables (B, n + 6 + N) into q, p_HO, the rotation vector and λ."""
        n = self.hand.n
        return x[:, :n], x[:, n : n + 3], x[:, n + 3 : n + 6], x[:, n + 6 :]

    def face_distances(self, p_O: Array) -> FaceDistances:
        """Compute the distances of points p_O (M, 3), m, from the object's faces."""
        return face_distances(self.shape, p_O)

    def tip_centres(self, q: Array) -> Array:
        """Compute the centres of the touching tips in H, (B, N, 3), m, in postures q (B, n), rad."""
        return self._kinematics.evaluate(q).tip_centres[:, list(self.fingers)]

    def tip_points(self, candidates: Candidates) -> Array:
        """Compute the centres of the touching tips in O, (B, N, 3), m."""
        q, p_HO, turn, _ = self.unpack(candidates.x)
        return np.asarray((self.tip_centres(q) - p_HO[:, None]) @ (candidates.R_start @ rotations(turn)))

    def faces_near_first(self, p_O: Array) -> FaceDistances:
        """Compute the distances of points near the first N of them, the tips of one candidate, from the object's faces.

        A curved object is replaced by its tangents at the first N points.

        Args:
            p_O: (B N, 3) points in O, m, N by N.
        """
        tangents = face_tangents(self.shape, p_O[: len(self.fingers)])
        return self.face_distances(p_O) if tangents is None else tangents.at(p_O)

    def rough_faces(self, p_O: Array) -> FaceDistances:
        """Compute rough distances of points p_O (M, 3), m, from the object's faces, for a first choice of candidates."""
        return rough_face_distances(self.shape, p_O)

    def measure(self, candidates: Candidates, faces_at: Callable[[Array], FaceDistances] | None = None) -> CandidateMeasures:
        """Compute the measures of candidates.

        Args:
            candidates: B candidates.
            faces_at: computes the distances of points (B N, 3) in O from the object's faces, in place of `face_distances`.
        """
        q, p_HO, turn, _ = self.unpack(candidates.x)
        R_HO = candidates.R_start @ rotations(turn)
        postures, kin = self._kinematics.evaluate(q), self._kinematics
        tip_centres = (postures.tip_centres[:, list(self.fingers)] - p_HO[:, None]) @ R_HO
        B, N = tip_centres.shape[:2]
        points, row, face = tip_centres.reshape(-1, 3), np.arange(B * N), candidates.face.ravel()
        faces = (faces_at or self.face_distances)(points)
        normal = faces.normal[row, face].reshape(B, N, 3)
        spheres_O = ((postures.sphere_centres - p_HO[:, None]) @ R_HO).reshape(-1, 3)
        palm_O = (postures.palm_centres - p_HO[:, None]) @ R_HO
        is_near_first = faces_at == self.faces_near_first
        gaps = self._sphere_gaps(spheres_O.reshape(B, -1, 3), is_near_first)
        J = postures.linear_jacobians[:, list(self.fingers)]
        n_H = (R_HO[:, None] @ normal[..., None])[..., 0]
        sigma = np.asarray(np.linalg.svd(J, compute_uv=False), dtype=np.float64)  # m/rad
        contact_jacobians = self._contact_jacobians(postures, n_H)
        slowest = kin.direction_counts[None, list(self.fingers), None] - 1
        p_PO = p_HO - self.requirements.palm_point_H
        lowest = ((self._hull @ R_HO.transpose(0, 2, 1)) @ self.requirements.palm_normal_H).min(axis=1)
        lowest += p_PO @ self.requirements.palm_normal_H  # m, above the plane of the palm
        return CandidateMeasures(
            q=q,
            p_HO=p_HO,
            R_HO=R_HO,
            tip_centres=tip_centres,
            contact_distance=faces.face_distance[row, face].reshape(B, N) - self.radii,
            edge_distance=faces.edge_distance[row, face].reshape(B, N),
            normal=normal,
            normal_gain=_normal_gain(J, n_H),
            limit_margin=self._limit_margin(q, contact_jacobians),
            min_tip_speed=np.take_along_axis(sigma, slowest, axis=2)[..., 0],
            undriven_speed=(n_H[:, :, None] @ contact_jacobians[..., self._undriven])[:, :, 0],
            link_gap=np.minimum.reduceat(gaps, kin.first_sphere, axis=1),
            finger_gap=self._finger_gaps(postures),
            palm_gap=np.minimum(lowest, self._palm_shape_gap(palm_O)),
            side_margin=self._side_margin(R_HO, normal, spheres_O.reshape(B, -1, 3), palm_O),
            pair_distance=self._pair_distances(postures, p_HO, R_HO, is_near_first),
        )

    def residuals(
        self,
        candidates: Candidates,
        preference_weight: float = 1.0,
        faces_at: Callable[[Array], FaceDistances] | None = None,
    ) -> Array:
        """Compute the residuals of candidates.

        Args:
            candidates: B candidates.
            preference_weight: weight of the preferences.
            faces_at: as in `measure`.

        Returns:
            (B, M), in units in which a violation of 1 is bad.
        """
        m = self.measure(candidates, faces_at)
        _, _, turn, lam = self.unpack(candidates.x)
        force = (lam[..., None] * m.normal).sum(axis=1)
        moment = (lam[..., None] * np.cross(m.tip_centres, m.normal)).sum(axis=1) / self._length
        gaps = np.concatenate([m.link_gap, m.finger_gap, m.palm_gap[:, None]], axis=1)
        return np.concatenate(
            [
                m.contact_distance / _MILLIMETRE,
                _shortfall(m.edge_distance, self.requirements.edge_ratio * self.radii),
                _shortfall(gaps, self._least_gaps),
                _shortfall(m.side_margin, 0.0),
                _shortfall(m.pair_distance, 0.0),
                np.maximum(0.0, _LIMIT_SLACK - m.limit_margin) / _LIMIT_SCALE,
                _BALANCE_WEIGHT * force,
                _BALANCE_WEIGHT * moment,
                _BALANCE_WEIGHT * (lam.sum(axis=1, keepdims=True) - 1.0),
                preference_weight * _REST_WEIGHT * (m.q - self.rest) / self._half_range,
                preference_weight * _PRESS_WEIGHT * _TIP_SPEED * m.normal_gain,
                preference_weight * _MOVE_WEIGHT * _TIP_SPEED / np.maximum(m.min_tip_speed, _SINGULAR_SPEED),
                m.undriven_speed.reshape(len(turn), -1) / _UNDRIVEN_SPEED,
                0.01 * turn,  # keeps the orientation of a sphere, which no other residual determines
            ],
            axis=1,
        )

    def contact_jacobians(self, q: Array, p_HO: Array, R_HO: Array, face: Indices) -> tuple[Array, Array]:
        """Compute the Jacobians of the fingers at the contacts.

        Args:
            q: (B, n) postures, rad.
            p_HO: (B, 3) positions of the object in H, m.
            R_HO: (1, 3, 3) the object's axes in H, the same for all.
            face: (1, N) indices of the touched faces, the same for all.

        Returns:
            (B, N, 3, n) velocities of the contact points in H, m/rad, and (B, N, n) the fingers' spin about the normals.
        """
        postures = self._kinematics.evaluate(q)
        tip_centres = (postures.tip_centres[:, list(self.fingers)] - p_HO[:, None]) @ R_HO
        B, N = tip_centres.shape[:2]
        faces = self.face_distances(tip_centres.reshape(-1, 3))
        normal = faces.normal[np.arange(B * N), np.tile(face[0], B)].reshape(B, N, 3)
        n_H = normal @ R_HO.swapaxes(1, 2)
        spin = (n_H[:, :, None] @ postures.angular_jacobians[:, list(self.fingers)])[:, :, 0]
        return self._contact_jacobians(postures, n_H), spin

    def _contact_jacobians(self, postures: PostureKinematics, n_H: Array) -> Array:
        """Compute J_v − r n̂ J_ω at the contacts of tips with radius r, (B, N, 3, n), m/rad."""
        chosen = list(self.fingers)
        arm = skew(self.radii[:, None] * n_H)
        return np.asarray(postures.linear_jacobians[:, chosen] - arm @ postures.angular_jacobians[:, chosen])

    def _limit_margin(self, q: Array, J: Array) -> Array:
        """Compute the joint limit margins after ± the travel t by the least joint motions: margin − t ‖J⁺ d‖∞, rad."""
        J = J[..., self.used_joints]
        A = J @ J.swapaxes(-1, -2) + _TRAVEL_DAMPING**2 * np.eye(3)
        d = np.broadcast_to(self.travel_directions.T, (*A.shape[:2], 3, len(self.travel_directions)))
        rates = np.abs(J.swapaxes(-1, -2) @ np.linalg.solve(A, d))  # rad/m
        margin = np.minimum(q - self.hand.q_lower, self.hand.q_upper - q)[:, self.used_joints]
        left = margin - self.requirements.travel * rates.max(axis=(1, 3), initial=0.0)
        return np.asarray(left / self.joint_scale[self.used_joints])

    def _sphere_gaps(self, spheres_O: Array, is_near_first: bool) -> Array:
        """Compute the gaps between the spheres (B, S, 3) in O and the object, (B, S), m.

        Args:
            spheres_O: centres, m.
            is_near_first: whether all centres are near those of the first row. The gaps of spheres that are not the nearest
                ones of their finger then count as those of the first row.
        """
        slack = self._allowed_overlap - self._kinematics.sphere_radii
        if not is_near_first:
            return np.asarray(self.shape.phi(spheres_O.reshape(-1, 3)).reshape(spheres_O.shape[:2]) + slack)
        first = np.asarray(self.shape.phi(spheres_O[0])) + slack
        least = np.minimum.reduceat(first, self._kinematics.first_sphere)[self._kinematics.sphere_finger]
        near = np.flatnonzero(first <= least + _NEAR)
        gaps = np.tile(first, (len(spheres_O), 1))
        gaps[1:, near] = self.shape.phi(spheres_O[1:, near].reshape(-1, 3)).reshape(-1, len(near)) + slack[near]
        return gaps

    def _finger_gaps(self, postures: PostureKinematics) -> Array:
        """Compute the least gap between the spheres of each pair of fingers, (B, F(F−1)/2), m."""
        s, radii, first = postures.sphere_centres, self._kinematics.sphere_radii, self._kinematics.first_sphere
        square = np.square(s).sum(axis=2)
        gaps = []
        for a in range(1, len(first)):  # each finger with all fingers before it, whose spheres come first
            own, before = slice(first[a], first[a + 1] if a + 1 < len(first) else None), slice(0, first[a])
            apart = s[:, own] @ (-2.0 * s[:, before].swapaxes(1, 2))
            apart += square[:, own, None]
            apart += square[:, None, before]
            np.sqrt(np.maximum(apart, 0.0, out=apart), out=apart)
            apart -= radii[own, None] + radii[before]
            gaps.append(np.minimum.reduceat(apart.min(axis=1), first[:a], axis=1))
        return np.concatenate(gaps, axis=1) if gaps else np.zeros((len(s), 0))

    def _pair_distances(self, postures: PostureKinematics, p_HO: Array, R_HO: Array, is_near_first: bool) -> Array:
        """Compute the distances of the goal's pairs, (B, P), m."""
        if not self.pairs.pairs:
            return np.zeros((len(p_HO), 0))
        p, R = self._frames(postures, p_HO, R_HO)
        return self.pairs.near_first(p, R) if is_near_first else self.pairs.exact(p, R)

    def _frames(self, postures: PostureKinematics, p_HO: Array, R_HO: Array) -> tuple[list[Array], list[Array]]:
        """Return positions, m, and axes of the links, the object and the base in H."""
        B = len(p_HO)
        return [*postures.p_HL, p_HO, np.zeros((B, 3))], [*postures.R_HL, R_HO, np.tile(np.eye(3), (B, 1, 1))]

    def _side_margin(self, R_HO: Array, normal: Array, spheres_O: Array, palm_O: Array) -> Array:
        """Compute the margins of the side conditions, (B, K), m."""
        points, kin = np.concatenate([spheres_O, palm_O], axis=1), self._kinematics
        radii = np.concatenate([kin.sphere_radii, kin.palm_radii])
        return self.requirements.side.margins(self.requirements.palm_normal_H, R_HO, normal, points, radii)

    def _palm_shape_gap(self, palm_O: Array) -> Array:
        """Compute the least gap between the object and the spheres of the palm in O, (B,), m; infinite without spheres."""
        gaps = self.shape.phi(palm_O.reshape(-1, 3)).reshape(palm_O.shape[:2]) - self._kinematics.palm_radii
        return np.asarray(gaps.min(axis=1, initial=np.inf))


def _shortfall(value: Array, least: Array | float) -> Array:
    """Return the part by which lengths are below their least values and a slack, in millimetres."""
    return np.asarray(np.maximum(0.0, least + _DISTANCE_SLACK - np.minimum(value, 1.0)) / _MILLIMETRE)


def _normal_gain(J: Array, n_H: Array) -> Array:
    """Return √(nᵀ (J Jᵀ + ε² 1)⁻¹ n), (B, N), rad/m: large where the finger cannot move its tip along n."""
    A = J @ J.swapaxes(-1, -2) + _SINGULAR_SPEED**2 * np.eye(3)
    return np.asarray(np.sqrt((n_H * np.linalg.solve(A, n_H[..., None])[..., 0]).sum(axis=-1)))


def hull_points(shape: Solid) -> Array:
    """Return points of a shape's convex hull in O, (400, 3), m.

    Args:
        shape: the object's surface.
    """
    return np.asarray(shape.project_to_surface(_FAR * _sphere_directions(400)))


def _sphere_directions(count: int) -> Array:
    """Return evenly spread unit vectors (count, 3), on a golden spiral."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.column_stack([np.sqrt(1.0 - z * z) * np.cos(angle), np.sqrt(1.0 - z * z) * np.sin(angle), z])

"""Constraints that keep pairs of bodies apart in a search, as smooth inequalities at every knot.

The smaller body of a pair is represented by spheres that touch its sides from inside, the larger one by the primitive around
it. Each sphere keeps its distance from the primitive by `outside_level` ≥ 1. Corners of the smaller body stick out of its
spheres: the exact check of a result decides, and a pair that still collides gets a larger distance in the next search.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.grasp.collision.least_gap import FramePoses, find_near_pairs
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.hand.hand import Hand
from graspforce.hand.shapes.collision_body import CollisionBody
from graspforce.planning.collisions import plan_collision, poses_of_plan
from graspforce.planning.failure import PlanFailure
from graspforce.planning.interpolation import Indices
from graspforce.planning.nlp.equations import Equations, make_equations
from graspforce.planning.nlp.outside import outside_level
from graspforce.planning.nlp.symbolic_finger import symbolic_link
from graspforce.planning.plan import Plan

_MAX_SEARCHES = 3  # programs that are solved, each with the collisions of the one before kept apart
_MAX_IMPROVEMENTS = 2  # the same if there is a plan without collision already
BARRIER = 1e-3  # first barrier parameter of programs that keep pairs apart: they start from a motion that nearly does

_LOOKAHEAD = 2e-3  # m: pairs that come this near their required distance are constrained, too
_GROWTH = 5e-4  # m: distance beside the lack of a pair that collided although it was constrained
_REACH = 8e-3  # m: spheres that stay farther from the other body in the first guess get no row
_LARGEST_SPACING = 1.5  # of the radius, between spheres
_MIN_LEAST = 1e-4  # m: least distance of a row
_END_TOLERANCE = 1e-6  # lack of a row that the program accepts beside the lack at the ends

_FIXED, _OBJECT = "fixed", "object"  # kinds of frames; a link's kind is the name of its finger

SeparationRow = tuple[Equations, list[Indices], Array, Array, Array]  # equations, variables, parameters, bounds


@dataclass(frozen=True, eq=False, slots=True)
class MovingFrame:
    """A frame whose pose follows from variables of a program.

    Attributes:
        kind: "object", or the name of the finger that moves a link.
        link: index of the link; -1 for the object.
        places: places of its variables in a knot's vector: position and Cayley parameters, or joints of the finger.
        numbers: of the object, p₀, and the scales of length and Cayley parameters; of a link, the scales of the joints.
        R_0: (3, 3) orientation of the object for zero Cayley parameters; the identity for a link.
    """

    kind: str
    link: int
    places: Indices
    numbers: Array
    R_0: Array


class Separation:
    """The pairs that a search keeps apart, learned from the collisions of its results.

    Args:
        scene: the bodies; None for no constraints.

    Attributes:
        distances: distance to keep of each constrained pair beside its required one, m, by the pair's index.
        last: the last plan with a collision; the next search starts from it.
    """

    def __init__(self, scene: SceneCollision | None) -> None:
        self.scene = scene
        self.distances: dict[int, float] = {}
        self.last: Plan | None = None

    def find_collision(self, plan: Plan) -> PlanFailure | None:
        """Return the collision of a plan, and constrain the pairs that come near in it; None if there is none.

        Args:
            plan: the plan.
        """
        collision = plan_collision(self.scene, plan)
        if self.scene is not None and collision is not None:
            self.last = plan
            poses = poses_of_plan(self.scene, plan)
            required = self.scene.required(poses)
            for pair, excess in find_near_pairs(self.scene.bodies, self.scene.pairs, poses, required, _LOOKAHEAD):
                grown = self.distances[pair] - min(excess, 0.0) + _GROWTH if pair in self.distances else _GROWTH
                self.distances[pair] = grown
        return collision

    def search_count(self, best: Plan | None) -> int:
        """Return the largest number of searches.

        Args:
            best: a plan without collision; None if there is none yet.
        """
        return _MAX_SEARCHES if best is None else _MAX_IMPROVEMENTS

    def rows(self, hand: Hand, frames: Mapping[int, MovingFrame], guess: FramePoses, x: Array) -> Iterator[SeparationRow]:
        """Yield the rows of the constrained pairs.

        Args:
            hand: the hand.
            frames: the frames that move, by their index in the scene.
            guess: poses of the frames in the first guess.
            x: (K + 1, size) variables of the first guess.
        """
        if self.scene is None:
            return
        for pair, distance in self.distances.items():
            one, other = (self.scene.bodies[i] for i in self.scene.pairs[pair])
            small, large = (one, other) if one.radius <= other.radius else (other, one)
            if small.frame not in frames and large.frame not in frames:
                continue
            centres, radius = cover(small)
            for centre in centres:
                if _least_distance(centre, small, large, guess) < radius + distance + _REACH:
                    least = max(radius + self.scene.margin + distance, _MIN_LEAST)
                    yield _row(hand, frames, (small, large), centre, least, (guess, x))


def links_of_finger(hand: Hand, finger: str, places: Indices, scales: Array) -> dict[int, MovingFrame]:
    """Return the links that only the joints of a finger move, as moving frames by their index.

    Args:
        hand: the hand.
        finger: name of the finger.
        places: places of its joints in a knot's vector.
        scales: scales of these variables, rad.
    """
    tree, joints, frames = hand.tree(), list(hand.finger(finger).joints), {}
    link = next(tip.link for tip in tree.tips if tip.finger == finger)
    while link >= 0:
        frames[link] = MovingFrame(finger, link, places, scales, np.eye(3))
        link = tree.links[link].parent
    moved = np.abs(hand.T[:, joints]).sum(axis=1) > 0.0
    return {i: frame for i, frame in frames.items() if any(moved[k] for k in frames if k <= i)}


def cover(body: CollisionBody) -> tuple[Array, float]:
    """Return centres (K, 3) in the body's frame, m, and the radius, m, of equal spheres that touch its sides from inside.

    Args:
        body: the body.
    """
    inner = float(body.half_extents.min())
    half = np.maximum(body.half_extents - inner, 0.0)
    counts = [int(np.ceil(2.0 * h / (_LARGEST_SPACING * inner) - 1e-9)) + 1 if h > 1e-3 * inner else 1 for h in half.tolist()]
    lines = [np.linspace(-h, h, count) if count > 1 else np.zeros(1) for h, count in zip(half.tolist(), counts, strict=True)]
    lattice = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(body.p_FB + lattice @ body.R_FG.T), inner


def _primitive(body: CollisionBody) -> Solid:
    """Return the primitive around a body, about the centre of its box."""
    x, _, z = body.half_extents.tolist()
    if body.kind == "sphere":
        return Sphere(x)
    return Cylinder(x, 2.0 * z) if body.kind in ("cylinder", "capsule") else Box(2.0 * body.half_extents)


def _sizes(body: CollisionBody) -> Array:
    """Return the half sizes of the primitive around a body, m: radius; radius and half height; or half edges."""
    return body.half_extents[{"sphere": [0], "cylinder": [0, 2], "capsule": [0, 2]}.get(body.kind, [0, 1, 2])]


def _least_distance(centre: Array, small: CollisionBody, large: CollisionBody, guess: FramePoses) -> float:
    """Return the least distance of a point of one body from the primitive around another in the first guess, m."""
    p = guess.p[:, small.frame] + guess.R[:, small.frame] @ centre - guess.p[:, large.frame]
    x = (guess.R[:, large.frame].swapaxes(1, 2) @ p[:, :, None])[:, :, 0] - large.p_FB
    return float(_primitive(large).phi(x @ large.R_FG).min())


def _row(
    hand: Hand,
    frames: Mapping[int, MovingFrame],
    bodies: tuple[CollisionBody, CollisionBody],
    centre: Array,
    least: float,
    first: tuple[FramePoses, Array],
) -> SeparationRow:
    """Return the row of a sphere about a point of the first body that keeps a distance from the second."""
    (small, large), (guess, x) = bodies, first
    kinds, places, numbers, points, axes = [], [], [], [], []
    for body, point in ((small, centre), (large, large.p_FB)):
        frame = frames.get(body.frame)
        if frame is None:  # at rest in the first guess
            p, R = guess.p[0, body.frame], guess.R[0, body.frame]
            kinds.append((_FIXED, -1))
            points.append(p + R @ point)
            axes.append(R @ body.R_FG)
        else:
            kinds.append((frame.kind, frame.link))
            places.append(frame.places)
            numbers.append(frame.numbers)
            points.append(frame.R_0 @ point)
            axes.append(frame.R_0 @ body.R_FG)
    e = separation_equations(hand, kinds[0], kinds[1], type(_primitive(large)))
    parameters = np.concatenate([*numbers, points[0], points[1], axes[1].ravel(), _sizes(large), [least]])
    variables = np.concatenate(places)
    at_ends = [float(e.value(x[k, variables], parameters)) for k in (0, -1)]
    return e, places, parameters, np.array([min(1.0, *at_ends) - _END_TOLERANCE]), np.full(1, np.inf)


@lru_cache(maxsize=256)
def separation_equations(hand: Hand, one: tuple[str, int], other: tuple[str, int], kind: type[Solid]) -> Equations:
    """Return the equation of a sphere outside a primitive; ≥ 1 if it keeps its distance.

    Variables: those of both frames. Parameters: the numbers of both frames, the sphere's centre and the primitive's centre and
    axes in their frames, the primitive's half sizes, and the distance from the sphere's centre.

    Args:
        hand: the hand.
        one: kind and link of the sphere's frame.
        other: kind and link of the primitive's frame.
        kind: Sphere, Cylinder or Box.
    """
    variables: list[ca.SX] = []
    numbers: list[ca.SX] = []
    poses: list[tuple[ca.SX, ca.SX]] = []
    for i, (frame, link) in enumerate((one, other)):
        if frame == _FIXED:
            poses.append((ca.SX.zeros(3), ca.SX.eye(3)))
            continue
        count = 6 if frame == _OBJECT else len(hand.finger(frame).joints)
        variables.append(ca.SX.sym(f"x{i}", count))
        numbers.append(ca.SX.sym(f"n{i}", 5 if frame == _OBJECT else count))
        if frame == _OBJECT:
            poses.append(_object_pose(variables[-1], numbers[-1]))
        else:
            p, R = symbolic_link(hand, frame, link)(numbers[-1] * variables[-1])
            poses.append((p, R))
    centre, middle, axes = ca.SX.sym("centre", 3), ca.SX.sym("middle", 3), ca.SX.sym("axes", 9)
    sizes, least = ca.SX.sym("sizes", {Sphere: 1, Cylinder: 2, Box: 3}[kind]), ca.SX.sym("least")
    (p_one, R_one), (p_other, R_other) = poses
    offset = R_other.T @ (p_one + R_one @ centre - p_other) - middle
    x = ca.reshape(axes, 3, 3) @ offset  # axes are given by rows and reshaped by columns: this is the transpose
    parameters = ca.vertcat(*numbers, centre, middle, axes, sizes, least)
    return make_equations("separation", ca.vertcat(*variables), parameters, outside_level(kind, x, sizes, least))


def _object_pose(y: ca.SX, numbers: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the position of the object, and its rotation from R₀, for Cayley parameters."""
    r = numbers[4] * y[3:]
    S = ca.skew(r)
    return numbers[:3] + numbers[3] * y[:3], ca.SX.eye(3) + 2.0 / (1.0 + ca.dot(r, r)) * (S + S @ S)

"""A hand above a table with an object: the direction of gravity for which the object of a grasp stands on a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.constants import STANDARD_GRAVITY
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Shape, Sphere, Superquadric, TriangleMesh
from graspforce.geometry.vectors import table_axes
from graspforce.grasp.body import Body
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import GraspSearchOptions, find_grasp
from graspforce.hand.hand import Hand
from graspforce.hand.shapes.collision_body import CollisionBody, object_geometry, place, signed_distance
from graspforce.simulation.cycle.rest import is_stable

_TABLE = Box((1.0, 1.0, 0.02))
_IDLE_POSTURES = 12  # random postures of idle fingers that are tried
LEAST_CLEARANCE = 0.005  # m, of the hand from the table


@dataclass(frozen=True, eq=False, slots=True)
class TableScene:
    """A grasp of an object that stands on a table.

    Attributes:
        grasp: the grasp.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        height: distance of the table below the object's origin, m.
        clearance: least distance of the hand from the table in the grasp, m.
    """

    grasp: Grasp
    gravity_H: Array
    height: float
    clearance: float

    @property
    def down(self) -> Array:
        """(3,) unit vector along gravity, in H."""
        return np.asarray(self.gravity_H / STANDARD_GRAVITY)

    @property
    def table(self) -> Obstacle:
        """The table as an obstacle, a plate of 1 m by 1 m."""
        centre = self.grasp.p_HO + (self.height + 0.5 * float(_TABLE.edges[2])) * self.down
        return Obstacle(_TABLE, centre, _axes_with_third(self.down))


def rest_faces(shape: Shape | None) -> list[tuple[Array, float]]:
    """Return the directions (3,) in O that may point down while the object stands, and the table's distances along them, m.

    A sphere gets 26 directions, a cylinder its flat faces, a box its six faces, a superquadric the ends of its axes on
    which it is stable, and a convex mesh its faces below the centre of volume.

    Args:
        shape: surface of the object.

    Raises:
        InvalidInput: no solid.
    """
    axes = np.vstack([np.eye(3), -np.eye(3)])
    if isinstance(shape, Sphere):
        grid = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3)).reshape(3, -1).T
        grid = grid[np.abs(grid).sum(axis=1) > 0.0]
        return [(d, shape.radius) for d in grid / np.linalg.norm(grid, axis=1)[:, None]]
    if isinstance(shape, Cylinder):
        return [(d, 0.5 * shape.height) for d in axes[[2, 5]]]
    if isinstance(shape, Box):
        return [(d, 0.5 * float(np.abs(d) @ shape.edges)) for d in axes]
    if isinstance(shape, Superquadric):
        return [(d, float(np.abs(d) @ shape.axes)) for d in axes if is_stable(shape, d)]
    if isinstance(shape, TriangleMesh):
        return _mesh_faces(shape)
    raise InvalidInput("body.shape", type(shape).__name__, "a solid: its faces decide how it stands")


def scene_on_table(grasp: Grasp) -> TableScene:
    """Return the grasp with its object on the table that is furthest from the hand; idle fingers are moved away from it.

    Args:
        grasp: the grasp.

    Raises:
        InvalidInput: the object's shape is no solid.
    """
    scenes = []
    for direction, height in rest_faces(grasp.body.shape):
        scene = TableScene(grasp, freeze(STANDARD_GRAVITY * grasp.R_HO @ direction), height, 0.0)
        scenes.append(_with_idle_fingers(scene))
    return max(scenes, key=lambda each: each.clearance)


def find_table_grasp(
    hand: Hand,
    body: Body,
    fingers: Sequence[str] | None = None,
    *,
    friction: float = 0.6,
    seed: int = 0,
    edge_ratio: float = 1.0,
) -> TableScene:
    """Find a grasp of an object on a table, with a search whose hand stays above the table.

    The seed also chooses the face on which the object stands during the search, in turn. The result has the table where it is
    furthest from the hand.

    Args:
        hand: the hand.
        body: the object.
        fingers: as in `find_grasp`.
        friction: coefficient of friction.
        seed: of the search.
        edge_ratio: least distance of a contact from the edge of its face, divided by the tip radius: a finger should touch the
            face although the object is not quite where it is expected.

    Raises:
        InvalidInput: no grasp is found, or the hand in it is nearer to the table than 5 mm.
    """
    faces = rest_faces(body.shape)
    options = GraspSearchOptions(up_O=-faces[seed % len(faces)][0], edge_ratio=edge_ratio)
    scene = scene_on_table(find_grasp(hand, body, fingers, friction=friction, seed=seed, options=options))
    if scene.clearance < LEAST_CLEARANCE:
        found = f"a grasp with {1e3 * scene.clearance:.1f} mm between hand and table"
        raise InvalidInput("body", found, f"a grasp with {1e3 * LEAST_CLEARANCE:g} mm")
    return scene


def hand_clearance(scene: TableScene, q: Array) -> float:
    """Return the least distance of the links and the palm from the table, m; negative for an overlap.

    Args:
        scene: the scene.
        q: (n,) joint positions, rad.
    """
    grasp = scene.grasp
    collision = SceneCollision(grasp.hand)
    poses = collision.poses(q[None])
    obstacle = scene.table
    table = CollisionBody.of_geometry("table", -1, object_geometry(obstacle.shape), obstacle.p_HO, obstacle.R_HO)
    there = place(table, np.zeros(3), np.eye(3))
    distances = [
        signed_distance(link, place(link, poses.p[0, link.frame], poses.R[0, link.frame]), table, there)[0]
        for link in collision.links
    ]
    tips = []
    for finger in grasp.hand.fingers:
        below = (grasp.hand.tip_pose(q, finger.name)[0] - grasp.p_HO) @ scene.down
        tips.append(scene.height - float(below) - (finger.tip_radius or 0.0))
    return float(min(*distances, *tips))


def _with_idle_fingers(scene: TableScene) -> TableScene:
    """Return the scene with the idle fingers in the posture that is furthest from the table and free of collisions."""
    grasp = scene.grasp
    hand = grasp.hand
    idle = [j for finger in hand.fingers if finger.name not in grasp.fingers for j in finger.joints]
    idle = [j for j in idle if not any(j in hand.finger(name).joints for name in grasp.fingers)]
    candidates = [np.array(grasp.q)]
    if idle:
        rng = np.random.default_rng(0)
        middle = 0.5 * (hand.q_lower + hand.q_upper)
        postures = [hand.neutral, middle, *rng.uniform(hand.q_lower, hand.q_upper, (_IDLE_POSTURES, hand.n))]
        for posture in postures:
            q = np.array(grasp.q)
            q[idle] = posture[idle]
            candidates.append(q)
    collision = SceneCollision(hand, grasp.body.shape, grasp.fingers, CollisionSettings())
    best, clearance = grasp.q, -np.inf
    for q in candidates:
        gap = collision.least_gap(q, grasp.p_HO, grasp.R_HO)
        least = hand_clearance(scene, q)
        if gap is not None and gap.distance <= 0.0 and q is not candidates[0]:
            continue
        if least > clearance:
            best, clearance = q, least
    return replace(scene, grasp=replace(grasp, q=best), clearance=float(clearance))


def _mesh_faces(shape: TriangleMesh) -> list[tuple[Array, float]]:
    """Return the faces of a mesh's convex hull that lie below its centre of volume."""
    from scipy.spatial import ConvexHull  # imported here, because it is slow to import

    hull = ConvexHull(shape.vertices)
    faces = []
    for equation in np.unique(np.round(hull.equations, 9), axis=0):
        n, distance = equation[:3], -float(equation[3])
        foot = shape.centre + (distance - n @ shape.centre) * n
        corners = shape.vertices[np.abs(shape.vertices @ n - distance) < 1e-6]
        if len(corners) >= 3 and _is_inside(foot, corners, n):
            faces.append((n, distance))
    return faces


def _is_inside(p: Array, corners: Array, n: Array) -> bool:
    """Return whether a point of a plane is inside the convex polygon of corners in any order."""
    axes = table_axes(n)
    flat = (corners - p) @ axes.T
    angles = np.sort(np.arctan2(flat[:, 1], flat[:, 0]))
    return bool(np.diff(np.append(angles, angles[0] + 2.0 * np.pi)).max() < np.pi)


def _axes_with_third(direction: Array) -> Array:
    """Return a rotation matrix whose third axis is a unit vector."""
    first, second = table_axes(direction)
    if np.linalg.det(np.array([first, second, direction])) < 0.0:
        first, second = second, first
    return np.column_stack([first, second, direction])

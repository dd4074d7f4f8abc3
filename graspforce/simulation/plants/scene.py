"""The scene: a MuJoCo model of a hand and the object in its grasp, checked against Pinocchio's model of the hand.

The world frame is H: the hand's base is fixed at its origin, and gravity is given in H. Each link of the kinematic tree is a
body with the same inertia. A dependent joint of a coupling follows its leading joint by an equality constraint. A locked joint
is a fixed transform. Fingertips are spheres or convex hulls of meshes; they collide with the object. The collision shapes of
the links and the palm collide with the object, the floor and one another; see `link_geoms`. Of an object that is a mesh,
spherical fingertips touch the smooth surface, see `surface_contacts`; links and floor touch its convex hull.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactModel
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.geometry import TriangleMesh
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp, check_grasp
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.simulation.plants import meshes
from graspforce.simulation.plants.engine_settings import EngineSettings
from graspforce.simulation.plants.link_geoms import LINK_FRICTION, add_link_geoms
from graspforce.simulation.plants.scene_parts import (
    FLOOR,
    OBJECT,
    add_contact_pair,
    add_floor,
    add_hand,
    add_object,
    make_passive_geom,
    moving_joints,
    set_engine_options,
)
from graspforce.simulation.plants.surface_contacts import HULL_MARGIN, SurfaceContacts
from graspforce.simulation.plants.tendon_parts import motor_map

TipGeometry = Literal["ball", "mesh"]

DEFAULT_TIP_RADIUS = 0.005  # m, of fingertips without a radius: much smaller than objects, much larger than the penetration
TIP_GEOMETRIES: tuple[TipGeometry, ...] = ("ball", "mesh")

_MODEL_TOLERANCE = 1e-9  # relative; MuJoCo and Pinocchio round differently


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled scene, with the indices of its parts in MuJoCo's arrays.

    Attributes:
        grasp: the grasp from which the scene was built.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        engine: settings of the engine.
        spec: specification of the model, for extensions or export as MJCF.
        model: compiled model.
        q_address: (n_moving,) indices of the moving joints in qpos.
        v_address: (n_moving,) indices of the moving joints in qvel.
        T: (n_moving, n) coupling matrix: positions of the moving joints are T q + q0.
        q0: (n_moving,) coupling offsets, rad.
        motor_joints: (n,) indices of the motors' joints among the moving ones; of an opposed motion, of one of its joints.
        motor_map: (n, n_moving) S: motors' coordinates q = S (positions of the moving joints − q0).
        object_q_address: index of the object's first coordinate in qpos.
        object_v_address: index of the object's first velocity in qvel.
        object_body: index of the object's body.
        object_geom: index of the object's geom.
        floor_geom: index of the floor's geom; None without a floor.
        tip_bodies: indices of the links with the grasp's fingertips, in the order of its contacts.
        tip_geoms: indices of the fingertips' geoms, in the same order.
        contact_pairs: indices of the fingertips' contact pairs with the object, in the same order.
        tip_radius: (N,) radii of the fingertips, m.
        surface: the surface that fingertips touch if the object is a mesh and they are spheres; None otherwise.
    """

    grasp: Grasp
    gravity_H: Array
    engine: EngineSettings
    spec: mujoco.MjSpec = field(repr=False)
    model: mujoco.MjModel = field(repr=False)
    q_address: npt.NDArray[np.intp]
    v_address: npt.NDArray[np.intp]
    T: Array
    q0: Array
    motor_joints: npt.NDArray[np.intp]
    motor_map: Array
    object_q_address: int
    object_v_address: int
    object_body: int
    object_geom: int
    floor_geom: int | None
    tip_bodies: tuple[int, ...]
    tip_geoms: tuple[int, ...]
    contact_pairs: tuple[int, ...]
    tip_radius: Array
    surface: SurfaceContacts | None

    def tip_index(self, contact: mujoco.MjContact) -> int | None:
        """Return the index of the grasp's fingertip in a contact; None for other contacts.

        Args:
            contact: a contact of MuJoCo.
        """
        geoms = contact.geom.tolist()
        return next((i for i, geom in enumerate(self.tip_geoms) if geom in geoms), None)


def build_scene(
    grasp: Grasp,
    *,
    gravity_H: npt.ArrayLike = GRAVITY_PALM_UP,
    engine: EngineSettings | None = None,
    body: Body | None = None,
    floor: float | None = None,
    tip_geometry: TipGeometry = "ball",
    directories: Sequence[str | os.PathLike[str]] = (),
) -> Scene:
    """Build the scene of a grasp, and check its hand against Pinocchio's.

    The controller models fingertips as spheres about the tip frames. With ``tip_geometry="mesh"`` the plant uses the shapes of
    the hand's URDF, and its contacts deviate from the controller's.

    Args:
        grasp: hand, object and contacts; the contacts give the friction.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        engine: settings of the engine.
        body: the true object, if its mass or inertia differs from the grasp's.
        floor: distance of a floor below the object's origin, m; none by default. It collides with the object
            and the moving links.
        tip_geometry: "ball", or "mesh" for the convex hulls of `Hand.tip_mesh`.
        directories: directories to search for mesh files, as in `Hand.tip_mesh`.

    Raises:
        InvalidInput: unknown tip geometry; the object has no shape, or one that MuJoCo lacks; a mesh that is not convex with
            fingertips that are meshes; a floor without gravity.
        ModelError: MuJoCo cannot build the hand, its dynamics differ from Pinocchio's, or a mesh is missing.
    """
    fields.check_choice(tip_geometry, "tip_geometry", TIP_GEOMETRIES)
    engine = engine or EngineSettings()
    shape = (body or grasp.body).shape or grasp.body.shape
    surface = shape if isinstance(shape, TriangleMesh) and tip_geometry == "ball" else None
    if isinstance(shape, TriangleMesh) and surface is None and not shape.is_convex:
        raise InvalidInput("tip_geometry", tip_geometry, '"ball" for a mesh that is not convex: MuJoCo would fill its hollows')
    gravity_H = arrays.check_array(gravity_H, "gravity_H", (3,))
    hand, tree = check_grasp(grasp).hand, grasp.hand.tree()
    radii = _tip_radii(grasp)

    spec = mujoco.MjSpec()
    spec.modelname = hand.name
    set_engine_options(spec, engine, gravity_H)
    bodies = add_hand(spec, hand, tree, engine)
    for i, name in enumerate(grasp.fingers):
        if tip_geometry == "mesh":
            geom = meshes.add_mesh_geom(spec, bodies, hand.tip_mesh(name, directories))
        else:
            tip = next(tip for tip in tree.tips if tip.finger == name)
            carrier = bodies[tip.link] if tip.link >= 0 else spec.worldbody
            geom = carrier.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radii[i], 0.0, 0.0], pos=tip.p_LF)
        make_passive_geom(geom, f"tip {name}")
    add_object(spec, body or grasp.body, grasp)
    others = (OBJECT,) if floor is None else (OBJECT, FLOOR)
    if floor is not None:
        add_floor(spec, grasp, gravity_H, arrays.check_number(floor, "floor", above=0.0), engine)
    if engine.solid_links:
        pairs = add_link_geoms(spec, lambda link: bodies[link] if link >= 0 else spec.worldbody, grasp, others)
        for first, second in pairs:
            add_contact_pair(spec, first, second, ContactModel.POINT, (LINK_FRICTION, 0.0), engine)
    for i, name in enumerate(grasp.fingers):
        mu, gamma = grasp.contacts.mu[i], grasp.contacts.gamma[i]
        pair = add_contact_pair(spec, f"tip {name}", OBJECT, grasp.contacts.models[i], (mu, gamma), engine)
        if surface is not None:
            pair.margin = HULL_MARGIN
    try:
        model = spec.compile()
    except ValueError as error:
        raise ModelError(f"{hand.name}: MuJoCo cannot build it: {error}") from None

    scene = _index_scene(grasp, gravity_H, engine, spec, model, surface)
    check_against_pinocchio(scene)
    return scene


def check_against_pinocchio(scene: Scene) -> float:
    """Check MuJoCo's hand against Pinocchio's: mass matrix Tᵀ M T + D, gravity torque, inverse dynamics.

    The check covers the grasp, the neutral posture and three random postures.

    Args:
        scene: the scene to check.

    Returns:
        The largest relative difference.

    Raises:
        ModelError: a difference exceeds rounding.
    """
    hand, model = scene.grasp.hand, scene.model
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)  # the same postures on every call
    postures = [scene.grasp.q, hand.neutral, *rng.uniform(hand.q_lower, hand.q_upper, (3, hand.n))]
    largest, rest = 0.0, np.zeros(hand.n)
    for q in postures:
        v = rng.uniform(-1.0, 1.0, hand.n) * hand.velocity_limit
        for name, value, expected in (
            ("mass matrix", _mass_matrix(scene, data, q), hand.mass_matrix(q)),
            ("gravity", _bias_torque(scene, data, q, rest), hand.gravity_torque(q, scene.gravity_H)),
            ("inverse dynamics", _bias_torque(scene, data, q, v), hand.inverse_dynamics(q, v, rest, scene.gravity_H)),
        ):
            difference = float(np.abs(value - expected).max() / max(np.abs(expected).max(), 1e-12))
            if difference > _MODEL_TOLERANCE:
                raise ModelError(f"{hand.name}: MuJoCo's {name} differs from Pinocchio's by {difference:.1g}, relative")
            largest = max(largest, difference)
    return largest


def set_posture(scene: Scene, data: mujoco.MjData, q: Array, v: Array) -> None:
    """Set positions and velocities of all joints of the hand, dependent ones included.

    Args:
        scene: the scene of the data.
        data: of MuJoCo; its qpos and qvel are changed.
        q: (n,) posture, rad.
        v: (n,) joint rates, rad/s.
    """
    data.qpos[scene.q_address] = scene.T @ q + scene.q0
    data.qvel[scene.v_address] = scene.T @ v


def _index_scene(
    grasp: Grasp,
    gravity_H: Array,
    engine: EngineSettings,
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    surface: TriangleMesh | None,
) -> Scene:
    """Return the scene of a compiled model, with the indices of its parts."""
    hand, is_moving = grasp.hand, moving_joints(grasp.hand)
    moving = [name for name, moves in zip(hand.full_joints, is_moving, strict=True) if moves]
    joints = [model.joint(name).id for name in moving]
    free_joint, object_geom = model.joint(OBJECT).id, int(model.geom(OBJECT).id)
    tip_geoms = tuple(int(model.geom(f"tip {name}").id) for name in grasp.fingers)
    return Scene(
        grasp=grasp,
        gravity_H=gravity_H,
        engine=engine,
        spec=spec,
        model=model,
        q_address=np.array([model.jnt_qposadr[j] for j in joints], dtype=np.intp),
        v_address=np.array([model.jnt_dofadr[j] for j in joints], dtype=np.intp),
        T=freeze(hand.T[is_moving]),
        q0=freeze(hand.q0[is_moving]),
        motor_joints=np.array([_motor_joint(hand, column, moving) for column in range(hand.n)], dtype=np.intp),
        motor_map=motor_map(hand, moving),
        object_q_address=int(model.jnt_qposadr[free_joint]),
        object_v_address=int(model.jnt_dofadr[free_joint]),
        object_body=int(model.body(OBJECT).id),
        object_geom=object_geom,
        floor_geom=next((i for i in range(model.ngeom) if model.geom(i).name == FLOOR), None),
        tip_bodies=tuple(int(model.geom(f"tip {name}").bodyid[0]) for name in grasp.fingers),
        tip_geoms=tip_geoms,
        contact_pairs=tuple(int(model.pair(f"tip {name} on {OBJECT}").id) for name in grasp.fingers),
        tip_radius=freeze(_tip_radii(grasp)),
        surface=None if surface is None else SurfaceContacts(surface, object_geom, tip_geoms),
    )


def _motor_joint(hand: Hand, column: int, moving: list[str]) -> int:
    """Return the index of a motor's joint among the moving ones; the last joint of an opposed motion."""
    if hand.joints[column].name in moving:
        return moving.index(hand.joints[column].name)
    return moving.index(hand.full_joints[int(np.flatnonzero(hand.T[:, column])[-1])])


def _tip_radii(grasp: Grasp) -> list[float]:
    """Return the radii of the grasp's fingertips, m."""
    return [grasp.hand.finger(name).tip_radius or DEFAULT_TIP_RADIUS for name in grasp.fingers]


def _mass_matrix(scene: Scene, data: mujoco.MjData, q: Array) -> Array:
    """Return MuJoCo's mass matrix in the motors' coordinates."""
    set_posture(scene, data, q, np.zeros(scene.grasp.hand.n))
    mujoco.mj_forward(scene.model, data)
    full = np.zeros((scene.model.nv, scene.model.nv))
    mujoco.mj_fullM(scene.model, data, full)
    M = full[np.ix_(scene.v_address, scene.v_address)]
    return np.asarray(scene.T.T @ M @ scene.T)


def _bias_torque(scene: Scene, data: mujoco.MjData, q: Array, v: Array) -> Array:
    """Return MuJoCo's torques at zero acceleration, in the motors' coordinates."""
    set_posture(scene, data, q, v)
    mujoco.mj_forward(scene.model, data)
    return np.asarray(scene.T.T @ data.qfrc_bias[scene.v_address])

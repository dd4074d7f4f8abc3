"""The scene: a MuJoCo model of a hand that holds an object, built from the hand's own links and checked against it.

W is H: the hand's base is fixed at the world's origin, and gravity points where the palm's attitude puts it. Links are bodies
with the tree's exact inertials; a follower of a coupling is held to its leader by a joint equality; a locked joint is none.
Fingertips are balls, or on demand convex hulls of the hand's own meshes, that touch the object and nothing else; what else is
drawn, links as bars or by their meshes, touches nothing.

Every number that decides how the engine behaves stands in `EngineSettings`, with its reason. Source: the MuJoCo documentation,
chapters "Computation" (constraint model, solref and solimp, noslip) and "Modeling"; the figures were measured with
benchmarks/closed_loop.py.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from graspforce.contact.contact import ContactModel
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.geometry import Box, Cylinder, Shape, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.hand.kinematic_tree import KinematicTree
from graspforce.simulation import meshes

DEFAULT_TIP_RADIUS = (
    0.005  # m: the ball of a fingertip that has no radius; small beside the objects, large beside the penetration
)
TIP_GEOMETRIES = ("ball", "mesh")
OBJECT = "object"
FLOOR = "floor"

_MODEL_TOLERANCE = 1e-9  # relative: MuJoCo and Pinocchio add the same numbers in another order
_CONDIM = {ContactModel.FRICTIONLESS: 1, ContactModel.POINT: 3, ContactModel.SOFT: 4}


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """How MuJoCo computes. The defaults are for contacts that hold for a minute.

    Args:
        dt: the time step, s. One control step at 1 kHz; contacts of 4 ms need at least two steps in that time.
        impratio: how much harder friction is than the normal force. Friction in MuJoCo is a stiff damper, so that what is
            held creeps, the slower the harder it is. A hand whose structure bears part of the load shows it most: three
            planar fingers about a cube let it turn by 0.2 °/s at 100, 0.02 at 1000, 0.0002 at 10000, at no cost.
        noslip: rounds of the pass after the solver that takes the rest of friction's softness out. Without it a 50 g sphere
            between three fingers that do not move creeps out of the grasp.
        solref: the contact's time constant, s, and damping ratio. Two steps is the least that is stable; a longer one sinks
            further, as its square.
        solimp: how much of a contact's violation the constraint takes out at no and at full depth (0 to 1), and the depth, m.
            Nearer to 1 sinks less, but leaves the solver an ill-conditioned problem. With these a newton sinks 20 µm.
        coupling_solref, coupling_solimp: the same for followers of couplings. They carry no impact, so they are as hard as
            the time step allows.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    dt: float = 1e-3
    impratio: float = 10_000.0
    noslip: int = 20
    solref: tuple[float, float] = (0.004, 1.0)
    solimp: tuple[float, float, float] = (0.95, 0.99, 0.001)
    coupling_solref: tuple[float, float] = (0.002, 1.0)
    coupling_solimp: tuple[float, float, float] = (0.9999, 0.9999, 0.001)

    def __post_init__(self) -> None:
        object.__setattr__(self, "dt", arrays.check_number(self.dt, "dt", above=0.0))
        object.__setattr__(self, "impratio", arrays.check_number(self.impratio, "impratio", above=0.0))
        object.__setattr__(self, "noslip", fields.check_integer(self.noslip, "noslip", minimum=0, maximum=10_000))


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled scene, and where in MuJoCo's arrays its parts stand.

    Attributes:
        hold: what it was built from.
        gravity_H: (3,) m/s².
        engine: how it computes.
        spec: the MjSpec, for who wants to add to it or write it as MJCF.
        model: the compiled MjModel.
        q_address, v_address: (n_moving,) where the moving joints stand in qpos and qvel.
        T, q0: (n_moving, n) and (n_moving,): the moving joints' positions are T q + q0.
        leaders: (n,) which of the moving joints the motors drive.
        object_q_address, object_v_address: where the object's free joint begins in qpos and qvel.
        object_body, object_geom: its body and its surface.
        tip_bodies, tip_geoms: the fingertips of the hold's contacts, in order: the links that carry them, and what touches.
        pairs: the contact pairs of those fingertips with the object.
        tip_radius: (N,) of the balls, m.
    """

    grasp: Grasp
    gravity_H: Array
    engine: EngineSettings
    spec: Any = field(repr=False)
    model: Any = field(repr=False)
    q_address: np.ndarray[Any, np.dtype[np.intp]]
    v_address: np.ndarray[Any, np.dtype[np.intp]]
    T: Array
    q0: Array
    motor_joints: np.ndarray[Any, np.dtype[np.intp]]
    object_q_address: int
    object_v_address: int
    object_body: int
    object_geom: int
    tip_bodies: tuple[int, ...]
    tip_geoms: tuple[int, ...]
    contact_pairs: tuple[int, ...]
    tip_radius: Array

    def tip_index(self, contact: Any) -> int | None:
        """Which of the hold's fingertips one of MuJoCo's contacts belongs to; None where to none."""
        geoms = contact.geom.tolist()
        return next((i for i, geom in enumerate(self.tip_geoms) if geom in geoms), None)


def build_scene(
    grasp: Grasp,
    *,
    gravity_H: Any = GRAVITY_PALM_UP,
    engine: EngineSettings | None = None,
    body: Body | None = None,
    floor: float | None = None,
    tips: str = "ball",
    directories: Sequence[str | os.PathLike[str]] = (),
) -> Scene:
    """The scene of a hold, its hand checked against Pinocchio.

    The controller believes in balls about the tip frames. With ``tips="mesh"`` the plant's fingertips are what the hand's model
    says they are, and the contacts lie elsewhere by as much as the one is off the other.

    Args:
        hold: the hand, the object with its shape, and which fingertips touch it; friction is the contacts' own.
        gravity_H: (3,) the acceleration of gravity in H, m/s².
        engine: how MuJoCo computes.
        body: the object as it really is, where that differs from what the hold believes of its mass and inertia.
        floor: how far below the object's origin a floor lies, m; none by default. It touches the object alone.
        tips: "ball", or "mesh": the convex hulls of `Hand.tip_mesh`.
        directories: where the files of meshes are looked for, as in `Hand.meshes`.

    Raises:
        InvalidInput: the object has no shape, or one that MuJoCo does not have; other tips.
        ModelError: MuJoCo cannot build the hand, or its mass matrix or gravity is not the hand's; a mesh is not there.
    """
    fields.check_choice(tips, "tips", TIP_GEOMETRIES)
    engine = engine or EngineSettings()
    gravity_H = arrays.check_array(gravity_H, "gravity_H", (3,))
    body = body or grasp.body
    hand, tree = grasp.hand, grasp.hand.tree()
    radius = freeze([hand.finger(name).tip_radius or DEFAULT_TIP_RADIUS for name in grasp.fingers])

    spec = mujoco.MjSpec()
    spec.modelname = hand.name
    _set_engine_options(spec, engine, gravity_H)
    moves = np.any(hand.T != 0.0, axis=1)  # a locked joint's row of T is zero
    bodies = _add_hand(spec, hand, tree, moves, engine)
    for i, name in enumerate(grasp.fingers):
        if tips == "mesh":
            geom = meshes.add_mesh_geom(spec, bodies, hand.tip_mesh(name, directories))
        else:
            tip = next(tip for tip in tree.tips if tip.finger == name)
            geom = bodies[tip.link].add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius[i], 0.0, 0.0], pos=tip.p_LF)
        make_passive_geom(geom, f"tip {name}")
    _add_object(spec, body, grasp)
    if floor is not None:
        _add_floor(spec, grasp, gravity_H, arrays.check_number(floor, "floor", above=0.0), engine)
    for i, name in enumerate(grasp.fingers):
        _add_contact_pair(
            spec, f"tip {name}", OBJECT, grasp.contacts.models[i], grasp.contacts.mu[i], grasp.contacts.gamma[i], engine
        )
    try:
        model = spec.compile()
    except ValueError as error:
        raise ModelError(f"{hand.name}: MuJoCo cannot build it: {error}") from None

    moving = [name for name, moving in zip(hand.full_joints, moves, strict=True) if moving]
    joints = [model.joint(name).id for name in moving]
    free = model.joint(OBJECT).id
    scene = Scene(
        grasp=grasp,
        gravity_H=gravity_H,
        engine=engine,
        spec=spec,
        model=model,
        q_address=np.array([model.jnt_qposadr[j] for j in joints], dtype=np.intp),
        v_address=np.array([model.jnt_dofadr[j] for j in joints], dtype=np.intp),
        T=freeze(hand.T[moves]),
        q0=freeze(hand.q0[moves]),
        motor_joints=np.array([moving.index(joint.name) for joint in hand.joints], dtype=np.intp),
        object_q_address=int(model.jnt_qposadr[free]),
        object_v_address=int(model.jnt_dofadr[free]),
        object_body=int(model.body(OBJECT).id),
        object_geom=int(model.geom(OBJECT).id),
        tip_bodies=tuple(int(model.geom(f"tip {name}").bodyid[0]) for name in grasp.fingers),
        tip_geoms=tuple(int(model.geom(f"tip {name}").id) for name in grasp.fingers),
        contact_pairs=tuple(int(model.pair(f"tip {name} on {OBJECT}").id) for name in grasp.fingers),
        tip_radius=radius,
    )
    check_against_pinocchio(scene)
    return scene


def check_against_pinocchio(scene: Scene) -> float:
    """Whether MuJoCo's hand is Pinocchio's: Tᵀ M T + D, gravity and the velocity's forces, at the hold and at other postures.

    Returns:
        The largest relative difference that was found.

    Raises:
        ModelError: it is more than rounding makes.
    """
    hand, model = scene.grasp.hand, scene.model
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)  # the same postures on every call
    postures = [scene.grasp.q, hand.neutral, *rng.uniform(hand.q_lower, hand.q_upper, (3, hand.n))]
    worst = 0.0
    for q in postures:
        v = rng.uniform(-1.0, 1.0, hand.n) * hand.velocity_limit
        for name, got, want in (
            ("mass matrix", *_mass_matrices(scene, data, q)),
            ("gravity", _bias_torque(scene, data, q, np.zeros(hand.n)), hand.gravity_torque(q, scene.gravity_H)),
            (
                "inverse dynamics",
                _bias_torque(scene, data, q, v),
                hand.inverse_dynamics(q, v, np.zeros(hand.n), scene.gravity_H),
            ),
        ):
            off = float(np.abs(got - want).max() / max(np.abs(want).max(), 1e-12))
            if off > _MODEL_TOLERANCE:
                raise ModelError(f"{hand.name}: MuJoCo's {name} differs from the hand's own by {off:.1g} of its size")
            worst = max(worst, off)
    return worst


def _mass_matrices(scene: Scene, data: Any, q: Array) -> tuple[Array, Array]:
    """MuJoCo's mass matrix in the actuated coordinates, and the hand's."""
    set_posture(scene, data, q, np.zeros(scene.grasp.hand.n))
    mujoco.mj_forward(scene.model, data)
    full = np.zeros((scene.model.nv, scene.model.nv))
    mujoco.mj_fullM(scene.model, data, full)
    M = full[np.ix_(scene.v_address, scene.v_address)]
    return scene.T.T @ M @ scene.T, scene.grasp.hand.mass_matrix(q)


def _bias_torque(scene: Scene, data: Any, q: Array, v: Array) -> Array:
    set_posture(scene, data, q, v)
    mujoco.mj_forward(scene.model, data)
    return np.asarray(scene.T.T @ data.qfrc_bias[scene.v_address])


def set_posture(scene: Scene, data: Any, q: Array, v: Array) -> None:
    """Put the hand's joints, followers included, where the actuated coordinates say."""
    data.qpos[scene.q_address] = scene.T @ q + scene.q0
    data.qvel[scene.v_address] = scene.T @ v


# ── parts ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _set_engine_options(spec: Any, engine: EngineSettings, gravity_H: Array) -> None:
    option = spec.option
    option.timestep = engine.dt
    option.gravity = gravity_H
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC  # the law's own cone; pyramids also creep a thousand times faster
    option.impratio = engine.impratio
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # damping implicit, the rest semi-implicit Euler
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations, option.tolerance = 100, 1e-12  # converge: some ten iterations, and a hold is judged by micrometres
    option.noslip_iterations, option.noslip_tolerance = engine.noslip, 0.0
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # small; and MuJoCo 4.0.0 factorises sparse Hessians wrongly
    if hasattr(mujoco.mjtDisableBit, "mjDSBL_MULTICCD"):  # one contact of a pair, as the controller has it: not a patch of four
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD
    spec.compiler.degree = False
    spec.compiler.autolimits = False


def _add_hand(spec: Any, hand: Hand, tree: KinematicTree, moves: Any, engine: EngineSettings) -> list[Any]:
    """The links, one body each, in the tree's order."""
    rotor = dict(zip([joint.name for joint in hand.joints], hand.rotor_inertia, strict=True))
    bodies: list[Any] = []
    for i, link in enumerate(tree.links):
        parent = spec.worldbody if link.parent < 0 else bodies[link.parent]
        p, R = link.p_PL, link.R_PL
        if not moves[i]:  # locked: a fixed turn or shift
            p, R = (p + R @ link.axis * hand.q0[i], R) if link.is_prismatic else (p, R @ _axis_rotation(link.axis, hand.q0[i]))
        body = parent.add_body(name=link.joint, pos=p, quat=_quaternion(R))
        body.explicitinertial = True
        body.mass, body.ipos = link.mass, link.p_LM
        body.fullinertia = _inertia_components(link.inertia)
        if moves[i]:
            kind = mujoco.mjtJoint.mjJNT_SLIDE if link.is_prismatic else mujoco.mjtJoint.mjJNT_HINGE
            joint = body.add_joint(name=link.joint, type=kind, axis=link.axis)
            joint.limited, joint.range = True, [link.lower, link.upper]
            joint.armature = rotor.get(link.joint, 0.0)  # D: the rotor turns with the joint that the motor drives
        bodies.append(body)
    for row, name in enumerate(hand.full_joints):
        if moves[row] and name not in rotor:
            column = int(np.flatnonzero(hand.T[row])[0])
            equality = spec.add_equality(
                type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, name=f"{name} follows"
            )
            equality.name1, equality.name2 = name, hand.joints[column].name
            equality.data[:5] = [hand.q0[row], hand.T[row, column], 0.0, 0.0, 0.0]
            equality.solref, equality.solimp = engine.coupling_solref, [*engine.coupling_solimp, 0.5, 2.0]
    return bodies


def _add_object(spec: Any, body: Body, grasp: Grasp) -> None:
    kind, size = _geom_of_shape(body.shape or grasp.body.shape)
    object_body_spec = spec.worldbody.add_body(name=OBJECT, pos=grasp.p_HO, quat=_quaternion(grasp.R_HO))
    object_body_spec.explicitinertial = True
    object_body_spec.mass, object_body_spec.ipos, object_body_spec.fullinertia = (
        body.mass,
        body.p_OM,
        _inertia_components(body.inertia),
    )
    object_body_spec.add_joint(name=OBJECT, type=mujoco.mjtJoint.mjJNT_FREE)
    make_passive_geom(object_body_spec.add_geom(type=kind, size=size), OBJECT)


def _geom_of_shape(shape: Shape | None) -> tuple[Any, list[float]]:
    """A shape as MuJoCo has it, exactly."""
    if isinstance(shape, Sphere):
        return mujoco.mjtGeom.mjGEOM_SPHERE, [shape.radius, 0.0, 0.0]
    if isinstance(shape, Cylinder):
        return mujoco.mjtGeom.mjGEOM_CYLINDER, [shape.radius, shape.height / 2.0, 0.0]
    if isinstance(shape, Box):
        return mujoco.mjtGeom.mjGEOM_BOX, (shape.edges / 2.0).tolist()
    if isinstance(shape, Superquadric) and np.all(shape.exponents == 1.0):
        return mujoco.mjtGeom.mjGEOM_ELLIPSOID, shape.axes.tolist()
    allowed = "a sphere, a cylinder, a box or an ellipsoid (a superquadric of exponents 1): MuJoCo has no other one exactly"
    raise InvalidInput("hold.body.shape", shape, allowed)


def _add_floor(spec: Any, grasp: Grasp, gravity_H: Array, depth: float, engine: EngineSettings) -> None:
    gravity_norm = float(np.linalg.norm(gravity_H))
    if gravity_norm == 0.0:
        raise InvalidInput("floor", depth, "absent where there is no gravity: nothing is below")
    up = -gravity_H / gravity_norm
    turn = np.zeros(4)
    mujoco.mju_quatZ2Vec(turn, up)
    plane = spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.3, 0.3, 0.01], pos=grasp.p_HO - depth * up, quat=turn
    )
    make_passive_geom(plane, FLOOR)
    _add_contact_pair(spec, FLOOR, OBJECT, ContactModel.POINT, 0.5, 0.0, engine)


def _add_contact_pair(
    spec: Any, first: str, second: str, model: ContactModel, mu: float, gamma: float, engine: EngineSettings
) -> None:
    """Two geoms that touch. condim is the contact's model: with more the plant would bear what the controller cannot use."""
    pair = spec.add_pair(name=f"{first} on {second}", geomname1=first, geomname2=second)
    pair.condim = _CONDIM[model]
    pair.friction = [mu, mu, gamma, 0.0, 0.0]
    pair.solref, pair.solimp = engine.solref, [*engine.solimp, 0.5, 2.0]


def make_passive_geom(geom: Any, name: str) -> None:
    """Name a geom and take its mass and its default collisions; it collides only through explicit pairs."""
    geom.name, geom.contype, geom.conaffinity, geom.mass = name, 0, 0, 0.0


def _inertia_components(inertia: Array) -> list[float]:
    return [float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _quaternion(R: Array) -> Array:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R).ravel())
    return quaternion


def _axis_rotation(axis: Array, angle: float) -> Array:
    quaternion, R = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    mujoco.mju_quat2Mat(R, quaternion)
    return R.reshape(3, 3)

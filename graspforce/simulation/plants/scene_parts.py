"""Parts of a scene's MuJoCo model: engine options, hand, object, floor, contact pairs."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactModel
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Shape, Sphere, Superquadric, TriangleMesh
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from graspforce.hand.kinematics.kinematic_tree import KinematicTree, Link
from graspforce.simulation.plants.engine_settings import EngineSettings
from graspforce.simulation.plants.tendon_parts import CLOSED, add_breakaways, add_differentials, find_free_differentials

OBJECT = "object"
FLOOR = "floor"

_FLOOR_FRICTION = 0.5
_ROLLING_RESISTANCE = 2e-4  # m, of objects on the table: lever arm of the normal force; hard bodies have 1e-4 to 5e-4
_CONDIM = {ContactModel.FRICTIONLESS: 1, ContactModel.POINT: 3, ContactModel.SOFT: 4}


def make_passive_geom(geom: mujoco.MjsGeom, name: str) -> None:
    """Name a geom, and remove its mass and its default collisions; it collides through explicit pairs only.

    Args:
        geom: the geom.
        name: its name.
    """
    geom.name, geom.contype, geom.conaffinity, geom.mass = name, 0, 0, 0.0


def moving_joints(hand: Hand) -> npt.NDArray[np.bool_]:
    """Return which of the hand's joints move, (n_full,); rows of locked joints are zero in T.

    Args:
        hand: the hand.
    """
    return np.asarray(np.any(hand.T != 0.0, axis=1))


def set_engine_options(spec: mujoco.MjSpec, engine: EngineSettings, gravity_H: Array) -> None:
    """Set the options of MuJoCo.

    Args:
        spec: specification of the model.
        engine: settings of the engine.
        gravity_H: (3,) acceleration of gravity in H, m/s².
    """
    option = spec.option
    option.timestep = engine.dt
    option.gravity = gravity_H
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC  # exact cones; pyramids also creep
    option.impratio = engine.impratio
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations, option.tolerance = 100, 1e-12  # converge: tracking errors are micrometres
    option.noslip_iterations, option.noslip_tolerance = engine.noslip, 0.0
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # MuJoCo 4.0.0 factorises sparse Hessians wrongly
    if hasattr(mujoco.mjtDisableBit, "mjDSBL_MULTICCD"):  # one contact for each pair, as in the controller
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD
    spec.compiler.degree = False
    spec.compiler.autolimits = False


def add_hand(spec: mujoco.MjSpec, hand: Hand, tree: KinematicTree, engine: EngineSettings) -> list[mujoco.MjsBody]:
    """Add links, joints and couplings.

    Args:
        spec: specification of the model.
        hand: the hand.
        tree: its links.
        engine: settings of the engine.

    Returns:
        The bodies of the links, in the tree's order.
    """
    is_moving = moving_joints(hand)
    rotor_inertia = dict(zip([joint.name for joint in hand.joints], hand.rotor_inertia, strict=True))
    free = {name for each in find_free_differentials(hand) for name in each.joints}
    bodies: list[mujoco.MjsBody] = []
    for i, link in enumerate(tree.links):
        parent = spec.worldbody if link.parent < 0 else bodies[link.parent]
        p, R = (link.p_PL, link.R_PL) if is_moving[i] else _locked_pose(link, hand.q0[i])
        body = parent.add_body(name=link.joint, pos=p, quat=rotation_quaternion(R))
        body.explicitinertial = True
        body.mass, body.ipos = link.mass, link.p_LM
        body.fullinertia = _inertia_components(link.inertia)
        if is_moving[i]:
            kind = mujoco.mjtJoint.mjJNT_SLIDE if link.is_prismatic else mujoco.mjtJoint.mjJNT_HINGE
            joint = body.add_joint(name=link.joint, type=kind, axis=link.axis)
            joint.limited, joint.range = True, [link.lower, link.upper]
            joint.armature = 0.0 if link.joint in free else rotor_inertia.get(link.joint, 0.0)  # D, at the motors' joints
        bodies.append(body)
    for row, name in enumerate(hand.full_joints):
        if is_moving[row] and name not in rotor_inertia and name not in free:
            _add_coupling(spec, hand, row, engine)
    add_differentials(spec, hand)
    add_breakaways(spec, hand, engine)
    return bodies


def _add_coupling(spec: mujoco.MjSpec, hand: Hand, row: int, engine: EngineSettings) -> None:
    """Add the constraint between a dependent joint and its leading joint."""
    name, column = hand.full_joints[row], int(np.flatnonzero(hand.T[row])[0])
    equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, name=f"{name}{CLOSED}")
    equality.name1, equality.name2 = name, hand.joints[column].name
    equality.data[:5] = [hand.q0[row], hand.T[row, column], 0.0, 0.0, 0.0]
    equality.solref, equality.solimp = engine.coupling_solref, [*engine.coupling_solimp, 0.5, 2.0]


def _locked_pose(link: Link, position: float) -> tuple[Array, Array]:
    """Return the pose on its parent of a link whose joint is locked at a position, rad or m."""
    if link.is_prismatic:
        return np.asarray(link.p_PL + link.R_PL @ link.axis * position), link.R_PL
    return link.p_PL, np.asarray(link.R_PL @ _axis_rotation(link.axis, position))


def add_object(spec: mujoco.MjSpec, body: Body, grasp: Grasp) -> None:
    """Add the object with a free joint.

    Args:
        spec: specification of the model.
        body: mass, inertia and shape of the object.
        grasp: gives its pose, and its shape if the body has none.

    Raises:
        InvalidInput: MuJoCo has no geom of this shape.
    """
    shape = body.shape or grasp.body.shape
    part = spec.worldbody.add_body(name=OBJECT, pos=grasp.p_HO, quat=rotation_quaternion(grasp.R_HO))
    part.explicitinertial = True
    part.mass, part.ipos, part.fullinertia = body.mass, body.p_OM, _inertia_components(body.inertia)
    part.add_joint(name=OBJECT, type=mujoco.mjtJoint.mjJNT_FREE)
    if isinstance(shape, TriangleMesh):
        spec.add_mesh(name=OBJECT, uservert=shape.vertices.ravel().tolist(), userface=shape.faces.ravel().tolist())
        geom = part.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=OBJECT)
    else:
        kind, size = _geom_of_shape(shape)
        geom = part.add_geom(type=kind, size=size)
    make_passive_geom(geom, OBJECT)


def _geom_of_shape(shape: Shape | None) -> tuple[mujoco.mjtGeom, list[float]]:
    """Return kind and sizes of MuJoCo's geom for a shape."""
    if isinstance(shape, Sphere):
        return mujoco.mjtGeom.mjGEOM_SPHERE, [shape.radius, 0.0, 0.0]
    if isinstance(shape, Cylinder):
        return mujoco.mjtGeom.mjGEOM_CYLINDER, [shape.radius, shape.height / 2.0, 0.0]
    if isinstance(shape, Box):
        return mujoco.mjtGeom.mjGEOM_BOX, (shape.edges / 2.0).tolist()
    if isinstance(shape, Superquadric) and np.all(shape.exponents == 1.0):
        return mujoco.mjtGeom.mjGEOM_ELLIPSOID, shape.axes.tolist()
    allowed = (
        "a sphere, a cylinder, a box, an ellipsoid (superquadric with exponents 1) or a convex mesh: "
        "MuJoCo has no other exact shapes"
    )
    raise InvalidInput("grasp.body.shape", shape, allowed)


def add_floor(spec: mujoco.MjSpec, grasp: Grasp, gravity_H: Array, depth: float, engine: EngineSettings) -> None:
    """Add a floor below the object; a plant can move it.

    Args:
        spec: specification of the model.
        grasp: gives the object's pose.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        depth: distance of the floor below the object's origin, m.
        engine: settings of the engine.

    Raises:
        InvalidInput: there is no gravity.
    """
    norm = float(np.linalg.norm(gravity_H))
    if norm == 0.0:
        raise InvalidInput("floor", depth, "absent without gravity, which defines below")
    up = -gravity_H / norm
    quaternion = np.zeros(4)
    mujoco.mju_quatZ2Vec(quaternion, up)
    position = grasp.p_HO - depth * up
    part = spec.worldbody.add_body(name=FLOOR, mocap=True, pos=position, quat=quaternion)
    plane = part.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.3, 0.3, 0.01])
    make_passive_geom(plane, FLOOR)
    pair = add_contact_pair(spec, FLOOR, OBJECT, ContactModel.POINT, (_FLOOR_FRICTION, 0.0), engine)
    pair.condim = 6  # with rolling
    pair.friction = [_FLOOR_FRICTION, _FLOOR_FRICTION, _ROLLING_RESISTANCE, _ROLLING_RESISTANCE, _ROLLING_RESISTANCE]


def add_contact_pair(
    spec: mujoco.MjSpec, first: str, second: str, model: ContactModel, friction: tuple[float, float], engine: EngineSettings
) -> mujoco.MjsPair:
    """Add a pair of geoms that collide, with the contact model's force components, and return it.

    Args:
        spec: specification of the model.
        first: name of a geom.
        second: name of the other geom.
        model: contact model; it sets MuJoCo's condim.
        friction: coefficient, and torsional friction length, m.
        engine: settings of the engine.
    """
    mu, gamma = friction
    pair = spec.add_pair(name=f"{first} on {second}", geomname1=first, geomname2=second)
    pair.condim = _CONDIM[model]
    pair.friction = [mu, mu, gamma, 0.0, 0.0]
    pair.solref, pair.solimp = engine.solref, [*engine.solimp, 0.5, 2.0]
    return pair


def _inertia_components(inertia: Array) -> list[float]:
    """Return xx, yy, zz, xy, xz, yz of an inertia matrix."""
    return [float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def rotation_quaternion(R: Array) -> Array:
    """Return the quaternion (w, x, y, z) of a rotation matrix.

    Args:
        R: (3, 3) rotation.
    """
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R).ravel())
    return quaternion


def _axis_rotation(axis: Array, angle: float) -> Array:
    """Return the matrix of a rotation about a unit vector."""
    quaternion, R = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    mujoco.mju_quat2Mat(R, quaternion)
    return R.reshape(3, 3)

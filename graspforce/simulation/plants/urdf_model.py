"""MuJoCo's own model of a hand's URDF, with motors and an object: the model of `UrdfPlant`.

MuJoCo reads the URDF file itself. Added are facts of the hand's description that a URDF lacks or states wrongly: inertias,
torque limits, rotor inertias, couplings, locked joints and fingertips. The collision
shapes of the links are added by `link_geoms`; fingertips are spheres, and touch the object only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from xml.etree import ElementTree

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graspforce.contact.contact import ContactModel
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.geometry import Box, Cylinder, Shape, Sphere
from graspforce.grasp.grasp import Grasp, check_grasp
from graspforce.hand.descriptions import description as descriptions
from graspforce.simulation.plants.link_geoms import LINK_FRICTION, add_link_geoms
from graspforce.simulation.plants.plant_options import PlantOptions

_OBJECT = "grasped object"
_POINT_TIP_RADIUS = 0.005  # m, of fingertips without a radius; the sphere's surface passes through the tip frame's origin
_IMPRATIO, _NOSLIP = 10_000.0, 10  # contacts creep in proportion to 1/impratio, 0.2 µm/s here
_SOLREF, _SOLIMP = [0.004, 1.0], [0.95, 0.99, 0.001, 0.5, 2.0]  # of contacts; a newton penetrates about 20 µm
_RIGID = [0.9999, 0.9999, 0.001, 0.5, 2.0]  # impedance of couplings and joint friction


@dataclass(frozen=True, eq=False)
class UrdfModel:
    """A compiled model, with the indices of its parts in MuJoCo's arrays.

    Attributes:
        model: of MuJoCo; its first n actuators are the motors, in the order of the hand's joints.
        q_rows: (n,) indices of the actuated joints in qpos.
        v_rows: (n,) indices of the actuated joints in qvel.
        joint_rows: (n_moving,) indices of all moving joints of the hand in qpos and, without the object, in qvel.
        T: (n_moving, n) positions of these joints are T q + q0.
        q0: (n_moving,) rad.
        object_body: index of the object's body.
        object_geom: index of the object's geom.
        object_q: index of the object's first coordinate in qpos.
        object_v: index of the object's first velocity in qvel.
        tip_geoms: indices of the fingertips' geoms, in the order of the grasp's contacts.
        pairs: indices of the fingertips' contact pairs, likewise.
    """

    model: mujoco.MjModel
    q_rows: npt.NDArray[np.intp]
    v_rows: npt.NDArray[np.intp]
    joint_rows: npt.NDArray[np.intp]
    T: Array
    q0: Array
    object_body: int
    object_geom: int
    object_q: int
    object_v: int
    tip_geoms: tuple[int, ...]
    pairs: tuple[int, ...]


def compile_urdf(grasp: Grasp, options: PlantOptions) -> UrdfModel:
    """Compile the URDF of a grasp's hand, with the object in its pose.

    Args:
        grasp: hand, object and contacts.
        options: the differences between them and the plant.

    Raises:
        InvalidInput: an option has the wrong number of values, or the object has no shape, or none that MuJoCo has.
        ModelError: MuJoCo cannot compile the URDF.
    """
    path = check_grasp(grasp).hand.urdf_path
    try:
        spec = mujoco.MjSpec.from_string(_without_shapes(descriptions.text(path)))
    except ValueError as error:
        raise ModelError(f"{path}: MuJoCo cannot read it: {error}") from None
    spec.compiler.fusestatic = False  # links of the tips stay bodies
    _set_options(spec, options)
    _correct_links(spec, grasp)
    _add_motors(spec, grasp, options)
    _add_object(spec, grasp, options)
    _add_tips(spec, grasp, options)
    for names in add_link_geoms(spec, partial(_body_of_link, spec, grasp), grasp, (_OBJECT,)):
        pair = spec.add_pair(geomname1=names[0], geomname2=names[1])
        pair.condim, pair.friction = 3, [LINK_FRICTION, LINK_FRICTION, 0.0, 0.0, 0.0]
        pair.solref, pair.solimp = _SOLREF, _SOLIMP
    try:
        model = spec.compile()
    except ValueError as error:
        raise ModelError(f"{path}: MuJoCo cannot compile it: {error}") from None
    return _index(grasp, model)


def _without_shapes(text: str) -> str:
    """Return a URDF without the shapes of its links, and without friction and couplings of its joints."""
    root = ElementTree.fromstring(text)
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for joint in root.findall("joint"):
        for part in [*joint.findall("mimic"), *joint.findall("dynamics")]:
            joint.remove(part)
    return ElementTree.tostring(root, encoding="unicode")


def _set_options(spec: mujoco.MjSpec, options: PlantOptions) -> None:
    """Set solver and integrator."""
    spec.option.timestep, spec.option.gravity = options.dt, options.gravity_H.tolist()
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    spec.option.impratio, spec.option.noslip_iterations = _IMPRATIO, _NOSLIP
    spec.option.tolerance = 1e-12


def _correct_links(spec: mujoco.MjSpec, grasp: Grasp) -> None:
    """Set the inertias, couplings and locked joints of the hand's description."""
    described = grasp.hand.description
    for override in described.inertias:
        body = spec.body(override.link)
        if body is not None:  # the root link is part of the world
            body.mass, body.ipos, body.fullinertia = override.mass, override.com, override.inertia
            body.iquat = [1.0, 0.0, 0.0, 0.0]
    for coupling in described.couplings:
        equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT)
        equality.name1, equality.name2 = coupling.follower, coupling.leader
        equality.data[:5] = [coupling.offset, coupling.ratio, 0.0, 0.0, 0.0]
        equality.solref, equality.solimp = [2.0 * spec.option.timestep, 1.0], _RIGID
    for lock in described.locked:
        joint = spec.joint(lock.joint)
        body, R = joint.parent, Rotation.from_quat(joint.parent.quat, scalar_first=True)
        if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
            body.pos = body.pos + R.apply(lock.position * joint.axis)
        else:
            body.quat = (R * Rotation.from_rotvec(lock.position * joint.axis)).as_quat(scalar_first=True)
        spec.delete(joint)


def _add_motors(spec: mujoco.MjSpec, grasp: Grasp, options: PlantOptions) -> None:
    """Add a motor with its rotor inertia and friction to each actuated joint."""
    n = grasp.hand.n
    gain, viscous = options.per_joint("torque_gain", n), options.per_joint("viscous", n)
    stiction = options.per_joint("coulomb", n) + options.per_joint("stribeck", n)
    for joint in spec.joints:
        joint.actfrclimited = False  # the URDF's effort; the motors have limits of their own
    for i, motor in enumerate(grasp.hand.joints):
        joint = spec.joint(motor.name)
        joint.armature, joint.frictionloss = motor.rotor_inertia, stiction[i]
        joint.damping = viscous[i] if np.ndim(joint.damping) == 0 else [viscous[i], 0.0, 0.0]  # a polynomial in MuJoCo 4
        joint.solref_friction, joint.solimp_friction = [2.0 * options.dt, 1.0], _RIGID
        drive = spec.add_actuator(name=motor.name, target=motor.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        drive.gainprm[0] = gain[i]
        drive.ctrllimited, drive.ctrlrange = True, [-motor.torque, motor.torque]


def _add_object(spec: mujoco.MjSpec, grasp: Grasp, options: PlantOptions) -> None:
    """Add the object with a free joint."""
    body = options.body or grasp.body
    kind, size = _geom_of(body.shape or grasp.body.shape)
    quaternion = Rotation.from_matrix(grasp.R_HO).as_quat(scalar_first=True)
    part = spec.worldbody.add_body(name=_OBJECT, pos=grasp.p_HO.tolist(), quat=quaternion)
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 2] *= np.linalg.det(axes)  # right-handed
    part.explicitinertial, part.mass, part.ipos, part.inertia = True, body.mass, body.p_OM.tolist(), moments
    part.iquat = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    part.add_freejoint(name=_OBJECT)
    turn = Rotation.from_rotvec(options.shape_turn.tolist()).as_quat(scalar_first=True)
    _add_geom(part, _OBJECT, kind, size, options.shape_offset).quat = turn


def _geom_of(shape: Shape | None) -> tuple[mujoco.mjtGeom, list[float]]:
    """Return MuJoCo's type and sizes of a shape."""
    match shape:
        case Sphere():
            return mujoco.mjtGeom.mjGEOM_SPHERE, [shape.radius, 0.0, 0.0]
        case Cylinder():
            return mujoco.mjtGeom.mjGEOM_CYLINDER, [shape.radius, 0.5 * shape.height, 0.0]
        case Box():
            return mujoco.mjtGeom.mjGEOM_BOX, [0.5 * edge for edge in shape.edges]
    raise InvalidInput("grasp.body.shape", shape, "a sphere, a cylinder or a box in this plant")


def _add_tips(spec: mujoco.MjSpec, grasp: Grasp, options: PlantOptions) -> None:
    """Add the fingertips, and their contacts with the object."""
    mu, gamma, rolling = options.contact_friction(grasp)
    offsets = options.tip_offsets(grasp)
    for i, name in enumerate(grasp.fingers):
        finger, center = grasp.hand.finger(name), offsets[i]
        if finger.tip_radius is None:
            n_H = grasp.R_HO @ grasp.contacts.R_OC[i, :, 2]
            center = center - _POINT_TIP_RADIUS * grasp.hand.tip_pose(grasp.q, name)[1].T @ n_H
        radius = finger.tip_radius or _POINT_TIP_RADIUS
        geom = f"fingertip {name}"
        carrier, place = _tip_carrier(spec, grasp, finger.tip, center)
        _add_geom(carrier, geom, mujoco.mjtGeom.mjGEOM_SPHERE, [radius, 0.0, 0.0], place)
        pair = spec.add_pair(name=geom, geomname1=geom, geomname2=_OBJECT)
        model = grasp.contacts.models[i]
        if model is ContactModel.FRICTIONLESS and mu[i] == 0.0:
            pair.condim = 1
        elif rolling[i] > 0.0:
            pair.condim = 6
        else:
            pair.condim = 4 if gamma[i] > 0.0 or model is ContactModel.SOFT else 3
        pair.friction = [mu[i], mu[i], gamma[i], rolling[i], rolling[i]]
        pair.solref, pair.solimp = _SOLREF, _SOLIMP


def _tip_carrier(spec: mujoco.MjSpec, grasp: Grasp, tip: str, center: Array) -> tuple[mujoco.MjsBody, Array]:
    """Return the body that carries a tip frame, and a point of the frame in the body, (3,) m."""
    hand = grasp.hand
    if tip in hand.urdf.links and spec.body(tip) is not None:
        return spec.body(tip), center
    link, p_LF, R_LF = hand.model.carrier_of(tip)
    return _body_of_link(spec, grasp, link), p_LF + R_LF @ center


def _body_of_link(spec: mujoco.MjSpec, grasp: Grasp, link: int) -> mujoco.MjsBody:
    """Return the body of a moving link by its index; the world for the base, -1."""
    hand = grasp.hand
    return spec.worldbody if link < 0 else spec.body(hand.urdf.joints[hand.full_joints[link]].child)


def _add_geom(body: mujoco.MjsBody, name: str, kind: mujoco.mjtGeom, size: list[float], position: Array) -> mujoco.MjsGeom:
    """Add a geom without mass that collides in explicit pairs only."""
    return body.add_geom(name=name, type=kind, size=size, pos=position.tolist(), mass=0.0, contype=0, conaffinity=0)


def _index(grasp: Grasp, model: mujoco.MjModel) -> UrdfModel:
    """Return the model with the indices of its parts."""
    hand = grasp.hand
    couplings = {coupling.follower: coupling for coupling in hand.description.couplings}
    motors = [joint.name for joint in hand.joints]
    moving = [model.joint(i).name for i in range(model.njnt) if model.joint(i).name != _OBJECT]
    T, q0 = np.zeros((len(moving), hand.n)), np.zeros(len(moving))
    for row, name in enumerate(moving):
        coupling = couplings.get(name)
        T[row, motors.index(name if coupling is None else coupling.leader)] = 1.0 if coupling is None else coupling.ratio
        q0[row] = 0.0 if coupling is None else coupling.offset
    return UrdfModel(
        model=model,
        q_rows=np.array([model.joint(name).qposadr[0] for name in motors], dtype=np.intp),
        v_rows=np.array([model.joint(name).dofadr[0] for name in motors], dtype=np.intp),
        joint_rows=np.array([model.joint(name).qposadr[0] for name in moving], dtype=np.intp),
        T=T,
        q0=q0,
        object_body=int(model.body(_OBJECT).id),
        object_geom=int(model.geom(_OBJECT).id),
        object_q=int(model.joint(_OBJECT).qposadr[0]),
        object_v=int(model.joint(_OBJECT).dofadr[0]),
        tip_geoms=tuple(int(model.geom(f"fingertip {name}").id) for name in grasp.fingers),
        pairs=tuple(int(model.pair(f"fingertip {name}").id) for name in grasp.fingers),
    )

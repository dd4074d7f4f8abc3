"""The model of `drake_plant`: a hand's URDF as Drake reads it, with motors, joint friction, fingertips and an object."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
from pydrake.geometry import AddContactMaterial, CollisionFilterDeclaration, GeometrySet, ProximityProperties
from pydrake.geometry import Box as DrakeBox
from pydrake.geometry import Cylinder as DrakeCylinder
from pydrake.geometry import Sphere as DrakeSphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import PdControllerGains, RotationalInertia, SpatialInertia
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from scipy.spatial.transform import Rotation

from graspforce.contact.contact import ContactModel
from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspState
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Shape, Sphere
from graspforce.grasp.grasp import Grasp
from graspforce.hand.descriptions import urdf
from graspforce.simulation import PlantOptions

STIFFNESS = 1e5  # N/m, of a contact
RELAXATION_TIME = 5e-3  # s
STICTION_RATE = 1e-3  # rad/s: below it Coulomb friction of a joint is proportional to the rate


@dataclass(frozen=True, eq=False, slots=True)
class DrakeModel:
    """A finalized plant with its diagram and state, and its parts."""

    diagram: Diagram
    root: Context
    plant: MultibodyPlant
    q_rows: npt.NDArray[np.intp]  # of the actuated joints among the positions
    v_rows: npt.NDArray[np.intp]  # of the actuated joints among the velocities
    motors: npt.NDArray[np.intp]  # of the motors among the actuators
    tips: tuple[int, ...]  # indices of the bodies of the fingertips

    @property
    def context(self) -> Context:
        """State and inputs of the plant."""
        return self.plant.GetMyMutableContextFromRoot(self.root)

    def advance(self, steps: int) -> None:
        """Advance by some steps of the engine. Contact results before this call are those of the first one.

        Args:
            steps: number of steps.
        """
        update = self.diagram.AllocateDiscreteVariables()
        for _ in range(steps):
            self.diagram.CalcForcedDiscreteVariableUpdate(self.root, update)
            self.root.get_mutable_discrete_state().SetFrom(update)
        self.root.SetTime(self.root.get_time() + steps * self.plant.time_step())


def check_supported(grasp: Grasp, options: PlantOptions) -> None:
    for name in ("torsional_friction", "rolling_friction"):
        if getattr(options, name) is not None:
            raise InvalidInput(name, getattr(options, name), "absent: Drake's point contact has none")
    if any(model is not ContactModel.POINT for model in grasp.contacts.models):
        raise InvalidInput("grasp.contacts", [model.value for model in grasp.contacts.models], "point contacts in this plant")
    if grasp.hand.description.locked:
        raise InvalidInput("grasp.hand", grasp.hand.name, "without locked joints in this plant")


def build_model(grasp: Grasp, options: PlantOptions, dt: float) -> DrakeModel:
    """Return the model of a grasp, with an engine step of dt in s."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, dt)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    plant.mutable_gravity_field().set_gravity_vector(options.gravity_H)
    hand, described = grasp.hand, grasp.hand.description
    (instance,) = Parser(plant).AddModelsFromString(_urdf_for_drake(grasp), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(hand.describe()["base"]))
    for coupling in described.couplings:
        joints = (plant.GetJointByName(name) for name in (coupling.follower, coupling.leader))
        plant.AddCouplerConstraint(*joints, gear_ratio=coupling.ratio, offset=coupling.offset)
    stiction = options.per_joint("coulomb", hand.n) + options.per_joint("stribeck", hand.n)
    viscous = options.per_joint("viscous", hand.n)
    for i, motor in enumerate(hand.joints):
        joint = plant.GetJointByName(motor.name)
        joint.set_default_damping(viscous[i])
        plant.AddJointActuator(motor.name, joint).set_default_rotor_inertia(motor.rotor_inertia)
    has_friction = bool(stiction.any())
    for i, motor in enumerate(hand.joints if has_friction else ()):
        if stiction[i] > 0.0:  # a brake: −clip(d v, ± stiction), implicit in the engine
            brake = plant.AddJointActuator(f"{motor.name} friction", plant.GetJointByName(motor.name), float(stiction[i]))
            brake.set_controller_gains(PdControllerGains(p=0.0, d=float(stiction[i]) / STICTION_RATE))
    tips = _add_geometry(plant, grasp, options)
    plant.SetUseSampledOutputPorts(False)  # outputs belong to the present state and inputs
    plant.Finalize()
    frames = [scene_graph.model_inspector().GetGeometries(plant.GetBodyFrameIdOrThrow(body)) for body in tips]
    filters = GeometrySet([geometry for geometries in frames for geometry in geometries])
    scene_graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeWithin(filters))
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    if has_friction:
        context = plant.GetMyMutableContextFromRoot(root)
        plant.get_desired_state_input_port(instance).FixValue(context, np.zeros(2 * plant.num_actuated_dofs(instance)))
    joints = [plant.GetJointByName(joint.name) for joint in hand.joints]
    rows = [[joint.position_start() for joint in joints], [joint.velocity_start() for joint in joints]]
    rows.append([int(plant.GetJointActuatorByName(joint.name).index()) for joint in hand.joints])
    q_rows, v_rows, motors = np.array(rows, dtype=np.intp)
    return DrakeModel(diagram, root, plant, q_rows, v_rows, motors, tuple(map(int, tips)))


def _urdf_for_drake(grasp: Grasp) -> str:
    """Return the hand's URDF with the inertias of its description, without shapes, friction, limits and couplings."""
    path, described = grasp.hand.urdf_path, grasp.hand.description
    text = urdf.with_inertias(path.read_text(), {each.link: each.inertial for each in described.inertias}, str(path))
    root = ElementTree.fromstring(text)
    for part in [*root.findall("link"), *root.findall("joint")]:
        for tag in ("visual", "collision", "dynamics", "mimic"):
            for element in part.findall(tag):
                part.remove(element)
    for element in root.findall("transmission"):
        root.remove(element)
    return ElementTree.tostring(root, encoding="unicode")


def _add_geometry(plant: MultibodyPlant, grasp: Grasp, options: PlantOptions) -> list[int]:
    """Add the object, its surface and the fingertips; return the bodies of the fingertips."""
    body, mu = options.body or grasp.body, options.contact_friction(grasp)[0]
    moments = RotationalInertia(*body.inertia.diagonal(), body.inertia[0, 1], body.inertia[0, 2], body.inertia[1, 2])
    inertia = SpatialInertia.MakeFromCentralInertia(body.mass, body.p_OM, moments)
    held = plant.AddRigidBody("object", plant.AddModelInstance("object"), inertia)
    shape = _drake_shape(body.shape or grasp.body.shape)
    plant.RegisterCollisionGeometry(held, surface_pose(options), shape, "object", _properties(1.0))
    bodies = []
    for i, name in enumerate(grasp.fingers):
        link = plant.GetBodyByName(grasp.hand.finger(name).tip)
        place = RigidTransform(options.tip_offsets(grasp)[i])
        # Drake combines coefficients as 2 μ₁ μ₂ / (μ₁ + μ₂); the object has 1
        plant.RegisterCollisionGeometry(link, place, DrakeSphere(tip_radii(grasp)[i]), name, _properties(mu[i] / (2.0 - mu[i])))
        bodies.append(link.index())
    return bodies


def _properties(mu: float) -> ProximityProperties:
    """Return contact properties; two bodies in series have half the stiffness and the sum of the relaxation times."""
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=None, point_stiffness=2.0 * STIFFNESS, friction=CoulombFriction(mu, mu), properties=properties
    )
    properties.AddProperty("material", "relaxation_time", 0.5 * RELAXATION_TIME)
    return properties


def _drake_shape(shape: Shape | None) -> DrakeSphere | DrakeCylinder | DrakeBox:
    if isinstance(shape, Sphere):
        return DrakeSphere(shape.radius)
    if isinstance(shape, Cylinder):
        return DrakeCylinder(shape.radius, shape.height)
    if isinstance(shape, Box):
        return DrakeBox(*shape.edges)
    raise InvalidInput("grasp.body.shape", shape, "a sphere, a cylinder or a box in this plant")


def tip_radii(grasp: Grasp) -> list[float]:
    """Return the radii of the fingertips, m."""
    radii = [grasp.hand.finger(name).tip_radius for name in grasp.fingers]
    if None in radii:
        raise InvalidInput("grasp.fingers", grasp.fingers, "fingers with spherical tips in this plant")
    return [float(radius) for radius in radii if radius]


def _pose(p: Array, R: Array) -> RigidTransform:
    return RigidTransform(RotationMatrix(R), p)


def surface_pose(options: PlantOptions) -> RigidTransform:
    """Return the pose of the object's surface in O."""
    return _pose(options.shape_offset, Rotation.from_rotvec(options.shape_turn.tolist()).as_matrix())


def read_state(model: DrakeModel) -> GraspState:
    """Return the state of a model."""
    plant, context = model.plant, model.context
    body = plant.GetBodyByName("object")
    X, V = plant.EvalBodyPoseInWorld(context, body), plant.EvalBodySpatialVelocityInWorld(context, body)
    motion = BodyMotion(X.translation(), X.rotation().matrix(), np.concatenate([V.translational(), V.rotational()]))
    return GraspState(plant.GetPositions(context)[model.q_rows], plant.GetVelocities(context)[model.v_rows], motion)


def set_state(model: DrakeModel, grasp: Grasp, state: GraspState) -> None:
    """Set the state of a model at time zero; coupled joints follow."""
    model.root.SetTime(0.0)
    plant, context, hand = model.plant, model.context, grasp.hand
    joints = [plant.GetJointByName(name) for name in hand.full_joints]
    q, v = np.array(plant.GetPositions(context)), np.array(plant.GetVelocities(context))
    q[[joint.position_start() for joint in joints]] = hand.T @ state.q + hand.q0
    v[[joint.velocity_start() for joint in joints]] = hand.T @ state.v
    plant.SetPositions(context, q)
    plant.SetVelocities(context, v)
    body, motion = plant.GetBodyByName("object"), state.object
    plant.SetFreeBodyPose(context, body, _pose(motion.p_HO, motion.R_HO))
    plant.SetFreeBodySpatialVelocity(context, body, SpatialVelocity(w=motion.twist[3:], v=motion.twist[:3]))

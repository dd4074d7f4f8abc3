"""An episode: a world with a displaced object, and the controller of a cycle in it, with nominal or with full knowledge."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.control.phases.phase_controller import PhaseController
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.settings import ControlSettings
from graspforce.core.arrays import Array, freeze
from graspforce.estimation.sensor_model import SensorModel
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.simulation.cycle.cycle_run import CycleController, CycleRecording, StepCallback, TablePlant, run_cycle
from graspforce.simulation.cycle.pose_errors import displaced_pose
from graspforce.simulation.cycle.rest import resting_pose
from graspforce.simulation.cycle.table_scene import TableScene
from graspforce.simulation.worlds.world import World

ControllerMaker = Callable[[CyclePlan, PhaseSettings | None, SensorModel, ControlSettings], CycleController]

_POSE_STREAM = 200  # of random numbers; the world and its sensors use smaller numbers
_FRICTION = ("coulomb", "stribeck", "stribeck_velocity", "viscous")


@dataclass(frozen=True, slots=True)
class PoseError:
    """Error of the object's expected pose on the table.

    Args:
        distance: largest displacement along the table, m; the true one is uniform in a disc.
        angle: largest rotation about the vertical, rad; the true one is uniform.
    """

    distance: float = 0.01
    angle: float = math.radians(10.0)

    def draw(self, world: World) -> tuple[Array, float]:
        """Return the displacement (2,), m, and the rotation, rad, of a world.

        Args:
            world: its seed decides.
        """
        rng = world.rng(_POSE_STREAM)
        radius, direction = self.distance * math.sqrt(rng.uniform()), rng.uniform(-math.pi, math.pi)
        return radius * np.array([math.cos(direction), math.sin(direction)]), self.angle * rng.uniform(-1.0, 1.0)


def run_episode(
    scene: TableScene,
    plan: CyclePlan,
    world: World,
    pose_error: PoseError,
    control: ControlSettings,
    settings: PhaseSettings | None = None,
    *,
    knows_everything: bool = False,
    make_controller: ControllerMaker = PhaseController,
    on_step: StepCallback = lambda plant, command: None,
) -> CycleRecording:
    """Simulate a cycle in a world.

    A controller with full knowledge knows hand, object, friction and pose; its sensors are perfect but late.

    Args:
        scene: the nominal scene.
        plan: its plan.
        world: the world.
        pose_error: error of the object's expected pose.
        control: settings of the object controller.
        settings: settings of the phases.
        knows_everything: whether the controller has full knowledge.
        make_controller: makes the controller from plan, settings of the phases, sensors and settings of the object controller.
        on_step: called after each step.

    Raises:
        InvalidInput: the hand cannot hold the object's weight, or no gains are stable with the sensors.
    """
    if knows_everything:
        scene, world, control = known_scene(scene, world, control)
        plan, pose_error = replace(plan, grasp=scene.grasp), PoseError(0.0, 0.0)
    table = TablePlant(scene, world, displaced_pose(scene, *pose_error.draw(world)), plan.q_start)
    controller = make_controller(plan, settings, world.sensors, control)
    return run_cycle(table, controller, scene, world, on_step=on_step)


def known_scene(scene: TableScene, world: World, control: ControlSettings) -> tuple[TableScene, World, ControlSettings]:
    """Return a scene with the true values of a world, the world relative to it, and settings without assumed errors.

    Surface and fingertips are where the scene has them; motor torques are exact. Round objects are where they rest.

    Args:
        scene: the nominal scene.
        world: the world.
        control: settings of the object controller.
    """
    grasp = scene.grasp
    options = world.plant_options(grasp, scene.gravity_H)
    n = grasp.hand.n
    coulomb, stribeck, velocity, viscous = (options.per_joint(name, n) for name in _FRICTION)
    friction = JointFriction(coulomb, stribeck, velocity, viscous)
    mu, _, _ = options.contact_friction(grasp)
    body = replace(options.body or grasp.body, shape=grasp.body.shape)
    p_HO, R_HO = resting_pose(body.shape, body.p_OM, (grasp.p_HO, grasp.R_HO), scene.down)
    contacts = _moved_contacts(grasp, p_HO, R_HO)
    true = replace(
        grasp,
        hand=replace(grasp.hand, friction=friction),
        body=body,
        contacts=replace(contacts, mu=freeze(mu)),
        p_HO=p_HO,
        R_HO=R_HO,
    )
    sensors = SensorModel(rate=world.sensors.rate, latency=world.sensors.latency, has_velocity=True, tip_force_noise=0.0)
    known = replace(
        world,
        mass_factor=1.0,
        centre_offset=np.zeros(3),
        friction_factor=1.0,
        tip_offset=0.0,
        shape_offset=0.0,
        shape_turn=0.0,
        torque_error=0.0,
        stiffness_error=0.0,
        drive_error=0.0,
        encoder_offset=0.0,
        camera_outages=(),
        camera_outliers=0.0,
        contact_point_noise=None,
        sensors=sensors,
    )
    return replace(scene, grasp=true), known, replace(control, friction_error=0.0, mass_error=0.0, contact_error=0.0)


def _moved_contacts(grasp: Grasp, p_HO: Array, R_HO: Array) -> ContactSet:
    """Return the contacts at the same places in H for another pose of the object."""
    contacts, R = grasp.contacts, R_HO.T @ grasp.R_HO
    p_OC = contacts.p_OC @ R.T + R_HO.T @ (grasp.p_HO - p_HO)
    return replace(contacts, p_OC=freeze(p_OC), R_OC=freeze(R @ contacts.R_OC))

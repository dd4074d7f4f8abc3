"""Plants of a world: one function for each of the two plants, and `make_world_plant` to choose one by name."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graspforce.contact.contact import Contact
from graspforce.core import fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.geometry.vectors import unit_vectors
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import GRAVITY_PALM_UP
from graspforce.simulation.plants.disturbance import Push
from graspforce.simulation.plants.driven_plant import DrivenPlant
from graspforce.simulation.plants.plant import Disturbance, Plant
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.plants.scene import DEFAULT_TIP_RADIUS, Scene, TipGeometry, build_scene
from graspforce.simulation.plants.urdf_plant import UrdfPlant
from graspforce.simulation.worlds.world import World

PlantName = Literal["links", "urdf"]

PLANT_NAMES: tuple[PlantName, ...] = ("links", "urdf")

# A joint at rest yields to a torque below its friction by less than 1e-5 rad/s.
_FRICTION_SOLREF, _FRICTION_SOLIMP = (0.002, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
_GAP_ITERATIONS, _GAP_TOLERANCE = 30, 1e-9  # m
_RANK_TOLERANCE = 0.01  # relative; smaller singular values of the normals' Jacobian count as zero
_SOFT_CONDIM = 4  # MuJoCo's normal force, two tangential forces and a moment about the normal


def make_plant(
    grasp: Grasp,
    options: PlantOptions,
    *,
    pushes: Sequence[tuple[float, ...]] = (),
    disturbances: Sequence[Disturbance] = (),
    tip_geometry: TipGeometry = "ball",
    directories: Sequence[str | os.PathLike[str]] = (),
    floor: float | None = None,
) -> Plant:
    """Return the plant of `build_scene` with the true parameters of a world.

    Args:
        grasp: the grasp that the controller is told.
        options: true parameters, as `World.plant_options` returns them. Their `dt` sets the engine's step.
        pushes: (fx, fy, fz, start, duration) of forces on the object's origin in H, N and s.
        disturbances: further changes of the plant.
        tip_geometry: as in `build_scene`.
        directories: as in `build_scene`.
        floor: as in `build_scene`.

    Raises:
        InvalidInput: the object has no shape that MuJoCo knows, a displaced fingertip does not reach it, or the hand cannot
            hold its told weight.
        ModelError: as in `build_scene`.
    """
    scene = build_scene(
        _touching_grasp(grasp, options),
        gravity_H=options.gravity_H,
        body=options.body,
        tip_geometry=tip_geometry,
        directories=directories,
        floor=floor,
    )
    _apply_contacts(scene, options)
    motors = _TrueMotors.from_options(scene, options)
    forces = [Push(np.array(push[:3]), push[3], push[4]) for push in pushes]
    return Plant(scene, disturbances=[motors, *forces, *disturbances])


def make_urdf_plant(grasp: Grasp, options: PlantOptions, *, pushes: Sequence[tuple[float, ...]] = ()) -> UrdfPlant:
    """Return the plant from the hand's URDF with the true parameters of a world.

    Args:
        grasp: the grasp that the controller is told.
        options: true parameters, as `World.plant_options` returns them.
        pushes: as in `make_plant`.

    Raises:
        InvalidInput: as in `UrdfPlant`.
        ModelError: as in `UrdfPlant`.
    """

    def push(plant: UrdfPlant) -> None:
        for *force, start, duration in pushes:
            if start <= plant.t < start + duration:
                plant.push(force)

    return UrdfPlant(grasp, options, events=[push])


def make_world_plant(
    world: World, grasp: Grasp, gravity_H: npt.ArrayLike = GRAVITY_PALM_UP, name: PlantName = "links"
) -> Plant | UrdfPlant | DrivenPlant:
    """Return the plant of a world, with its pushes, and with the true drives of a hand whose drives are not ideal.

    Args:
        world: the world.
        grasp: the grasp that the controller is told.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        name: "links" for `make_plant`, "urdf" for `make_urdf_plant`.

    Raises:
        InvalidInput: another name, or as there.
        ModelError: as there.
    """
    fields.check_choice(name, "plant", PLANT_NAMES)
    make = make_plant if name == "links" else make_urdf_plant
    return with_drives(make(grasp, world.plant_options(grasp, gravity_H), pushes=world.pushes), world, grasp)


def with_drives(plant: Plant | UrdfPlant, world: World, grasp: Grasp) -> Plant | UrdfPlant | DrivenPlant:
    """Return a plant with the true drives of a world; the plant itself if the hand's drives are ideal.

    Args:
        plant: the plant of hand and object.
        world: the world.
        grasp: the grasp that the controller is told.
    """
    drives = grasp.hand.drives
    return plant if drives.is_ideal else DrivenPlant(plant, world.true_drives(drives))


def _touching_grasp(grasp: Grasp, options: PlantOptions) -> Grasp:
    """Return the grasp with displaced fingertips, in a posture in which they touch the true surface.

    The posture is found by Newton's method: each step closes the gaps along the present normals by the least joint motion.
    """
    offsets = options.tip_offsets(grasp)
    shape = grasp.body.shape
    if shape is None or not (offsets.any() or options.shape_offset.any() or options.shape_turn.any()):
        return grasp
    hand = grasp.hand.with_tip_offsets(dict(zip(grasp.fingers, offsets, strict=True)))
    frames = [hand.frame_id(name) for name in grasp.fingers]
    radii = np.array([hand.finger(name).tip_radius or DEFAULT_TIP_RADIUS for name in grasp.fingers])
    R_OG = Rotation.from_rotvec(np.array(options.shape_turn)).as_matrix()  # G: frame of the surface
    p_HG, R_HG = grasp.p_HO + grasp.R_HO @ options.shape_offset, grasp.R_HO @ R_OG
    q = np.array(grasp.q)
    for _ in range(_GAP_ITERATIONS):
        p_HF, J = (each[0] for each in hand.model.frame_jacobians(q[None], frames))
        centres = (p_HF - p_HG) @ R_HG
        points = shape.project_to_surface(centres)
        normals = unit_vectors(points - centres)  # a ball outside the object touches along them, also on an edge or a corner
        n_H = normals @ R_HG.T
        gaps = np.einsum("ij,ij->i", points @ R_HG.T + p_HG - p_HF, n_H) - radii  # m
        if np.abs(gaps).max() < _GAP_TOLERANCE:
            break
        rows = np.einsum("ij,ijk->ik", n_H, J[:, :3])
        q = q + np.linalg.pinv(rows, rcond=_RANK_TOLERANCE) @ gaps
    else:
        finger = grasp.fingers[int(np.abs(gaps).argmax())]
        raise InvalidInput("options.tip_offset", offsets, f"so small that {finger} reaches the object from its posture")
    places = [Contact(options.shape_offset + R_OG @ p, R_OG @ n, 0.0) for p, n in zip(points, normals, strict=True)]
    contacts = replace(
        grasp.contacts, p_OC=freeze([place.position for place in places]), R_OC=freeze([place.R_OC for place in places])
    )  # fmt: skip
    return replace(grasp, hand=hand, contacts=contacts, q=q)


def _apply_contacts(scene: Scene, options: PlantOptions) -> None:
    """Set step, friction, surface and joint friction of a scene's model."""
    model, grasp = scene.model, scene.grasp
    model.opt.timestep = options.dt
    mu, gamma, rolling = options.contact_friction(grasp)
    for i, pair in enumerate(scene.contact_pairs):
        model.pair_friction[pair] = [mu[i], mu[i], gamma[i], rolling[i], rolling[i]]
        if gamma[i] > 0.0:
            model.pair_dim[pair] = max(_SOFT_CONDIM, model.pair_dim[pair])
        if rolling[i] > 0.0:
            model.pair_dim[pair] = 6
    turn = Rotation.from_rotvec(np.array(options.shape_turn))
    model.geom_pos[scene.object_geom] = options.shape_offset + turn.apply(model.geom_pos[scene.object_geom])
    quaternion = np.roll(turn.as_quat(), 1)  # (w, x, y, z)
    mujoco.mju_mulQuat(model.geom_quat[scene.object_geom], quaternion, np.array(model.geom_quat[scene.object_geom]))
    model.geom_sameframe[scene.object_geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # compiled with O's frame
    rows = scene.v_address[scene.motor_joints]
    n = grasp.hand.n
    model.dof_damping[rows] = options.per_joint("viscous", n)
    model.dof_frictionloss[rows] = options.per_joint("coulomb", n) + options.per_joint("stribeck", n)
    model.dof_solref[rows], model.dof_solimp[rows] = _FRICTION_SOLREF, _FRICTION_SOLIMP


@dataclass(frozen=True, eq=False, slots=True)
class _TrueMotors:
    """True torques of the motors, and friction that falls with the joint's rate.

    Attributes:
        gain: (n,) torque per commanded torque.
        coulomb: (n,) N·m.
        stribeck: (n,) additional friction at rest, N·m.
        stribeck_velocity: (n,) rad/s.
    """

    gain: Array
    coulomb: Array
    stribeck: Array
    stribeck_velocity: Array

    @classmethod
    def from_options(cls, scene: Scene, options: PlantOptions) -> _TrueMotors:
        """Return the motors of a scene."""
        n = scene.grasp.hand.n
        return cls(*(options.per_joint(name, n) for name in ("torque_gain", "coulomb", "stribeck", "stribeck_velocity")))

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Set the friction of the step, and return the true torques. See `Disturbance.apply`."""
        rows = plant.scene.v_address[plant.scene.motor_joints]
        ratio = plant.data.qvel[rows] / self.stribeck_velocity
        loss = self.coulomb + self.stribeck * np.exp(-ratio * ratio)
        plant.model.dof_frictionloss[rows] = loss + plant.gear_friction
        return np.asarray(self.gain * tau)

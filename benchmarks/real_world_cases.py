"""Cases of `benchmarks.real_world`: a world, what the controller is told, a motion, and the requirement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Literal

import numpy as np

from benchmarks.mujoco_loop import EARTH, PALM_UP
from graspforce import ContactSet, ForceProblem, Hand, solve
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.control.contacts.lost_drives import LostDrives
from graspforce.control.friction.friction_compensation import FrictionSettings
from graspforce.core.arrays import Array
from graspforce.estimation import CameraModel, SensorModel
from graspforce.geometry import Box, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.simulation import (
    ControllerCommand,
    MeasuredRecording,
    Reference,
    World,
    constant_reference,
    linear_reference,
    simulate_measured,
)
from graspforce.simulation.loops.comparison_controllers import ExactController
from graspforce.simulation.plants.plant_interface import PlantInterface
from graspforce.simulation.worlds.world_plants import PLANT_NAMES, make_world_plant

HANDS = ("allegro_right", "dlr_hit2", "four_finger")
OBJECTS = {"ball": Sphere(0.03), "box": Box([0.05, 0.05, 0.05])}
PLANTS = (*PLANT_NAMES, "drake")
MASS, FRICTION = 0.05, 0.7  # kg
TRAVEL, PERIOD = 0.005, 1.0  # m, end to end, and s
LOSS_TIME = 0.5  # s

Motion = Literal["still", "following"]
Told = Callable[[ControlSettings, Grasp], ControlSettings]


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """A world with a requirement.

    Args:
        label: what is wrong in the world, and the motion.
        requirement: what must hold.
        judge: function from the runs to the measured text and whether the requirement is met. The runs are those of the
            controller and, if `compare` is set, of the controller with full knowledge.
        world: the world.
        motion: "still", or "following" 5 mm at 1 Hz.
        duration: simulated time, s.
        told: what the controller is told beside the sensors. Default: nothing.
        knows_pads: whether the controller is told that the fingertips are soft pads.
        compare: whether the controller with full knowledge runs too.
        lost_contact: index of the contact whose finger loses its drives at `LOSS_TIME`; None for none.
    """

    label: str
    requirement: str
    judge: Callable[[list[MeasuredRecording]], tuple[str, bool]]
    world: World = field(default_factory=World.nominal)
    motion: Motion = "following"
    duration: float = 10.0
    told: Told = lambda settings, grasp: settings
    knows_pads: bool = False
    compare: bool = False
    lost_contact: int | None = None


@cache
def find_case_grasp(hand_name: str, object_name: str) -> Grasp:
    """Return the grasp of a hand, always the same.

    Args:
        hand_name: name of a shipped hand.
        object_name: "ball" or "box".
    """
    hand = Hand.load(hand_name)
    return find_grasp(hand, Body.solid(OBJECTS[object_name], MASS), friction=FRICTION, gravity_H=gravity(hand_name))


def gravity(hand_name: str) -> Array:
    """Return gravity in H with the palm up, m/s².

    Args:
        hand_name: name of a shipped hand.
    """
    return PALM_UP if hand_name.startswith("allegro") else EARTH


def make_case_plant(world: World, grasp: Grasp, gravity_H: Array, name: str) -> PlantInterface:
    """Return the plant of a world, with its pushes.

    Args:
        world: the world.
        grasp: the grasp that the controller is told.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        name: one of `PLANTS`.
    """
    if name != "drake":
        return make_world_plant(world, grasp, gravity_H, name)
    from benchmarks.drake_plant import DrakePlant  # an optional dependency

    def push(plant: DrakePlant) -> None:
        for *force, start, duration in world.pushes:
            if start <= plant.t < start + duration:
                plant.push(force)

    return DrakePlant(grasp, world.plant_options(grasp, gravity_H), events=[push])


def is_supported(case: Case, plant_name: str) -> bool:
    """Return whether a plant can simulate a case: Drake's point contact has no torsional friction.

    Args:
        case: the case.
        plant_name: one of `PLANTS`.
    """
    return plant_name != "drake" or case.world.pad_torsion == 0.0


def run_case(case: Case, hand_name: str, object_name: str, plant_name: str) -> tuple[str, bool]:
    """Return the measured text of a case, and whether its requirement is met.

    Args:
        case: the case.
        hand_name: name of a shipped hand.
        object_name: "ball" or "box".
        plant_name: one of `PLANTS`.
    """
    grasp, gravity_H = find_case_grasp(hand_name, object_name), gravity(hand_name)
    options = case.world.plant_options(grasp, gravity_H)
    base = case.told(ControlSettings(gravity_H=gravity_H), grasp)
    settings = ControlSettings.for_sensors(case.world.sensors, base, drives=grasp.hand.drives).settings
    told = with_soft_contacts(grasp, case.world.pad_torsion) if case.knows_pads else grasp
    if case.lost_contact is not None:
        return run_loss(case, told, settings, plant_name)
    plant = make_case_plant(case.world, grasp, gravity_H, plant_name)
    controllers = [OutputFeedbackController(told, settings, case.world.sensors)]
    if case.compare:
        controllers.append(ExactController(grasp, options, settings, plant))
    runs = [simulate_measured(plant, each, reference(case, grasp), case.duration, case.world) for each in controllers]
    return case.judge(runs)


def run_loss(case: Case, grasp: Grasp, settings: ControlSettings, plant_name: str) -> tuple[str, bool]:
    """Return the measured text of a case in which a finger loses its drives, and whether its requirement is met.

    Whether forces of the other fingers exist is decided without the controller: by Clarabel, for the grasp at rest.

    Args:
        case: the case.
        grasp: the grasp with the contacts that the controller is told.
        settings: settings of the controller.
        plant_name: one of `PLANTS`.
    """
    lost = case.lost_contact or 0
    world = replace(case.world, drive_losses=((grasp.fingers[lost], LOSS_TIME),))
    plant = make_case_plant(world, grasp, settings.gravity_H, plant_name)
    commands: list[tuple[float, bool, str]] = []  # time at the end of the step, s; whether forces are certified; warning

    def on_step(plant: PlantInterface, command: ControllerCommand) -> None:
        commands.append((plant.t, not command.forces_reused, (*command.warnings, "")[0]))

    controller = OutputFeedbackController(grasp, settings, world.sensors)
    run = simulate_measured(plant, controller, reference(case, grasp), case.duration, world, on_step=on_step)
    after = [each for each in commands if each[0] > LOSS_TIME + 0.5 * plant.dt]
    stated = next((t for t, _, warning in after if "lost its drive" in warning), np.inf)
    periods = (stated - LOSS_TIME) * world.sensors.rate
    moved = 1e3 * float(np.linalg.norm(run.motion_error, axis=1).max())  # mm
    fate = f"{'dropped' if run.is_dropped else 'held'}, {moved:.2f} mm"
    if has_forces_without(grasp, lost, settings.gravity_H):
        is_met = not run.is_dropped and after[0][1] and periods < 1.5
        return f"{fate}, forces of the others after {periods:.0f} period", is_met
    return f"no forces exist: {fate}, safe stop after {periods:.0f} period", not after[0][1] and periods < 1.5


def has_forces_without(grasp: Grasp, lost: int, gravity_H: Array) -> bool:
    """Return whether forces of the other contacts hold the object at rest, within motor torques and cones.

    Args:
        grasp: the grasp.
        lost: index of the contact whose finger has no drive.
        gravity_H: (3,) acceleration of gravity in H, m/s².
    """
    contacts = list(grasp.contacts.contacts)
    contacts[lost] = replace(contacts[lost], max_normal=0.0)
    problem = replace(grasp, contacts=ContactSet.stack(contacts)).force_problem(gravity_H)
    drives, actuation = LostDrives.of(grasp, (grasp.fingers[lost],)), problem.actuation
    limp = replace(actuation, tau_u=drives.without_torques(actuation.tau_u))
    return solve(ForceProblem(problem.contacts, problem.w, limp), "clarabel").found


def with_soft_contacts(grasp: Grasp, torsion: float) -> Grasp:
    """Return a grasp with soft contacts.

    Args:
        grasp: the grasp.
        torsion: torsional friction length γ, m.
    """
    contacts = [replace(each, model="soft", torsional_friction=torsion) for each in grasp.contacts.contacts]
    return replace(grasp, contacts=ContactSet.stack(contacts))


def reference(case: Case, grasp: Grasp) -> Reference:
    """Return the desired motion of a case, along the direction in which the grasp can move farthest.

    Args:
        case: the case.
        grasp: the grasp.
    """
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    return constant_reference(start) if case.motion == "still" else linear_reference(start, TRAVEL * np.eye(3)[0], PERIOD)


# ── what the controller is told ────────────────────────────────────────────────────────────────────────────────────────────


def tell_friction(coulomb: float | None) -> Told:
    """Return settings that compensate joint friction.

    Args:
        coulomb: friction of every joint, N·m; None if it is not known.
    """

    def told(settings: ControlSettings, grasp: Grasp) -> ControlSettings:
        n = grasp.hand.n
        model = JointFriction(np.full(n, coulomb or 0.0), np.zeros(n), np.full(n, 0.05), np.zeros(n))
        return replace(settings, friction=FrictionSettings(model=model))

    return told


# ── judges ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def rms_below(limit: float) -> Callable[[list[MeasuredRecording]], tuple[str, bool]]:
    """Return a judge of the RMS error of the object's displacement.

    Args:
        limit: largest RMS error, mm.
    """

    def judge(runs: list[MeasuredRecording]) -> tuple[str, bool]:
        error = 1e3 * np.linalg.norm(runs[0].motion_error, axis=1)  # mm
        rms = float(np.sqrt(np.mean(error**2)))
        return f"{rms:.3f} mm", not runs[0].is_dropped and rms <= limit

    return judge


def rests_within(limit: float) -> Callable[[list[MeasuredRecording]], tuple[str, bool]]:
    """Return a judge of the range of motion in the second half of the run.

    Args:
        limit: largest range of a coordinate, µm.
    """

    def judge(runs: list[MeasuredRecording]) -> tuple[str, bool]:
        p = runs[0].truth.p_HO
        moved = 1e6 * float(np.ptp(p[len(p) // 2 :], axis=0).max())  # µm
        return f"{moved:.2f} µm", not runs[0].is_dropped and moved <= limit

    return judge


def still_within(distance: float, angle: float) -> Callable[[list[MeasuredRecording]], tuple[str, bool]]:
    """Return a judge of the largest displacement and rotation.

    Args:
        distance: mm.
        angle: degrees.
    """

    def judge(runs: list[MeasuredRecording]) -> tuple[str, bool]:
        moved = 1e3 * float(np.linalg.norm(runs[0].motion_error, axis=1).max())  # mm
        turned = float(np.degrees(runs[0].turn_error.max()))
        is_met = not runs[0].is_dropped and moved <= distance and turned <= angle
        return f"{moved:.4f} mm, {turned:.4f}°", is_met

    return judge


def peak_ratio_below(limit: float) -> Callable[[list[MeasuredRecording]], tuple[str, bool]]:
    """Return a judge of the largest displacement, against that of the controller with full knowledge.

    Args:
        limit: largest ratio.
    """

    def judge(runs: list[MeasuredRecording]) -> tuple[str, bool]:
        peaks = [1e3 * float(np.linalg.norm(run.motion_error, axis=1).max()) for run in runs]  # mm
        ratio = peaks[0] / peaks[1]
        return f"{peaks[0]:.3f} mm, ratio {ratio:.2f}", not runs[0].is_dropped and ratio <= limit

    return judge


def scatter_below(limit: float) -> Callable[[list[MeasuredRecording]], tuple[str, bool]]:
    """Return a judge of the RMS error about its mean, which does not contain the bias of the camera.

    Args:
        limit: mm.
    """

    def judge(runs: list[MeasuredRecording]) -> tuple[str, bool]:
        error = runs[0].truth.position_error
        error = error[len(error) // 12 :]  # without the first 5 s of 60 s, in which the estimate moves to the camera's bias
        scatter = 1e3 * float(np.sqrt(np.mean(np.sum((error - error.mean(axis=0)) ** 2, axis=1))))
        return f"{scatter:.3f} mm" + (", dropped" if runs[0].is_dropped else ""), not runs[0].is_dropped and scatter <= limit

    return judge


def held(runs: list[MeasuredRecording]) -> tuple[str, bool]:
    """Judge whether the object is held, with any error."""
    error = 1e3 * float(np.sqrt(np.mean(np.sum(runs[0].motion_error ** 2, axis=1))))  # mm
    return f"{'dropped' if runs[0].is_dropped else 'held'}, {error:.2f} mm", not runs[0].is_dropped


def held_gently(runs: list[MeasuredRecording]) -> tuple[str, bool]:
    """Judge slip of at most 1 mm, and a peak squeeze of at most 1.5 times that of the controller with full knowledge."""
    slip = 1e3 * float(runs[0].sliding.max())  # mm
    squeezes = [float(run.truth.f[:, :, 2].max()) for run in runs]  # N
    ratio = squeezes[0] / squeezes[1]
    is_met = not runs[0].is_dropped and slip <= 1.0 and ratio <= 1.5
    return f"{'dropped, ' if runs[0].is_dropped else ''}slip {slip:.2f} mm, squeeze {ratio:.2f} ×", is_met


# ── cases ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _friction(coulomb: float) -> World:
    return World(joint_friction=coulomb, joint_friction_spread=0.2)


_CAMERA = CameraModel(
    rate=30.0, latency=0.05, position_noise=1e-3, angle_noise=np.radians(1.0), position_bias=3e-3, angle_bias=0.0
)
_PUSH = (0.0, 0.5, 0.0, 0.3, 0.1)  # N in H, s
_GENTLE = "held, slip ≤ 1 mm, squeeze ≤ 1.5 ×"

CASES = (
    Case("nothing", "≤ 0.05 mm", rms_below(0.05)),
    Case("joint friction 0.05 N·m ± 20 %, told 0.05", "≤ 0.2 mm", rms_below(0.2), _friction(0.05), told=tell_friction(0.05)),
    Case("joint friction 0.1 N·m ± 20 %, told 0.1", "≤ 0.4 mm", rms_below(0.4), _friction(0.1), told=tell_friction(0.1)),
    Case("joint friction 0.05 N·m, not told", "≤ 0.4 mm", rms_below(0.4), _friction(0.05), told=tell_friction(None)),
    Case("joint friction 0.1 N·m, not told", "≤ 0.8 mm", rms_below(0.8), _friction(0.1), told=tell_friction(None)),
    Case("joint friction 0.1 N·m, at rest", "≤ 10 µm", rests_within(10.0), _friction(0.1), "still", told=tell_friction(None)),
    Case("no object pose, at rest", "≤ 0.05 mm, ≤ 0.1°", still_within(0.05, 0.1), motion="still"),
    Case("no object pose, following", "≤ 0.2 mm", rms_below(0.2)),
    Case(
        "no object pose, push of 0.5 N", "peak ≤ 1.3 × that with pose", peak_ratio_below(1.3), World(pushes=(_PUSH,)),
        "still", 1.0, compare=True,
    ),
    Case(
        "camera of 30 Hz, 50 ms late, 1 mm and 1° noise, 3 mm bias, 1 s lost", "≤ 0.5 mm about its mean for 60 s",
        scatter_below(0.5), World(sensors=SensorModel(encoder_noise=1e-4, camera=_CAMERA), camera_outages=((20.0, 1.0),)),
        "still", 60.0,
    ),
    Case("delay of 20 ms in the loop", "held", held, World(sensors=SensorModel(latency=0.02))),
    Case("mass × 0.5", _GENTLE, held_gently, World(mass_factor=0.5), compare=True),
    Case("mass × 2", _GENTLE, held_gently, World(mass_factor=2.0), compare=True),
    Case("centre of mass 10 mm off", _GENTLE, held_gently, World(centre_offset=(0.006, 0.008, 0.0)), compare=True),
    Case("μ 40 % below what was told", _GENTLE, held_gently, World(friction_factor=0.6), compare=True),
    Case(
        "contacts 3 mm and normals 5° off", _GENTLE, held_gently,
        World(tip_offset=3e-3, shape_turn=np.radians(5.0)), compare=True,
    ),
    *(
        Case(
            f"drives of the {name} finger lost in mid-hold, soft pads of 5 mm", "held where forces exist, 1 period",
            held, World(pad_torsion=5e-3), "still", 3.0, knows_pads=True, lost_contact=k,
        )
        for k, name in enumerate(("first", "second", "third"))
    ),
    Case("soft pads with MuJoCo's torsion, 5 mm", _GENTLE, held_gently, World(pad_torsion=5e-3), knows_pads=True, compare=True),
)  # fmt: skip

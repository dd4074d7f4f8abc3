"""Grasps, disturbances and recordings that the benchmarks of estimation share: truth from MuJoCo, noise added afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from benchmarks.mujoco_loop import EARTH, PALM_UP
from graspforce import Hand, simulation
from graspforce.contact.compiled_kinematics import slip_displacement
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController, object_motion
from graspforce.control.command import free_torque
from graspforce.core.arrays import Array
from graspforce.core.records import make_unchecked
from graspforce.estimation import GraspEstimator, Measurement, PoseMeasurement, SensorModel
from graspforce.estimation.grasp_monitor import AppliedCommand, GraspMonitor, GraspMonitorEstimate, GraspMonitorSettings
from graspforce.geometry import Box, Sphere
from graspforce.geometry.rotations import rotation_exp
from graspforce.grasp.body import Body
from graspforce.grasp.collision.nearest_pair import NearestPair
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.simulation import Disturbance, FrictionChange, Plant, Push

HANDS, OBJECTS = ("allegro_right", "dlr_hit2", "four_finger"), ("ball", "box")
PERIOD, FRICTION, TRAVEL = 1e-3, 0.7, 0.005  # s, of all contacts, and m at 1 Hz
_FAR_END, _CHECK_STEPS, _DRAWS = 0.51, 10, 100  # s: the motion ends at 0.5 s; periods between two checks; directions
_BODIES = {"ball": Body.solid(Sphere(0.03), 0.05), "box": Body.solid(Box((0.05, 0.05, 0.05)), 0.05)}
_ARRAYS = ("q", "p_HO", "R_HO", "tau", "joint_acceleration", "free_torque", "f_H", "f", "R_OC", "mu", "touching", "slip")


@cache
def grasp_of(hand: str, held: str) -> Grasp:
    """Return the grasp of a hand and an object."""
    return find_grasp(Hand.load(hand), _BODIES[held], friction=FRICTION, gravity_H=gravity_of(hand))


def body_of(held: str) -> Body:
    """Return the body of an object, as the controller knows it."""
    return _BODIES[held]


def gravity_of(hand: str) -> Array:
    """Return the acceleration of gravity with the palm up, in H, m/s²."""
    return PALM_UP if hand.startswith("allegro") else EARTH


@dataclass(frozen=True, eq=False)
class FingerPush:
    """A force on the last link of a finger, at the tip: (3,) in H, N; from `start` for `duration`, s."""

    finger: str
    force: Array
    start: float
    duration: float

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Add the force."""
        if self.start <= t < self.start + self.duration:
            i = plant.scene.grasp.fingers.index(self.finger)
            body, geom = plant.scene.tip_bodies[i], plant.scene.tip_geoms[i]
            arm = plant.data.geom_xpos[geom] - plant.data.xipos[body]  # m
            plant.add_wrench(body, self.force, np.cross(arm, self.force))
        return tau


def free_direction(rng: np.random.Generator, hand: str, held: str) -> Array:
    """Return a random unit vector in H along which the undisturbed motion is free of collisions.

    Directions are drawn uniformly until no two bodies touch that must not, up to the far end of the motion.

    Raises:
        RuntimeError: there is no such direction among 100.
    """
    grasp = grasp_of(hand, held)
    nearest = NearestPair(grasp.hand, SceneCollision(grasp.hand, grasp.body.shape, grasp.fingers, CollisionSettings()))
    for _ in range(_DRAWS):
        direction = rng.standard_normal(3)
        direction /= np.linalg.norm(direction)
        rows = record(hand, held, _FAR_END, direction).rows
        states = zip(*(rows[name][::_CHECK_STEPS] for name in ("q", "p_HO", "R_HO")), strict=True)
        gaps = [nearest.find(*state) for state in states]
        if all(gap is None or gap.distance > 0.0 for gap in gaps):
            return np.asarray(direction)
    raise RuntimeError(f"{hand}, {held}: no direction without collisions")


def random_disturbance(rng: np.random.Generator, kind: str, grasp: Grasp, start: float) -> Disturbance:
    """Return a drop of friction of one finger or of all, or a push on the object or on a finger."""
    finger = grasp.fingers[rng.integers(len(grasp.fingers))]
    if kind.startswith("friction"):
        mu, duration = rng.uniform(0.02, 0.25), float(rng.choice([0.0, 0.02, 0.1, 0.3]))
        return FrictionChange(mu, start, duration, finger if kind == "friction of one" else None)
    direction = rng.standard_normal(3)
    force, duration = rng.uniform(1.0, 6.0) * direction / np.linalg.norm(direction), rng.uniform(0.03, 0.3)
    return Push(force, start, duration) if kind == "push on the object" else FingerPush(finger, 0.7 * force, start, duration)


KINDS = ("friction of one", "friction of all", "push on the object", "push on a finger")


@dataclass(frozen=True, eq=False)
class Truth:
    """True signals of a run, a row for each period.

    Attributes:
        hand, held: names of hand and object.
        desired: desired motion of each period.
        rows: arrays by name: joints q, pose p_HO and R_HO, torques tau, commanded joint_acceleration, the free_torque of the
            hand's own motion that goes with it, forces f_H in H and f in the plant's contact frames, their frames, friction
            mu, touching, and accumulated slip (s, N, 2), m.
    """

    hand: str
    held: str
    desired: Sequence[BodyMotion]
    rows: dict[str, Array]

    def __len__(self) -> int:
        return len(self.rows["q"])

    @property
    def slip(self) -> Array:
        """(s, N) length of the true slip, m."""
        return np.asarray(np.linalg.norm(self.rows["slip"], axis=2))


def record(
    hand: str,
    held: str,
    duration: float,
    direction: Array,
    disturbances: Sequence[Disturbance] = (),
    *,
    body: Body | None = None,
    after_slip: float | None = None,
) -> Truth:
    """Run the controller with the true state along 5 mm at 1 Hz, and return the truth.

    Args:
        hand: name of the hand.
        held: name of the object.
        duration: s.
        direction: (3,) of the motion.
        disturbances: changes of the plant.
        body: the true object; default: that of the grasp.
        after_slip: end the run so long after a slip of 0.5 mm, s.
    """
    grasp, gravity_H = grasp_of(hand, held), gravity_of(hand)
    plant = Plant(simulation.build_scene(grasp, gravity_H=gravity_H, body=body), disturbances=disturbances)
    controller = ObjectController(grasp, ControlSettings(gravity_H=gravity_H))
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    reference = simulation.linear_reference(start, TRAVEL * direction / np.linalg.norm(direction), 1.0)
    first = controller.step(plant.reset(), start)
    controller.reset()
    state, last, end = plant.reset(None if first.forces_reused else first.f), None, np.inf
    slip, desired = np.zeros((len(grasp.fingers), 2)), []
    rows: dict[str, list[Array]] = {name: [] for name in _ARRAYS}
    contacts = plant.true_contacts()
    for k in range(round(duration / PERIOD)):
        motion = object_motion(reference(k * PERIOD))
        command = controller.step(state, motion)
        tips, R_OC = controller.memory.tip_contacts, controller.memory.R_OC
        if last is not None and tips is not None:
            slip = slip + slip_displacement(last, tips, R_OC) * contacts.touching[:, None]
        last = tips
        R_HO = state.object.R_HO
        values: dict[str, Any] = {
            "q": state.q, "p_HO": state.object.p_HO, "R_HO": R_HO, "tau": contacts.tau,
            "joint_acceleration": command.joint_acceleration, "free_torque": free_torque(command),
            "f": contacts.f[:, :3], "R_OC": contacts.R_OC,
            "f_H": np.einsum("ij,njk,nk->ni", R_HO, contacts.R_OC, contacts.f[:, :3]), "mu": contacts.mu,
            "touching": contacts.touching, "slip": slip,
        }  # fmt: skip
        for name, value in values.items():
            rows[name].append(np.array(value))
        desired.append(motion)
        if end == np.inf and after_slip is not None and np.linalg.norm(slip, axis=1).max() > 5e-4:
            end = k * PERIOD + after_slip
        if k * PERIOD > end:
            break
        state = plant.step(command.tau)
        contacts = plant.true_contacts()
    return Truth(hand, held, desired, {name: np.array(values) for name, values in rows.items()})


class Sensing:
    """Estimators behind noisy sensors, one measurement for each row of a truth.

    Args:
        grasp: the grasp, as the estimators know it.
        gravity_H: (3,) m/s².
        sensors: noise of the sensors; poses are measured in every period if there is a camera.
        seed: of the noise.
        settings: settings of the monitor.
    """

    def __init__(
        self, grasp: Grasp, gravity_H: Array, sensors: SensorModel, seed: int, settings: GraspMonitorSettings | None = None
    ) -> None:
        self._grasp, self._sensors, self._rng = grasp, sensors, np.random.default_rng(seed)
        self._state_estimator = GraspEstimator(grasp, sensors, PERIOD)
        self.monitor = GraspMonitor(grasp, sensors, PERIOD, gravity_H, settings)
        self._state: Any = None
        self._memory = self.monitor.initial_memory()
        self._acceleration = np.zeros(grasp.hand.n)
        self._slipping: Any = None
        self._free_torque: Array | None = None
        self._k = 0

    def step(self, truth: Truth, row: int) -> GraspMonitorEstimate:
        """Return the estimate of the next period, in which the row of a truth holds."""
        rows, sensors, rng = truth.rows, self._sensors, self._rng
        t, n = self._k * PERIOD, self._grasp.hand.n
        q = rows["q"][row] + sensors.encoder_noise * rng.standard_normal(n)
        pose = tips = None
        if sensors.camera is not None:
            turn = rotation_exp(sensors.camera.angle_noise * rng.standard_normal(3))
            p = rows["p_HO"][row] + sensors.camera.position_noise * rng.standard_normal(3)
            pose = make_unchecked(PoseMeasurement, t=t, p_HO=p, R_HO=turn @ rows["R_HO"][row], covariance=None)
        if sensors.tip_force_noise is not None:
            tips = np.zeros((len(self._grasp.fingers), 6))
            tips[:, :3] = rows["f_H"][row] + sensors.tip_force_noise * rng.standard_normal(tips[:, :3].shape)
        commanded = rows["tau"][row]
        tau = None if sensors.torque_noise is None else commanded + sensors.torque_noise * rng.standard_normal(n)
        nothing = dict.fromkeys(("v", "current", "contact_points"))
        measurement = make_unchecked(Measurement, t=t, q=q, tau=tau, tip_wrench=tips, object=pose, **nothing)
        if self._state is None:
            self._state = self._state_estimator.initial_memory(replace(measurement, q=rows["q"][row]), 50)
        state, self._state = self._state_estimator.step(self._state, measurement, self._acceleration, slipping=self._slipping)
        applied = AppliedCommand(commanded, self._acceleration, truth.desired[row], self._free_torque)
        estimate, self._memory = self.monitor.step(self._memory, measurement, state, self._state, applied)
        self._acceleration, self._free_torque = rows["joint_acceleration"][row], rows["free_torque"][row]
        self._k += 1
        self._slipping = estimate.slip.evident if estimate.slip.evident.any() else None
        return estimate

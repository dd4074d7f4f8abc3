"""The world as it is, where it differs from what a controller is told: `World`.

A controller gets a grasp: hand, object, contacts, friction. The plant gets that grasp and a world. Nothing in this module
belongs to an engine: `World.plant_options` returns plain numbers for the joints and contacts of one grasp, and each plant
applies them.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.estimation.sensor_model import CameraModel, SensorModel
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.drive import Drives
from graspforce.hand.hand import GRAVITY_PALM_UP
from graspforce.simulation.plants.plant_options import PlantOptions

MAX_SEED = 2**32 - 1
_LEAST_EFFICIENCY = 0.05  # of a true gear

_ABOVE_ZERO = ("mass_factor", "friction_factor", "stribeck_velocity")
_NOT_NEGATIVE = (
    *("tip_offset", "shape_offset", "shape_turn", "joint_friction", "stiction", "viscous_friction"),
    *("pad_torsion", "encoder_offset"),
)
_SHARES = ("joint_friction_spread", "torque_error", "stiffness_error", "drive_error", "camera_outliers")  # [0, 1)
# Streams of random numbers: a new quantity gets a new number, so that the others keep their values for a seed.
_TIPS, _SHAPE, _JOINTS, _MOTORS, _REAL, _DRIVES, _GEARS = range(7)


@dataclass(frozen=True, eq=False, slots=True)
class World:
    """True parameters of hand, object, contacts and sensors, relative to what the controller is told.

    The default is a world without any difference and with perfect encoders, in which the object's pose is not measured.
    Sizes are given here; directions, and the values of single joints and fingers, follow from the seed.

    Args:
        mass_factor: true mass and inertia of the object, divided by those of the grasp.
        centre_offset: (3,) displacement of the centre of mass, in O, m.
        friction_factor: true coefficient of friction, divided by that of the grasp.
        pad_torsion: torsional friction length γ of the fingertips, m; zero for the contact models of the grasp.
        tip_offset: distance of each fingertip's centre from its place in the hand's description, m, in a random direction.
        shape_offset: displacement of the object's surface from its place in O, m, in a random direction.
        shape_turn: rotation of the object's surface about O's origin, rad, about a random axis.
        joint_friction: Coulomb friction of the joints, N·m.
        joint_friction_spread: largest relative deviation of a joint's Coulomb friction from `joint_friction`, in [0, 1).
        stiction: friction at rest beyond the Coulomb friction, as a fraction of it.
        stribeck_velocity: rate at which that surplus has fallen to 37 %, rad/s.
        viscous_friction: viscous friction of the joints, N·m·s/rad.
        torque_error: largest relative deviation of a motor's torque from its command, in [0, 1).
        stiffness_error: largest relative deviation of a drive's stiffness and damping from its description, in [0, 1).
        drive_error: largest relative deviation of a drive's delay, backlash, and losses in each direction, 1 − η and 1 − η_b,
            from its description, each with a factor of its own, in [0, 1).
        sensors: rate, latency and noise of the sensors. The simulation delays torques by `sensors.latency`. A camera's bias
            has the length `position_bias` or the angle `angle_bias`, and a random direction.
        encoder_offset: largest constant error of an encoder, rad.
        camera_outages: (start, duration) of each time without images, s.
        camera_outliers: fraction of images with a pose that is wrong by centimetres, in [0, 1).
        contact_point_noise: standard deviation of measured contact points, m; None if they are not measured.
        pushes: (fx, fy, fz, start, duration) of forces on the object's origin, in H, N, with times in s.
        drive_losses: (finger, time) of each finger whose drives are off from a time on, s. The controller is told in the
            period in which it happens.
        seed: of directions, of single joints and fingers, and of the sensors' noise; 0 to 2³² − 1.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    mass_factor: float = 1.0
    centre_offset: Array = field(default_factory=lambda: freeze(np.zeros(3)))
    friction_factor: float = 1.0
    pad_torsion: float = 0.0
    tip_offset: float = 0.0
    shape_offset: float = 0.0
    shape_turn: float = 0.0
    joint_friction: float = 0.0
    joint_friction_spread: float = 0.0
    stiction: float = 0.0
    stribeck_velocity: float = 0.05
    viscous_friction: float = 0.0
    torque_error: float = 0.0
    stiffness_error: float = 0.0
    drive_error: float = 0.0
    sensors: SensorModel = field(default_factory=SensorModel)
    encoder_offset: float = 0.0
    camera_outages: tuple[tuple[float, float], ...] = ()
    camera_outliers: float = 0.0
    contact_point_noise: float | None = None
    pushes: tuple[tuple[float, ...], ...] = ()
    drive_losses: tuple[tuple[str, float], ...] = ()
    seed: int = 0

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            mass_factor: float = ...,
            centre_offset: npt.ArrayLike = ...,
            friction_factor: float = ...,
            pad_torsion: float = ...,
            tip_offset: float = ...,
            shape_offset: float = ...,
            shape_turn: float = ...,
            joint_friction: float = ...,
            joint_friction_spread: float = ...,
            stiction: float = ...,
            stribeck_velocity: float = ...,
            viscous_friction: float = ...,
            torque_error: float = ...,
            stiffness_error: float = ...,
            drive_error: float = ...,
            sensors: SensorModel = ...,
            encoder_offset: float = ...,
            camera_outages: tuple[tuple[float, float], ...] = ...,
            camera_outliers: float = ...,
            contact_point_noise: float | None = None,
            pushes: tuple[tuple[float, ...], ...] = ...,
            drive_losses: tuple[tuple[str, float], ...] = ...,
            seed: int = 0,
        ) -> None: ...

    def __post_init__(self) -> None:
        for name in _ABOVE_ZERO:
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        for name in (*_NOT_NEGATIVE, *_SHARES):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, minimum=0.0)})
        for name in _SHARES:
            if getattr(self, name) >= 1.0:
                raise InvalidInput(name, getattr(self, name), "less than 1")
        if not isinstance(self.sensors, SensorModel):
            raise InvalidInput("sensors", self.sensors, "a SensorModel")
        if self.contact_point_noise is not None:
            noise = arrays.check_number(self.contact_point_noise, "contact_point_noise", minimum=0.0)
            set_fields(self, contact_point_noise=noise)
        set_fields(
            self,
            centre_offset=arrays.check_array(self.centre_offset, "centre_offset", (3,)),
            camera_outages=_check_rows(self.camera_outages, "camera_outages", 2),
            pushes=_check_rows(self.pushes, "pushes", 5),
            drive_losses=_check_losses(self.drive_losses),
            seed=fields.check_integer(self.seed, "seed", minimum=0, maximum=MAX_SEED),
        )

    @classmethod
    def nominal(cls) -> World:
        """Return the world that the controller is told, with perfect encoders and without a camera."""
        return cls()

    @classmethod
    def real(cls, seed: int, torque_limit: float = 0.7) -> World:
        """Return a random world of a laboratory, with everything wrong at once.

        Uniform distributions, unless stated otherwise:

        - mass × 0.5 to 2 (log-uniform), centre of mass up to 10 mm off
        - friction × 0.6 to 1.1; every second world has pads with a torsional friction length of 1 to 5 mm
        - fingertips up to 3 mm, surface of the object up to 1 mm and 5° off
        - Coulomb friction of the joints 0.03 to 0.14 of `torque_limit`, ± 20 % between joints; friction at rest up to 50 %
          greater; viscous friction up to 0.01 of `torque_limit` at 1 rad/s
        - torques of the motors up to 10 %, stiffness of position drives up to 30 % off; delay of the loop 0 to 10 ms
        - encoders with 0.1 to 1 mrad noise (log-uniform) and up to 5 mrad constant error
        - fingertip forces with 0.02 to 0.1 N noise, and contact points with 0.5 mm noise, in every second world; joint torques
          with 1 to 3 % of `torque_limit` noise in every second world
        - in three of four worlds a camera of 15, 30 or 60 Hz, 20 to 80 ms late, with 0.3 to 1 mm and 0.005 to 0.02 rad noise, a
          bias of up to 3 mm and 0.02 rad, 2 % outliers in every second world, and 1 s without images in every second world
        - a push of 0.5 N for 0.1 s in a random direction, at 0.5 to 2.5 s

        Args:
            seed: of all random values.
            torque_limit: least torque limit of the hand's motors, N·m; a weak hand has less friction.

        Raises:
            InvalidInput: a seed outside 0 to 2³² − 1, or a limit that is not above 0.
        """
        seed = fields.check_integer(seed, "seed", minimum=0, maximum=MAX_SEED)
        torque_limit = arrays.check_number(torque_limit, "torque_limit", above=0.0)
        rng = np.random.default_rng([seed, _REAL])
        push = (*(0.5 * random_direction(rng)), rng.uniform(0.5, 2.5), 0.1)
        has_tip_sensors, has_torques, has_pads, has_camera = rng.uniform(size=4) < (0.5, 0.5, 0.5, 0.75)
        camera = CameraModel(
            rate=float(rng.choice([15.0, 30.0, 60.0])),
            latency=rng.uniform(0.02, 0.08),
            position_noise=rng.uniform(3e-4, 1e-3),
            angle_noise=rng.uniform(0.005, 0.02),
            position_bias=rng.uniform(0.0, 3e-3),
            angle_bias=rng.uniform(0.0, 0.02),
        )
        outage, outliers = rng.uniform(0.5, 3.0), float(rng.choice([0.0, 0.02]))
        is_interrupted = rng.uniform() < 0.5
        tip_noise, torque_noise = rng.uniform(0.02, 0.1), rng.uniform(0.01, 0.03) * torque_limit  # N and N·m
        return cls(
            mass_factor=math.exp(rng.uniform(math.log(0.5), math.log(2.0))),
            centre_offset=rng.uniform(0.0, 0.01) * random_direction(rng),
            friction_factor=rng.uniform(0.6, 1.1),
            pad_torsion=rng.uniform(1e-3, 5e-3) * has_pads,
            tip_offset=rng.uniform(0.0, 3e-3),
            shape_offset=rng.uniform(0.0, 1e-3),
            shape_turn=rng.uniform(0.0, math.radians(5.0)),
            joint_friction=rng.uniform(0.03, 0.14) * torque_limit,
            joint_friction_spread=0.2,
            stiction=rng.uniform(0.0, 0.5),
            viscous_friction=rng.uniform(0.0, 0.01) * torque_limit,
            torque_error=rng.uniform(0.0, 0.1),
            stiffness_error=0.3,
            sensors=SensorModel(
                encoder_noise=math.exp(rng.uniform(math.log(1e-4), math.log(1e-3))),
                latency=1e-3 * int(rng.integers(0, 11)),
                torque_noise=torque_noise if has_torques else None,
                tip_force_noise=tip_noise if has_tip_sensors else None,
                camera=camera if has_camera else None,
            ),
            encoder_offset=rng.uniform(0.0, 5e-3),
            camera_outages=((outage, 1.0),) if has_camera and is_interrupted else (),
            camera_outliers=outliers if has_camera else 0.0,
            contact_point_noise=5e-4 if has_tip_sensors else None,
            pushes=(push,),
            seed=seed,
        )

    def to_dict(self) -> JsonRecord:
        """Return a plain record of all fields."""
        record: dict[str, Any] = {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}
        rows = {name: [list(row) for row in record[name]] for name in ("camera_outages", "pushes", "drive_losses")}
        return {**record, **rows, "centre_offset": self.centre_offset.tolist(), "sensors": self.sensors.to_dict()}

    @classmethod
    def from_dict(cls, record: object, field: str = "world") -> World:
        """Read a world from a plain record. Fields that are absent or null take their defaults.

        Args:
            record: fields by name.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, optional=[each.name for each in dataclasses.fields(cls)])
        given = {name: value for name, value in values.items() if value is not None}
        if "sensors" in given:
            given["sensors"] = SensorModel.from_dict(given["sensors"], f"{field}.sensors")
        try:
            return cls(**given)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    # ── values for one grasp ───────────────────────────────────────────────────────────────────────────────────────────────

    def plant_options(self, grasp: Grasp, gravity_H: npt.ArrayLike = GRAVITY_PALM_UP, dt: float = 1e-3) -> PlantOptions:
        """Return the true parameters for the joints, fingers and object of a grasp.

        Args:
            grasp: the grasp that the controller is told.
            gravity_H: (3,) acceleration of gravity in H, m/s².
            dt: length of a step, s.
        """
        count, n = len(grasp.contacts), grasp.hand.n
        body = grasp.body
        true_body = Body(
            self.mass_factor * body.mass, self.mass_factor * body.inertia, body.p_OM + self.centre_offset, body.shape
        )
        shape = self.rng(_SHAPE)
        spread = self.joint_friction_spread * self.rng(_JOINTS).uniform(-1.0, 1.0, n)
        coulomb = self.joint_friction * (1.0 + spread)  # N·m
        return PlantOptions(
            gravity_H=gravity_H,
            dt=dt,
            body=true_body,
            friction=self.friction_factor * grasp.contacts.mu,
            torsional_friction=np.full(count, self.pad_torsion) if self.pad_torsion > 0.0 else None,
            tip_offset=self.tip_offset * np.array([random_direction(self.rng(_TIPS, i)) for i in range(count)]),
            shape_offset=self.shape_offset * random_direction(shape),
            shape_turn=self.shape_turn * random_direction(shape),
            coulomb=coulomb,
            stribeck=self.stiction * coulomb,
            stribeck_velocity=self.stribeck_velocity,
            viscous=self.viscous_friction,
            torque_gain=1.0 + self.torque_error * self.rng(_MOTORS).uniform(-1.0, 1.0, n),
        )

    def true_drives(self, drives: Drives) -> Drives:
        """Return the true drives of a hand. Stiffness and damping of each joint differ by one factor.

        Args:
            drives: drives of the hand's description.
        """
        rng, gears = self.rng(_DRIVES), self.rng(_GEARS)
        joints = []
        for drive in drives.joints:
            factor = 1.0 + self.stiffness_error * rng.uniform(-1.0, 1.0)
            stiffness = None if drive.stiffness is None else factor * drive.stiffness
            delay, backlash, *losses = 1.0 + self.drive_error * gears.uniform(-1.0, 1.0, 4)
            driving, backdriving = np.multiply(losses, [1.0 - drive.efficiency, 1.0 - drive.backdriving_efficiency])
            true = dataclasses.replace(
                drive,
                stiffness=stiffness,
                damping=factor * drive.damping,
                delay=delay * drive.delay,
                backlash=backlash * drive.backlash,
                efficiency=max(1.0 - driving, _LEAST_EFFICIENCY),
                backdriving_efficiency=max(1.0 - backdriving, _LEAST_EFFICIENCY),
            )
            joints.append(true)
        return Drives(tuple(joints))

    def rng(self, *stream: int) -> np.random.Generator:
        """Return the source of random numbers of one quantity.

        Args:
            *stream: number of the quantity, and index within it. Each stream is independent of the others.
        """
        return np.random.default_rng([self.seed, *stream])


def random_direction(rng: np.random.Generator) -> Array:
    """Return a unit vector with uniform distribution over the sphere, (3,).

    Args:
        rng: source of random numbers.
    """
    direction = rng.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction))


def _check_rows(value: object, name: str, width: int) -> tuple[tuple[float, ...], ...]:
    """Return rows of numbers of which the last two are a start and a duration, both at least 0."""
    rows = []
    for i, item in enumerate(fields.check_sequence(value, name)):
        row = arrays.check_array(item, f"{name}[{i}]", (width,))
        for k in (width - 2, width - 1):
            arrays.check_number(row[k], f"{name}[{i}][{k}]", minimum=0.0)
        rows.append(tuple(row.tolist()))
    return tuple(rows)


def _check_losses(value: object) -> tuple[tuple[str, float], ...]:
    """Return pairs of a finger's name and a time that is at least 0."""
    losses = []
    for i, item in enumerate(fields.check_sequence(value, "drive_losses")):
        name = f"drive_losses[{i}]"
        pair = fields.check_sequence(item, name)
        if len(pair) != 2:
            raise InvalidInput(name, item, "a finger's name and a time in s")
        losses.append((fields.check_text(pair[0], f"{name}[0]"), arrays.check_number(pair[1], f"{name}[1]", minimum=0.0)))
    return tuple(losses)

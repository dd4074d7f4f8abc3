"""Options of the command line that describe a world: what is true beside what the controller is told."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.estimation import CameraModel, SensorModel
from graspforce.simulation.worlds.world import World

Preset = Literal["nominal", "real"]

PRESETS: tuple[Preset, ...] = ("nominal", "real")

_EXACT_POSITION, _EXACT_ANGLE = 1e-7, 1e-6  # m and rad: noise of a pose that is measured without noise
# --noise: for each sensor the fields of SensorModel, CameraModel or World, and the number of values that are required
_NOISE = {
    "encoder": (("encoder_noise", "encoder_resolution"), 1),
    "velocity": (("velocity_noise",), 1),
    "torque": (("torque_noise",), 1),
    "current": (("current_noise",), 1),
    "tip": (("tip_force_noise",), 1),
    "point": (("contact_point_noise",), 1),
    "pose": (("position_noise", "angle_noise"), 2),
    "bias": (("position_bias", "angle_bias"), 1),
}
_NOISE_FORMAT = (
    "encoder=RAD[:RESOLUTION], velocity=RAD/S, torque=NM, current=A, tip=N, point=M, pose=M:RAD or "
    "bias=M[:RAD], separated by commas"
)


@dataclass(frozen=True, slots=True)
class WorldOptions:
    """The world that the command's options describe. Options that are given replace those of the preset.

    Args:
        preset: "nominal" or "real", a random world; None if it is not given.
        seed: of the world.
        noise: noise of the sensors, such as "encoder=1e-3,pose=1e-3:0.02".
        camera: "RATE:LATENCY", Hz and s.
        camera_lost: "START:DURATION" of each time without images, s.
        no_pose: the object's pose is not measured.
        rate: measurements and commands per second, Hz.
        delay: from a measurement to the torque that follows from it, s.
        friction_error: relative error of the told friction: −0.4 if the true one is 40 % less.
        mass_error: relative error of the told mass: 0.3 if the true one is 30 % greater.
        centre_error: "X,Y,Z" displacement of the centre of mass in O, m.
        contact_error: "M[:RAD]" displacement of fingertips, and rotation of the object's surface.
        joint_friction: "NM[:SPREAD[:STICTION]]": Coulomb friction, and as fractions of it its spread between joints and the
            surplus at rest.
        torque_error: largest relative error of a motor's torque.
        stiffness_error: largest relative error of a drive's stiffness and damping.
        drive_error: largest relative error of a drive's delay, backlash and losses.
        pad_torsion: torsional friction length of the fingertips, m.
        lose: "FINGER:TIME" of each finger whose drives are off from a time on, s.

    Raises:
        InvalidInput: an option has another form, or a value is out of range.
    """

    preset: Preset | None = None
    seed: int = 0
    noise: str | None = None
    camera: str | None = None
    camera_lost: tuple[str, ...] = ()
    no_pose: bool = False
    rate: float | None = None
    delay: float | None = None
    friction_error: float | None = None
    mass_error: float | None = None
    centre_error: str | None = None
    contact_error: str | None = None
    joint_friction: str | None = None
    torque_error: float | None = None
    stiffness_error: float | None = None
    drive_error: float | None = None
    pad_torsion: float | None = None
    lose: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.preset is not None:
            fields.check_choice(self.preset, "world", PRESETS)
        if self.no_pose and (self.camera is not None or self.camera_lost):
            raise InvalidInput("--no-pose", True, "given without --camera and --camera-lost")
        self.world(self.seed)

    @property
    def is_given(self) -> bool:
        """Whether an option makes a world."""
        return any(getattr(self, each.name) != each.default for each in dataclasses.fields(self) if each.name != "seed")

    def world(self, seed: int, torque_limit: float = 0.7, pushes: tuple[tuple[float, ...], ...] = ()) -> World:
        """Return the world of a seed.

        Without options of sensors, the nominal world has perfect encoders, and measures the object's pose in each period.

        Args:
            seed: of the world.
            torque_limit: least torque limit of the hand's motors, N·m, as in `World.real`.
            pushes: further pushes, as in `World`.

        Raises:
            InvalidInput: a value is out of range; names the option.
        """
        base = World.real(seed, torque_limit) if self.preset == "real" else World(seed=seed)
        changes = self._physical_changes()
        sensors, extra = self._sensors(base.sensors, self.preset == "real")
        outages = tuple(_numbers(text, "--camera-lost", "START:DURATION", 2, 2) for text in self.camera_lost)
        if outages or sensors.camera is None:
            changes["camera_outages"] = outages
        losses = (*base.drive_losses, *(_parse_loss(text) for text in self.lose))
        pushes = (*base.pushes, *pushes)
        return dataclasses.replace(base, sensors=sensors, pushes=pushes, drive_losses=losses, **changes, **extra)

    def _physical_changes(self) -> dict[str, Any]:
        """Return the given fields of hand, object and contacts."""
        changes: dict[str, Any] = {}
        for option, name in (("friction_error", "friction_factor"), ("mass_error", "mass_factor")):
            error = getattr(self, option)
            if error is not None:
                changes[name] = 1.0 + arrays.check_number(error, f"--{option.replace('_', '-')}", above=-1.0)
        for name in ("torque_error", "stiffness_error", "drive_error", "pad_torsion"):
            if getattr(self, name) is not None:
                changes[name] = arrays.check_number(getattr(self, name), f"--{name.replace('_', '-')}", minimum=0.0)
        if self.centre_error is not None:
            changes["centre_offset"] = _numbers(self.centre_error, "--centre-error", "X,Y,Z", 3, 3, ",")
        if self.contact_error is not None:
            values = _numbers(self.contact_error, "--contact-error", "M[:RAD]", 1, 2)
            changes.update(zip(("tip_offset", "shape_turn"), values, strict=False))
        if self.joint_friction is not None:
            values = _numbers(self.joint_friction, "--joint-friction", "NM[:SPREAD[:STICTION]]", 1, 3)
            changes.update(zip(("joint_friction", "joint_friction_spread", "stiction"), values, strict=False))
        return changes

    def _sensors(self, base: SensorModel, has_preset: bool) -> tuple[SensorModel, dict[str, Any]]:
        """Return the sensors, and further fields of the world that belong to them."""
        noise = self._parse_noise()
        extra = {"contact_point_noise": noise.pop("contact_point_noise")} if "contact_point_noise" in noise else {}
        camera_fields = {each.name for each in dataclasses.fields(CameraModel)}
        camera_noise = {name: noise.pop(name) for name in list(noise) if name in camera_fields}
        changes: dict[str, Any] = dict(noise)
        if "velocity_noise" in noise:
            changes["has_velocity"] = True
        if self.rate is not None:
            changes["rate"] = arrays.check_number(self.rate, "--rate", above=0.0)
        if self.delay is not None:
            changes["latency"] = arrays.check_number(self.delay, "--delay", minimum=0.0)
        rate = changes.get("rate", base.rate)
        camera = base.camera
        if camera is None and not has_preset:
            camera = CameraModel(rate, 0.0, _EXACT_POSITION, _EXACT_ANGLE)
        if self.camera is not None:
            image_rate, latency = _numbers(self.camera, "--camera", "RATE:LATENCY", 2, 2)
            arrays.check_number(image_rate, "--camera", above=0.0)
            arrays.check_number(latency, "--camera", minimum=0.0)
            camera = dataclasses.replace(camera or CameraModel(), rate=image_rate, latency=latency)
        if camera_noise:
            camera = dataclasses.replace(camera or CameraModel(rate, 0.0), **camera_noise)
        return dataclasses.replace(base, camera=None if self.no_pose else camera, **changes), extra

    def _parse_noise(self) -> dict[str, float]:
        """Return the fields that --noise sets."""
        found: dict[str, float] = {}
        for part in self.noise.split(",") if self.noise is not None else ():
            name, sign, text = part.partition("=")
            if not sign or name not in _NOISE:
                raise InvalidInput("--noise", part, _NOISE_FORMAT)
            names, required = _NOISE[name]
            values = _numbers(text, f"--noise {name}", _NOISE_FORMAT, required, len(names))
            for field, value in zip(names, values, strict=False):
                found[field] = arrays.check_number(value, f"--noise {name}", minimum=0.0)
        for field, exact in (("position_noise", _EXACT_POSITION), ("angle_noise", _EXACT_ANGLE)):
            if field in found:
                found[field] = max(found[field], exact)
        return found


def _parse_loss(text: str) -> tuple[str, float]:
    """Return finger and time, s, of an option such as index:1.5."""
    form = "FINGER:TIME, such as index:1.5"
    finger, _, time = text.rpartition(":")
    (t,) = _numbers(time, "--lose", form, 1, 1)
    if not finger:
        raise InvalidInput("--lose", text, form)
    return finger, arrays.check_number(t, "--lose", minimum=0.0)


def _numbers(text: str, option: str, form: str, least: int, most: int, separator: str = ":") -> tuple[float, ...]:
    """Return the numbers of an option such as 30:0.05."""
    try:
        numbers = tuple(float(part) for part in text.split(separator))
    except ValueError:
        numbers = ()
    if not least <= len(numbers) <= most:
        raise InvalidInput(option, text, form)
    return numbers

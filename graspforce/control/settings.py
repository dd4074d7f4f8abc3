"""Settings of the object controller: gains, margins, limits and tolerances."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.control.friction.friction_compensation import FrictionSettings
from graspforce.control.sensor_gains import LoopMargins, LoopTargets, fastest_loop
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.core.settings_record import SettingsRecord
from graspforce.estimation.sensor_model import SensorModel
from graspforce.force.uncertainty import Uncertainty
from graspforce.grasp.collision.obstacle import Obstacle, check_obstacles
from graspforce.hand.drives.drive import Drives
from graspforce.hand.hand import GRAVITY_PALM_UP


@dataclass(frozen=True, eq=False, slots=True)
class PoseGains(SettingsRecord):
    """PID gains on the object's pose error, separate for translation and rotation.

    The commanded acceleration is a = a_d + kd (V_d − V) + kp e + ki ∫ e dt. By default the poles are a double pole at 40 rad/s,
    and the integral removes an offset with a time constant of about 0.2 s.

    Args:
        kp_linear, kp_angular: proportional gains, 1/s², from 0 to 1e12.
        kd_linear, kd_angular: derivative gains, 1/s, from 0 to 1e12.
        ki_linear, ki_angular: integral gains, 1/s³, from 0 to 1e12 and less than kd·kp (Routh's criterion).

    Raises:
        InvalidInput: a gain is negative or not finite, or the loop is unstable.
    """

    RECORD: ClassVar[str] = "gains"

    kp_linear: float = 1600.0
    kd_linear: float = 80.0
    ki_linear: float = 8000.0
    kp_angular: float = 1600.0
    kd_angular: float = 80.0
    ki_angular: float = 8000.0

    def __post_init__(self) -> None:
        gains = {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}
        set_fields(self, **{name: arrays.check_number(gain, name, minimum=0.0, maximum=1e12) for name, gain in gains.items()})
        for part in ("linear", "angular"):
            kp, kd, ki = (getattr(self, f"{gain}_{part}") for gain in ("kp", "kd", "ki"))
            if ki > 0.0 and ki >= kp * kd:
                allowed = f"less than kp_{part}·kd_{part} = {kp * kd:g}, otherwise the loop is unstable"
                raise InvalidInput(f"ki_{part}", ki, allowed)

    @classmethod
    def critically_damped(cls, linear: float, angular: float, integral: float = 0.0) -> PoseGains:
        """Return gains with double poles at given rates.

        Args:
            linear: pole rates of translation and rotation, rad/s, at least 0.
            angular: pole rates of translation and rotation, rad/s, at least 0.
            integral: approximate rate at which the integral removes an offset, 1/s, at least 0.

        Raises:
            InvalidInput: a rate is negative or not finite.
        """
        rates = [arrays.check_number(rate, name, minimum=0.0) for name, rate in (("linear", linear), ("angular", angular))]
        offset_rate = arrays.check_number(integral, "integral", minimum=0.0)
        return cls(*(gain for rate in rates for gain in (rate**2, 2.0 * rate, offset_rate * rate**2)))

    def rows(self) -> Array:
        """Return kp, kd and ki as the rows of a (3, 6) array, each repeated for the components of a twist."""
        linear = [self.kp_linear, self.kd_linear, self.ki_linear]
        angular = [self.kp_angular, self.kd_angular, self.ki_angular]
        return freeze(np.repeat(np.array([linear, angular]).T, 3, axis=1))


@dataclass(frozen=True, eq=False, slots=True)
class ControlSettings:
    """Settings of the object controller. Each number is at most 1e6.

    Args:
        gains: gains on the object's pose error.
        slip_margin: friction margin s of the planned forces, N: ‖f_t‖ ≤ μ f_n − s at every contact with friction. If it is
            infeasible, the forces keep 99.9 % of the largest feasible margin.
        friction_reserve: fraction of μ that the planned forces leave unused, in [0, 1): they use μ (1 − reserve).
        force_weight: ρ in the cost ½‖tau‖²_W + ½ρ‖f‖², (N·m/N)². It makes forces unique that load no motor.
        posture_stiffness: stiffness of the joints towards their desired posture, 1/s². It acts in the null space of the
            contacts and on fingers without contact. The pull is limited so that joints approach at their speed limits at most.
        posture_damping: damping of the same motion, 1/s.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        period: time between two steps, s, from 1e-6 to 10.
        integral_limit_linear: largest linear acceleration from the integral, m/s².
        integral_limit_angular: largest angular acceleration from the integral, rad/s².
        creep_limit: sliding distance of a fingertip from which the controller warns of slip, m. With noisy encoders at least
            four standard deviations of the fingertip's position count.
        creep_time: time constant with which past sliding is forgotten, s.
        contact_tolerance: distance between fingertip and surface from which the controller warns of a lost contact, m.
        rank_tolerance: singular values of the constraint matrix below this fraction of the largest count as zero, in (0, 1).
        friction: compensation of joint friction; None for none. The slip margin grows by
            `friction_compensation.friction_slip_margin` of its `torque_error`.
        friction_error: fraction e by which true friction may be less than modelled, in [0, 1): forces use μ (1 − e) and
            γ (1 − e).
        mass_error: fraction e by which the true mass may differ, in [0, 1). The slip margin grows by the friction that a
            further load of e m g may use, in any direction.
        contact_error: largest angle between true and modelled contact normals, rad. Forces use the cone that is inside all
            true cones. A contact that is d off on a surface of radius ρ has a normal that is d/ρ off.
        position_error: largest error of the joint positions in a state, rad. Servos that take positions turn it into torques.
        reflex_squeeze: fraction by which the reflex on slip raises the normal force of a contact at once; see `slip_reflex`.
        reflex_time: time constant with which the reflex decays, s.
        clearance_steps: in streams, the commands of states whose sequence number this divides contain `Command.clearance`; 0
            for none.
        obstacles: bodies at rest in H, such as a table, whose distance counts in `Command.clearance`.
        spin_compliance: ℓ₀ of `contacts.mobility`, by which the object yields where fingers cannot follow the spin of their
            soft pads, m/rad. With 0 the object follows exactly, and the pads spin and creep.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    gains: PoseGains = field(default_factory=PoseGains)
    slip_margin: float = 0.5
    friction_reserve: float = 0.1
    force_weight: float = 1e-6
    posture_stiffness: float = 400.0
    posture_damping: float = 40.0
    gravity_H: Array = field(default_factory=lambda: freeze(GRAVITY_PALM_UP))
    period: float = 1e-3
    integral_limit_linear: float = 5.0
    integral_limit_angular: float = 50.0
    creep_limit: float = 1e-4
    creep_time: float = 1.0
    contact_tolerance: float = 1e-3
    rank_tolerance: float = 0.01
    friction: FrictionSettings | None = None
    friction_error: float = 0.0
    mass_error: float = 0.0
    contact_error: float = 0.0
    position_error: float = 0.0
    reflex_squeeze: float = 0.3
    reflex_time: float = 5.0
    clearance_steps: int = 0
    obstacles: tuple[Obstacle, ...] = ()
    spin_compliance: float = 0.0

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            gains: PoseGains = ...,
            slip_margin: float = ...,
            friction_reserve: float = ...,
            force_weight: float = ...,
            posture_stiffness: float = ...,
            posture_damping: float = ...,
            gravity_H: npt.ArrayLike = ...,
            period: float = ...,
            integral_limit_linear: float = ...,
            integral_limit_angular: float = ...,
            creep_limit: float = ...,
            creep_time: float = ...,
            contact_tolerance: float = ...,
            rank_tolerance: float = ...,
            friction: FrictionSettings | None = ...,
            friction_error: float = ...,
            mass_error: float = ...,
            contact_error: float = ...,
            position_error: float = ...,
            reflex_squeeze: float = ...,
            reflex_time: float = ...,
            clearance_steps: int = ...,
            obstacles: Sequence[Obstacle] = ...,
            spin_compliance: float = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        not_negative = ("slip_margin", "friction_reserve", "force_weight", "posture_stiffness", "posture_damping")
        errors = ("friction_error", "mass_error", "contact_error", "position_error", "reflex_squeeze", "spin_compliance")
        for name in (*not_negative, "integral_limit_linear", "integral_limit_angular", *errors):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, minimum=0.0, maximum=_LARGEST)})
        set_fields(self, period=check_period(self.period))
        for name in ("creep_limit", "creep_time", "contact_tolerance", "rank_tolerance", "reflex_time"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0, maximum=_LARGEST)})
        for name in ("friction_reserve", "rank_tolerance", "friction_error", "mass_error"):
            if getattr(self, name) >= 1.0:
                raise InvalidInput(name, getattr(self, name), "less than 1")
        if self.friction is not None and not isinstance(self.friction, FrictionSettings):
            raise InvalidInput("friction", self.friction, "FrictionSettings, or None")
        steps = fields.check_integer(self.clearance_steps, "clearance_steps", minimum=0, maximum=_MAX_CLEARANCE_STEPS)
        gravity_H = arrays.check_array(self.gravity_H, "gravity_H", (3,), limit=_LARGEST)
        set_fields(self, gravity_H=gravity_H, clearance_steps=steps, obstacles=check_obstacles(self.obstacles))

    @classmethod
    def for_sensors(
        cls,
        sensors: SensorModel,
        base: ControlSettings | None = None,
        targets: LoopTargets | None = None,
        drives: Drives | None = None,
    ) -> SensorSettings:
        """Return settings with the fastest gains that sensors and drives permit, and the margins of their loop.

        The loop contains the joint filter of `GraspEstimator`. The posture's stiffness and damping are reduced to half of the
        rate of the gains, and the tolerances of the hold at rest are raised to four standard deviations of the motion that
        sensor noise causes. The error of joint positions is at least three standard deviations of the estimated ones.
        Objects yield to soft pads by 10 mm/rad, with compensated joint friction by 30 mm/rad, unless the base states a value.

        Args:
            sensors: rate, latency and noise of the joints' sensors.
            base: the other settings. Default: `ControlSettings()`.
            targets: required margins, and largest noise. Default: `LoopTargets()`, with an integral three times as fast for
                drives that state errors.
            drives: drives of the hand. Their delay counts as latency. A drive that takes set-points less often than the
                controller computes them holds each one longer, on average by half of the difference. The required delay margin
                is larger by that time. Default: drives without delay that take every set-point.

        Raises:
            InvalidInput: no gains meet the requirements.
        """
        base = cls() if base is None else base
        if drives is not None:
            targets = _targets_for(drives) if targets is None else targets
            sensors = sensors.with_delay(drives.delay)
            hold = drives.longest_hold - max(base.period, 1.0 / sensors.rate)  # s, beyond that of the controller
            targets = dataclasses.replace(targets, delay_margin=targets.delay_margin + max(0.5 * hold, 0.0))
        gains, margins = fastest_loop(sensors, base.period, targets)
        stiffness = min(base.posture_stiffness, (0.5 * margins.rate) ** 2)
        damping = min(base.posture_damping, margins.rate)
        friction = base.friction
        if friction is not None:
            noise = 4.0 * margins.position_noise  # rad
            friction = dataclasses.replace(
                friction,
                rest_tolerance_linear=max(friction.rest_tolerance_linear, _LEVER * noise),
                rest_tolerance_angular=max(friction.rest_tolerance_angular, noise),
            )
        settings = dataclasses.replace(
            base,
            gains=PoseGains(gains.kp, gains.kd, gains.ki, gains.kp, gains.kd, gains.ki),
            posture_stiffness=stiffness,
            posture_damping=damping,
            friction=friction,
            position_error=max(base.position_error, _POSITION_DEVIATIONS * margins.estimate_noise),
            spin_compliance=base.spin_compliance or (_SPIN_COMPLIANCE if friction is None else _STIFF_SPIN_COMPLIANCE),
        )
        return SensorSettings(settings, margins)

    @classmethod
    def for_uncertainty(cls, uncertainty: Uncertainty, base: ControlSettings | None = None) -> ControlSettings:
        """Return settings with which the controller's forces hold for errors of friction, normals and mass.

        The controller takes the largest errors of all contacts. It covers the error of the mass by a slip margin for a load in
        any direction, so that its forces are larger than those of `solve` for the same uncertainty.

        Args:
            uncertainty: with friction_error, normal_error, mass_error and slip_margin only.
            base: the other settings, of which friction_reserve stays. Default: `ControlSettings()`.

        Raises:
            InvalidInput: another error is not zero.
        """
        for name in ("centre_of_mass_error", "wrenches", "wrench_ellipsoid", "position_error", "torque_error"):
            if getattr(uncertainty, name).any():
                allowed = "zero without a grasp: `control.settings_for_errors` covers all errors of a grasp at rest"
                raise InvalidInput(f"uncertainty.{name}", getattr(uncertainty, name).tolist(), allowed)
        return dataclasses.replace(
            cls() if base is None else base,
            friction_error=float(uncertainty.friction_error.max()),
            contact_error=float(uncertainty.normal_error.max()),
            mass_error=uncertainty.mass_error,
            slip_margin=uncertainty.slip_margin,
        )

    @property
    def posture_decay_rate(self) -> float:
        """Rate with which a joint approaches its desired posture, 1/s: max(kd, 2 √kp) of the posture's stiffness and damping.

        A joint that is Δq off approaches with the speed kp Δq divided by this rate. Less damping than critical would only make
        the joint oscillate, so the rate is at least 2 √kp.
        """
        return max(self.posture_damping, 2.0 * math.sqrt(self.posture_stiffness))

    def to_dict(self) -> JsonRecord:
        """Return a plain record of all settings.

        Three names differ there: `gravity` is `gravity_H`, `touch_gap` is `contact_tolerance`, and `least_lever` is
        `rank_tolerance`. Settings that the first edition lacks are omitted at their defaults: its servers read the record.
        """
        omitted = {name for name, default in _LATER.items() if getattr(self, name) == default}
        names = [each.name for each in dataclasses.fields(self) if each.name not in omitted]
        record = {_RECORD_NAMES.get(name, name): getattr(self, name) for name in names}
        record |= {"gravity": self.gravity_H.tolist(), "gains": self.gains.to_dict()}
        if self.obstacles:
            record["obstacles"] = [obstacle.to_dict() for obstacle in self.obstacles]
        return record if self.friction is None else {**record, "friction": self.friction.to_dict()}

    @classmethod
    def from_dict(cls, record: object, field: str = "settings") -> ControlSettings:
        """Read settings from a plain record. Settings that are absent or null take their defaults.

        Args:
            record: settings as `to_dict` names them.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
        """
        names = {_RECORD_NAMES.get(each.name, each.name): each.name for each in dataclasses.fields(cls)}
        values = fields.check_record(record, field, optional=names)
        given = {names[name]: value for name, value in values.items() if value is not None}
        if "gains" in given:
            given["gains"] = PoseGains.from_dict(given["gains"], f"{field}.gains")
        if "friction" in given:
            given["friction"] = FrictionSettings.from_dict(given["friction"], f"{field}.friction")
        if "obstacles" in given:
            items = fields.check_sequence(given["obstacles"], f"{field}.obstacles")
            given["obstacles"] = [Obstacle.from_dict(item, f"{field}.obstacles[{i}]") for i, item in enumerate(items)]
        try:
            return cls(**given)
        except InvalidInput as error:
            name, bracket, index = error.field.partition("[")
            record_name = _RECORD_NAMES.get(name, name) + bracket + index
            raise error.with_field(record_name).with_prefix(field) from None


def check_period(value: object, field: str = "period") -> float:
    """Return the time between two steps of a control loop, s, from 1e-6 to 10.

    Args:
        value: the value to check.
        field: its path for error messages.

    Raises:
        InvalidInput: not a number in the range.
    """
    return arrays.check_number(arrays.check_number(value, field, above=0.0), field, minimum=1e-6, maximum=10.0)


# Settings that the first edition lacks, and their defaults.
_LATER = {
    "friction": None,
    **dict.fromkeys(("friction_error", "mass_error", "contact_error", "position_error"), 0.0),
    "reflex_squeeze": 0.3,
    "reflex_time": 5.0,
    "clearance_steps": 0,
    "obstacles": (),
    "spin_compliance": 0.0,
}


class SensorSettings(NamedTuple):
    """Settings for given sensors.

    Attributes:
        settings: the settings.
        margins: stability margins and noise of the loop with these gains.
    """

    settings: ControlSettings
    margins: LoopMargins


def _targets_for(drives: Drives) -> LoopTargets:
    """Return requirements on the loop of drives: wrong torques change with the motion, and the integral must follow."""
    has_errors = drives.values("torque_error").any() or drives.values("stiffness_error").any()
    return LoopTargets(integral=_DRIVE_INTEGRAL) if has_errors else LoopTargets()


_DRIVE_INTEGRAL = 15.0  # 1/s
_MAX_CLEARANCE_STEPS = 10**6
_LARGEST = 1e6  # of each setting in its unit
_SPIN_COMPLIANCE, _STIFF_SPIN_COMPLIANCE = 0.01, 0.03  # m/rad; joints with friction move less
_POSITION_DEVIATIONS = 3.0  # standard deviations that count as the largest error
_LEVER = 0.1  # m: length of a finger, from joint motions to motions of the object

# Names in a record; the other fields have the same name there.
_RECORD_NAMES = {"gravity_H": "gravity", "contact_tolerance": "touch_gap", "rank_tolerance": "least_lever"}

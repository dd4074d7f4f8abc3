"""Compensation of joint friction: feed-forward along the planned motion, with observed levels.

The torque for the planned joint rates v is

    tau = (c + s e^(−(v/v_s)²)) tanh(v/ε) + b v.

The measured rates do not enter. Hence too large a level does not make the loop unstable, and a joint at rest gets no torque.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.control.friction.disturbance_observer import FrictionObserver, ObserverTimes, RestMemory
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.joint_friction import SMOOTHING_RATE, JointFriction
from graspforce.hand.hand import Hand

REST_RATE = 1e-3  # rad/s: with smaller planned rates of all joints the plan is at rest

_UNKNOWN_FRACTION = 0.05  # of a motor's torque: friction of joints without source, in proportion to the known ones


@dataclass(frozen=True, eq=False, slots=True)
class FrictionSettings:
    """Settings of the compensation of joint friction.

    Args:
        model: known friction. Default: the friction of the hand's description.
        observe: whether the Coulomb levels follow what feedback measures, from the known friction on.
        times: time constants of the observer.
        largest_fraction: bound of the observed levels, as a fraction of each motor's torque, in (0, 1).
        smoothing_rate: ε, rad/s: the compensation is about proportional to smaller planned rates.
        rest_tolerance_linear: position error within which the integral is held while the plan is at rest, m. With noise, at
            least three standard deviations of the position.
        rest_tolerance_angular: the same of the orientation, rad.
        rest_time: time after which the integral is held in any case while the plan is at rest, s.
        torque_error: standard deviation of each joint's torque for which the slip margin grows, N·m, at least 0; see
            `friction_slip_margin`. Default: that of a joint at rest, whose friction is anywhere between ± its Coulomb level,
            c/√3; for a joint of unknown friction c is 5 % of the motor's torque.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    model: JointFriction | None = None
    observe: bool = True
    times: ObserverTimes = field(default_factory=ObserverTimes)
    largest_fraction: float = 0.3
    smoothing_rate: float = SMOOTHING_RATE
    rest_tolerance_linear: float = 5e-5
    rest_tolerance_angular: float = 5e-4
    rest_time: float = 1.0
    torque_error: float | None = None

    def __post_init__(self) -> None:
        fields.check_boolean(self.observe, "observe")
        for name in ("largest_fraction", "smoothing_rate"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        for name in ("rest_tolerance_linear", "rest_tolerance_angular", "rest_time"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, minimum=0.0)})
        if self.torque_error is not None:
            set_fields(self, torque_error=arrays.check_number(self.torque_error, "torque_error", minimum=0.0))
        if self.largest_fraction >= 1.0:
            raise InvalidInput("largest_fraction", self.largest_fraction, "less than 1")
        if not isinstance(self.times, ObserverTimes):
            raise InvalidInput("times", self.times, "ObserverTimes")
        if self.model is not None and not isinstance(self.model, JointFriction):
            raise InvalidInput("model", self.model, "a JointFriction, or None")

    @property
    def rest_tolerance(self) -> Array:
        """(6,) tolerances of the components of a pose error, m and rad."""
        return freeze(np.repeat([self.rest_tolerance_linear, self.rest_tolerance_angular], 3))

    def torque_errors(self, hand: Hand) -> Array:
        """Return the standard deviations of the joints' torques for which the slip margin grows, (n,), N·m.

        Args:
            hand: the hand.
        """
        if self.torque_error is not None:
            return freeze(np.full(hand.n, self.torque_error))
        return freeze(_expected_coulomb(hand, hand.friction if self.model is None else self.model) / math.sqrt(3.0))

    def to_dict(self) -> JsonRecord:
        """Return a plain record of all settings."""
        record = {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}
        model = None if self.model is None else self.model.to_dict()
        return {**record, "model": model, "times": dataclasses.asdict(self.times)}

    @classmethod
    def from_dict(cls, record: object, field: str = "friction") -> FrictionSettings:
        """Read settings from a plain record. Settings that are absent or null take their defaults.

        Args:
            record: settings under their names.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, optional=[each.name for each in dataclasses.fields(cls)])
        given = {name: value for name, value in values.items() if value is not None}
        if "model" in given:
            given["model"] = JointFriction.from_dict(given["model"], f"{field}.model")
        if "times" in given:
            names = [each.name for each in dataclasses.fields(ObserverTimes)]
            times = fields.check_record(given["times"], f"{field}.times", optional=names)
            try:
                given["times"] = ObserverTimes(**times)
            except InvalidInput as error:
                raise error.with_prefix(f"{field}.times") from None
        try:
            return cls(**given)
        except InvalidInput as error:
            raise error.with_prefix(field) from None


@dataclass(frozen=True, eq=False, slots=True)
class FrictionMemory:
    """State of the compensation after a step, which the next step starts from.

    Attributes:
        level: (n,) Coulomb levels of the joints, N·m.
        rest: hold of the pose integral; None while the plan moves.
    """

    level: Array
    rest: RestMemory | None = None

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `level`, and `rest` or null."""
        return {"level": self.level.tolist(), "rest": None if self.rest is None else self.rest.to_dict()}

    @classmethod
    def from_dict(cls, record: object, field: str = "friction") -> FrictionMemory:
        """Read a memory from a plain record.

        Args:
            record: as `to_dict` returns it; `rest` may be absent or null.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["level"], optional=["rest"])
        level, rest = arrays.check_array(values["level"], f"{field}.level", (None,), minimum=0.0), values.get("rest")
        return cls(level, None if rest is None else RestMemory.from_dict(rest, f"{field}.rest"))


class PlannedRates(NamedTuple):
    """Planned motion of the joints in one step.

    Attributes:
        v: (n,) planned joint rates, rad/s.
        feedback: (n,) joint accelerations of the feedback on the object's pose, rad/s²; zero for joints that do not move it.
        along: (n,) those of the part of the feedback that acts along the object's planned motion, rad/s². None: all of it.
    """

    v: Array
    feedback: Array
    along: Array | None = None


class FrictionCompensation:
    """Compensation of the joint friction of a hand, without memory of its own.

        compensation = FrictionCompensation(hand, FrictionSettings())
        memory = compensation.initial_memory()
        tau_friction, memory = compensation.step(memory, PlannedRates(v, feedback))

    Add the torques to tau_u before the force problem is solved, so that its torque limits hold for the sum.

    Args:
        hand: the hand.
        settings: known friction, and settings of the observer.
        period: time between two steps, s, greater than 0.

    Attributes:
        settings: the settings.
        model: the known friction.
        inertia: (n,) inertias of the joints in the neutral posture, kg·m².
        observer: observer of the Coulomb levels.

    Raises:
        InvalidInput: the known friction belongs to another number of joints, or the period is not positive.
    """

    def __init__(self, hand: Hand, settings: FrictionSettings, period: float = 1e-3) -> None:
        model = hand.friction if settings.model is None else settings.model
        if model.n != hand.n:
            raise InvalidInput("model.coulomb", model.coulomb, f"a list of {hand.n} numbers, one for each joint of {hand.name}")
        self.settings, self.model = settings, model
        self.inertia = freeze(np.diag(hand.mass_matrix(hand.neutral)))
        period = arrays.check_number(period, "period", above=0.0)
        bound = np.maximum(settings.largest_fraction * hand.torque_upper, model.coulomb)  # N·m
        self.observer = FrictionObserver(_expected_share(hand, model), freeze(bound), settings.times, period)

    def initial_memory(self) -> FrictionMemory:
        """Return the memory before the first step: the known Coulomb levels."""
        return FrictionMemory(self.model.coulomb)

    def step(self, memory: FrictionMemory, planned: PlannedRates) -> tuple[Array, FrictionMemory]:
        """Return the torques that overcome friction in the next period, (n,), N·m, and the memory for the next step.

        Args:
            memory: memory after the last step; `initial_memory()` before the first.
            planned: planned rates and feedback of the joints.
        """
        model, v = self.model, planned.v
        direction = np.tanh(v / self.settings.smoothing_rate)
        level = memory.level
        if self.settings.observe:
            along = None if planned.along is None else self.inertia * planned.along
            level = self.observer.step(level, direction, self.inertia * planned.feedback, along)
        excess = model.stribeck * np.exp(-np.square(v / model.stribeck_velocity))  # N·m
        return (level + excess) * direction + model.viscous * v, FrictionMemory(level, memory.rest)


def friction_slip_margin(grasp: Grasp, torque_error: npt.ArrayLike) -> float:
    """Return the slip margin that covers an error of the joints' friction torques, N.

    An error δτ of the torques changes the contact forces by δf = −(Jᵀ)⁺ δτ. Feedback on the object's pose removes the part that
    has a net wrench, so the part in the null space of G remains. For independent errors of the joints, the margin covers one
    standard deviation of ‖δf_t‖ + μ |δf_n| at every contact.

    Args:
        grasp: hand, object and contacts.
        torque_error: standard deviation of the joints' torques, N·m, at least 0; a number for all, or (n,).

    Raises:
        InvalidInput: an error is negative or not finite, or there is another number of joints.
    """
    hand, contacts = grasp.hand, grasp.contacts
    given = np.asarray(torque_error, dtype=np.float64)
    errors = arrays.check_array(
        np.broadcast_to(given, hand.n) if given.ndim == 0 else given, "torque_error", (hand.n,), minimum=0.0
    )
    J = hand.contact_jacobian(grasp.q, grasp.fingers, contacts, grasp.p_HO, grasp.R_HO)
    G = contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1)[:, contacts.columns]
    forces = np.linalg.pinv(J.T)  # (k, n), N per N·m
    internal = forces - np.linalg.pinv(G) @ (G @ forces)
    padded = np.stack([contacts.pad(column) for column in internal.T])  # (n, N, 4)
    size = np.linalg.norm(padded[:, :, :2], axis=2) + contacts.mu * np.abs(padded[:, :, 2])  # (n, N)
    return float(np.sqrt(np.square(errors[:, None] * size).sum(axis=0)).max())


def _expected_share(hand: Hand, model: JointFriction) -> Array:
    """Return the expected friction of each joint relative to the mean: as known, otherwise in proportion to the torque."""
    expected = _expected_coulomb(hand, model)
    return freeze(expected / expected.mean())


def _expected_coulomb(hand: Hand, model: JointFriction) -> Array:
    """Return the expected Coulomb friction of each joint, (n,), N·m: as known, otherwise in proportion to the torque."""
    return np.where(model.known & (model.coulomb > 0.0), model.coulomb, _UNKNOWN_FRACTION * hand.torque_upper)

"""Observer of joint friction, and a hold of the pose integral at rest.

The observer adapts a friction level of each joint to the torque that feedback asks for along the planned motion. It changes
nothing at rest, so it cannot cause oscillations there. An integral can: static friction holds the joints until the integral has
grown beyond it, then they jump over the goal, and the cycle repeats. The hold stops the integral at the goal or after one jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields


@dataclass(frozen=True, slots=True)
class ObserverTimes:
    """Time constants of the friction observer.

    Args:
        common: time in which the level common to all joints follows feedback along the planned motion, s, greater than 0.
        across: time in which the common level follows other feedback, s, greater than 0.
        joint: time in which the difference of one joint from the common level follows, s, greater than 0.
        forgetting: time in which that difference decays during motion, s, greater than 0. Some combinations of joint torques
            only squeeze the object and do not move it; without decay their levels would drift.

    Raises:
        InvalidInput: a time is out of range; names the field and the allowed values.
    """

    common: float = 0.05
    across: float = 0.25
    joint: float = 0.3
    forgetting: float = 0.5

    def __post_init__(self) -> None:
        for name in ("common", "across", "joint", "forgetting"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})


class FrictionObserver:
    """Observer of the Coulomb friction of n joints. It has no memory of its own.

    With the planned direction φ = tanh(v/ε) in place of the sign of the planned rates v, the feedback torque u of the joints,
    and its part u_p along the object's planned motion, the levels c follow

        ċ = φ u/T_joint + r Σ r φ (u_p/T_common + (u − u_p)/T_across)/n − |φ| (c − r c̄)/T_forgetting,    0 ≤ c ≤ c_max,

    where r is the expected share of each joint and c̄ the common level. Too little compensation leaves a tracking error along
    the motion, whose feedback torque raises the level. Near the planned motion the first two terms lower the Lyapunov function
    of adaptive control. Errors across the motion are due to friction, too, but static friction can also hold a wrong
    orientation, whose feedback raises the level in one direction of the motion and lowers it in the other. The level follows
    them more slowly than the motion reverses.

    Source: Slotine and Li (1987), section 3, with the regressor of Coulomb friction along the planned motion.

    Args:
        share: (n,) r, expected friction of each joint relative to their mean, greater than 0.
        largest: (n,) c_max, N·m.
        times: time constants.
        period: time between two steps, s.

    Attributes:
        share, largest: as given.
        rate_common, rate_across, rate_joint, rate_forgetting: period divided by the time constants.
    """

    def __init__(self, share: Array, largest: Array, times: ObserverTimes, period: float) -> None:
        self.share, self.largest = share, largest
        self.rate_common, self.rate_across, self.rate_joint, self.rate_forgetting = (
            period / each for each in (times.common, times.across, times.joint, times.forgetting)
        )

    def step(self, level: Array, direction: Array, feedback_torque: Array, along: Array | None = None) -> Array:
        """Return the levels for the next step.

        Args:
            level: (n,) present Coulomb levels, N·m.
            direction: (n,) φ, planned direction of the joints, −1 to 1.
            feedback_torque: (n,) u, feedback torque of the joints that move the object, zero for the others, N·m.
            along: (n,) u_p, its part along the object's planned motion, N·m. Default: all of it.
        """
        drive = direction * feedback_torque  # N·m, positive if the joints lag
        part = drive if along is None else direction * along  # N·m, of the drive along the planned motion
        common_drive = float(self.share @ (self.rate_common * part + self.rate_across * (drive - part)))  # N·m
        active = max(int(np.count_nonzero(feedback_torque)), 1)
        mean = float(level @ self.share) / float(self.share @ self.share)  # N·m
        change = self.rate_joint * drive + self.share * (common_drive / active)
        change -= self.rate_forgetting * np.abs(direction) * (level - self.share * mean)
        return freeze(np.minimum(np.maximum(level + change, 0.0), self.largest))


@dataclass(frozen=True, eq=False, slots=True)
class RestMemory:
    """State of the integral's hold while the plan is at rest.

    Attributes:
        held: (6,) components of the integral that are held, 1 or 0.
        error: (6,) pose error at which they were held, m and rad.
        start: (6,) integral from which the components approach the goal, m·s and rad·s.
        steps: steps since the plan came to rest, or since the last release.
    """

    held: Array
    error: Array
    start: Array
    steps: int = 0

    @property
    def is_held(self) -> bool:
        """Whether all components are held."""
        return bool(self.held.all())

    def to_dict(self) -> JsonRecord:
        """Return a plain record."""
        record = {name: getattr(self, name).tolist() for name in ("held", "error", "start")}
        return {**record, "steps": self.steps}

    @classmethod
    def from_dict(cls, record: object, field: str = "rest") -> RestMemory:
        """Read the state from a plain record.

        Args:
            record: as `to_dict` returns it.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        names = ("held", "error", "start")
        values = fields.check_record(record, field, required=[*names, "steps"])
        steps = fields.check_integer(values["steps"], f"{field}.steps", minimum=0, maximum=2**53)
        held, error, start = (arrays.check_array(values[name], f"{field}.{name}", (6,)) for name in names)
        return cls(held, error, start, steps)


def hold_integral(
    memory: RestMemory | None, error: Array, integral: Array, next_integral: Array, tolerance: Array, most_steps: int
) -> tuple[Array, RestMemory]:
    """Return the integral of the next step while the plan is at rest, and the state of its hold.

    A component is held once its error is within the tolerance, has changed sign since the plan came to rest, or has had
    `most_steps` to vanish. It is released when the object has moved by more than the tolerance, such as by a push.

    Source: Bisoffi et al. (2020) change the integral at sign changes of the error to avoid this oscillation.

    Args:
        memory: state after the last step; None if the plan moved then.
        error: (6,) pose error, m and rad.
        integral: (6,) integral of this step, m·s and rad·s.
        next_integral: (6,) integral of the next step without hold.
        tolerance: (6,) m and rad.
        most_steps: steps after which the integral is held in any case.
    """
    if memory is not None and memory.is_held and not (np.abs(error - memory.error) > tolerance).any():
        return integral, memory
    if memory is None:
        held, held_error, start, steps = np.zeros(6, dtype=np.bool_), error, integral, 0
    else:
        held = (memory.held > 0.0) & (np.abs(error - memory.error) <= tolerance)
        released = (memory.held > 0.0) & ~held
        held_error, start = memory.error, np.where(released, integral, memory.start)
        steps = 0 if released.any() else memory.steps + 1
    reached = ~held & ((np.abs(error) <= tolerance) | (error * (integral - start) < 0.0) | (steps >= most_steps))
    held_error, held = np.where(reached, error, held_error), held | reached
    return freeze(np.where(held, integral, next_integral)), RestMemory(freeze(held), freeze(held_error), freeze(start), steps)

"""A glove as an input of control streams: the approach of a hand to an object, and the desired pose of a held object.

The chain is reading → posture of the glove's model (`calibration`) → its fingertips → fingertips of the target hand
(`fingertip_mapping`). In the approach, the hand follows its fingertips; while it holds an object, the object follows the rigid
motion of the fingertips. `command` takes a frame at the glove's rate, and `step` returns the desired motion at the rate of the
stream. If frames stop, the desired motion comes to rest.

The desired motion is all that a glove changes. The controller of the stream chooses the forces and certifies them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.control.joints.joint_command import JointMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from graspforce.learning.glove.calibration import GloveCalibration
from graspforce.learning.glove.fingertip_mapping import FingertipMap, FingertipMapper, fit_fingertip_map
from graspforce.learning.glove.frames import GloveFrames
from graspforce.learning.glove.teleoperation import (
    ApproachLimits,
    PostureFilter,
    TeleoperationFilter,
    TeleoperationLimits,
    virtual_object,
)

_LEAST_FINGERS = 3  # of a rigid motion
MotionT_co = TypeVar("MotionT_co", covariant=True)
MotionT = TypeVar("MotionT")


class GloveOperator:
    """The fingertips that an operator with a glove shows to a hand.

    Args:
        calibration: of the glove.
        model: hand whose joints the calibration has.
        correspondence: fingers and frame of the model in the target hand.

    Raises:
        InvalidInput: the calibration lacks a joint of the model.
        UnknownName: the model has no such finger.
    """

    def __init__(self, calibration: GloveCalibration, model: Hand, correspondence: FingertipMap) -> None:
        names = list(model.joint_names)
        for name in names:
            if name not in calibration.joints:
                allowed = f"names with all joints of {model.name}: {name} is missing"
                raise InvalidInput("calibration.joints", calibration.joints, allowed)
        self.calibration, self.model, self.correspondence = calibration, model, correspondence
        self._columns = [calibration.joints.index(name) for name in names]
        self._sources = tuple(dict.fromkeys(correspondence.fingers.values()))
        for name in self._sources:
            model.finger(name)

    def posture(self, reading: npt.ArrayLike) -> Array:
        """Return the posture of the model, (n,), rad, within its limits.

        Args:
            reading: (m,) readings of the sensors.

        Raises:
            InvalidInput: not as many finite numbers as sensors.
        """
        q = self.calibration.posture(reading)[self._columns]
        return freeze(np.clip(q, self.model.q_lower, self.model.q_upper))

    def tips(self, reading: npt.ArrayLike) -> dict[str, Array]:
        """Return the fingertips of the model in its base, (3,), m, by finger.

        Args:
            reading: (m,) readings of the sensors.

        Raises:
            InvalidInput: not as many finite numbers as sensors.
        """
        q = self.posture(reading)
        return {name: self.model.tip_pose(q, name)[0] for name in self._sources}


class GloveInput(Protocol[MotionT_co]):
    """An input of a stream: `GloveApproach` or `GloveHold`."""

    def command(self, reading: npt.ArrayLike) -> None:
        """Take over a frame."""
        ...  # pragma: no cover

    def step(self, dt: float) -> MotionT_co:
        """Return the desired motion of the next control period."""
        ...  # pragma: no cover


class GloveApproach:
    """Desired joint motion of a hand that follows an operator's fingertips, for a stream of a joint-space law.

    The hand's links keep the clearance of the correspondence in the postures that are commanded.

    Args:
        hand: the target hand.
        operator: the operator.
        q_start: (n,) posture at the start, rad; neutral by default.
        limits: limits of the desired motion.

    Raises:
        InvalidInput: an argument is not allowed.
        UnknownName: the hand has no such finger.
    """

    def __init__(
        self,
        hand: Hand,
        operator: GloveOperator,
        q_start: npt.ArrayLike | None = None,
        limits: ApproachLimits | None = None,
    ) -> None:
        self._operator = operator
        self._mapper = FingertipMapper(hand, operator.correspondence, q_start)
        self._filter = PostureFilter(hand, self._mapper.q, limits)

    def command(self, reading: npt.ArrayLike) -> None:
        """Take over a frame, at the glove's rate.

        Args:
            reading: (m,) readings of the sensors.

        Raises:
            InvalidInput: not as many finite numbers as sensors.
        """
        self._filter.command(self._mapper.step(self._operator.tips(reading)).q)

    def step(self, dt: float) -> JointMotion:
        """Return the desired motion of the next control period.

        Args:
            dt: the period, s, > 0 and below the time constant of the limits.

        Raises:
            InvalidInput: another period.
        """
        return self._filter.step(dt)


class GloveHold:
    """Desired motion of a held object that follows an operator's fingertips as a rigid body, for a control stream.

    The first frame is that of the object at rest: the operator may begin in any posture.

    Args:
        grasp: the grasp of the target hand.
        operator: the operator, with three fingers of the grasp at least.
        limits: limits of the desired motion. Choose `travel` by `travel_limits` of the grasp.
        gain: object displacement over that of the fingertips, > 0.

    Raises:
        InvalidInput: an argument is not allowed.
    """

    def __init__(
        self, grasp: Grasp, operator: GloveOperator, limits: TeleoperationLimits | None = None, gain: float = 1.0
    ) -> None:
        self._operator, self._gain = operator, arrays.check_number(gain, "gain", above=0.0)
        self._fingers = [name for name in operator.correspondence.fingers if name in grasp.fingers]
        if len(self._fingers) < _LEAST_FINGERS:
            allowed = f"{_LEAST_FINGERS} of the grasp's fingers {', '.join(grasp.fingers)} at least"
            raise InvalidInput("operator.correspondence.fingers", tuple(operator.correspondence.fingers), allowed)
        self._start = BodyMotion(grasp.p_HO, grasp.R_HO)
        self._filter = TeleoperationFilter(self._start, limits)
        self._tips_start: Array | None = None

    def command(self, reading: npt.ArrayLike) -> None:
        """Take over a frame, at the glove's rate.

        Args:
            reading: (m,) readings of the sensors.

        Raises:
            InvalidInput: not as many finite numbers as sensors, or the fingertips of the first frame are in line.
        """
        targets = self._operator.correspondence.targets(self._operator.tips(reading))
        tips = np.array([targets[name] for name in self._fingers])
        first = tips if self._tips_start is None else self._tips_start
        p_HO, R_HO = virtual_object(self._start, first, tips, self._gain)
        self._tips_start = first
        self._filter.command(p_HO, R_HO)

    def step(self, dt: float) -> BodyMotion:
        """Return the desired motion of the next control period.

        Args:
            dt: the period, s, > 0 and below the time constant of the limits.

        Raises:
            InvalidInput: another period.
        """
        return self._filter.step(dt)


class GloveReference(Generic[MotionT]):
    """A reference motion as a function of time, from an input and its frames. Call it once per control period.

    Args:
        source: the input.
        frames: the frames; each is taken over once, and only the newest one if several have arrived.
        period: the control period, s, > 0.

    Attributes:
        taken: number of frames that were taken over.
    """

    def __init__(self, source: GloveInput[MotionT], frames: GloveFrames, period: float) -> None:
        self._source, self._frames = source, frames
        self._period = arrays.check_number(period, "period", above=0.0)
        self._last = -1
        self.taken = 0

    def __call__(self, t: float) -> MotionT:
        """Return the desired motion of the period that begins now.

        Args:
            t: time since the start, s.

        Raises:
            InvalidInput: a frame has another number of readings than the calibration.
        """
        frame = self._frames.at(t)
        if frame is not None and frame.number != self._last:
            self._source.command(frame.reading)
            self._last = frame.number
            self.taken += 1
        return self._source.step(self._period)


def neutral_correspondence(model: Hand, hand: Hand, fingers: Mapping[str, str]) -> FingertipMap:
    """Return the map of fingertips that fits best in the neutral postures of both hands; the identity for equal hands.

    Args:
        model: hand of the glove's calibration.
        hand: the target hand.
        fingers: the model's finger for each finger of the target hand that follows; at least three for different hands.

    Raises:
        InvalidInput: fewer than three fingers of different hands, or fingertips in line.
        UnknownName: a hand has no such finger.
    """
    if model.name == hand.name:
        return FingertipMap(fingers)
    tips_S = [model.tip_pose(model.neutral, name)[0] for name in fingers.values()]
    tips_H = [hand.tip_pose(hand.neutral, name)[0] for name in fingers]
    return fit_fingertip_map(fingers, tips_S, tips_H)

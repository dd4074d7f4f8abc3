"""Detection of a fingertip's contact during the guarded close, from what the hand measures.

- ``tip force``: the measured force on the fingertip, low-passed, along the inward normal.
- ``joint torque``: the force at the tip that explains the disturbance of the joints beyond that of the free motion, while the
  tip is slower than its target.
- ``stall``: the tip has stopped although its target moves, or its target is further ahead than in free motion.

With fingertip sensors whose noise stays below the touch force, only the first applies. Otherwise the second and the third apply
together, the second only if the drives take torques or currents.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.control.phases.finger_servo import ServoStep
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.core.arrays import Array, freeze
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.hand.drives.drive import POSITION_MODES
from graspforce.hand.hand import Hand

ContactSign = Literal["", "tip force", "joint torque", "stall"]  # what showed the contact; empty for no contact

_FORCE_TIME = 0.005  # s: low-pass of measured forces
_RESIDUAL_TIME = 0.02  # s: low-pass of the forces from the joints' disturbances
_SPEED_TIME = 0.03  # s: low-pass of the tips' speeds
_DEVIATIONS = 5.0  # standard deviations of a filtered force that count as contact
_FORCE_SHARE, _SLOW, _STALLED = 0.6, 0.6, 0.3  # of the bound of the feedback, and of the target's speed
_STALL_TIME = 0.06  # s
_STALL_LAG = 0.004  # m, from a tip to its target: noise of the encoders, which hides a low speed, does not hide it


class ClosingTargets(NamedTuple):
    """Targets of N closing fingertips in a step.

    Attributes:
        speed: (N,) speeds of the targets along the inward normals, m/s; zero for targets that rest.
        lag: (N,) distance of each tip from its target along the normal, m.
        bound: (N,) bound of the feedback of each finger at its tip, N.
    """

    speed: Array
    lag: Array
    bound: Array


@dataclass(frozen=True, eq=False, slots=True)
class DetectorMemory:
    """Memory of the detector between two steps.

    Attributes:
        force: (N,) low-passed measured normal forces, N.
        residual: (N, 3) low-passed forces from the disturbances, N.
        baseline: (N, 3) these forces in the free motion, N.
        speed: (N,) low-passed speeds of the tips along the inward normals, m/s.
        p_tip: (N, 3) tips in the last step, m.
        stalled: (N,) time for which each tip has stood still, s.
    """

    force: Array
    residual: Array
    baseline: Array
    speed: Array
    p_tip: Array
    stalled: Array


class ContactDetector:
    """Detector of the contacts of N fingertips. It has no memory of its own.

    Args:
        hand: the hand; its drives decide whether disturbances show forces.
        sensors: what the hand measures, with its noise.
        settings: speed of the close, and touch force.
        period: time between two steps, s.
    """

    def __init__(self, hand: Hand, sensors: SensorModel, settings: PhaseSettings, period: float) -> None:
        self._commanded_speed, touch_force = settings.close_speed, settings.touch_force
        self._period = period
        self._has_torques = not hand.drives.has_mode(*POSITION_MODES).any()
        self._force, self._residual, self._speed = (
            1.0 - math.exp(-period / time) for time in (_FORCE_TIME, _RESIDUAL_TIME, _SPEED_TIME)
        )
        noise = (sensors.tip_force_noise or 0.0) * math.sqrt(self._force / (2.0 - self._force))  # N, after the low-pass
        self.force_threshold = max(0.5 * touch_force, _DEVIATIONS * noise)  # N
        self._has_tips = sensors.tip_force_noise is not None and self.force_threshold < touch_force

    def initial_memory(self, p_tip: Array) -> DetectorMemory:
        """Return the memory at the start of the close.

        Args:
            p_tip: (N, 3) positions of the tips, m.
        """
        count = len(p_tip)
        zeros = freeze(np.zeros((count, 3)))
        rest = freeze(np.zeros(count))
        return DetectorMemory(rest, zeros, zeros, freeze(np.full(count, self._commanded_speed)), p_tip, rest)

    def restarted(self, memory: DetectorMemory, fingers: npt.NDArray[np.bool_]) -> DetectorMemory:
        """Return the memory with fingers that move again.

        Args:
            memory: memory after the last step.
            fingers: (N,) fingers that had stopped, and move again.
        """
        speed, stalled = np.where(fingers, self._commanded_speed, memory.speed), np.where(fingers, 0.0, memory.stalled)
        return replace(memory, speed=freeze(speed), stalled=freeze(stalled))

    def step(
        self,
        memory: DetectorMemory,
        measurement: Measurement,
        servo: ServoStep,
        normals: Array,
        targets: ClosingTargets,
        is_free: bool,
    ) -> tuple[tuple[ContactSign, ...], DetectorMemory]:
        """Return what shows a contact of each finger, and the memory for the next step.

        Args:
            memory: memory after the last step.
            measurement: the newest measurement.
            servo: result of the servo in this step.
            normals: (N, 3) inward normals in H.
            targets: targets of the tips in this step.
            is_free: whether no fingertip can touch yet; the baseline is learned then.
        """
        force, speed = memory.force, targets.speed
        if measurement.tip_wrench is not None:
            measured = np.einsum("ij,ij->i", measurement.tip_wrench[:, :3], normals)
            force = force + self._force * (measured - force)
        residual = memory.residual + self._residual * (servo.f_disturbance - memory.residual)
        baseline = residual if is_free else memory.baseline
        tip_speed = np.einsum("ij,ij->i", servo.p_tip - memory.p_tip, normals) / self._period
        filtered = memory.speed + self._speed * (tip_speed - memory.speed)
        stalled = np.where((filtered < _STALLED * speed) & (speed > 0.0), memory.stalled + self._period, 0.0)
        if is_free:
            stalled = np.zeros(len(stalled))
        pressing = -np.einsum("ij,ij->i", residual - baseline, normals)  # N: the object pushes back
        signs: list[ContactSign] = []
        for i in range(len(normals)):
            sign: ContactSign = ""
            if is_free:
                pass
            elif self._has_tips and measurement.tip_wrench is not None:
                sign = "tip force" if force[i] > self.force_threshold else ""
            elif self._has_torques and pressing[i] > _FORCE_SHARE * targets.bound[i] and filtered[i] < _SLOW * speed[i]:
                sign = "joint torque"
            elif stalled[i] > _STALL_TIME or targets.lag[i] > _STALL_LAG:
                sign = "stall"
            signs.append(sign)
        after = DetectorMemory(
            freeze(force), freeze(residual), freeze(baseline), freeze(filtered), servo.p_tip, freeze(stalled)
        )
        return tuple(signs), after

"""The guarded close: each fingertip moves along its inward normal until it touches, and waits there with a small force."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.phases.contact_detector import ClosingTargets, ContactDetector, DetectorMemory
from graspforce.control.phases.cycle_plan import BaseMotion, CyclePlan
from graspforce.control.phases.finger_servo import FingerServo, ForceBounds, ServoMemory, ServoStep
from graspforce.control.phases.phase_rules import NO_CONTACT
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.phase_step import PhaseTorques
from graspforce.control.phases.tip_motion import TipMotion
from graspforce.control.phases.touched_grasp import POSE_DEVIATIONS, pose_from_touch, touch_gaps, touched_grasp
from graspforce.core.arrays import Array, freeze
from graspforce.estimation.measurement import Measurement

_FREE_FORCE = 5.0  # N: bound of the feedback of a finger that cannot touch yet
_LARGEST_LAG = 5e-3  # m, from a free fingertip to its target
_LAG_AT_TOUCH = 2e-3  # m, the same where it may touch: half of the lag that the detector takes for a contact
_PRESS_DISTANCE = 0.01  # m: a waiting finger's target is this far inside, so that its feedback reaches the touch force
_LEAST_FREE_TRAVEL = 0.003  # m: the fingers overcome their static friction in it
_FRICTION_SHARE = 0.3  # of the observed joint friction at the tip, by which the bound grows: friction is not constant
_ACROSS_SHARE = 1.5  # the same across the normals: static friction exceeds the observed one, and such a force hardly pushes
_FOLLOWS, _RESTS = 0.9, 0.1  # of the commanded speed: target that follows its normal, and target that rests
_RISE_TIME = 0.1  # s, of the closing speed
_MOST_RETRIES, _RETRY_EFFORT = 2, 2.0  # of fingers that stopped off the object, and factor of their bound each time


class ClosePhase:
    """The guarded close.

    A finger that touches stops. Its target is then inside the object along the normal, so that its feedback, which is bounded,
    presses with the touch force.

    A fingertip before the object's nearest place is free: a large bound overcomes the static friction of its joints, which the
    servo learns. Later a finger may stop by static friction, or lose the object that another finger moves. When all have
    stopped, those that are off the surface of the most probable object go on with a larger bound. So does a finger at the end
    of its travel that is far behind its target. A close has two such retries at most.

    Args:
        servo: the servo.
        detector: the detector of contacts.
        plan: the plan.
        settings: speed, force and travel.
        base: where the hand's base stays.

    Attributes:
        signs: what showed the contact of each finger; empty for fingers without contact.
        q_wait: (n,) target posture of the waiting fingers, rad.
        has_passed: (N,) whether each fingertip has moved past the object without contact.
    """

    def __init__(
        self, servo: FingerServo, detector: ContactDetector, plan: CyclePlan, settings: PhaseSettings, base: BaseMotion
    ) -> None:
        grasp = plan.grasp
        self._plan, self._retries = plan, 0
        self._servo, self._detector, self._settings, self._base = servo, detector, settings, base
        self._motion, self._standoff = TipMotion(grasp.hand, grasp.fingers), plan.standoff
        self._normals = grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
        count = len(grasp.fingers)
        lever = float(np.linalg.norm(grasp.contacts.p_OC, axis=1).max())  # m
        spread = np.hypot(settings.position_error, settings.angle_error * lever)
        self._free_travel = max(float((plan.standoff - POSE_DEVIATIONS * spread).min()), _LEAST_FREE_TRAVEL)  # m
        self._q, self._p_start = plan.q_pregrasp, self._motion.positions(plan.q_pregrasp)
        self._travel = np.zeros(count)  # m, of the targets
        self._tip_travel, self._lag = np.zeros(count), np.zeros(count)  # m, of the tips, and behind their targets
        self._effort = np.ones(count)  # factor of the bound's share of the friction
        self._memory: DetectorMemory | None = None
        self.signs: tuple[str, ...] = ("",) * count
        self.q_wait = plan.q_pregrasp
        self.has_passed: npt.NDArray[np.bool_] = np.zeros(count, dtype=bool)

    def step(self, t: float, measurement: Measurement, memory: ServoMemory) -> PhaseTorques:
        """Return the torques of a period; see `JointPhase.step`.

        Args:
            t: time since the start of the phase, s.
            measurement: the newest measurement.
            memory: memory of the servo.
        """
        settings, dt = self._settings, self._servo.period
        speed = settings.close_speed * min(1.0, t / _RISE_TIME)
        may_touch = self._tip_travel >= self._free_travel
        is_free = not may_touch.any()
        is_moving = np.array([not sign for sign in self.signs]) & (may_touch | (self._lag < _LARGEST_LAG))
        farthest = self._standoff + settings.largest_travel  # m
        self._q, rates = self._motion.advance(self._q, (speed * is_moving)[:, None] * self._normals, dt)
        speeds = self._target_speeds(np.asarray(speed * is_moving), rates)
        self._travel += dt * np.where(speeds > 0.0, speeds, speed * is_moving)
        force = np.where(may_touch, self._bound(memory, _FRICTION_SHARE), _FREE_FORCE)
        across = np.where(may_touch, self._bound(memory, _ACROSS_SHARE), _FREE_FORCE)
        bounds = force if is_free else ForceBounds(self._normals, force, across)
        servo = self._servo.step(memory, measurement, JointMotion(self._q, rates), bounds, is_free=~may_touch)
        self._lag = self._along(self._motion.positions(self._q) - servo[0].p_tip)  # m
        self._detect(measurement, servo[0], ClosingTargets(speeds, self._lag, force), may_touch)
        missed = (self._travel > farthest) & is_moving
        is_behind = self._lag > _LARGEST_LAG
        self.has_passed = missed & ~is_behind
        goes_on = self._go_on(missed & is_behind, servo[0].p_tip)
        is_over = all(self.signs) and not self._retry(servo[0])
        abort = NO_CONTACT if missed.any() and not goes_on and not is_over else ""
        return PhaseTorques(servo[0].tau, servo, self._base, is_over, abort)

    def _bound(self, memory: ServoMemory, share: float) -> Array:
        """Return the largest feedback force (N,) of each finger, N: the touch force and a share of its joints' friction."""
        friction = self._motion.tip_forces(self._q, memory.friction)  # N
        return np.asarray(self._settings.touch_force + share * self._effort * friction)

    def _target_speeds(self, commanded: Array, rates: Array) -> Array:
        """Return the speeds (N,) of the targets along the inward normals, m/s; zero for targets that rest.

        A target that follows its normal up to the damping of the joint motion has the commanded speed. A finger of one joint
        whose tip moves obliquely to the normal is slower.

        Args:
            commanded: (N,) commanded speeds, m/s.
            rates: (n,) rates of the joints of the targets, rad/s.
        """
        along = self._along(self._motion.velocities(self._q, rates))
        share = np.divide(along, commanded, out=np.zeros_like(along), where=commanded > 0.0)
        return np.where(share > _RESTS, np.minimum(1.0, share / _FOLLOWS) * commanded, 0.0)

    def _retry(self, servo: ServoStep) -> bool:
        """Let the fingers go on that have stopped off the object, and return whether any does."""
        plan, settings = self._plan, self._settings
        if self._retries == _MOST_RETRIES:
            return False
        pose = pose_from_touch(plan.grasp, servo.p_tip, plan.down, settings)
        gaps = touch_gaps(touched_grasp(plan.grasp, servo.q, servo.p_tip, pose), servo.p_tip)  # m
        return self._go_on(gaps > settings.contact_tolerance, servo.p_tip)

    def _go_on(self, fingers: npt.NDArray[np.bool_], p_tip: Array) -> bool:
        """Let fingers that static friction has stopped go on with a larger bound, and return whether any does."""
        if not fingers.any() or self._retries == _MOST_RETRIES or self._memory is None:
            return False
        self._retries += 1
        self._memory = self._restart(fingers, p_tip, self._memory)
        self._effort = np.where(fingers, _RETRY_EFFORT * self._effort, self._effort)
        self.signs = tuple("" if each else sign for sign, each in zip(self.signs, fingers.tolist(), strict=True))
        return True

    def _restart(self, fingers: npt.NDArray[np.bool_], p_tip: Array, memory: DetectorMemory) -> DetectorMemory:
        """Set the targets of fingers to where they are, and return the detector's memory in which they move again."""
        excess = self._motion.positions(self._q) - p_tip  # m
        self._q, _ = self._motion.advance(self._q, np.where(fingers[:, None], -excess, 0.0), 1.0)
        self._travel = np.where(fingers, self._along(p_tip - self._p_start), self._travel)
        return self._detector.restarted(memory, fingers)

    def _along(self, vectors: Array) -> Array:
        """Return the components (N,) of vectors (N, 3) along the inward normals."""
        return np.asarray(np.einsum("ij,ij->i", vectors, self._normals))

    def _detect(
        self, measurement: Measurement, servo: ServoStep, targets: ClosingTargets, may_touch: npt.NDArray[np.bool_]
    ) -> None:
        """Stop the fingers that touch now, and set their targets inside the object."""
        p_tip = servo.p_tip
        if self._memory is None:
            self._memory = self._detector.initial_memory(p_tip)
        is_free = not may_touch.any()
        signs, memory = self._detector.step(self._memory, measurement, servo, self._normals, targets, is_free)
        self._tip_travel = np.maximum(self._tip_travel, self._along(p_tip - self._p_start))
        arrives = ~may_touch & (self._tip_travel >= self._free_travel) & (self._lag > _LAG_AT_TOUCH)
        self._memory = self._restart(arrives, p_tip, memory) if arrives.any() else memory
        found = [i for i, sign in enumerate(signs) if sign and may_touch[i] and not self.signs[i]]
        if not found:
            return
        self.signs = tuple(signs[i] if i in found else sign for i, sign in enumerate(self.signs))
        pressed = np.zeros((len(self.signs), 3))
        for i in found:
            pressed[i] = p_tip[i] + _PRESS_DISTANCE * self._normals[i] - self._motion.positions(self._q)[i]
        self._q, _ = self._motion.advance(self._q, pressed, 1.0)
        self.q_wait = freeze(self._q)

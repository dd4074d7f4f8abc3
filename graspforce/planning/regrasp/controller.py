"""Execution of a regrasp plan: object moves, and steps of single fingers with forces that rise and fall at a bounded rate.

At the end of a step the fingertip presses slowly against the surface, by 0.1 mm. It then touches before the forces count on it:
the object is off its planned pose by some hundredths of a millimetre.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.control import Command, ContactChange, GraspMotion, GraspState, ObjectController
from graspforce.control.contacts.contact_change import FORCE_RATE
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.geometry.minimum_jerk import minimum_jerk
from graspforce.grasp.grasp import Grasp
from graspforce.planning.path.paths import JointPath
from graspforce.planning.regrasp.records import FingerStage, ObjectStage, RegraspPlan


class RegraspPhase(str, Enum):
    """What happens in a step of the controller."""

    MOVE = "move"  # all fingers move the object
    RELEASE = "release"  # the force of one finger falls
    STEP = "step"  # that finger moves without contact, and touches
    LOAD = "load"  # its force rises at the new contact
    DONE = "done"  # the object rests at the end of the path
    STOPPED = "stopped"  # the others could not hold the object; all fingers hold it at rest


_PRESS_DEPTH = 1e-4  # m: of a tip into the surface
_PRESS_TIME = 0.1  # s


class RegraspController:
    """Controller that executes a regrasp plan. Call `step` once every period.

    Args:
        plan: the plan; its task has the settings of the controller.
        force_rate: rate at which normal forces change while a finger lets go or joins, N/s, > 0.

    Attributes:
        phase: phase of the last step.
        stage: index of the stage of the last step; the number of stages at the end.
        command_fingers: fingers at the contacts of the last command.

    Raises:
        InvalidInput: the rate is out of range.
    """

    def __init__(self, plan: RegraspPlan, force_rate: float = FORCE_RATE) -> None:
        self._plan, self._rate = plan, arrays.check_number(force_rate, "force_rate", above=0.0)
        self._controller = ObjectController(plan.task.grasp, plan.task.control)
        self._period = plan.task.control.period  # s
        self.reset()

    def reset(self) -> None:
        """Return to the start of the plan."""
        self._controller.reset()
        self.stage, self.phase, self._time = 0, RegraspPhase.MOVE, 0.0
        self._q = np.array(self._plan.task.grasp.q)  # desired posture at rest, rad
        self._path: JointPath | None = None
        self._offset = self._press = np.zeros(len(self._q))
        self.command_fingers = self._controller.grasp.fingers
        self._begin()

    @property
    def grasp(self) -> Grasp:
        """The present grasp."""
        return self._controller.grasp

    @property
    def is_over(self) -> bool:
        """Whether the plan is done or stopped."""
        return self.phase in (RegraspPhase.DONE, RegraspPhase.STOPPED)

    @property
    def moving_finger(self) -> str | None:
        """The finger that lets go, steps or joins; None while all fingers move the object."""
        if self.stage == len(self._plan.stages):
            return None
        stage = self._plan.stages[self.stage]
        return stage.finger if isinstance(stage, FingerStage) else None

    def step(self, state: GraspState, external: npt.ArrayLike | None = None) -> Command:
        """Compute the motor torques for the next period.

        Args:
            state: measured joints and object.
            external: as in `ObjectController.step`.

        Raises:
            InvalidInput: as in `ObjectController.step`.
        """
        self._change_phase(state)
        self.command_fingers = self._controller.grasp.fingers
        command = self._controller.step(state, self.desired(), external)
        self._time += self._period
        return command

    def desired(self) -> GraspMotion:
        """Return the desired motion of object and joints at the present time of the stage."""
        path, rest = self._plan.task.path, np.zeros(len(self._q))
        if self.stage == len(self._plan.stages):
            return _at_rest(path.motion(path.length), self._q)
        stage = self._plan.stages[self.stage]
        if isinstance(stage, ObjectStage) and self.phase is RegraspPhase.MOVE:
            u = np.array([state.u for state in stage.states])
            s, rate, acceleration = minimum_jerk(self._time, stage.duration)
            length = float(u[-1] - u[0])
            now = float(u[0]) + s * length
            q, slope = _interpolate(now, u, np.array([state.q for state in stage.states]))
            return GraspMotion(path.motion(now, rate * length, acceleration * length), q, rate * length * slope, rest)
        u_rest = stage.end.u
        if self.phase is RegraspPhase.STEP and isinstance(stage, FingerStage) and self._path is not None:
            if self._time > stage.duration:
                s, rate, acceleration = minimum_jerk(self._time - stage.duration, _PRESS_TIME)
                pressed = stage.postures[-1] + s * self._press
                return GraspMotion(path.motion(u_rest), pressed, rate * self._press, acceleration * self._press)
            s, rate, acceleration = minimum_jerk(self._time, stage.duration)
            points = self._path.points(np.array([s]))
            decay, decay_rate, decay_acceleration = 1.0 - s, -rate, -acceleration
            q = points.q[0] + decay * self._offset
            v = rate * points.q_s[0] + decay_rate * self._offset
            a = acceleration * points.q_s[0] + rate**2 * points.q_ss[0] + decay_acceleration * self._offset
            return GraspMotion(path.motion(u_rest), q, v, a)
        return _at_rest(path.motion(u_rest), self._q)

    def _change_phase(self, state: GraspState) -> None:
        """Go on to the next phase if the present one is over."""
        if self.is_over:
            return
        stage = self._plan.stages[self.stage]
        if isinstance(stage, ObjectStage):
            if self._time >= stage.duration:
                self._q = np.array(stage.end.q)
                self._next_stage()
                self._change_phase(state)
            return
        if self.phase is RegraspPhase.MOVE:
            self._controller.change_contacts(ContactChange(release=[stage.finger], force_rate=self._rate), state)
            self._enter(RegraspPhase.RELEASE)
        elif self.phase is RegraspPhase.RELEASE and not self._controller.is_changing:
            if stage.finger in self._controller.grasp.fingers:
                self._enter(RegraspPhase.STOPPED)
                return
            self._path = JointPath.through(stage.postures)
            joints = list(self._plan.task.grasp.hand.finger(stage.finger).joints)
            self._offset = np.zeros(len(self._q))
            self._offset[joints] = state.q[joints] - stage.postures[0][joints]
            self._press = self._press_motion(stage)
            self._enter(RegraspPhase.STEP)
        elif self.phase is RegraspPhase.STEP and self._time >= stage.duration + _PRESS_TIME:
            change = ContactChange(add={stage.finger: stage.contact}, force_rate=self._rate)
            self._q = np.array(stage.end.q)
            self._controller.change_contacts(change, state)
            self._enter(RegraspPhase.LOAD)
        elif self.phase is RegraspPhase.LOAD and not self._controller.is_changing:
            self._next_stage()
            self._change_phase(state)

    def _press_motion(self, stage: FingerStage) -> Array:
        """Return the joint motion that moves a tip into the surface at the end of its step, (n,), rad."""
        hand, q = self._plan.task.grasp.hand, stage.postures[-1]
        joints = list(hand.finger(stage.finger).joints)
        J = hand.tips_along(q[None], [stage.finger])[1][0, 0][:, joints]
        normal_H = self._plan.task.path.motion(stage.end.u).R_HO @ stage.contact.normal
        press = np.zeros(hand.n)
        press[joints] = np.linalg.pinv(J) @ (_PRESS_DEPTH * normal_H)
        return press

    def _next_stage(self) -> None:
        """Begin the next stage."""
        self.stage += 1
        self._begin()

    def _begin(self) -> None:
        """Begin the stage."""
        self._enter(RegraspPhase.DONE if self.stage == len(self._plan.stages) else RegraspPhase.MOVE)

    def _enter(self, phase: RegraspPhase) -> None:
        """Begin a phase."""
        self.phase, self._time = phase, 0.0


def _at_rest(motion: BodyMotion, q: Array) -> GraspMotion:
    """Return the motion of an object and joints at rest."""
    rest = np.zeros(len(q))
    return GraspMotion(BodyMotion(motion.p_HO, motion.R_HO), q, rest, rest)


def _interpolate(at: float, u: Array, q: Array) -> tuple[Array, Array]:
    """Return the posture at a place between states, (n,), rad, and its slope dq/du."""
    k = int(np.clip(np.searchsorted(u, at) - 1, 0, len(u) - 2))
    slope = (q[k + 1] - q[k]) / (u[k + 1] - u[k])
    return freeze(q[k] + (at - u[k]) * slope), slope

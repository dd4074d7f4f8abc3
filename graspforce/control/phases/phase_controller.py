"""The controller of a grasp cycle: the sequence of phases, their time limits and safe stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from graspforce.control.drives.drive_commands import DriveMap
from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.output_feedback import OutputFeedbackController
from graspforce.control.phases.close_phase import ClosePhase
from graspforce.control.phases.contact_detector import ContactDetector
from graspforce.control.phases.cycle_plan import BaseMotion, CyclePlan
from graspforce.control.phases.finger_servo import FingerServo, ServoMemory, ServoStep
from graspforce.control.phases.joint_phases import HoldJoints, JointPhase, ReopenPhase
from graspforce.control.phases.missed_place import along_table, shift_of_late_touch, shift_of_miss, shift_of_slip
from graspforce.control.phases.object_phases import CarryPhase, HeldObject, HoldObject, SqueezePhase
from graspforce.control.phases.phase_rules import (
    LATE_TOUCH,
    PAUSED,
    PHASE_ORDER,
    PHASE_RULES,
    RETRIED,
    TIME_LIMIT,
    WRONG_OBJECT,
    PhaseName,
)
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.phase_step import FeedbackController, PhaseCommand, PhaseRecord, PhaseTorques
from graspforce.control.phases.phase_times import check_times, opening_time
from graspforce.control.phases.release_phase import ReleasePhase
from graspforce.control.phases.touched_grasp import pose_from_touch, touch_gaps, touched_grasp
from graspforce.control.settings import ControlSettings
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.grasp.grasp import Grasp

ControllerFactory = Callable[[Grasp], FeedbackController]
_Phase = JointPhase | ClosePhase | SqueezePhase | CarryPhase | ReleasePhase | ReopenPhase | HoldJoints | HoldObject

_APPROACH_FORCE = 20.0  # N: bound of the feedback of each finger while it moves alone
_STOP_FORCE = 2.0  # N: bound of the feedback of each finger that keeps its place after an abort
_REST_SHARE = 0.5  # of the tolerance of a posture: error that static friction may leave in a finger at rest
_STOPPED = "stopped by the caller"
_DONE = frozenset(("done", "stopped"))


class PhaseController:
    """Controller of a grasp cycle: approach, close, squeeze, lift, move, place, release, retract. Call `step` each period.

    If the touched places do not fit the object, a finger finds no contact, or the squeeze fails, the fingers open and close
    again, above the place where the object then seems to be.

    Args:
        plan: the plan.
        settings: settings of the phases.
        sensors: what the hand measures.
        control: settings of the object controller; their gravity and period are those of plan and sensors.
        make_controller: makes the object controller of a touched grasp. Default: an `OutputFeedbackController` with the gains
            that the sensors permit.

    Attributes:
        phase: the present phase.
        grasp: the grasp as known: the plan's, after the touch the touched one.
        records: the phases that have ended.

    Raises:
        InvalidInput: no gains are stable with these sensors, or a phase cannot end within its time limit.
    """

    def __init__(
        self,
        plan: CyclePlan,
        settings: PhaseSettings | None = None,
        sensors: SensorModel | None = None,
        control: ControlSettings | None = None,
        make_controller: ControllerFactory | None = None,
    ) -> None:
        self.plan, self.settings = plan, settings or PhaseSettings()
        self.sensors = SensorModel() if sensors is None else sensors
        base = replace(control or ControlSettings(), gravity_H=plan.gravity_H, period=1.0 / self.sensors.rate)
        self._control = ControlSettings.for_sensors(self.sensors, base, drives=plan.grasp.hand.drives).settings
        self._make_controller = make_controller or self._output_feedback
        hand, grasp = plan.grasp.hand, plan.grasp
        check_times(plan, self.settings)
        rest_band = _REST_SHARE * self.settings.posture_tolerances(hand)  # rad or m
        self._servo = FingerServo(hand, grasp.fingers, self.sensors, plan.gravity_H, self.settings.largest_rate, rest_band)
        self._detector = ContactDetector(hand, self.sensors, self.settings, self._servo.period)
        self._drives = DriveMap(hand, self._control.position_error, self._servo.period)
        self.reset()

    def reset(self) -> None:
        """Return to the start of the cycle."""
        self.grasp = self.plan.grasp
        self.records: tuple[PhaseRecord, ...] = ()
        self.phase: PhaseName = "approach"
        self._base = BaseMotion.at_rest(np.zeros(3))  # of the last command
        self._active: _Phase = self._joint_phase(self.plan.approach, self._base, learns=True)
        self._memory: ServoMemory | None = None
        self._held: HeldObject | None = None
        self._closing: ClosePhase | None = None
        self._start: float | None = None
        self._phase_start = self._last = 0.0
        self._message = self._request = ""

    @property
    def is_over(self) -> bool:
        """Whether the cycle is done or has stopped."""
        return self.phase in _DONE

    @property
    def signs(self) -> tuple[str, ...]:
        """(N,) what showed the contact of each finger in the close; empty for fingers without contact, and after the place."""
        return ("",) * len(self.grasp.fingers) if self._closing is None else self._closing.signs

    def step(self, measurement: Measurement) -> PhaseCommand:
        """Return the command of a control period.

        Args:
            measurement: the newest measurement.

        Raises:
            InvalidInput: the measurement belongs to another hand, or is earlier than the last one.
        """
        self._check(measurement)
        if self._memory is None or self._start is None:
            self._start, self._memory = measurement.t, self._servo.initial_memory(measurement)
        t = measurement.t - self._start
        if self.phase not in _DONE and t - self._last > self.settings.loss_time:
            self._stop(t, PAUSED, measurement.q, self._base)
        self._last = t
        result = self._active.step(t - self._phase_start, measurement, self._memory)
        servo, self._memory = result.servo
        phase, signs = self.phase, self.signs
        if phase not in _DONE:
            abort = self._request or result.abort
            if not abort and not result.is_over and t - self._phase_start > PHASE_RULES[phase].time_limit:
                abort = TIME_LIMIT
            if abort:
                self._fail(t, abort, servo, result.base)
            elif result.is_over:
                self._advance(t, servo, result.base)
        self._base = result.base
        return self._command(t, phase, signs, result)

    def stop(self, reason: str = _STOPPED) -> None:
        """Stop the cycle with the safe stop of the present phase, from the next step on.

        Args:
            reason: kept in the record of the phase and in the commands; an empty one counts as the default.
        """
        self._request = reason or _STOPPED

    # ── sequence ───────────────────────────────────────────────────────────────────────────────────────────────────────────

    def _advance(self, t: float, servo: ServoStep, base: BaseMotion) -> None:
        """End the present phase and begin the next one."""
        ended = self.phase
        if ended == "close" and not self._touch(servo):
            self._fail(t, WRONG_OBJECT, servo, base)
            return
        if ended == "squeeze" and not self._is_last_attempt:
            shift = shift_of_late_touch(self.plan.grasp, self.grasp, servo.p_tip, self.plan.down, self.settings)
            if shift is not None:
                self._reopen(t, LATE_TOUCH, servo, base, shift)
                return
        self._record(t, PHASE_RULES[ended].exit, False)
        following = 1 if ended == "reopen" else PHASE_ORDER.index(ended) + 1
        self.phase = PHASE_ORDER[following] if following < len(PHASE_ORDER) else "done"
        self._phase_start = t
        rest = BaseMotion.at_rest(base.p)
        if ended in ("squeeze", "place") and isinstance(self._active, SqueezePhase | CarryPhase):
            self._held = self._active.target.held()  # the pose to which the target moved on the table
        plan, held = self.plan, self._held
        if self.phase == "close":
            self._message = ""
            self._active = self._closing = ClosePhase(self._servo, self._detector, plan, self.settings, rest)
        elif self.phase == "retract":
            self._active = self._joint_phase(self._retraction(servo.q), rest, learns=True)
        elif self.phase == "done":
            self._active = HoldJoints(self._servo, plan.q_start, rest, self._bounds(_APPROACH_FORCE))
        elif held is not None:
            self._active = self._object_phase(held, servo, rest)

    def _object_phase(self, held: HeldObject, servo: ServoStep, rest: BaseMotion) -> _Phase:
        """Return the present phase of the held object."""
        plan, profiles = self.plan, self.plan.carry_profiles
        if self.phase == "squeeze":
            assert self._closing is not None  # the phase before
            return SqueezePhase(held, self._closing.q_wait, rest)
        if self.phase == "lift":
            return CarryPhase(held, rest.p, plan.lift, profiles.lift)
        if self.phase == "move":
            return CarryPhase(held, rest.p, plan.move, profiles.move)
        if self.phase == "place":
            return CarryPhase(held, rest.p, -plan.lift, profiles.place, lowers=True)
        self._closing = None  # the fingers leave the object
        return ReleasePhase(held, servo.q, rest, plan.q_pregrasp)

    def _touch(self, servo: ServoStep) -> bool:
        """Update the grasp from the touched places and make its object controller, if these places fit the object."""
        plan = self.plan
        pose = pose_from_touch(plan.grasp, servo.p_tip, plan.down, self.settings)
        self.grasp = touched_grasp(plan.grasp, servo.q, servo.p_tip, pose)
        gaps = touch_gaps(self.grasp, servo.p_tip)  # m
        if float(np.abs(gaps).max()) > self.settings.fit_tolerance:
            return False
        controller = self._make_controller(self.grasp)
        self._held = HeldObject(self.grasp, controller, self._servo, plan.gravity_H, self.settings, gaps)
        return True

    def _fail(self, t: float, reason: str, servo: ServoStep, base: BaseMotion) -> None:
        """Begin the next attempt after a failure, or stop the cycle."""
        if self._request or (self.phase, reason) not in RETRIED or self._is_last_attempt:
            self._stop(t, reason, servo.q, base)
            return
        self._reopen(t, reason, servo, base, self._shift(reason, servo))

    def _reopen(self, t: float, reason: str, servo: ServoStep, base: BaseMotion, shift: Array) -> None:
        """Open the fingers, and then move the base by a displacement (3,), m, for the next attempt."""
        self._message = f"{self.phase}: {reason}"
        self._record(t, reason, True)
        self.phase, self._phase_start, self.grasp = "reopen", t, self.plan.grasp
        self._held = self._closing = None
        opening = self._joint_phase(self._opening(servo.q), BaseMotion.at_rest(base.p))
        self._active = ReopenPhase(self.grasp.hand, opening, shift)

    @property
    def _is_last_attempt(self) -> bool:
        """Whether the fingers close for the last time."""
        return 1 + sum(record.phase == "reopen" for record in self.records) == self.settings.attempts

    def _shift(self, reason: str, servo: ServoStep) -> Array:
        """Return how far the object of a failed close or squeeze is from where it is expected, (3,) m along the table."""
        down, expected, active = self.plan.down, self.plan.grasp, self._active
        if isinstance(active, ClosePhase):
            return self._shift_of_close(active, reason, servo.p_tip)
        assert isinstance(active, SqueezePhase)  # no other phase is repeated
        slip = shift_of_slip(self.grasp, servo.p_tip, down, self.settings.contact_tolerance)
        if slip is not None:
            return slip
        return along_table(active.target.pose.p_HO - expected.p_HO, down)  # the touched places fit the object

    def _shift_of_close(self, close: ClosePhase, reason: str, p_tip: Array) -> Array:
        """Return how far the object is from where it is expected after a failed close, (3,) m along the table.

        Args:
            close: the failed close.
            reason: why it failed.
            p_tip: (N, 3) centres of the fingertips, in H, m.
        """
        down, expected = self.plan.down, self.plan.grasp
        touching = np.array([bool(sign) for sign in close.signs])
        if reason == WRONG_OBJECT:  # fingertips before the surface have stopped by friction
            touching &= touch_gaps(self.grasp, p_tip) <= self.settings.contact_tolerance
        p_HO, _ = pose_from_touch(expected, p_tip, down, self.settings, touching)
        shift = along_table(p_HO - expected.p_HO, down)
        if close.has_passed.any():
            finger = int(np.argmax(close.has_passed))
            beside = shift_of_miss(expected, finger, p_tip[finger], down)
            shift = shift if beside is None else shift + beside
        return shift

    def _stop(self, t: float, reason: str, q: Array, base: BaseMotion) -> None:
        """End the cycle with the safe stop of the present phase, at the present posture and motion of the base."""
        rule = PHASE_RULES[self.phase]
        self._message = f"{rule.name}: {reason}"
        self._record(t, reason, True)
        self.phase, self._phase_start = "stopped", t
        if rule.safe_stop == "hold object" and self._held is not None:
            self._active = HoldObject(self._held, base)
        else:
            self._active = HoldJoints(self._servo, q, base, self._bounds(_STOP_FORCE))

    def _retraction(self, q: Array) -> JointTrajectory:
        """Return the motion from a posture to the pre-grasp posture and back along the approach."""
        return self._opening(q).followed_by(self.plan.approach.reversed())

    def _opening(self, q: Array) -> JointTrajectory:
        """Return the motion from a posture to the pre-grasp posture."""
        q_open = self.plan.q_pregrasp
        return JointTrajectory.between(q, q_open, opening_time(self.plan.grasp.hand, q, q_open))

    # ── parts ──────────────────────────────────────────────────────────────────────────────────────────────────────────────

    def _bounds(self, force: float) -> Array:
        return np.full(len(self.grasp.fingers), force)

    def _joint_phase(self, motion: JointTrajectory, base: BaseMotion, learns: bool = False) -> JointPhase:
        return JointPhase(self._servo, motion, self.settings, base, self._bounds(_APPROACH_FORCE), learns)

    def _output_feedback(self, grasp: Grasp) -> FeedbackController:
        """Return the object controller of a touched grasp."""
        return OutputFeedbackController(grasp, self._control, self.sensors)

    def _record(self, t: float, reason: str, is_aborted: bool) -> None:
        """Store the phase that ends."""
        self.records = (*self.records, PhaseRecord(self.phase, self._phase_start, t, reason, is_aborted, self.grasp))

    def _check(self, measurement: Measurement) -> None:
        """Raise InvalidInput if a measurement belongs to another hand or grasp."""
        hand, count = self.grasp.hand, len(self.grasp.fingers)
        if len(measurement.q) != hand.n:
            raise InvalidInput("measurement.q", measurement.q.shape, f"({hand.n},), one for each motor of {hand.name}")
        wrench = measurement.tip_wrench
        if wrench is not None and len(wrench) != count:
            raise InvalidInput("measurement.tip_wrench", wrench.shape, f"({count}, 6), a row for each finger of the grasp")

    def _command(self, t: float, phase: PhaseName, signs: tuple[str, ...], result: PhaseTorques) -> PhaseCommand:
        """Return the command of a step."""
        count, command, servo = len(self.grasp.fingers), result.command, result.servo[0]
        f_normal, margin = np.zeros(count), float("nan")
        if command is not None:
            f_normal = result.share * command.contacts.pad(np.asarray(command.f))[:, 2]
            margin = float(np.min(command.slip_margin))
        return PhaseCommand(
            t=t,
            phase=phase,
            tau=result.tau,
            base=result.base,
            touching=signs,
            f_normal=freeze(f_normal),
            slip_margin=margin,
            message=self._message,
            joints=(servo.q, servo.v),
            drives=self._drives,
        )

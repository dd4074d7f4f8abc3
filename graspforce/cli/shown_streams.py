"""Pictures and numbers of a running stream's steps, for its view: of a held object, of the phases of a grasp, and of joints."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from graspforce.browser.charts import (
    ERROR,
    FORCES,
    JOINT_ERROR,
    LEAST_MARGIN,
    MARGINS,
    STEP_TIME,
    TEMPERATURE,
    TORQUE,
    TORQUE_ERROR,
)
from graspforce.browser.readings import Readings, torque_use
from graspforce.cli.hand_scene import hand_scene
from graspforce.contact import friction
from graspforce.contact.motion import BodyMotion
from graspforce.control.phases.phase_rules import PhaseName
from graspforce.control.state import GraspState, object_motion
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.service import JointStreamSetup, PhaseStreamSetup, StreamSetup
from graspforce.service.client.stream_monitor import AnyStreamStep, JointStreamStep, PhaseStreamStep, StreamStep
from graspforce.service.wire.memory_records import to_array
from graspforce.service.wire.stream_setups import AnySetup
from graspforce.simulation import build_scene
from graspforce.simulation.rendering import DisplayModel, SceneState
from graspforce.simulation.rendering.marks import RecordedContacts, posture_state, scene_state

_CARRIED: tuple[PhaseName, ...] = ("lift", "move", "place", "stopped")  # phases in which the object moves with the hand
_PLACED: tuple[PhaseName, ...] = ("release", "retract", "done")
_APART: tuple[PhaseName, ...] = ("approach", "retract", "done")  # phases in which no finger touches
_MOVED = 1e-6  # m: a stopped hand that is further from its start holds the object

Shown = tuple[SceneState, tuple[Array, Array] | None, Readings]
"""A picture: state, desired position, m, and orientation of the object in H, or None without; and the numbers."""


class ShownStream(Protocol):
    """A stream whose steps a page shows."""

    @property
    def display(self) -> DisplayModel: ...  # pragma: no cover
    @property
    def charts(self) -> tuple[str, ...]: ...  # pragma: no cover

    def show(self, step: AnyStreamStep, start: float = 0.0) -> Shown:
        """Return the picture of a step.

        Args:
            step: the step.
            start: time on the driver's clock that is shown as zero, s.
        """
        ...  # pragma: no cover


def shown_stream(setup: AnySetup) -> ShownStream:
    """Return the pictures of a stream.

    Args:
        setup: setup of the stream.

    Raises:
        InvalidInput: the scene cannot be built.
        ModelError: the hand cannot be shown.
    """
    if isinstance(setup, StreamSetup):
        return ShownGrasp(setup)
    return ShownPhases(setup) if isinstance(setup, PhaseStreamSetup) else ShownJoints(setup)


class ShownGrasp:
    """A stream that controls a held object.

    Args:
        setup: setup of the stream.
    """

    def __init__(self, setup: StreamSetup) -> None:
        self._setup, self._scene = setup, build_scene(setup.grasp, gravity_H=setup.settings.gravity_H)
        self.display = DisplayModel(self._scene)
        heat = (TEMPERATURE,) if setup.hand.drives.has_thermal_data else ()
        self.charts = (MARGINS, TORQUE, ERROR, STEP_TIME, *heat)

    def show(self, step: AnyStreamStep, start: float = 0.0) -> Shown:
        """Return the picture of a step. After a change of contacts, it has no marks of contacts.

        Args:
            step: the step.
            start: time on the driver's clock that is shown as zero, s.

        Raises:
            InvalidInput: a step with measurements has no estimate.
        """
        assert isinstance(step, StreamStep)
        state, command, setup = step.state, step.command, self._setup
        t = state.time - start
        if isinstance(state.state, GraspState):
            q, motion = state.state.q, BodyMotion(state.state.object.p_HO, state.state.object.R_HO)
        elif command.estimate is not None:
            estimate = command.estimate
            q, motion = np.array(estimate.posture), BodyMotion(estimate.fused_position, estimate.fused_rotation)
        else:
            raise InvalidInput("estimate", None, "given in the commands of a stream of measurements")
        known, count = setup.grasp.contacts, len(setup.grasp.fingers)
        change = command.contact_change
        is_changed = change is not None and change.number > setup.change_number
        margins = np.zeros(count) if is_changed else to_array(command.slip_margin)
        contacts = RecordedContacts(
            np.full(count, not is_changed),
            np.zeros((count, 4)) if is_changed else known.pad(to_array(command.force)),
            known.p_OC if is_changed else to_array(command.positions, -1, 3),
            known.R_OC if is_changed else to_array(command.memory.frames, -1, 3, 3),
            known.mu,
            known.gamma,
        )
        use = torque_use(to_array(command.torque), setup.hand.torque_lower, setup.hand.torque_upper)
        error = 1e3 * float(np.linalg.norm(to_array(command.pose_error)[:3]))  # mm
        heat = np.nan if command.winding_temperature is None else float(to_array(command.winding_temperature).max())
        step_time = 1e3 * command.server_seconds  # ms
        readings = Readings(t, margins, use, error, step_time, tuple(command.warnings), temperature=heat)
        desired = object_motion(state.desired)
        return scene_state(self._scene, t, q, motion, contacts), (desired.p_HO, desired.R_HO), readings


class ShownPhases:
    """A stream of the phases of a grasp, seen from the hand's base.

    The object is where it was last measured. Without a measurement it lies where the plan expects it, and moves with the hand
    from the lift to the placing. Arrows are the measured forces of the fingertips, or the planned normal forces.

    Args:
        setup: setup of the stream.
    """

    charts = (FORCES, LEAST_MARGIN, TORQUE, STEP_TIME)

    def __init__(self, setup: PhaseStreamSetup) -> None:
        self._setup, grasp = setup, setup.plan.grasp
        self._scene = build_scene(grasp, gravity_H=setup.plan.gravity_H)
        self.display = DisplayModel(self._scene)
        self._pose: tuple[Array, Array] | None = None  # position, m, and axes of the object in H
        self._base = np.zeros(3)  # m, in the last step

    def show(self, step: AnyStreamStep, start: float = 0.0) -> Shown:
        """Return the picture of a step.

        Args:
            step: the step.
            start: not used: the time is that since the start of the cycle.
        """
        assert isinstance(step, PhaseStreamStep)
        measured, command, hand = step.state.measurement, step.command, self._setup.hand
        p_HO, R_HO = self._object_pose(step)
        normal, known = np.array(command.normal_force), self._scene.grasp.contacts
        forces = np.zeros((len(normal), 4))
        forces[:, 2] = normal
        if measured.tip_wrench is not None:
            forces[:, :3] = np.einsum("nji,nj->ni", R_HO @ known.R_OC, measured.tip_wrench[:, :3])
        signs = np.array([bool(sign) for sign in command.touching] or [False] * len(normal))
        touching = (signs | (normal > 0.0)) & (command.phase not in _APART)
        contacts = RecordedContacts(touching.astype(float), forces, known.p_OC, known.R_OC, known.mu, known.gamma)
        margin = np.nan if command.slip_margin is None else command.slip_margin
        if measured.tip_wrench is not None and touching.any():
            margin = float(friction.slip_margin(forces, known.mu, known.gamma)[touching].min())
        readings = Readings(
            command.t,
            np.array([margin]),
            torque_use(np.array(command.torque), hand.torque_lower, hand.torque_upper),
            np.nan,
            1e3 * command.server_seconds,
            (command.message,) if command.message else (),
            phase=command.phase,
            normal_force=np.where(touching, forces[:, 2], 0.0),
        )
        return scene_state(self._scene, command.t, measured.q, BodyMotion(p_HO, R_HO), contacts), None, readings

    def _object_pose(self, step: PhaseStreamStep) -> tuple[Array, Array]:
        """Return position (3,), m, and axes (3, 3) of the object in H, and keep them for the next step."""
        phase, base, plan = step.command.phase, np.array(step.command.base.position), self._setup.plan
        is_carried = phase in _CARRIED and (phase != "stopped" or float(np.linalg.norm(base)) > _MOVED)
        if step.state.measurement.object is not None:
            seen = step.state.measurement.object
            self._pose = seen.p_HO, seen.R_HO
        elif self._pose is None:  # the base's displacement has moved the hand, and the object with it while carried
            way = np.zeros(3) if is_carried else base - plan.move if phase in _PLACED else base
            self._pose = freeze(plan.grasp.p_HO - way), plan.grasp.R_HO
        elif not is_carried:
            self._pose = freeze(self._pose[0] - (base - self._base)), self._pose[1]
        self._base = base
        return self._pose


class ShownJoints:
    """A stream of a joint-space law: the hand alone.

    Args:
        setup: setup of the stream.
    """

    def __init__(self, setup: JointStreamSetup) -> None:
        self._setup, self._scene = setup, hand_scene(setup.hand)
        self.display = DisplayModel(self._scene, shows_object=False)
        self.charts = (TORQUE_ERROR if setup.law == "force" else JOINT_ERROR, TORQUE, STEP_TIME)

    def show(self, step: AnyStreamStep, start: float = 0.0) -> Shown:
        """Return the picture of a step.

        Args:
            step: the step.
            start: time on the driver's clock that is shown as zero, s.
        """
        assert isinstance(step, JointStreamStep)
        state, command, hand = step.state, step.command, self._setup.hand
        t, joint_error, torque_error = state.time - start, np.nan, np.nan
        if state.desired is not None:
            joint_error = float(np.degrees(np.abs(state.desired.q - state.measured.q).max()))
        if state.torque is not None and state.torque_desired is not None:
            torque_error = float(np.abs(state.torque_desired - state.torque).max())
        use = torque_use(np.array(command.torque), hand.torque_lower, hand.torque_upper)
        readings = Readings(
            t, freeze([]), use, np.nan, 1e3 * command.server_seconds, joint_error=joint_error, torque_error=torque_error
        )
        return posture_state(self._scene, t, state.measured.q), None, readings

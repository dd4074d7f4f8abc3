"""Command of the object controller for one period."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import Any, NamedTuple

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.control.clearance import ClearanceQuery
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.control.contacts.mobility import NO_TWISTS, planned_rates
from graspforce.control.drives.drive_commands import DriveCommand, DriveMap
from graspforce.control.drives.drive_margin import TorqueSensitivity, torque_sensitivity
from graspforce.control.state import GraspState
from graspforce.control.step_data import StepResult, StepTargets
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import native
from graspforce.core.json_text import JsonRecord
from graspforce.core.lazy_field import LazyField
from graspforce.core.text_table import Table
from graspforce.force.solution import Solution
from graspforce.grasp.grasp import Grasp
from graspforce.hand.collision import LinkGap

_NO_WRENCH = freeze(np.zeros(6))


@dataclass(frozen=True, eq=False)
class Command:
    """Motor torques for one control period, with the planned contact forces and accelerations.

    Attributes:
        tau: (n,) motor torques within their limits, N·m.
        f: (k,) planned contact forces, stacked in the contact frames, N and N·m.
        contacts: present contacts in O, with their true friction.
        w: (6,) wrench that the contacts must supply, about O's origin, in O, N and N·m.
        acceleration: (6,) commanded acceleration of the object in H, m/s² and rad/s²; as `BodyMotion.acceleration`.
        joint_acceleration: (n,) commanded joint accelerations, rad/s².
        error: (6,) pose error in H: p_d − p, m, and log(R_d Rᵀ), rad.
        solution: certified solution of the force problem. Its normal forces lack the shift s/μ of the slip margin.
        slip_margin: (N,) μ f_n − ‖f_t‖ of the planned forces with the true friction, N.
        guaranteed_margin: (N,) part of it that remains for all torque errors of the drives, N; see `drive_margin`. Negative if
            they can make a contact slip.
        drive: what the drives of the joints take for these torques.
        saturated: whether a motor is at its torque limit.
        uncontrollable: (m, 6) orthonormal rows u in H's axes. The fingers can make a twist in m/s and rad/s exactly if
            u · twist = 0 for all rows. Empty if every twist is feasible.
        structural_wrench: (6,) part of w that the structure of the hand carries, in O, N and N·m: it comes from forces that
            load no motor.
        creep: (N,) recent sliding of each fingertip on the object, m.
        warnings: messages about slip, lost contacts, joint limits, small margins and infeasible motions.
        forces_reused: whether no certified forces were found: f are the forces of the last step, or after the loss of a finger
            the forces with the nearest wrench.
        clearance: the nearest two of links, palm, object and `ControlSettings.obstacles` that must not touch, with their
            distance in the measured state. It is computed when it is read first, which takes about as long as ten steps; read
            it in one of 50 steps. None if there is no such pair, or in a command of a record.
    """

    tau: Array
    f: Array
    contacts: ContactSet
    w: Array
    acceleration: Array
    joint_acceleration: Array
    error: Array
    solution: Solution
    slip_margin: Array
    guaranteed_margin: Array
    drive: DriveCommand
    saturated: bool
    uncontrollable: Array
    structural_wrench: Array
    creep: Array
    warnings: tuple[str, ...]
    forces_reused: bool
    clearance: LinkGap | None = None

    def __repr__(self) -> str:
        forces = "reused" if self.forces_reused else self.solution.status.value
        return f"<Command: {len(self.tau)} torques, {len(self.contacts)} contacts, forces {forces}>"

    def __str__(self) -> str:
        return "\n".join([str(self._table()), *(f"Warning: {warning}" for warning in self.warnings)])

    def _repr_html_(self) -> str:
        warnings = "".join(f"<p>Warning: {escape(warning)}</p>" for warning in self.warnings)
        return self._table().to_html() + warnings

    def _table(self) -> Table:
        """Return the table of the contacts, with torques and pose error in its title."""
        forces = "reused" if self.forces_reused else self.solution.status.value
        limit = " (saturated)" if self.saturated else ""
        distance, angle = math.hypot(*self.error[:3]), math.hypot(*self.error[3:])  # m and rad
        title = (
            f"Command: torques {self.tau.min():.3g} to {self.tau.max():.3g} N·m{limit}, forces {forces}, "
            f"pose error {1e3 * distance:.3g} mm and {math.degrees(angle):.3g}°"
        )
        numbers = zip(self.contacts.pad(self.f).tolist(), self.slip_margin.tolist(), self.creep.tolist(), strict=True)
        rows = [
            (str(i), *(f"{number:.3f}" for number in (*f[:3], margin, 1e3 * creep)))
            for i, (f, margin, creep) in enumerate(numbers)
        ]
        return Table(("contact", "f_t1 N", "f_t2 N", "f_n N", "slip margin N", "creep mm"), tuple(rows), title)

    def to_dict(self) -> JsonRecord:
        """Return a plain record without the clearance, with the `positions` and `frames` of the contacts in O."""
        return {
            "torque": self.tau.tolist(),
            "force": self.f.tolist(),
            "positions": self.contacts.p_OC.tolist(),
            "frames": self.contacts.R_OC.tolist(),
            "wrench": self.w.tolist(),
            "acceleration": self.acceleration.tolist(),
            "joint_acceleration": self.joint_acceleration.tolist(),
            "pose_error": self.error.tolist(),
            "slip_margin": self.slip_margin.tolist(),
            "guaranteed_margin": self.guaranteed_margin.tolist(),
            "drive": self.drive.to_dict(),
            "uncontrollable": self.uncontrollable.tolist(),
            "borne": self.structural_wrench.tolist(),
            "creep": self.creep.tolist(),
            "saturated": self.saturated,
            "held": self.forces_reused,
            "warnings": list(self.warnings),
            "solution": self.solution.to_dict(),
        }

    @classmethod
    def from_dict(cls, record: object, contacts: ContactSet, field: str = "command") -> Command:
        """Read a command from a plain record.

        Args:
            record: as `to_dict` returns it.
            contacts: contacts of the grasp, with models, friction and force limits.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=_RECORD_FIELDS)
        count = len(contacts)

        def read(name: str, *shape: int | None) -> Array:
            return arrays.check_array(values[name], f"{field}.{name}", shape)

        joint_acceleration = read("joint_acceleration", None)
        uncontrollable = values["uncontrollable"]
        return cls(
            tau=read("torque", len(joint_acceleration)),
            f=read("force", contacts.size),
            contacts=dataclasses.replace(
                contacts,
                p_OC=read("positions", count, 3),
                R_OC=arrays.check_rotations(values["frames"], f"{field}.frames", count),
            ),
            w=read("wrench", 6),
            acceleration=read("acceleration", 6),
            joint_acceleration=joint_acceleration,
            error=read("pose_error", 6),
            solution=Solution.from_dict(values["solution"]),
            slip_margin=read("slip_margin", count),
            guaranteed_margin=read("guaranteed_margin", count),
            drive=DriveCommand.from_dict(values["drive"], f"{field}.drive"),
            saturated=fields.check_boolean(values["saturated"], f"{field}.saturated"),
            uncontrollable=read("uncontrollable", None, 6) if uncontrollable else freeze(np.zeros((0, 6))),
            structural_wrench=read("borne", 6),
            creep=read("creep", count),
            warnings=tuple(
                fields.check_text(text, f"{field}.warnings[{i}]")
                for i, text in enumerate(fields.check_sequence(values["warnings"], f"{field}.warnings"))
            ),
            forces_reused=fields.check_boolean(values["held"], f"{field}.held"),
        )


_RECORD_FIELDS = (
    *("torque", "force", "positions", "frames", "wrench", "acceleration", "joint_acceleration", "pose_error"),
    *(
        "slip_margin",
        "guaranteed_margin",
        "drive",
        "uncontrollable",
        "borne",
        "creep",
        "saturated",
        "held",
        "warnings",
        "solution",
    ),
)


class CommandSource(NamedTuple):
    """Data of a step from which a command computes its further fields.

    Attributes:
        grasp: hand, object and contacts, with friction and force limits.
        constraints: kinematic constraints of the contacts.
        targets: targets of the step.
        state: measured state of the step.
        desired_twist: (6,) desired twist of the object in H, m/s and rad/s.
        drives: map to the set-points of the hand's drives.
        free_torque: (n,) torques of the hand's own motion, without contact and joint friction, N·m.
        clearance: query of the least distance.
        sensitivity: effects of torque errors with these constraints; None if the step did not need them.
    """

    grasp: Grasp
    constraints: ContactConstraints
    targets: StepTargets
    state: GraspState
    desired_twist: Array
    drives: DriveMap
    free_torque: Array
    clearance: ClearanceQuery
    sensitivity: TorqueSensitivity | None = None


def make_lazy_command(
    source: CommandSource,
    result: StepResult,
    solution: Solution,
    f: Array,
    warnings: tuple[str, ...],
    forces_reused: bool,
) -> Command:
    """Return a command that computes its further fields at their first access; most steps need only the torques.

    Args:
        source: data for the further fields.
        result: torques, saturation and sliding of the step.
        solution: solution of the force problem.
        f: (k,) contact forces, N and N·m.
        warnings: messages of the step.
        forces_reused: whether f are the forces of an earlier step.
    """
    command = object.__new__(_LazyCommand)
    vars(command).update(
        _source=source,
        tau=result.tau,
        f=f,
        solution=solution,
        saturated=result.saturated,
        creep=result.creep_distance,
        warnings=warnings,
        forces_reused=forces_reused,
    )
    return command


def free_torque(command: Command) -> Array | None:
    """Return the torques of the hand's own motion in a command, (n,), N·m, without contact and joint friction.

    Args:
        command: the command; None is returned for a command that was read from a record.
    """
    return command._source.free_torque if isinstance(command, _LazyCommand) else None


def read_step_arrays(command: Command) -> tuple[Array, ...]:
    """Return the fields w, acceleration, joint_acceleration, error, slip_margin, uncontrollable and structural_wrench.

    A command that is read once, such as one of a stream, need not store them.

    Args:
        command: the command.
    """
    if not isinstance(command, _LazyCommand) or command._source.targets.uncontrollable_error is not None:
        motion = command.w, command.acceleration, command.joint_acceleration, command.error
        return *motion, command.slip_margin, command.uncontrollable, command.structural_wrench
    targets = command._source.targets
    motion = targets.w, targets.object_acceleration, targets.joint_acceleration, targets.error
    return *motion, _slip_margin(command), NO_TWISTS, _NO_WRENCH


def _current_contacts(command: _LazyCommand) -> ContactSet:
    """Return the contacts of the grasp at their present positions."""
    contacts, targets = command._source.grasp.contacts, command._source.targets
    return ContactSet(
        targets.p_OC,
        targets.R_OC,
        contacts.models,
        contacts.mu,
        contacts.gamma,
        contacts.min_normal,
        contacts.max_normal,
    )


def _slip_margin(command: _LazyCommand) -> Array:
    """Return μ f_n − ‖f_t‖ with the true friction, (N,), N."""
    contacts = command._source.grasp.contacts
    if contacts.size == 3 * len(contacts):  # point contacts
        if native is not None:
            margins = np.empty(len(contacts))
            native.slip_margins(command.f, contacts.mu, margins)
            return margins
        f_t1, f_t2, f_n = command.f.reshape(-1, 3).T
        return np.asarray(contacts.mu * f_n - np.hypot(f_t1, f_t2))
    return friction.slip_margin(contacts.pad(command.f), contacts.mu, contacts.gamma)


def _guaranteed_margin(command: _LazyCommand) -> Array:
    """Return the slip margin that remains for all torque errors of the drives, (N,), N."""
    grasp, constraints, targets, state, *_ = command._source
    error, margin = command.drive.torque_error, np.asarray(command.slip_margin)
    if not error.any():
        return margin
    sensitivity = command._source.sensitivity
    if sensitivity is None:
        A, B, _ = constraints.constraint_rows(targets.rolling)
        masses = grasp.hand.model.mass_matrix(state.q), grasp.body.mass_matrix()
        sensitivity = torque_sensitivity(A, B, *masses, constraints, grasp.contacts)
    return np.asarray(margin - sensitivity.margin @ error)


def _drive(command: _LazyCommand) -> DriveCommand:
    """Return what the drives take for the torques of a command."""
    source = command._source
    drives, v, planned = source.drives, source.state.v, None
    if drives.has_losses or drives.takes_rates:
        A, B, _ = source.constraints.constraint_rows(source.targets.rolling)
        twist_O = (source.desired_twist.reshape(2, 3) @ source.state.object.R_HO).ravel()
        planned = planned_rates(A, B, twist_O)
        if drives.takes_rates:  # the damping of a servo would turn the noise of measured rates into torques
            v = planned_rates(A, B, twist_O, v)
    return drives.set_points(command.tau, source.state.q, v, planned)


def _uncontrollable(command: _LazyCommand) -> Array:
    """Return the uncontrollable twists in H's axes, (m, 6)."""
    if command._source.targets.uncontrollable_error is None:  # every twist is feasible
        return NO_TWISTS
    uncontrollable = command._source.targets.accelerations.uncontrollable
    if not uncontrollable.size:
        return uncontrollable
    return np.asarray((uncontrollable.reshape(-1, 2, 3) @ command._source.state.object.R_HO.T).reshape(-1, 6))


def _structural_wrench(command: _LazyCommand) -> Array:
    """Return the wrench of the forces that load no motor, (6,), in O, N and N·m."""
    grasp, constraints, targets, *_ = command._source
    if targets.uncontrollable_error is None or targets.accelerations.Q is None:
        return _NO_WRENCH
    Q = targets.accelerations.Q
    f, (_, B, _) = constraints.constraint_forces(grasp.contacts.pad(command.f)), constraints.constraint_rows(targets.rolling)
    return np.asarray((Q @ (Q.T @ f)) @ B)


def _lazy_field(compute: Callable[[_LazyCommand], Any]) -> Any:
    """Return a field that is computed at its first access; its type is that of the field of `Command`."""
    return LazyField(compute)


class _LazyCommand(Command):
    """Command whose further fields are computed at their first access."""

    _source: CommandSource
    w = _lazy_field(lambda command: command._source.targets.w)
    acceleration = _lazy_field(lambda command: command._source.targets.object_acceleration)
    joint_acceleration = _lazy_field(lambda command: command._source.targets.joint_acceleration)
    error = _lazy_field(lambda command: command._source.targets.error)
    contacts = _lazy_field(_current_contacts)
    slip_margin = _lazy_field(_slip_margin)
    guaranteed_margin = _lazy_field(_guaranteed_margin)
    drive = _lazy_field(_drive)
    uncontrollable = _lazy_field(_uncontrollable)
    structural_wrench = _lazy_field(_structural_wrench)
    clearance = _lazy_field(lambda command: command._source.clearance.find(command._source.state))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a plain `Command` for copies and pickles; the source stays with the controller."""
        return Command, tuple(getattr(self, each.name) for each in dataclasses.fields(Command))

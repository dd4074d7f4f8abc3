"""What a controller tells a hand to do, and what it found on the way."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.control.contact_constraints import ContactConstraints
from graspforce.control.step_data import StepTargets
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.force.solution import Solution


@dataclass(frozen=True, eq=False)
class Command:
    """The motor torques for one control period, and the forces and motion that they are meant to make.

    Attributes:
        tau: (n,) motor torques, N·m, inside the motors' limits.
        f: (k,) planned contact forces, stacked in the contact frames, N and N·m.
        contacts: the contacts where they are now, in O, with their true friction.
        w: (6,) the wrench that the contacts must supply, about O's origin, in O, N and N·m.
        acceleration: (6,) the object's commanded acceleration, as `BodyMotion.acceleration`, in H, m/s² and rad/s².
        joint_acceleration: (n,) the commanded joint accelerations, rad/s².
        error: (6,) from where the object is to where it should be, in H, m and rad.
        solution: the force problem's answer, certified. It stands for f less what the slip margin adds to each normal force.
        slip_margin: (N,) μ f_n − ‖f_t‖ of the planned forces with the true friction, N.
        saturated: whether a motor is at its limit.
        uncontrollable: (m, 6) orthonormal rows u, in H's axes: the fingers can make a twist of the object, in m/s and rad/s,
            exactly when u · twist is zero for all of them. Empty for fingers that can move their contacts every way.
        borne: (6,) the part of w, in O, N and N·m, that forces supply which load no motor: the fingers' structure bears them.
        creep: (N,) how far each fingertip has lately slid over the object, m.
        warnings: what a person should know, in sentences.
        held: whether no certified forces were found, and the last ones are held.
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
    saturated: bool
    uncontrollable: Array
    borne: Array
    creep: Array
    warnings: tuple[str, ...]
    held: bool

    def to_dict(self) -> dict[str, Any]:
        """Return a plain record; of the contacts it has the `positions` and the `frames` in O."""
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
            "uncontrollable": self.uncontrollable.tolist(),
            "borne": self.borne.tolist(),
            "creep": self.creep.tolist(),
            "saturated": self.saturated,
            "held": self.held,
            "warnings": list(self.warnings),
            "solution": self.solution.to_dict(),
        }

    @classmethod
    def from_dict(cls, record: object, contacts: ContactSet, field: str = "command") -> Command:
        """Read a command from a plain record.

        Args:
            record: as `to_dict` returns it.
            contacts: the contacts of the grasp: models, friction and force limits.
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
            saturated=fields.check_boolean(values["saturated"], f"{field}.saturated"),
            uncontrollable=read("uncontrollable", None, 6) if uncontrollable else freeze(np.zeros((0, 6))),
            borne=read("borne", 6),
            creep=read("creep", count),
            warnings=tuple(
                fields.check_text(text, f"{field}.warnings[{i}]")
                for i, text in enumerate(fields.check_sequence(values["warnings"], f"{field}.warnings"))
            ),
            held=fields.check_boolean(values["held"], f"{field}.held"),
        )


_RECORD_FIELDS = (
    *("torque", "force", "positions", "frames", "wrench", "acceleration", "joint_acceleration", "pose_error"),
    *("slip_margin", "uncontrollable", "borne", "creep", "saturated", "held", "warnings", "solution"),
)


def make_lazy_command(
    *, grasp_contacts: ContactSet, constraints: ContactConstraints, targets: StepTargets, R_HO: Array, **known: Any
) -> Command:
    """A command whose other parts are worked out when they are first asked for: few steps are looked at so closely.

    Args:
        grasp_contacts: the contacts where the hold began, with what they bear.
        ties: which relative velocities the contacts tie.
        wanted: what was wanted before the forces were known.
        R_HO: (3, 3) the object's axes in H.
        known: `tau`, `f`, `solution`, `saturated`, `creep`, `warnings` and `held`.
    """
    command = object.__new__(_LazyCommand)
    vars(command).update(known, _source=(grasp_contacts, constraints, targets, R_HO))
    return command


def _current_contacts(command: _LazyCommand) -> ContactSet:
    grasp_contacts, _, now, _ = command._source
    return ContactSet(
        now.p_OC,
        now.R_OC,
        grasp_contacts.models,
        grasp_contacts.mu,
        grasp_contacts.gamma,
        grasp_contacts.min_normal,
        grasp_contacts.max_normal,
    )


def _slip_margin(command: _LazyCommand) -> Array:
    grasp_contacts = command._source[0]
    return friction.slip_margin(grasp_contacts.pad(command.f), grasp_contacts.mu, grasp_contacts.gamma)


def _uncontrollable(command: _LazyCommand) -> Array:
    *_, targets, R_HO = command._source
    return np.asarray((targets.accelerations.uncontrollable.reshape(-1, 2, 3) @ R_HO.T).reshape(-1, 6))


def _borne(command: _LazyCommand) -> Array:
    grasp_contacts, constraints, targets, _ = command._source
    Q = targets.accelerations.Q
    if Q is None:
        return np.zeros(6)
    f, (_, B, _) = constraints.constraint_forces(grasp_contacts.pad(command.f)), constraints.constraint_rows(targets.rolling)
    return np.asarray((Q @ (Q.T @ f)) @ B)


def _lazy_field(part: Callable[[_LazyCommand], Any]) -> Any:
    """A field that is worked out when it is first asked for."""
    return cached_property(part)


class _LazyCommand(Command):
    _source: tuple[ContactSet, ContactConstraints, StepTargets, Array]
    w = _lazy_field(lambda command: command._source[2].w)
    acceleration = _lazy_field(lambda command: command._source[2].acceleration)
    joint_acceleration = _lazy_field(lambda command: command._source[2].joints)
    error = _lazy_field(lambda command: command._source[2].error)
    contacts = _lazy_field(_current_contacts)
    slip_margin = _lazy_field(_slip_margin)
    uncontrollable = _lazy_field(_uncontrollable)
    borne = _lazy_field(_borne)

    def __reduce__(self) -> tuple[Any, ...]:
        """What leaves the process, or is copied, is the command alone: what it was made of stays with its controller."""
        return Command, tuple(getattr(self, each.name) for each in dataclasses.fields(Command))

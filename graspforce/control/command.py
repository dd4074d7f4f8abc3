"""What a controller tells a hand to do, and what it found on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from graspforce import friction
from graspforce.arrays import Array
from graspforce.contact import ContactSet
from graspforce.control.ties import Ties
from graspforce.control.wanted import Wanted
from graspforce.solution import Solution


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


def made(*, hold_contacts: ContactSet, ties: Ties, wanted: Wanted, R_HO: Array, **known: Any) -> Command:
    """A command whose other parts are worked out when they are first asked for: few steps are looked at so closely.

    Args:
        hold_contacts: the contacts where the hold began, with what they bear.
        ties: which relative velocities the contacts tie.
        wanted: what was wanted before the forces were known.
        R_HO: (3, 3) the object's axes in H.
        known: `tau`, `f`, `solution`, `saturated`, `creep`, `warnings` and `held`.
    """
    command = object.__new__(_Made)
    vars(command).update(known, _from=(hold_contacts, ties, wanted, R_HO))
    return command


def _contacts(command: _Made) -> ContactSet:
    hold, _, now, _ = command._from
    return ContactSet(now.p_OC, now.R_OC, hold.models, hold.mu, hold.gamma, hold.min_normal, hold.max_normal)


def _slip_margin(command: _Made) -> Array:
    hold = command._from[0]
    return friction.slip_margin(hold.pad(command.f), hold.mu, hold.gamma)


def _uncontrollable(command: _Made) -> Array:
    *_, wanted, R_HO = command._from
    return np.asarray((wanted.moves.uncontrollable.reshape(-1, 2, 3) @ R_HO.T).reshape(-1, 6))


def _borne(command: _Made) -> Array:
    hold, ties, wanted, _ = command._from
    Q = wanted.moves.Q
    if Q is None:
        return np.zeros(6)
    f, (_, B, _) = ties.forces(hold.pad(command.f)), ties.of(wanted.rolling)
    return np.asarray((Q @ (Q.T @ f)) @ B)


def _later(part: Callable[[_Made], Any]) -> Any:
    """A field that is worked out when it is first asked for."""
    return cached_property(part)


class _Made(Command):
    _from: tuple[ContactSet, Ties, Wanted, Array]
    w = _later(lambda command: command._from[2].w)
    acceleration = _later(lambda command: command._from[2].acceleration)
    joint_acceleration = _later(lambda command: command._from[2].joints)
    error = _later(lambda command: command._from[2].error)
    contacts = _later(_contacts)
    slip_margin = _later(_slip_margin)
    uncontrollable = _later(_uncontrollable)
    borne = _later(_borne)

    def __reduce__(self) -> tuple[Any, ...]:
        """What leaves the process, or is copied, is the command alone: what it was made of stays with its controller."""
        return Command, tuple(getattr(self, each.name) for each in fields(Command))

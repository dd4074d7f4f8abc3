"""Grasp and memory of the object controller after a change of the contacts of a held object."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from graspforce.contact.contact import Contact, ContactSet
from graspforce.control.contacts.contact_change import ContactChange, ForceRamp
from graspforce.control.memory import ControlMemory
from graspforce.control.state import GraspState
from graspforce.core.arrays import Array, freeze
from graspforce.grasp.grasp import Grasp


def begin_change(grasp: Grasp, memory: ControlMemory, state: GraspState, change: ContactChange) -> tuple[Grasp, ControlMemory]:
    """Return the grasp with the contacts that join, and the memory with the ramp of the change.

    Args:
        grasp: the present grasp.
        memory: memory after the last step.
        state: measured state.
        change: the change.

    Raises:
        InvalidInput: another change is in progress, or the grasp cannot change its contacts so.
        UnknownName: no such finger.
    """
    change.check(grasp, memory.ramp is not None)
    if change.add:
        grasp, memory = _with_contacts(grasp, memory, state, range(len(grasp.fingers)), change.add)
    return grasp, dataclasses.replace(memory, ramp=ForceRamp.begin(grasp.fingers, change))


def finish_release(grasp: Grasp, memory: ControlMemory, state: GraspState) -> tuple[Grasp, ControlMemory]:
    """Return the grasp without the contacts that have let go, and its memory. The memory's ramp must be at its end.

    Args:
        grasp: the present grasp.
        memory: memory after the step in which they carried nothing.
        state: measured state.
    """
    kept = range(len(grasp.fingers)) if memory.ramp is None else np.flatnonzero(~memory.ramp.releasing).tolist()
    return _with_contacts(grasp, memory, state, kept, {})


def _with_contacts(
    grasp: Grasp, memory: ControlMemory, state: GraspState, kept: Sequence[int], add: Mapping[str, Contact]
) -> tuple[Grasp, ControlMemory]:
    """Return the grasp with some of its contacts, at their present places, and others, and the memory of these contacts."""
    places = grasp.contacts.p_OC if memory.tip_contacts is None else memory.tip_contacts.p_OC
    present = dataclasses.replace(grasp.contacts, p_OC=places, R_OC=memory.R_OC)
    contacts = present.select(kept)
    if add:
        contacts = contacts.followed_by(ContactSet.stack(tuple(add.values())))
    fingers = [*(grasp.fingers[i] for i in kept), *add]
    pose = state.object
    changed = Grasp(grasp.hand, grasp.body, fingers, contacts, state.q, pose.p_HO, pose.R_HO)
    new = len(add)
    f = None
    if memory.f is not None:
        padded = np.vstack([grasp.contacts.pad(memory.f)[list(kept)], np.zeros((new, 4))])
        f = freeze(padded.ravel()[contacts.columns])
    return changed, dataclasses.replace(
        memory,
        R_OC=contacts.R_OC,
        creep=_rows(memory.creep, kept, new),
        spin=None if memory.spin is None else _rows(memory.spin, kept, new),
        f=f,
        tip_contacts=None,
        reflex=None if memory.reflex is None else memory.reflex.for_contacts(kept, new),
        ramp=None,
    )


def _rows(values: Array, kept: Sequence[int], new: int) -> Array:
    """Return the rows of the contacts that stay, and zeros for the new ones."""
    return freeze(np.concatenate([values[list(kept)], np.zeros((new, *values.shape[1:]))]))

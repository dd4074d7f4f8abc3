"""Collect the steps of a simulation into a recording."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control.drives.drive_commands import DriveCommand
from graspforce.control.state import GraspState
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.plants.plant_interface import PlantInterface, TrueContacts
from graspforce.simulation.recordings.recording import Recording


class ControllerCommand(Protocol):
    """The fields of a command that are recorded, as in `graspforce.control.Command` and in a command of a stream."""

    @property
    def tau(self) -> Array: ...  # pragma: no cover
    @property
    def drive(self) -> DriveCommand: ...  # pragma: no cover
    @property
    def f(self) -> Array: ...  # pragma: no cover
    @property
    def contacts(self) -> ContactSet: ...  # pragma: no cover
    @property
    def error(self) -> Array: ...  # pragma: no cover
    @property
    def slip_margin(self) -> Array: ...  # pragma: no cover
    @property
    def saturated(self) -> bool: ...  # pragma: no cover
    @property
    def forces_reused(self) -> bool: ...  # pragma: no cover
    @property
    def warnings(self) -> tuple[str, ...]: ...  # pragma: no cover


class RecordingBuilder:
    """The rows of a recording during the simulation."""

    def __init__(self) -> None:
        self.values: dict[str, list[Any]] = {}
        self.warnings: list[tuple[float, str]] = []
        self._last_warnings: set[str] = set()
        self.collisions: list[tuple[float, str, str, float]] = []
        self._open_collisions: dict[tuple[str, str], int] = {}  # index in `collisions` of each pair that touches now

    def add_inputs(self, t: float, state: GraspState, desired: BodyMotion, command: ControllerCommand) -> None:
        """Add the true state, the desired motion and the command of a step.

        Args:
            t: begin of the step, s.
            state: the true state at that time.
            desired: the desired motion at that time.
            command: the command of the step.
        """
        motion = state.object
        self._add(t=t, q=state.q, v=state.v, p_HO=motion.p_HO, R_HO=motion.R_HO, twist=motion.twist)
        self._add(p_desired=desired.p_HO, R_desired=desired.R_HO, twist_desired=desired.twist)
        planned: Array = command.contacts.pad(np.asarray(command.f))
        self._add(tau_command=command.tau, planned=planned, planned_R_OC=command.contacts.R_OC)
        self._add(planned_margin=command.slip_margin, forces_reused=command.forces_reused, saturated=command.saturated)
        topics = {text.partition(":")[0]: text for text in command.warnings}  # the part after the colon varies
        self.warnings += [(t, text) for topic, text in topics.items() if topic not in self._last_warnings]
        self._last_warnings = set(topics)

    def add_results(self, plant: PlantInterface) -> None:
        """Add the torques and contacts of a step.

        Args:
            plant: the plant after the step.
        """
        contacts = plant.true_contacts()
        self._add(
            tau=contacts.tau,
            touching=contacts.touching,
            f=contacts.f,
            p_OC=contacts.p_OC,
            R_OC=contacts.R_OC,
            mu=contacts.mu,
            gamma=contacts.gamma,
            depth=contacts.depth,
        )
        self._add_collisions(contacts)

    def finish(self, grasp: Grasp) -> Recording:
        """Return the recording of the steps so far.

        Args:
            grasp: the grasp, which gives the names and the torque limits.
        """
        hand = grasp.hand
        return Recording(
            hand=hand.name,
            fingers=grasp.fingers,
            joints=tuple(joint.name for joint in hand.joints),
            warnings=tuple(self.warnings),
            torque_lower=hand.torque_lower,
            torque_upper=hand.torque_upper,
            collisions=tuple(self.collisions),
            grasp=_grasp_record(grasp),
            **{name: freeze(values) for name, values in self.values.items()},
        )

    def _add_collisions(self, contacts: TrueContacts) -> None:
        """Add the collisions of a step; those that continue keep their first time and their largest force."""
        forces: dict[tuple[str, str], float] = {}
        for each in contacts.collisions:  # several contacts of one pair add up
            forces[each.first, each.second] = forces.get((each.first, each.second), 0.0) + each.force
        open_before, self._open_collisions = self._open_collisions, {}
        for pair, force in forces.items():
            index = open_before.get(pair, len(self.collisions))
            if index == len(self.collisions):
                self.collisions.append((contacts.t, *pair, force))
            elif force > self.collisions[index][3]:
                self.collisions[index] = (self.collisions[index][0], *pair, force)
            self._open_collisions[pair] = index

    def _add(self, **row: object) -> None:
        for name, value in row.items():
            self.values.setdefault(name, []).append(value)


def _grasp_record(grasp: Grasp) -> JsonRecord | None:
    """Return the record of a grasp; None if no record describes its surface, or its contacts on inner links and the palm."""
    try:
        return grasp.to_dict()
    except InvalidInput:
        return None

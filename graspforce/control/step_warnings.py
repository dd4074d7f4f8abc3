"""Warnings of a step: slip, lost contacts, joints at their limits, and motions that the fingers cannot make."""

from __future__ import annotations

import math

from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.settings import ControlSettings
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp

_DISTANCE, _ANGLE = 1e-3, 0.02  # m and rad: uncontrollable errors from which the controller warns


class StepWarnings:
    """Warnings of one grasp, without memory.

    Args:
        grasp: hand, object and contacts.
        settings: with `creep_limit` and `contact_tolerance`.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings) -> None:
        self._grasp, self._creep_limit, self._contact_tolerance = grasp, settings.creep_limit, settings.contact_tolerance
        self._joints = sorted({joint for name in grasp.fingers for joint in grasp.hand.finger(name).joints})

    def of_step(self, creep: Array, gap: Array, q: Array, conditions: ContactConditions | None = None) -> tuple[str, ...]:
        """Return the warnings of the contacts and of the joints.

        Args:
            creep: as in `of_contacts`, m.
            gap: as in `of_contacts`, m.
            q: as in `of_joints`, rad.
            conditions: as in `of_contacts`.
        """
        return (*self.of_contacts(creep, gap, conditions), *self.of_joints(q))

    def of_contacts(self, creep: Array, gap: Array, conditions: ContactConditions | None) -> list[str]:
        """Return a warning for each finger that slips or has lost contact.

        Sliding distances and gaps contain the noise of the sensors. If the conditions state slip or contact, they decide.

        Args:
            creep: (N,) recent sliding distances, m.
            gap: (N,) distances of the fingertips from the surface, m.
            conditions: of the contacts in this step; None for as modelled.
        """
        slipping = None if conditions is None else conditions.slipping
        touching = None if conditions is None else conditions.touching
        slips = creep > self._creep_limit if slipping is None else slipping
        is_lost = gap > self._contact_tolerance if touching is None else ~touching
        found = []
        for i, name in enumerate(self._grasp.fingers):
            if slips[i]:
                found.append(f"{name} slips: {1e3 * creep[i]:.2f} mm on the object")
            if is_lost[i]:
                found.append(f"{name} has lost contact: {1e3 * gap[i]:.2f} mm from the object")
        return found

    def of_joints(self, q: Array) -> list[str]:
        """Return a warning for each joint of the fingers at its position limit.

        Args:
            q: (n,) joint positions, rad.
        """
        hand = self._grasp.hand
        at_limit = [j for j in self._joints if not hand.q_lower[j] < q[j] < hand.q_upper[j]]
        return [f"{hand.joints[j].name} is at its position limit: {q[j]:.3f} rad" for j in at_limit]


def uncontrollable_warning(error: Array) -> list[str]:
    """Return a warning if the uncontrollable part of the pose error is large.

    Args:
        error: (6,) uncontrollable part, m and rad.
    """
    distance, angle = math.hypot(*error[:3]), math.hypot(*error[3:])  # m and rad
    if distance <= _DISTANCE and angle <= _ANGLE:
        return []
    remaining = f"{1e3 * distance:.2f} mm and {math.degrees(angle):.2f}° remain"
    return [f"the fingers cannot make all of this motion without slipping: {remaining}"]

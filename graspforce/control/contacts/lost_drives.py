"""Fingers whose drives are off: redistribution to the other fingers, or a safe stop.

A finger without drive applies no planned force, and its motors no torque. Its contact constrains neither the object nor the
other joints: a limp finger falls through postures in which its fingertip could not follow the object. The rule for each period:

1. If certified forces of the other fingers supply the wrench of the desired motion, they are used, with the largest margin.
2. Otherwise the object is to stop: feedback holds the position at which the stop began and damps the rotation, whose error may
   be beyond what the other fingers can correct. If certified forces of the other fingers supply that wrench, they are used.
3. Otherwise no forces hold the object. The other fingers press with the forces whose wrench is nearest to that of the stop,
   with the slip margin if this leaves the wrench as near as without, and the command warns. Forces of the last period would be
   out of balance without the lost finger and push the object away.

The integral of the pose error stays constant in a stop. The desired motion is tried again in each period.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.control.contacts.contact_conditions import Mask
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp


@dataclass(frozen=True, eq=False, slots=True)
class LostDrives:
    """Contacts and motors of fingers whose drives are off.

    Attributes:
        fingers: their names.
        contacts: (N,) mask of their contacts.
        motors: (n,) mask of their motors. A motor that also moves another finger, such as a wrist's, is not lost.
    """

    fingers: tuple[str, ...]
    contacts: Mask
    motors: Mask

    @classmethod
    def of(cls, grasp: Grasp, fingers: tuple[str, ...]) -> LostDrives:
        """Return the contacts and motors of fingers.

        Args:
            grasp: hand, object and contacts.
            fingers: names of fingers of the grasp.
        """
        motors = np.zeros(grasp.hand.n, dtype=np.bool_)
        for each in sorted(grasp.hand.fingers, key=lambda finger: finger.name not in fingers):  # lost fingers first
            motors[list(each.joints)] = each.name in fingers
        return cls(fingers, np.array([name in fingers for name in grasp.fingers]), motors)

    def without_torques(self, tau: Array) -> Array:
        """Return motor torques with those of the lost motors zero, (n,), N·m.

        Args:
            tau: (n,) motor torques, N·m.
        """
        return np.where(self.motors, 0.0, tau)

    def message(self, is_moving: bool, is_held: bool) -> str:
        """Return the warning of a step.

        Args:
            is_moving: whether certified forces make the desired motion.
            is_held: whether certified forces hold the object.
        """
        outcome = "no forces of the other fingers hold the object: safe stop with the nearest wrench"
        if is_held:
            outcome = "the other fingers hold the object" if is_moving else "the other fingers stop the object"
        drives = "has lost its drive" if len(self.fingers) == 1 else "have lost their drives"
        return f"{', '.join(self.fingers)} {drives}: {outcome}"

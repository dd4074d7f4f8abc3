"""What the closed loop needs of a plant: `PlantInterface`, and the record of its true contacts.

Several plants implement it, with different engines and models. No controller reads `TrueContacts`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from graspforce.control.state import GraspState
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp


@dataclass(frozen=True, slots=True)
class LinkCollision:
    """A contact of a link or the palm with the object, the floor or another link.

    Attributes:
        first: name of the first URDF link.
        second: name of the second URDF link; "object" and "floor" for these.
        force: normal force, N.
    """

    first: str
    second: str
    force: float


@dataclass(frozen=True, eq=False, slots=True)
class TrueContacts:
    """Contacts of the plant in one step, a row for each finger of the grasp.

    Fingers without contact have zero forces and their last contact point and frame.

    Attributes:
        t: begin of the step, s.
        touching: (N,) whether the fingertip touches.
        f: (N, 4) forces of the fingers on the object, (f_t1, f_t2, f_n, m_n) in the contact frames, N and N·m.
        p_OC: (N, 3) contact points in O, m.
        R_OC: (N, 3, 3) contact frames in O; tangents as in `Contact`, third axis into the object.
        mu: (N,) coefficients of friction in this step.
        gamma: (N,) torsional friction lengths in this step, m.
        depth: (N,) penetration of the surfaces, m.
        tau: (n,) torques at the joints, N·m.
        collisions: contacts of links and palm, fingertips on the object excepted.
    """

    t: float
    touching: npt.NDArray[np.bool_]
    f: Array
    p_OC: Array
    R_OC: Array
    mu: Array
    gamma: Array
    depth: Array
    tau: Array
    collisions: tuple[LinkCollision, ...] = ()


class PlantInterface(Protocol):
    """A hand and an object in motion: motor torques in, true state and true contact forces out."""

    @property
    def grasp(self) -> Grasp:
        """The grasp in which the plant starts."""
        ...  # pragma: no cover

    @property
    def dt(self) -> float:
        """Length of a step, s."""
        ...  # pragma: no cover

    @property
    def t(self) -> float:
        """Time since the reset, s."""
        ...  # pragma: no cover

    def reset(self, f: npt.ArrayLike | None = None) -> GraspState:
        """Return to the grasp, at rest, with contacts that carry forces, and return the true state.

        Args:
            f: (k,) stacked contact forces, N and N·m. Default: the plant's own choice.
        """
        ...  # pragma: no cover

    def step(self, tau: npt.ArrayLike) -> GraspState:
        """Advance by dt under a torque command, and return the true state at the end of the step.

        Args:
            tau: (n,) commanded torques, N·m.
        """
        ...  # pragma: no cover

    def state(self) -> GraspState:
        """Return the true state."""
        ...  # pragma: no cover

    def true_contacts(self) -> TrueContacts:
        """Return the contacts of the last step."""
        ...  # pragma: no cover

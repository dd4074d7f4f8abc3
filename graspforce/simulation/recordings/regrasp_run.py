"""The recording of an executed regrasp plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.regrasp import RegraspPhase


@dataclass(frozen=True, eq=False, slots=True)
class RegraspRun:
    """The recording of a run.

    Attributes:
        t: (M,) times of the steps, s.
        phase: (M,) phase of each step.
        error: (M, 6) desired minus true pose of the object in H, m and rad.
        planned_margin: (M,) least slip margin of the planned forces among contacts that do not let go or join, N.
        true_margin: (M,) least slip margin of the plant's touching contacts, N; infinite without contact.
        is_certified: (M,) whether the forces of the step have a certificate.
        tau: (M, n) motor torques, N·m.
        final_error: (6,) goal minus true pose of the object at the end, m and rad.
        outcome: phase at the end; a dropped object has another one than DONE.
        collisions: names of two bodies that touched and should not; empty if there were none.
    """

    t: Array
    phase: tuple[RegraspPhase, ...]
    error: Array
    planned_margin: Array
    true_margin: Array
    is_certified: Array
    tau: Array
    final_error: Array
    outcome: RegraspPhase
    collisions: tuple[tuple[str, str], ...]

    @property
    def is_complete(self) -> bool:
        """Whether the plan was executed to its end."""
        return self.outcome is RegraspPhase.DONE

    @property
    def uncertified_count(self) -> int:
        """Number of steps whose forces have no certificate."""
        return len(self.is_certified) - int(np.count_nonzero(self.is_certified))

    @property
    def largest_torque_step(self) -> float:
        """Largest change of a motor torque from one step to the next, N·m."""
        return float(np.abs(np.diff(self.tau, axis=0)).max())

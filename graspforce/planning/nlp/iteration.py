"""The progress of a solver."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class OptimiserIteration:
    """One iteration of a solver.

    Args:
        number: from 0.
        objective: the duration relative to the guess's, approximately.
        seconds: since the solver started.
    """

    number: int
    objective: float
    seconds: float

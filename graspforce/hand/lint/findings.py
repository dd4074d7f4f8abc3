"""A fault of a hand model, as the checks report it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

GIVE_INERTIA = "give the inertia of its shape at uniform density, in the URDF or under inertias in the description"
"""Remedy of a wrong inertia."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault of a hand model.

    Attributes:
        severity: "error" if results are wrong or the hand cannot be loaded, "warning" if results may be wrong,
            "note" for a fact to know.
        location: the link, joint or joints.
        problem: the fault, with its numbers.
        consequence: its effect on results.
        remedy: how to correct it.
    """

    severity: Literal["error", "warning", "note"]
    location: str
    problem: str
    consequence: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.location}: {self.problem}. Consequence: {self.consequence}. Remedy: {self.remedy}."

"""The options of ``graspforce simulate`` that describe the simulation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from graspforce.cli.options import GraspOptions
from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.simulation.plants.scene import TIP_GEOMETRIES

REFERENCES = ("still", "reach", "sine", "turn")


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """The simulation that the command's options describe.

    Args:
        grasp: hand, object and grasp search.
        reference: still, reach, sine or turn.
        travel: end to end, (x, y, z) in H, m; for turn the rotation vector, rad. None for `default_travel`.
        period: of the motion, s.
        duration: of the simulation, s.
        pushes: (fx, fy, fz, start, duration): force in H, N, and times, s.
        tips: fingertips of the plant: "ball" as in the controller, or "mesh" as in the hand's URDF.
        meshes: directories to search for mesh files.
        turn: rotation vector in H, rad, of an additional rotation out and back; zero for none.
        turn_period: of that rotation, s; None for `period`.

    Raises:
        InvalidInput: names the field and the allowed values.
    """

    grasp: GraspOptions
    reference: str
    travel: tuple[float, ...] | None
    period: float
    duration: float
    pushes: tuple[tuple[float, ...], ...]
    tips: str = "ball"
    meshes: tuple[Path, ...] = ()
    turn: tuple[float, ...] = (0.0, 0.0, 0.0)
    turn_period: float | None = None

    def __post_init__(self) -> None:
        fields.check_choice(self.reference, "reference", REFERENCES)
        fields.check_choice(self.tips, "tips", TIP_GEOMETRIES)
        arrays.check_number(self.period, "period", above=0.0)
        arrays.check_number(self.duration, "duration", above=0.0)
        turn = arrays.check_array(self.turn, "turn", (3,))
        if self.turn_period is not None:
            arrays.check_number(self.turn_period, "turn-period", above=0.0)
        if self.travel is not None and not arrays.check_array(self.travel, "travel", (3,)).any() and self.reference == "turn":
            raise InvalidInput("travel", self.travel, "a rotation vector that is not zero")
        if self.reference == "turn" and turn.any():
            raise InvalidInput("turn", self.turn, "zero with --reference turn, whose rotation is --travel")

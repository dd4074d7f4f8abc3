"""Settings of the MuJoCo engine.

The settings make contacts stiff enough that a grasped object does not creep within a minute. They are explained in MuJoCo's
documentation, chapters "Computation" (constraint model, solref, solimp, noslip) and "Modeling". Measured effects:
benchmarks/closed_loop.py.
"""

from __future__ import annotations

from dataclasses import dataclass

from graspforce.core import arrays, fields
from graspforce.core.records import set_fields


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """Settings of the MuJoCo engine.

    Args:
        dt: time step, s: one control period at 1 kHz. A contact's time constant needs at least two steps.
        impratio: impedance of friction over that of the normal force. MuJoCo's friction is a stiff damper, so a held object
            creeps at a rate that falls as 1/impratio.
        noslip: iterations of the pass after the solver that removes the remaining creep.
        solref: time constant, s, and damping ratio of contacts. Two time steps are the stable minimum; the penetration grows
            with the square of the time constant.
        solimp: impedance of contacts at zero and at full depth, 0 to 1, and the full depth, m. Values closer to 1 give less
            penetration and worse conditioning; these give about 20 µm per newton.
        coupling_solref: time constant, s, and damping ratio of the couplings between joints.
        coupling_solimp: impedances and depth of the couplings. Couplings carry no impact, so they are as stiff as the time
            step allows.
        solid_links: whether links and palm collide with one another, the object and the floor.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    dt: float = 1e-3
    impratio: float = 10_000.0
    noslip: int = 20
    solref: tuple[float, float] = (0.004, 1.0)
    solimp: tuple[float, float, float] = (0.95, 0.99, 0.001)
    coupling_solref: tuple[float, float] = (0.002, 1.0)
    coupling_solimp: tuple[float, float, float] = (0.9999, 0.9999, 0.001)
    solid_links: bool = True

    def __post_init__(self) -> None:
        set_fields(
            self,
            dt=arrays.check_number(self.dt, "dt", above=0.0),
            impratio=arrays.check_number(self.impratio, "impratio", above=0.0),
            solid_links=fields.check_boolean(self.solid_links, "solid_links"),
            noslip=fields.check_integer(self.noslip, "noslip", minimum=0, maximum=10_000),
        )

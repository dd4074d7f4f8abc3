"""What the compiled binding offers; structured.h and certify.h say what each array holds."""

import numpy as np
import numpy.typing as npt

_Integers = npt.NDArray[np.intc]
_Numbers = npt.NDArray[np.float64]

class Kernel:
    def __init__(
        self,
        components: _Integers,
        contact_block: _Integers,
        joint_block: _Integers,
        facet_contact: _Integers,
        G: _Numbers,
        w: _Numbers,
        mu: _Numbers,
        gamma: _Numbers,
        min_normal: _Numbers,
        max_normal: _Numbers,
        J: _Numbers,
        tau_u: _Numbers,
        lower: _Numbers,
        upper: _Numbers,
        weight: _Numbers,
        facet: _Numbers,
        cost: _Numbers,
        force_weight: _Numbers,
        units: _Numbers,
        answer: _Numbers,
        report: _Numbers,
    ) -> None: ...
    def solve(self, first: int, last: int, tolerance: float, max_iterations: int, warm: bool, /) -> int: ...
    def step(
        self, tolerance: float, max_iterations: int, warm: bool, /
    ) -> tuple[int, int, tuple[float, float, float] | None]: ...
    def certify(self, first: int, last: int, /) -> None: ...

"""What the compiled binding offers; structured.h, grasp.h and certify.h say what each array holds."""

from typing import Any

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
        p: _Numbers | None,
        R: _Numbers | None,
        G: _Numbers | None,
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
        cost: _Numbers | None,
        force_weight: _Numbers,
        units: _Numbers,
        answer: _Numbers,
        report: _Numbers,
    ) -> None: ...
    def solve(self, first: int, last: int, tolerance: float, max_iterations: int, warm: bool, /) -> int: ...
    def certify(self, first: int, last: int, /) -> None: ...

class IncrementalKernel:
    def __init__(
        self,
        max_block_size: int,
        columns: npt.NDArray[np.intp],
        facet_contact: _Integers | None,
        w: _Numbers,
        J: _Numbers | None,
        tau_u: _Numbers | None,
        p: _Numbers,
        R: _Numbers,
        mu: _Numbers,
        gamma: _Numbers,
        min_normal: _Numbers,
        max_normal: _Numbers,
        lower: _Numbers | None,
        upper: _Numbers | None,
        weight: _Numbers | None,
        facet: _Numbers | None,
        cost: _Numbers | None,
        force_weight: float,
        /,
    ) -> None: ...
    def step(
        self, tolerance: float, max_iterations: int, warm: bool, w: Any, J: Any, tau_u: Any, p: Any, R: Any, /
    ) -> tuple[int, int, tuple[float, float, float] | None, bytes, int] | None: ...
    def load(self, *numbers: Any) -> bool: ...
    def spans(self) -> bytes: ...

def make_record(kind: type[Any], names: tuple[str, ...], /, *values: Any) -> Any: ...
def find_fingers(components: _Integers, J: _Numbers, contact_block: _Integers, joint_block: _Integers, /) -> int: ...

"""Types of the compiled kernel. The C headers in graspforce/csrc/include/graspforce describe the arrays."""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

_Integers = npt.NDArray[np.intc]
_Numbers = npt.NDArray[np.float64]
_Record = TypeVar("_Record")

__version__: str
report_fields: tuple[tuple[str, str], ...]

class Residuals(NamedTuple):
    primal: float
    dual: float
    gap: float

class StepResult(NamedTuple):
    status: int
    iterations: int
    residuals: Residuals | None
    numbers: bytes
    changed: int

class Kernel:
    def __init__(
        self,
        *,
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
        force_unit: _Numbers,
        length_unit: _Numbers,
        cost_unit: _Numbers,
        torque_unit: _Numbers,
        f: _Numbers,
        y: _Numbers,
        z: _Numbers,
        nu_lower: _Numbers,
        nu_upper: _Numbers,
        lambda_lower: _Numbers,
        lambda_upper: _Numbers,
        tau: _Numbers,
        report: npt.NDArray[np.void],
        level: int = 0,
        moment_length: float = 1.0,
    ) -> None: ...
    def solve(self, first: int, last: int, tolerance: float, max_iterations: int, warm: bool, /) -> int: ...
    def certify(self, first: int, last: int, /) -> None: ...

class IncrementalKernel:
    def __init__(
        self,
        max_block_size: int,
        columns: npt.NDArray[np.intp],
        facet_contact: _Integers | None,
        level: int,
        w: _Numbers,
        J: _Numbers | None,
        tau_u: _Numbers | None,
        p: _Numbers,
        R: _Numbers,
        mu: _Numbers,
        min_normal: _Numbers,
        max_normal: _Numbers,
        gamma: _Numbers,
        lower: _Numbers | None,
        upper: _Numbers | None,
        weight: _Numbers | None,
        facet: _Numbers | None,
        cost: _Numbers | None,
        force_weight: float,
        moment_length: float,
        /,
    ) -> None: ...
    def step(
        self,
        tolerance: float,
        max_iterations: int,
        warm: bool,
        /,
        *changes: object,
    ) -> StepResult | None: ...
    def load(self, *numbers: object) -> bool: ...
    def limit_time(self, seconds: float, /) -> None: ...
    def limit_short_steps(self, steps: int, /) -> None: ...
    def short_step_bound(self, reduction: float, /) -> int: ...
    def spans(self) -> bytes: ...
    def solution_layout(self) -> dict[str, tuple[int, int]]: ...

def make_record(kind: type[_Record], names: Sequence[str], /, *values: Any) -> _Record: ...
def find_fingers(components: _Integers, J: _Numbers, contact_block: _Integers, joint_block: _Integers, /) -> int: ...

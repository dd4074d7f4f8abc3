"""Runs of the compiled kernel on cases, with outputs as arrays or as one record."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from graspforce.core.arrays import Array
from graspforce.force.backends._structured import Kernel, report_fields
from support.kernel_cases import KernelCase

OPTIMAL, INACCURATE, INFEASIBLE, FAILED = range(4)
CERTIFIED = ("certified_primal", "certified_dual", "certified_gap")
_REPORT = np.dtype(list(report_fields))
_INPUTS = tuple(field.name for field in fields(KernelCase) if field.name != "units")


@dataclass(frozen=True)
class KernelAnswer:
    """Outputs of the kernel for one problem. tau comes from certify()."""

    status: int
    iterations: int
    f: Array
    y: Array
    z: Array
    nu_lower: Array
    nu_upper: Array
    lambda_lower: Array
    lambda_upper: Array
    tau: Array


def make_outputs(case: KernelCase, count: int = 1) -> dict[str, Any]:
    """Return empty output arrays for `count` problems."""
    N, n = case.sizes
    sizes = {"f": case.k, "y": 6, "z": case.k, "nu_lower": N, "nu_upper": N, "lambda_lower": n, "lambda_upper": n, "tau": n}
    outputs: dict[str, Any] = {name: np.zeros((count, size)) for name, size in sizes.items()}
    return {**outputs, "report": np.zeros(count, dtype=_REPORT)}


def bind_kernel(case: KernelCase, count: int = 1, **arrays: Any) -> tuple[Kernel, dict[str, Any]]:
    """Return a kernel bound to a case, and its arrays by name. `arrays` replace those of the case, or outputs."""
    n = case.sizes[1]
    units = {"force_unit": np.ones(1), "length_unit": np.ones(1), "cost_unit": np.ones(1), "torque_unit": np.ones(n)}
    bound = {name: getattr(case, name) for name in _INPUTS}
    bound = {**bound, **units, **case.units, **make_outputs(case, count), **arrays}
    bound = {name: np.ascontiguousarray(value) for name, value in bound.items()}
    return Kernel(p=None, R=None, **bound), bound


def unpack_answer(outputs: dict[str, Any], i: int = 0) -> KernelAnswer:
    """Return the outputs of problem i as a record of copies."""
    report = outputs["report"][i]
    parts = {field.name: outputs[field.name][i].copy() for field in fields(KernelAnswer)[2:]}
    return KernelAnswer(int(report["status"]), int(report["iterations"]), **parts)


def certified_residuals(outputs: dict[str, Any], i: int = 0) -> Array:
    """Return primal residual, dual residual and gap of problem i, as certify() measured them."""
    return np.array([outputs["report"][name][i] for name in CERTIFIED])


def solve(case: KernelCase, tolerance: float = 1e-9, max_iterations: int = 60) -> KernelAnswer:
    """Solve one case from a cold start."""
    kernel, outputs = bind_kernel(case)
    kernel.solve(0, 1, tolerance, max_iterations, False)
    return unpack_answer(outputs)

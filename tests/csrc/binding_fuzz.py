"""Call the compiled binding with valid and invalid arrays, for a build under sanitizers: `binding_fuzz.py MODULE COUNT`.

Print the numbers of accepted steps, rejected steps and raised errors. Any other result ends the program with an error. Only the
module file and NumPy are imported.
"""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType
from typing import Any

import numpy as np

SPECIAL = [0.0, -0.0, 1e300, -1e300, 1e-300, 5e-324, 1e20, -1.0, np.inf, -np.inf, np.nan, 1e154]
COLUMNS = {1: (2,), 3: (0, 1, 2), 4: (0, 1, 2, 3)}
CHANGEABLE = ("w", "J", "tau_u", "p", "R", "mu", "min_normal", "max_normal", "gamma")
ARGUMENT_ERRORS = (ValueError, TypeError, BufferError)
ACCEPTED, REJECTED, RAISED = range(3)


def load_module(path: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location("_structured", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["_structured"] = module
    spec.loader.exec_module(module)
    return module


def maybe_invalid(rng: np.random.Generator, array: Any, rate: float) -> Any:
    """Return the array or, with probability `rate`, one of another size, shape or type, or with a special number."""
    if not isinstance(array, np.ndarray) or rng.random() >= rate:
        return array
    if array.dtype.names:  # a report
        return [array[:0], np.zeros(1), None, np.zeros(3, array.dtype)][rng.integers(4)]
    invalid = [array.ravel()[: max(array.size - 1, 0)], np.append(array, 0), array.astype(np.float32), array.tolist()]
    invalid += [None, b"x", array[..., ::2], np.zeros(0), array.astype(">f8"), np.asfortranarray(array), object()]
    special = array.copy()
    if special.size:
        number = rng.choice(SPECIAL) if array.dtype == np.float64 else rng.integers(-2, 8)
        special.flat[rng.integers(special.size)] = number
    return [*invalid, special, special, special, special][rng.integers(len(invalid) + 4)]


def random_changes(rng: np.random.Generator, N: int, k: int, n: int) -> dict[str, np.ndarray]:
    """Return valid numbers of the arrays that a step may change."""
    R = np.linalg.qr(rng.normal(size=(N, 3, 3)))[0]
    R[:, :, 0] *= np.linalg.det(R)[:, None]
    return {
        "w": rng.normal(size=6),
        "J": 0.05 * rng.normal(size=(k, n)) * (rng.random((k, n)) < 0.6),
        "tau_u": 0.02 * rng.normal(size=n),
        "p": 0.05 * rng.normal(size=(N, 3)),
        "R": R,
        "mu": rng.uniform(0, 1, N),
        "min_normal": np.zeros(N),
        "max_normal": np.full(N, rng.choice([50.0, np.inf])),
        "gamma": rng.uniform(0, 0.02, N),
    }


def random_constants(n: int) -> dict[str, np.ndarray]:
    """Return valid numbers of the other arrays."""
    return {"lower": np.full(n, -2.0), "upper": np.full(n, 2.0), "weight": np.ones(n)}


def drive_array_kernel(rng: np.random.Generator, module: ModuleType, inputs: dict[str, Any], rate: float) -> int:
    """Bind, solve and certify, at first with arrays that may be invalid. Return how often an error was raised."""
    N, n, k = len(inputs["mu"]), len(inputs["tau_u"]), len(inputs["J"])
    sizes = {"force_unit": 1, "length_unit": 1, "cost_unit": 1, "torque_unit": n, "f": k, "y": 6, "z": k}
    sizes |= {"nu_lower": N, "nu_upper": N, "lambda_lower": n, "lambda_upper": n, "tau": n}
    valid = {**inputs, **{name: np.zeros(size) for name, size in sizes.items()}}
    valid |= {"G": None, "facet": np.zeros((0, 4)), "cost": None, "force_weight": np.array([rng.choice([0, 1.0])])}
    valid |= {"facet_contact": np.zeros(0, dtype=np.intc), "report": np.zeros(1, np.dtype(list(module.report_fields)))}
    raised = 0
    kernel = module.Kernel.__new__(module.Kernel)
    for arrays in ({name: maybe_invalid(rng, array, rate / 5) for name, array in valid.items()}, valid):
        try:
            kernel.__init__(**arrays)  # type: ignore[misc]
            break
        except (*ARGUMENT_ERRORS, RuntimeError):
            raised += 1
            try:
                kernel.certify(0, 1)
            except (ValueError, RuntimeError):
                kernel = module.Kernel.__new__(module.Kernel)
    try:
        kernel.solve(0, 1, 1e-9, 60, False)
        kernel.certify(0, 1)
    except ValueError:  # pyramids
        raised += 1
    return raised


def drive_incremental_kernel(
    rng: np.random.Generator, module: ModuleType, inputs: dict[str, Any], rate: float, counts: list[int]
) -> None:
    """Step and load, at first with arrays that may be invalid; count the results."""
    N, n, k = len(inputs["mu"]), len(inputs["tau_u"]), len(inputs["J"])
    columns = np.array([4 * i + c for i, m in enumerate(inputs["components"]) for c in COLUMNS[int(m)]], dtype=np.intp)
    constants = ("lower", "upper", "weight")
    problem = [*(inputs[name] for name in (*CHANGEABLE, *constants)), None, None, float(rng.choice([0, 1.0])), 0.1]
    level = int(rng.integers(3))

    def maybe_problem() -> list[Any]:
        return [maybe_invalid(rng, array, rate / 5) for array in problem]

    try:
        kernel = module.IncrementalKernel(30, maybe_invalid(rng, columns, rate / 5), None, level, *maybe_problem())
    except (*ARGUMENT_ERRORS, OverflowError):
        counts[RAISED] += 1
        kernel = module.IncrementalKernel(30, columns, None, level, *problem)
    for _ in range(4):
        new = random_changes(rng, N, k, n)
        new["J"] *= inputs["J"] != 0 if rng.random() < 0.7 else 1.0
        changes = [maybe_invalid(rng, new[name], rate) if rng.random() < 0.7 else None for name in CHANGEABLE]
        result = kernel.step(1e-9, 60, bool(rng.integers(2)), *changes)
        counts[REJECTED if result is None else ACCEPTED] += 1
        if result is not None:
            check_result(kernel, result, new)
        try:
            if not kernel.load(*maybe_problem()):
                counts[REJECTED] += 1
        except ARGUMENT_ERRORS:
            counts[RAISED] += 1
            try:
                kernel.step(1e-9, 60, True, *[None] * len(CHANGEABLE))
                raise AssertionError("a kernel without a problem made a step")
            except RuntimeError:
                assert kernel.load(*problem)


def check_result(kernel: Any, result: Any, new: dict[str, np.ndarray]) -> None:
    """Check status and length of the result of a step."""
    assert result.status in range(4)
    spans = np.frombuffer(kernel.spans(), dtype=np.intc).reshape(-1, 2)
    size = {**{name: array.size for name, array in new.items()}, "J": int(np.diff(spans).sum())}
    changed = sum(size[name] for bit, name in enumerate(CHANGEABLE) if result.changed >> bit & 1)
    assert len(result.numbers) == 8 * (kernel.solution_layout()["tau"][1] + changed)


def run_one(rng: np.random.Generator, module: ModuleType, counts: list[int]) -> None:
    N, n = int(rng.integers(1, 7)), int(rng.integers(0, 8))
    components = rng.choice([1, 3, 4], size=N).astype(np.intc)
    changes = random_changes(rng, N, int(components.sum()), n)
    rate = float(rng.choice([0.0, 0.0, 0.02, 0.2]))
    blocks = {"contact_block": np.zeros(N, dtype=np.intc), "joint_block": np.zeros(n, dtype=np.intc)}
    try:
        module.find_fingers(components, maybe_invalid(rng, changes["J"], rate), *blocks.values())
    except ARGUMENT_ERRORS:
        counts[RAISED] += 1
        module.find_fingers(components, changes["J"], *blocks.values())
    inputs = {"components": components, **blocks, **changes, **random_constants(n)}
    counts[RAISED] += drive_array_kernel(rng, module, inputs, rate)
    drive_incremental_kernel(rng, module, inputs, rate, counts)


def main() -> None:
    module, rng, counts = load_module(sys.argv[1]), np.random.default_rng(7), [0, 0, 0]
    for _ in range(int(sys.argv[2])):
        run_one(rng, module, counts)
    print(*counts)


if __name__ == "__main__":
    main()

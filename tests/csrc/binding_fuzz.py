"""Drives the compiled binding with right and wrong arrays, for a build under sanitizers: `binding_fuzz.py MODULE COUNT`.

Prints how many steps were taken, how many were refused, and how many calls raised; ends with an error where something else
comes out. It imports the module from its file and NumPy, nothing else.
"""

from __future__ import annotations

import importlib.util
import sys

import numpy as np

ODD = [0.0, -0.0, 1e300, -1e300, 1e-300, 5e-324, 1e20, -1.0, np.inf, -np.inf, np.nan, 1e154]


def module(path: str):
    spec = importlib.util.spec_from_file_location("_structured", path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def perhaps_wrong(rng: np.random.Generator, array: np.ndarray, rate: float) -> object:
    """The array; at times of another length, shape or type, or with an odd number in it."""
    if rng.random() >= rate:
        return array
    wrong = [
        array.ravel()[: max(array.size - 1, 0)],
        np.append(array, 0.0),
        array.astype(np.float32),
        array.tolist(),
        None,
        b"x",
    ]
    wrong += [array[..., ::2], np.zeros(0), array.astype(">f8"), np.asfortranarray(array), object()]
    odd = array.copy()
    if odd.size:
        odd.flat[rng.integers(odd.size)] = rng.choice(ODD)
    return [*wrong, odd, odd, odd, odd][rng.integers(len(wrong) + 4)]


def numbers(rng: np.random.Generator, N: int, k: int, n: int) -> dict[str, np.ndarray]:
    R = np.linalg.qr(rng.normal(size=(N, 3, 3)))[0]
    R[:, :, 0] *= np.linalg.det(R)[:, None]
    return {
        "w": rng.normal(size=6),
        "J": 0.05 * rng.normal(size=(k, n)) * (rng.random((k, n)) < 0.6),
        "tau_u": 0.02 * rng.normal(size=n),
        "p": 0.05 * rng.normal(size=(N, 3)),
        "R": R,
    }


def one(rng: np.random.Generator, built, counts: list[int]) -> None:
    N, n = int(rng.integers(1, 7)), int(rng.integers(0, 8))
    components = rng.choice([1, 3, 4], size=N).astype(np.intc)
    k = int(components.sum())
    x = numbers(rng, N, k, n)
    rate = float(rng.choice([0.0, 0.0, 0.02, 0.2]))
    blocks = np.zeros(N, dtype=np.intc), np.zeros(n, dtype=np.intc)
    try:
        built.find_fingers(components, perhaps_wrong(rng, x["J"], rate), *blocks)
    except (ValueError, TypeError, BufferError):
        counts[2] += 1
        built.find_fingers(components, x["J"], *blocks)
    inputs = [
        x["p"],
        x["R"],
        None,
        x["w"],
        rng.uniform(0, 1, N),
        rng.uniform(0, 0.02, N),
        np.zeros(N),
        np.full(N, 50.0),
        x["J"],
    ]
    inputs += [
        x["tau_u"],
        np.full(n, -2.0),
        np.full(n, 2.0),
        np.ones(n),
        np.zeros((0, 4)),
        None,
        np.array([rng.choice([0, 1.0])]),
    ]
    width = 2 * k + 6 + 2 * N + 3 * n
    outputs = [np.zeros(3 + n), np.zeros(width), np.zeros(8)]
    given = [array if array is None else perhaps_wrong(rng, array, rate / 5) for array in inputs]
    kernel = built.Kernel.__new__(built.Kernel)
    for arrays in (given, inputs):
        try:
            kernel.__init__(components, *blocks, np.zeros(0, dtype=np.intc), *arrays, *outputs)
            break
        except (ValueError, TypeError, BufferError, RuntimeError):
            counts[2] += 1
            try:
                kernel.certify(0, 1)
            except (ValueError, RuntimeError):
                kernel = built.Kernel.__new__(built.Kernel)
    kernel.solve(0, 1, 1e-9, 60, False)
    kernel.certify(0, 1)
    follow(rng, built, counts, x, (N, k, n, width), rate, columns_of(components))


def columns_of(components: np.ndarray) -> np.ndarray:
    within = {1: (2,), 3: (0, 1, 2), 4: (0, 1, 2, 3)}
    return np.array([4 * i + c for i, count in enumerate(components) for c in within[int(count)]], dtype=np.intp)


def follow(rng: np.random.Generator, built, counts: list[int], x, sizes: tuple[int, ...], rate: float, columns) -> None:
    N, k, n, width = sizes
    problem = [x["w"], x["J"], x["tau_u"], x["p"], x["R"], rng.uniform(0, 1, N), rng.uniform(0, 0.02, N), np.zeros(N)]
    problem += [np.full(N, 50.0), np.full(n, -2.0), np.full(n, 2.0), np.ones(n), None, None, float(rng.choice([0, 1.0]))]

    def perhaps() -> list[object]:
        return [perhaps_wrong(rng, array, rate / 5) if isinstance(array, np.ndarray) else array for array in problem]

    try:
        follower = built.IncrementalKernel(30, perhaps_wrong(rng, columns, rate / 5), None, *perhaps())
    except (ValueError, TypeError, BufferError, OverflowError):
        counts[2] += 1
        follower = built.IncrementalKernel(30, columns, None, *problem)
    for _ in range(4):
        fresh = numbers(rng, N, k, n)
        fresh["J"] *= x["J"] != 0 if rng.random() < 0.7 else 1.0
        changes = [
            perhaps_wrong(rng, fresh[name], rate) if rng.random() < 0.7 else None for name in ("w", "J", "tau_u", "p", "R")
        ]
        taken = follower.step(1e-9, 60, bool(rng.integers(2)), *changes)
        counts[taken is None] += 1
        if taken is not None:
            assert taken[0] in range(4)
            spans = np.frombuffer(follower.spans(), dtype=np.intc).reshape(-1, 2)
            size = {**{name: array.size for name, array in fresh.items()}, "J": int(np.diff(spans).sum())}
            assert len(taken[3]) == 8 * (width + sum(size[name] for bit, name in enumerate(fresh) if taken[4] >> bit & 1))
        try:
            if not follower.load(*perhaps()):
                counts[1] += 1
        except (ValueError, TypeError, BufferError):
            counts[2] += 1
            try:
                follower.step(1e-9, 60, True, *[None] * 5)
                raise AssertionError("a follower without a problem took a step")
            except RuntimeError:
                assert follower.load(*problem)


def main() -> None:
    built, rng, counts = module(sys.argv[1]), np.random.default_rng(7), [0, 0, 0]
    for _ in range(int(sys.argv[2])):
        one(rng, built, counts)
    print(*counts)


if __name__ == "__main__":
    main()

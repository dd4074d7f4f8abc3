"""Force problems of multi-finger hands with proven answers, as cone programs. Needs NumPy only.

>>> import graspforce_problems as gp
>>> case = gp.load("ring/3-force")
>>> abs(case.scale * case.value(case.x) + case.offset - case.objective) < case.tolerance and case.residual() < 1e-6
True

    minimise   ½ xᵀ P x + qᵀ x
    subject to A x = b,   C x ≤ d,   r − S x in second-order cones {(t, v): ‖v‖ ≤ t}, one after another

    optimum    P x + q = Aᵀ y − Cᵀ z − Sᵀ u,   z ≥ 0,   u in the cones,   cost of the forces = scale · value + offset
    ray        Aᵀ y = Cᵀ z + Sᵀ u,             z ≥ 0,   u in the cones,   bᵀ y − dᵀ z − rᵀ u = 1
"""

from __future__ import annotations

import hashlib
import json
import lzma
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).parent / "data"  # cases.parquet, json/*.jsonl.xz, cbf.tar.xz, qps.tar.xz, batches, manifest.json


@dataclass(frozen=True, eq=False)
class Program:
    """A program and its proven answer; the module states the equations.

    Args:
        name: name of the case.
        tags: tags of the case.
        feasible: whether the program is feasible.
        P, q: Hessian and gradient of the cost.
        A, b, C, d: equations and inequalities.
        S, r, cones: rows, constants and dimensions of the second-order cones.
        scale, offset: cost of the forces = scale · value + offset.
        objective: proven cost of the forces; None if infeasible.
        tolerance: relative accuracy of ``objective``.
        x: optimal variables; None if infeasible.
        y, z, u: optimal multipliers, or a ray that proves infeasibility.
        problem: the force problem: contacts, wrench, actuation and objective in SI units.
    """

    name: str
    tags: tuple[str, ...]
    feasible: bool
    P: np.ndarray
    q: np.ndarray
    A: np.ndarray
    b: np.ndarray
    C: np.ndarray
    d: np.ndarray
    S: np.ndarray
    r: np.ndarray
    cones: tuple[int, ...]
    scale: float
    offset: float
    objective: float | None
    tolerance: float
    x: np.ndarray | None
    y: np.ndarray
    z: np.ndarray
    u: np.ndarray
    problem: dict[str, Any]

    def value(self, x: np.ndarray) -> float:
        """Return ½ xᵀ P x + qᵀ x."""
        return float(0.5 * x @ self.P @ x + self.q @ x)

    def residual(self) -> float:
        """Return the largest violation of stationarity and constraints by the stored answer."""
        gradient = self.A.T @ self.y - self.C.T @ self.z - self.S.T @ self.u
        parts = [gradient, np.minimum(self.z, 0.0), np.minimum(_cone_margins(self.u, self.cones), 0.0)]
        if self.x is None:
            return float(np.abs(np.concatenate(parts)).max())
        parts[0] = gradient - self.P @ self.x - self.q
        parts += [self.A @ self.x - self.b, np.maximum(self.C @ self.x - self.d, 0.0)]
        parts.append(np.minimum(_cone_margins(self.r - self.S @ self.x, self.cones), 0.0))
        return float(np.abs(np.concatenate(parts)).max())


def _cone_margins(v: np.ndarray, cones: tuple[int, ...]) -> np.ndarray:
    """Return t − ‖w‖ of each cone's part (t, w) of v."""
    heads = np.cumsum([0, *cones])
    return np.array([v[i] - np.linalg.norm(v[i + 1 : j]) for i, j in pairwise(heads)])


def manifest() -> dict[str, Any]:
    """Return version, licence, hashes of the files, and the hash of every case."""
    return dict(json.loads((FOLDER / "manifest.json").read_text(encoding="utf-8")))


def names(collection: str | None = None) -> list[str]:
    """Return the names of all cases, or of one collection."""
    return [name for name in manifest()["cases"] if collection in (None, name.split("/")[0])]


def load(name: str) -> Program:
    """Return a case. Raises `KeyError` for an unknown name."""
    record = json.loads(_lines(name.split("/")[0])[name])
    size = len(record["q"])
    rows = {"P": size, "A": len(record["b"]), "C": len(record["d"]), "S": sum(record["cones"])}
    values: dict[str, Any] = {key: _dense(record[key], (count, size)) for key, count in rows.items()}
    values |= {key: None if record[key] is None else np.array(record[key], float) for key in "qbdrxyzu"}
    values |= {key: record[key] for key in ("name", "scale", "offset", "objective", "tolerance", "problem")}
    return Program(tags=tuple(record["tags"]), feasible=record["status"] == "optimal", cones=tuple(record["cones"]), **values)


@dataclass(frozen=True, eq=False)
class Batch:
    """Programs that differ in b only.

    Args:
        program: the first program, of the case ``batch/<kind>-000``.
        b: (B, e) right sides of the equations.
        objectives: (B,) proven costs of the forces; NaN for infeasible programs.
        rays: parts y, z and u of the ray of each infeasible program, by its index.
    """

    program: Program
    b: np.ndarray
    objectives: np.ndarray
    rays: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]]


def load_batch(kind: str) -> Batch:
    """Return ten thousand programs: "force", "torque", "pyramid" or "limits"."""
    with np.load(FOLDER / "batches" / f"{kind}.npz") as stored:
        b = stored["constant"] + stored["loads"] @ stored["moves"].T
        first, infeasible = load(f"batch/{kind}-000"), stored["infeasible"].tolist()
        y, z, u = np.split(stored["rays"], np.cumsum([len(first.b), len(first.d)]), axis=1)
        return Batch(first, b, stored["objectives"], dict(zip(infeasible, zip(y, z, u, strict=True), strict=True)))


def check_hashes() -> list[str]:
    """Return the names of the cases and files whose SHA-256 differs from the manifest."""
    known = manifest()
    wrong = [
        file for file, digest in known["files"].items() if hashlib.sha256((FOLDER / file).read_bytes()).hexdigest() != digest
    ]
    return wrong + [name for name, digest in known["cases"].items() if _case_hash(name) != digest]


def _case_hash(name: str) -> str:
    return hashlib.sha256(_lines(name.split("/")[0])[name].encode()).hexdigest()


@cache
def _lines(collection: str) -> dict[str, str]:
    """Return the JSON text of each case of a collection."""
    try:
        text = lzma.decompress((FOLDER / "json" / f"{collection}.jsonl.xz").read_bytes()).decode()
    except FileNotFoundError:
        raise KeyError(f"no collection {collection!r}") from None
    return {json.loads(line)["name"]: line for line in text.splitlines()}


def _dense(entries: dict[str, list[Any]], shape: tuple[int, int]) -> np.ndarray:
    matrix = np.zeros(shape)
    matrix[entries["row"], entries["column"]] = entries["value"]
    return matrix

"""The batches of the library in the data package: one program per batch, and for each member its right side and its optimum."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from graspforce.bench.case_program import case_program
from graspforce.problems.batches import Batch, load_batch
from graspforce.problems.generators.batch import KINDS, UNITS


def write_batches(folder: Path) -> None:
    """Write one file per batch, ``<kind>.npz``, with the arrays of `batch_arrays`.

    Args:
        folder: the folder; created if missing.
    """
    folder.mkdir(exist_ok=True)
    for kind in KINDS:
        np.savez_compressed(folder / f"{kind}.npz", **batch_arrays(load_batch(kind)))


def batch_arrays(batch: Batch) -> dict[str, Any]:
    """Return the arrays of a batch.

    The members have the program of the first one, with b = b₀ + M · load. ``proofs`` has the rows of the infeasible members:
    multipliers of equilibrium about O, of least and largest normal forces, and of least and largest torques, in SI units.

    Args:
        batch: the batch.
    """
    program = case_program(batch.problem)
    moves = np.zeros((len(program.b), 6))
    c = batch.problem.contacts.centroid
    about_centroid = np.eye(6)  # moments about the centroid: m − c × f
    about_centroid[3:, :3] = -np.array([[0.0, -c[2], c[1]], [c[2], 0.0, -c[0]], [-c[1], c[0], 0.0]])
    moves[:6] = about_centroid * UNITS / program.wrench_units[:, None]
    loads = np.rint(batch.wrenches / UNITS).astype(np.int16)
    constant = program.b - moves @ loads[0]
    infeasible = np.flatnonzero(np.isnan(batch.objectives)).astype(np.int32)
    values = {"loads": loads, "moves": moves, "constant": constant, "objectives": batch.objectives}
    return {**values, "infeasible": infeasible, "proofs": batch.proofs[infeasible]}

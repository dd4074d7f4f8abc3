"""The batches of the library in the data package: one program per batch, and for each member its right side and its answer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from graspforce.bench.case_program import case_program
from graspforce.bench.export.standard_form import proof_ray
from graspforce.problems.batches import Batch, load_batch
from graspforce.problems.case import ExpectedInfeasibility
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

    The members have the program of the first one, with b = b₀ + M · load. ``rays`` has a row (y, z, u) for each infeasible
    member, as in `standard_form`.

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
    rays = np.zeros((len(infeasible), len(program.b) + len(program.d) + len(program.r)))
    for row, i in enumerate(infeasible.tolist()):
        member, expected = replace(program, b=constant + moves @ loads[i]), batch.case(i).expected
        assert isinstance(expected, ExpectedInfeasibility)  # its objective is NaN
        rays[row] = np.concatenate(proof_ray(member, expected.proof))
    return {**values, "infeasible": infeasible, "rays": rays}

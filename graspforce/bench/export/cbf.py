"""Conic Benchmark Format, version 1 (Friberg 2016): the cost as a rotated cone, t ≥ ½ ‖F x‖².

    minimise qᵀ x + t    subject to   A x − b = 0,   C x − d ≤ 0,   r − S x in cones,   (t, 1, F x) in the rotated cone

The rotated cone of the format is {v: 2 v₁ v₂ ≥ v₃² + …, v₁ ≥ 0, v₂ ≥ 0}. The variable t follows x; a linear cost has none.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import sparse

from graspforce.bench.export.standard_form import StandardForm
from graspforce.core.arrays import Array


def write_cbf(form: StandardForm) -> str:
    """Return the text of a CBF file.

    Args:
        form: the program.
    """
    quadratic = form.F.nnz > 0
    m = len(form.q)
    columns = m + int(quadratic)
    blocks: list[tuple[str, sparse.csr_matrix, Array]] = [("L=", form.A, -form.b), ("L-", form.C, -form.d)]
    heads = np.cumsum([0, *form.cones])
    blocks += [("Q", -form.S[i:j], form.r[i:j]) for i, j in pairwise(heads)]
    if quadratic:
        epigraph = sparse.vstack([sparse.csr_matrix(([1.0], ([0], [m])), (1, columns)), sparse.csr_matrix((1, columns))])
        factor = sparse.hstack([form.F, sparse.csr_matrix((form.F.shape[0], 1))])
        rotated = sparse.csr_matrix(sparse.vstack([epigraph, factor]))
        blocks.append(("QR", rotated, np.eye(rotated.shape[0])[1]))
    blocks = [block for block in blocks if block[1].shape[0]]
    entries, constants, first = [], [], 0
    for _, rows, constant in blocks:
        triplets = rows.tocoo()
        entries += [
            (first + int(i), int(j), float(v)) for i, j, v in zip(triplets.row, triplets.col, triplets.data, strict=True)
        ]
        constants += [(first + int(i), float(constant[i])) for i in np.flatnonzero(constant)]
        first += rows.shape[0]
    cost = [(int(j), float(form.q[j])) for j in np.flatnonzero(form.q)] + ([(m, 1.0)] if quadratic else [])
    sections = [
        f"# {form.name}: cost of the forces = {form.scale!r} * value + {form.offset!r}\nVER\n1",
        "OBJSENSE\nMIN",
        f"VAR\n{columns} 1\nF {columns}",
        "\n".join([f"CON\n{first} {len(blocks)}", *(f"{kind} {rows.shape[0]}" for kind, rows, _ in blocks)]),
        "\n".join([f"OBJACOORD\n{len(cost)}", *(f"{j} {value!r}" for j, value in cost)]),
        "\n".join([f"ACOORD\n{len(entries)}", *(f"{i} {j} {value!r}" for i, j, value in entries)]),
        "\n".join([f"BCOORD\n{len(constants)}", *(f"{i} {value!r}" for i, value in constants)]),
    ]
    return "\n\n".join(sections) + "\n"

"""QPS, the free MPS format with a quadratic cost (Maros and Mészáros 1999): programs without second-order cones."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from graspforce.bench.export.standard_form import StandardForm
from graspforce.core.errors import UnsupportedProblem


def write_qps(form: StandardForm) -> str:
    """Return the text of a QPS file. Rows e0, e1, … are equations, c0, c1, … inequalities; columns are x0, x1, ….

    Args:
        form: a program without second-order cones.

    Raises:
        UnsupportedProblem: the program has second-order cones.
    """
    if form.cones:
        raise UnsupportedProblem(f"{form.name}: QPS has no second-order cones")
    names = [f"e{i}" for i in range(len(form.b))] + [f"c{i}" for i in range(len(form.d))]
    rows = sparse.csc_matrix(sparse.vstack([form.A, form.C]))
    lines = [f"* cost of the forces = {form.scale!r} * value + {form.offset!r}", f"NAME {form.name}", "ROWS", " N cost"]
    lines += [f" {'E' if name.startswith('e') else 'L'} {name}" for name in names]
    lines.append("COLUMNS")
    for j, gradient in enumerate(form.q):
        entries = [("cost", float(gradient))] if gradient else []
        column = slice(rows.indptr[j], rows.indptr[j + 1])
        entries += [(names[i], float(v)) for i, v in zip(rows.indices[column], rows.data[column], strict=True)]
        lines += [f" x{j} {name} {value!r}" for name, value in entries or [("cost", 0.0)]]
    lines.append("RHS")
    right = np.concatenate([form.b, form.d])
    lines += [f" rhs {names[i]} {float(right[i])!r}" for i in np.flatnonzero(right)]
    lines += ["BOUNDS", *(f" FR bound x{j}" for j in range(len(form.q)))]
    lower = sparse.tril(form.P).tocoo()
    if lower.nnz:
        lines.append("QUADOBJ")
        order = np.lexsort((lower.row, lower.col))
        lines += [f" x{lower.col[k]} x{lower.row[k]} {float(lower.data[k])!r}" for k in order]
    return "\n".join([*lines, "ENDATA"]) + "\n"

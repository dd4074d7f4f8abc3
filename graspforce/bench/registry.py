"""Solvers of the suite by name. A solver whose package is not installed is omitted."""

from __future__ import annotations

import importlib
from importlib import metadata
from typing import cast

from graspforce.bench.adapter import SolverAdapter
from graspforce.core.errors import UnknownName

SOLVERS = {
    "structured": "graspforce.bench.solvers.structured",
    "clarabel": "graspforce.bench.solvers.clarabel",
    "ecos": "graspforce.bench.solvers.ecos",
    "qoco": "graspforce.bench.solvers.qoco",
    "scs": "graspforce.bench.solvers.scs",
    "proxqp": "graspforce.bench.solvers.proxqp",
    "proxqp-nearest": "graspforce.bench.solvers.proxqp_nearest",
    "quadprog": "graspforce.bench.solvers.quadprog",
    "daqp": "graspforce.bench.solvers.daqp",
    "piqp": "graspforce.bench.solvers.piqp",
    "osqp": "graspforce.bench.solvers.osqp",
    "highs": "graspforce.bench.solvers.highs",
    "qpoases": "graspforce.bench.solvers.qpoases",
    "hpipm": "graspforce.bench.solvers.hpipm",
    "qrqp": "graspforce.bench.solvers.qrqp",
    "moreau": "graspforce.bench.solvers.moreau",
    "qpax": "graspforce.bench.solvers.qpax",
    "ipopt": "graspforce.bench.solvers.ipopt",
    "slsqp": "graspforce.bench.solvers.slsqp",
    "qocogen": "graspforce.bench.solvers.qocogen",
    "cvxpygen": "graspforce.bench.solvers.cvxpygen",
}
BY_NAME_ONLY = ("qocogen", "cvxpygen")  # compile code for each pattern of zeros, for seconds to minutes


def load_adapter(name: str) -> SolverAdapter:
    """Return a solver adapter by its name in `SOLVERS`, or by the dotted name of a module.

    Args:
        name: name of the solver or of the module.

    Raises:
        UnknownName: the name is unknown, or the module cannot be imported.
    """
    module = SOLVERS.get(name, name)
    try:
        return cast(SolverAdapter, importlib.import_module(module))
    except (ImportError, ValueError, TypeError) as error:
        allowed = "an installed solver of " + ", ".join(SOLVERS) + ", or an importable module with an adapter"
        raise UnknownName("solver", name, SOLVERS, f"{allowed} ({error})") from None


def installed_solvers() -> tuple[str, ...]:
    """Return the solvers of `SOLVERS` that can be imported, without `BY_NAME_ONLY`."""
    installed = []
    for name in (one for one in SOLVERS if one not in BY_NAME_ONLY):
        try:
            load_adapter(name)
        except UnknownName:
            continue
        installed.append(name)
    return tuple(installed)


def version(name: str) -> str:
    """Return the version of a solver's distribution; empty if it is not installed as a distribution.

    Args:
        name: name of the solver or of the module.
    """
    try:
        return metadata.version(load_adapter(name).PACKAGE)
    except metadata.PackageNotFoundError:
        return ""

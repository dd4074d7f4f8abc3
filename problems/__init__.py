"""Force problems with proven answers, for developing and checking solvers.

>>> from graspforce import problems, solve
>>> case = problems.load("ring/3-force")
>>> answer = solve(case.problem)
>>> abs(answer.objective / case.expected.objective - 1) < case.expected.tolerance
True
"""

from graspforce.problems.batches import Batch, load_batch
from graspforce.problems.case import Case, ExpectedInfeasibility, ExpectedOptimum
from graspforce.problems.library import (
    DATA_VERSION,
    TEXTBOOK,
    choose_folder,
    collections,
    data_hash,
    describe,
    load,
    names,
    smoke_names,
    text,
)

__all__ = [
    "DATA_VERSION",
    "TEXTBOOK",
    "Batch",
    "Case",
    "ExpectedInfeasibility",
    "ExpectedOptimum",
    "choose_folder",
    "collections",
    "data_hash",
    "describe",
    "load",
    "load_batch",
    "names",
    "smoke_names",
    "text",
]

"""Write the large collections: ``python -m benchmarks.write_collections [COLLECTION …]``, in a checkout, with extra ``bench``.

The generators of `graspforce.problems.generators` state the problems, and this program adds the expected answers. An optimum
needs certified solutions of two solvers of the suite, with high settings. The certificate accepts residuals of 1e-8, or of 1e-5
close to infeasibility. The two objectives must agree, and their difference gives the tolerance. An infeasibility proof is
verified without a solver. A case with neither is an error. A feasible case without forces strictly inside the cones gets a
proof of that, where two loaded contacts on the surface of their cones give one.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from graspforce import ForceProblem, solve
from graspforce.bench.adapter import SolverResult, SolverStatus
from graspforce.bench.case_program import case_program, forces_residual
from graspforce.bench.registry import load_adapter
from graspforce.force.certificate import TIGHT_TOLERANCE, certify, certify_infeasibility
from graspforce.force.cone_program import ConicProgram
from graspforce.force.status import Status
from graspforce.problems.case import Case, ExpectedInfeasibility
from graspforce.problems.derivations.records import CLOSED_FORM
from graspforce.problems.generators.no_interior import find_proof
from graspforce.problems.json_format import format_case_line
from graspforce.problems.sequences import format_sequence

GENERATED = ("batch", "hard", "infeasible", "ist", "large", "pyramid", "robust", "scaling", "soft", "trajectory", "whole-hand")
_SOLVERS = ("structured", "clarabel", "ecos", "qoco", "highs", "piqp", "daqp", "proxqp")  # run in this order until two agree
_ROBUST_SOLVERS = ("ecos", "qoco", "scs")  # second solvers of uncertain problems
_TOLERANCE_FACTOR = 3.0  # tolerance of the optimum over the difference of two objectives
_MAX_TOLERANCE = 1e-4  # largest accepted tolerance of an optimum, relative
_MAX_CONTACTS = 100  # dense pyramids and epigraphs take minutes above this


def main() -> None:
    """Write the given collections, or all."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.write_collections", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("collections", nargs="*", metavar="COLLECTION", help=f"of {', '.join(GENERATED)}; all by default")
    requested = parser.parse_args().collections
    for unknown in set(requested) - set(GENERATED):
        parser.error(f"unknown collection {unknown!r}; known: {', '.join(GENERATED)}")
    for collection in requested or GENERATED:
        module = collection.replace("-", "_")
        generator = importlib.import_module(f"graspforce.problems.generators.{module}")
        records = list(generator.cases())
        cases = [solve_record(record) for record in track(records, description=f"{collection:12}")]
        path = Path(__file__).parents[1] / "problems" / collection / "cases.jsonl"
        path.parent.mkdir(exist_ok=True)
        if collection == "batch":
            path = path.with_name("sequences.jsonl")
        path.write_text("".join(line + "\n" for line in _lines(collection, cases)), encoding="utf-8")
        loosest = max((case["expected"]["tolerance"] for case in cases), default=0.0)
        print(f"{collection}: {len(cases)} cases, {path.stat().st_size / 1e6:.2f} MB, loosest tolerance {loosest:.1e}")


def _lines(collection: str, cases: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the lines of a collection's file: one for each case, or one for each batch."""
    if collection != "batch":
        yield from map(format_case_line, cases)
        return
    for name, own in itertools.groupby(cases, key=lambda case: case["name"].rpartition("-")[0]):
        yield format_sequence(name, list(own))


def solve_record(record: dict[str, Any]) -> dict[str, Any]:
    """Return a record with a verified ``expected`` record.

    Args:
        record: record of the case.

    Raises:
        RuntimeError: no two solvers agree and there is no valid proof.
    """
    problem = ForceProblem.from_dict(record)
    if "expected" in record:
        known = Case.from_dict(record).expected
        if not isinstance(known, ExpectedInfeasibility) or not certify_infeasibility(problem, known.proof).certificate.verified:
            raise RuntimeError(f"{problem.name}: the proof of the generator is not valid")
        return {**record, "expected": {**record["expected"], "verified_by": ["proof"]}}
    answers: list[tuple[str, float, float]] = []  # solver, residual, objective
    for name, residual, objective in _certified_answers(problem):
        answers.append((name, residual, objective))
        best = _agreed_optimum(answers)
        if best is not None:
            y = None if problem.uncertainty is not None else find_proof(problem, solve(problem, explain=False).f)
            return {**record, "expected": best if y is None else {**best, "no_interior": y.tolist()}}
    answer = solve(problem, explain=False)
    if answer.status is not Status.INFEASIBLE or answer.infeasibility is None:
        raise RuntimeError(f"{problem.name}: no two solvers agree, and no proof was found: {answers}, {answer.status}")
    multipliers = answer.infeasibility.multipliers
    proof = {name: values for name, values in multipliers.to_dict().items() if np.any(values)}
    return {**record, "expected": {"status": "infeasible", "proof": proof, "tolerance": CLOSED_FORM, "verified_by": ["proof"]}}


def _certified_answers(problem: ForceProblem) -> Iterator[tuple[str, float, float]]:
    """Yield certified solutions, solver by solver: name, residual, objective."""
    if problem.uncertainty is not None:
        yield from _certified_squeezes(problem)
        return
    program = case_program(problem)
    for name in _SOLVERS:
        solver = load_adapter(name)
        large = len(problem.contacts) > _MAX_CONTACTS and name not in ("structured", "clarabel", "qoco")
        if large or (program.cones and not solver.EXACT_CONES):
            continue
        result = _run(name, program)
        if result is None or result.status is SolverStatus.INFEASIBLE:
            continue
        if result.f is not None and result.multipliers is not None:
            found = certify(problem, result.f, result.multipliers)
            if found.verified:
                residual = max(found.primal_residual, found.dual_residual, found.gap)
                yield name, residual, problem.cost(result.f)


def _run(solver: str, program: ConicProgram) -> SolverResult | None:
    """Return the result of a solver with high settings; None if it raised an exception."""
    try:
        bound_solver = load_adapter(solver).bind(program, "high")
        return bound_solver.read(bound_solver.run(None))
    except Exception:  # solvers raise exceptions of any type
        return None


def _certified_squeezes(problem: ForceProblem) -> Iterator[tuple[str, float, float]]:
    """Yield the certified squeeze of an uncertain problem, and squeezes of other solvers that hold for all errors."""
    solution = solve(problem, explain=False)
    if solution.status is Status.OPTIMAL and solution.certificate is not None and solution.certificate.is_tight:
        yield "clarabel", forces_residual(problem, solution.f), problem.cost(solution.f)
    for name in _ROBUST_SOLVERS:
        result = _run(name, case_program(problem))
        if result is not None and result.status is SolverStatus.SOLVED and result.f is not None:
            residual = forces_residual(problem, result.f)
            if residual <= TIGHT_TOLERANCE:
                yield name, residual, problem.cost(result.f)


def _agreed_optimum(answers: list[tuple[str, float, float]]) -> dict[str, Any] | None:
    """Return the optimum on which the last and an earlier solution agree, with the smaller residual."""
    *earlier, (name, residual, objective) = answers
    for other, other_residual, other_objective in earlier:
        best = objective if residual < other_residual else other_objective
        difference = abs(objective - other_objective) / max(abs(best), 1e-300)
        tolerance = max(CLOSED_FORM, _next_power_of_ten(_TOLERANCE_FACTOR * difference))
        if tolerance <= _MAX_TOLERANCE:
            return {"status": "optimal", "objective": best, "tolerance": tolerance, "verified_by": [other, name]}
    return None


def _next_power_of_ten(value: float) -> float:
    """Return the smallest power of ten that is not below a value; 0 for 0."""
    return 0.0 if value == 0.0 else 10.0 ** math.ceil(math.log10(value))


if __name__ == "__main__":
    main()

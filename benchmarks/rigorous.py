"""Rigorous certificates against an exact checker: `python -m benchmarks.rigorous --count 100000 --mutations 10000`.

Random problems of two to eight contacts, a third of them overloaded, in units of force from 1e-12 to 1e12 and of length from
1e-3 to 1e3: with exact cones or pyramids and every objective, or with --simple exact cones and the objectives torque, force and
sum_normal only. Each solution with a verdict gets a proof, which `check_proof.py` decides in exact rational arithmetic. "Not
proven" are verdicts whose rounding bounds are too large for a proof: they claim nothing.

Mutations replace one number of a valid proof by another one. With the old checksum all must be refused. With a new checksum the
exact checker decides about a statement on other data: those that it accepts change a number by less than the proof's room, or
one on which the proof does not depend.

With `--records` results are kept in a file: a later run continues them, and `--budget` limits its time.

The times are medians of repeated calls on one problem of four contacts and twelve motors, plain and rigorous: in Python for
some cones and objectives, and in C without conversion of arguments for exact cones (`benchmarks/rigorous_time.c`).
"""

from __future__ import annotations

import copy
import math
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import graspforce as gf
from benchmarks import report_page
from benchmarks.task_records import Record, Task, run_tasks
from graspforce.analysis.check_proof import ProofError, check
from graspforce.core.errors import InvalidInput
from graspforce.force.certificate import certify
from graspforce.force.proof_file import digest, make_proof

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.other_units import in_other_units
from support.random_problems import random_problem

ROOT = Path(__file__).parents[1]
PIECE = 1000  # problems or mutations of a record
PROOFS = 50  # that are mutated in a piece
SIMPLE = ("torque", "force", "sum_normal")
TIMED = (
    ("exact cones, torque", None, "torque"),
    ("exact cones, largest normal force", None, "max_normal"),
    ("exact cones, slip margin", None, "margin"),
    ("inner pyramids of 8 facets, torque", gf.Cone("pyramid", 8), "torque"),
)
TIMES_HEAD = ("certificate in Python", "plain (µs)", "rigorous (µs)", "ratio")
HEAD = ("verdict", "claims", "checker agrees", "not proven")
Proof = dict[str, Any]


def problems(count: int, seed: int, simple: bool) -> Iterator[gf.ForceProblem]:
    """Yield random problems in random units.

    Args:
        count: number of problems.
        seed: seed of the random numbers.
        simple: exact cones and the objectives of `SIMPLE` only.
    """
    rng, made = np.random.default_rng(seed), 0
    while made < count:
        problem = random_problem(rng)
        if not simple or (problem.cone.type == "exact" and problem.objective.type in SIMPLE):
            made += 1
            yield in_other_units(problem, 10.0 ** rng.uniform(-12.0, 12.0), 10.0 ** rng.uniform(-3.0, 3.0))


def claim(problem: gf.ForceProblem) -> tuple[str, str, Proof | None]:
    """Return the verdict on a problem, its outcome, and the proof if the checker agrees.

    Args:
        problem: the force problem.
    """
    solution = gf.solve(problem, explain=False)
    status = "optimal" if solution.found else solution.status.value
    if status == "failed":
        return status, "none", None
    try:
        proof = make_proof(solution)
    except InvalidInput:
        return status, "not proven", None
    try:
        agrees = check(proof) == status
    except ProofError:
        agrees = False
    return (status, "agrees", proof) if agrees else (status, "wrong", None)


def count_claims(count: int, seed: int, simple: bool) -> Record:
    """Return the number of outcomes by verdict.

    Args:
        count: number of problems.
        seed: seed of the random numbers.
        simple: as in `problems`.
    """
    outcomes: Counter[str] = Counter()
    for problem in problems(count, seed, simple):
        status, outcome, _ = claim(problem)
        outcomes[f"{status}, {outcome}"] += 1
    return dict(outcomes)


def mutate(proof: Proof, rng: np.random.Generator) -> Proof:
    """Return a proof with one number replaced.

    Args:
        proof: a proof.
        rng: random numbers.
    """
    mutated = copy.deepcopy(proof)
    places = list(_places(mutated))
    parent, key = places[rng.integers(len(places))]
    value = parent[key]
    factor = float(rng.choice([-1.0, 0.0, 0.5, 1.0 + 1e-6, 1.0 - 1e-12, 2.0, 1e6]))
    parent[key] = value * factor if value else float(rng.choice([-1.0, 1.0, 1e-9]))
    return mutated


def _places(node: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the place of every float: its list or record, and its index or name."""
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in items:
        if isinstance(value, dict | list):
            yield from _places(value)
        elif isinstance(value, float):
            yield node, key


def count_mutations(count: int, seed: int, simple: bool) -> Record:
    """Return how many mutations are refused with the old checksum, and with a new one.

    Args:
        count: number of mutations.
        seed: seed of the random numbers.
        simple: as in `problems`.
    """
    rng, refused = np.random.default_rng(seed), [0, 0]
    proofs = [proof for problem in problems(PROOFS, seed, simple) if (proof := claim(problem)[2]) is not None]
    for i in range(count):
        mutated = mutate(proofs[i % len(proofs)], rng)
        for renewed in (False, True):
            if renewed:
                mutated["digest"] = digest(mutated)
            try:
                check(mutated)
            except ProofError:
                refused[renewed] += 1
    return {"old": refused[0], "new": refused[1]}


def run_piece(task: Task) -> Record:
    """Return the result of one piece.

    Args:
        task: "claims" or "mutations", their number, the seed, and as in `problems` 1 for simple ones.
    """
    kind, count, seed, simple = task
    return (count_claims if kind == "claims" else count_mutations)(count, seed, bool(simple))


def nearest_cases() -> tuple[int, int]:
    """Return the number of the library's infeasible cases within 3e-6 of feasibility, and of those proven."""
    names = [name for name in gf.problems.names("infeasible") if "near-1e-06" in name or "near-3e-06" in name]
    proven = 0
    for name in names:
        proven += check(make_proof(gf.solve(gf.problems.load(name).problem, explain=False))) == "infeasible"
    return len(names), proven


def python_times() -> list[tuple[str, float, float]]:
    """Return name and median times of a plain and a rigorous certificate for each cone and objective, s."""
    given, times = gf.problems.load("trajectory/carry-1-000").problem, []
    for name, cone, objective in TIMED:
        problem = gf.ForceProblem(given.contacts, given.w, given.actuation, cone, gf.Objective(objective))
        solution = gf.solve(problem)
        f, m = solution.f, solution.multipliers
        assert m is not None  # an optimum has multipliers
        plain = _median(partial(certify, problem, f, m))
        times.append((name, plain, _median(partial(certify, problem, f, m, rigorous=True))))
    return times


def _median(run: Callable[[], object]) -> float:
    """Return the median time of 1000 calls, s."""
    times = []
    for _ in range(1000):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def c_times() -> str:
    """Return the times in C as a sentence; empty without a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return ""
    library = Path(gf.__file__).parent / "csrc"
    sources = [ROOT / "benchmarks" / "rigorous_time.c", *(library / "kernel" / f"{n}.c" for n in ("rigorous", "certify"))]
    flags = ["-std=gnu11", "-O3", "-fno-math-errno", "-fno-trapping-math", f"-I{library / 'include'}"]
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "times"
        subprocess.run([compiler, *flags, *map(str, sources), "-lm", "-o", str(program)], check=True)
        return subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout.strip()


def outcome_counts(record: Record) -> dict[str, int]:
    """Return the numbers of a record without its task and commit.

    Args:
        record: the record of a piece.
    """
    return {name: value for name, value in record.items() if name not in ("task", "commit")}


def main() -> None:
    """Measure, print the table and write the page."""
    options = report_page.parser("rigorous", __doc__)
    options.add_argument("--count", type=int, default=1000, help="number of problems")
    options.add_argument("--mutations", type=int, default=1000, help="number of mutations")
    options.add_argument("--seed", type=int, default=5, help="seed of the random numbers")
    options.add_argument(
        "--simple", action="store_true", help="exact cones and the objectives torque, force and sum_normal only"
    )
    options.add_argument("--processes", type=int, default=1, help="number of processes")
    options.add_argument("--budget", type=float, default=math.inf, help="time after which no further piece starts (s)")
    options.add_argument("--records", type=Path, help="file of results that a later run continues")
    given = options.parse_args()
    numbers = {"mutations": given.mutations, "claims": given.count}
    tasks: list[Task] = [
        (kind, min(PIECE, n - start), given.seed + start // PIECE, int(given.simple))
        for kind, n in numbers.items()
        for start in range(0, n, PIECE)
    ]
    with tempfile.TemporaryDirectory() as folder:
        records = given.records or Path(folder) / "records.jsonl"
        results = run_tasks(run_piece, tasks, records, given.processes, given.budget)
    claims = sum((Counter(outcome_counts(r)) for task, r in results.items() if task[0] == "claims"), Counter())
    mutations = sum((Counter(outcome_counts(r)) for task, r in results.items() if task[0] == "mutations"), Counter())
    rows = []
    for status in ("optimal", "infeasible"):
        agrees, wrong, unproven = (claims[f"{status}, {name}"] for name in ("agrees", "wrong", "not proven"))
        rows.append((status, str(agrees + wrong), str(agrees), str(unproven)))
    report_page.show("Rigorous certificates", HEAD, rows)
    near, proven = nearest_cases()
    times = [(name, f"{1e6 * a:.0f}", f"{1e6 * b:.0f}", f"{b / a:.2f}") for name, a, b in python_times()]
    sentences = [
        f"{claims.total()} problems; {claims['failed, none']} without a verdict.",
        f"{sum(task[1] for task in results if task[0] == 'mutations')} mutations: "
        f"{mutations['old']} refused with the old checksum, "
        f"{mutations['new']} with a new one.",
        f"Of the {near} infeasible cases of the library that are nearest to feasibility, {proven} are proven.",
        c_times(),
    ]
    print("\n".join(sentences))
    report_page.show("Times", TIMES_HEAD, times)
    if given.save:
        parts = [report_page.table(HEAD, rows), *filter(None, sentences), report_page.table(TIMES_HEAD, times)]
        tables = "\n\n".join(parts)
        report_page.save(
            given.save, "Rigorous certificates", __doc__, report_page.facts(f"graspforce {gf.__version__}"), tables
        )


if __name__ == "__main__":
    main()

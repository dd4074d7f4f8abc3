"""Termination of ProxQP on infeasible problems: ``python -m benchmarks.proxqp_infeasible [N]``, in a checkout.

The programs are all infeasible cases of the library, or every N-th program, with inner pyramids of 4, 8 and 16 facets. Their
units are those of the problem, newtons and metres, or millinewtons and millimetres. ProxQP runs with its default tolerances and
with smaller ones, with its dense and its sparse backend, and in three variants: with default options, with
primal_infeasibility_solving (nearest feasible problem), and with its infeasibility test effectively disabled.

Each solve has its own process and 0.5 s of processor time. The benchmark counts the returned statuses, and lists the programs
on which ProxQP did not terminate.
"""

from __future__ import annotations

import argparse
import dataclasses
import multiprocessing
import signal
from collections import Counter
from collections.abc import Iterator

import numpy as np
import proxsuite
from proxsuite import proxqp
from rich.progress import track
from scipy import sparse

from graspforce import Cone, problems
from graspforce.bench.si_units import to_si_units
from graspforce.force.cone_program import ConicProgram, conic_program
from graspforce.problems.case import ExpectedInfeasibility

_LIMIT = 0.5  # s of processor time
_TOLERANCES = (None, 1e-9, 1e-12)  # None: default of ProxQP
_VARIANTS = ("default", "nearest", "no test")
_NO_LIMIT = 1e20


def main() -> None:
    """Print the counts of statuses, and the programs on which ProxQP did not terminate."""
    about = (__doc__ or "").splitlines()[0]
    parser = argparse.ArgumentParser(prog="python -m benchmarks.proxqp_infeasible", description=about)
    parser.add_argument("every", nargs="?", type=int, default=1, metavar="N", help="use only every N-th program")
    every = parser.parse_args().every
    selected = list(programs())[::every]
    counts: Counter[tuple[str, str, str, str]] = Counter()
    unfinished = []
    for name, units, program in track(selected, description="ProxQP"):
        for tolerance in _TOLERANCES:
            for backend in ("dense", "sparse"):
                for variant in _VARIANTS:
                    status = _solve_in_process(program, tolerance, backend, variant)
                    counts[units, backend, variant, status] += 1
                    if not status.startswith("PROXQP"):
                        unfinished.append(
                            f"{name}, {units}, {backend}, {variant}, tolerance {tolerance or 'default'}: {status}"
                        )
    print(f"proxsuite {proxsuite.__version__}, {len(selected)} programs, {sum(counts.values())} solves")
    for (units, backend, variant, status), count in sorted(counts.items()):
        print(f"{units:8} {backend:7} {variant:9} {status:32} {count}")
    print("\n".join(unfinished) or "ProxQP terminated on all programs.")


def programs() -> Iterator[tuple[str, str, ConicProgram]]:
    """Yield the programs: name of the case with its number of facets, units, and program."""
    for name in problems.names():
        case = problems.load(name)
        if not isinstance(case.expected, ExpectedInfeasibility):
            continue
        exact = case.problem.cone.type == "exact"
        for facets in (4, 8, 16) if exact else (case.problem.cone.facets,):
            cone = Cone("pyramid", facets, "inner") if exact else case.problem.cone
            program = conic_program(dataclasses.replace(case.problem, cone=cone))
            si = to_si_units(program)
            moments = len(si.b) - 3
            rows = np.array([1e3] * 3 + [1e6] * moments)[:, None]  # mN, mN·mm
            small = dataclasses.replace(
                si, P=si.P * 1e-6, q=si.q * 1e-3, A=si.A * rows / 1e3, b=si.b * rows[:, 0], d=si.d * 1e3
            )
            for units, one in (("scaled", program), ("N, m", si), ("mN, mm", small)):
                yield f"{name} {facets}", units, one


def _solve_in_process(program: ConicProgram, tolerance: float | None, backend: str, variant: str) -> str:
    """Return the status that ProxQP returned, or the exit of its process."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(target=_solve, args=(theirs, program, tolerance, backend, variant))
    child.start()
    child.join()
    if child.exitcode == 0:
        return str(ours.recv())
    return "did not terminate" if child.exitcode == -signal.SIGPROF else f"exit code {child.exitcode}"


def _solve(
    pipe: multiprocessing.connection.Connection, program: ConicProgram, tolerance: float | None, backend: str, variant: str
) -> None:
    signal.setitimer(signal.ITIMER_PROF, _LIMIT)
    P, A, C = program.P, program.A, program.C
    if backend == "sparse":
        P, A, C = (sparse.csc_matrix(part) for part in (P, A, C))
    qp = getattr(proxqp, backend).QP(len(program.q), len(program.b), len(program.d))
    if tolerance is not None:
        qp.settings.eps_abs, qp.settings.eps_rel = tolerance, 0.0
    if variant == "nearest":
        qp.settings.primal_infeasibility_solving = True
    if variant == "no test":
        qp.settings.eps_primal_inf = qp.settings.eps_dual_inf = 1e-14
    qp.init(P, program.q, A, program.b, C, np.full(len(program.d), -_NO_LIMIT), program.d)
    qp.solve()
    pipe.send(str(qp.results.info.status).rpartition(".")[2])


if __name__ == "__main__":
    main()

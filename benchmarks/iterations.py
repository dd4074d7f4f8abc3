"""Most iterations of the structured kernel, and instructions of a solve: `python -m benchmarks.iterations --count 1000000`.

Problems of a size share a geometry in groups; forces, motors, friction and limits differ. "Random" ones are feasible. The
adversarial kinds are "slippery" (friction from 1e-4), "near the limit" (torque and force limits within 1e-6 of the forces that
make the problem feasible), "flat" (contacts within 1e-5 of a plane), "weights" (from 1e-4 to 1e4), and "overloaded" (up to 1000
times the load). Iterations are those until the kernel's own verdict; at most 60 are allowed.

Failures are problems without a certified optimum and without a verified proof of infeasibility after the iterations. Their
places are recorded. Each time the page is written, the kernel with its short steps (`docs/concepts/iteration_bound.md`) and
Clarabel solve them again; the page counts the certified answers of each. "Most steps" are iterations of both paths together.
"Bound" is the proven number of short steps that reduce all residuals to 1e-24. Short steps follow failures only.

Results are kept in `benchmarks/results/records/iterations.jsonl`: a later run continues them, and `--budget` limits its time.

Instructions are those of `gf_solve`, counted by callgrind over 200 random problems, for the machine code that the processor
selects (`benchmarks/iterations_count.c`).
"""

from __future__ import annotations

import itertools
import math
import operator
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import graspforce as gf
from benchmarks import report_page
from benchmarks.task_records import Record, Task, run_tasks
from graspforce.core.arrays import Array
from graspforce.force.backends import compiled_kernel
from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.backends.structured import KernelSession
from graspforce.force.certificate import certify, certify_infeasibility

ROOT = Path(__file__).parents[1]
SIZES = ((2, 3), (3, 3), (4, 3), (4, 4), (5, 4), (10, 4))  # contacts, joints of each finger
KINDS = ("random", "slippery", "near the limit", "flat", "weights", "overloaded")
LARGEST = 60  # iterations
GROUP_NUMBERS = 400_000  # numbers of J in a group
PIECE = 60  # groups of a record
RECORDS = ROOT / "benchmarks" / "results" / "records" / "iterations.jsonl"
COUNTED = 200  # problems under callgrind
HEAD = ("contacts", "joints", "problems", "mean", *(f"most, {kind}" for kind in KINDS))
FAILURES_HEAD = ("contacts", "joints", "failures", "short steps solve", "most steps", "bound", "Clarabel solves", "unsolved")
COUNT_HEAD = ("contacts", "joints", "instructions a solve", "iterations", "instructions an iteration")


@dataclass(frozen=True)
class Group:
    """Problems that share a geometry.

    Args:
        kind: one of `KINDS`.
        p: (N, 3) contact positions, m.
        R: (N, 3, 3) contact frames.
        rows: arrays of all problems by their names in `compiled_kernel.Kernel`, the first axis the problem.
    """

    kind: str
    p: Array
    R: Array
    rows: dict[str, Array]


def group(contacts: int, joints: int, count: int, index: int) -> Group:
    """Return a group of problems.

    Args:
        contacts: number of contacts, with one finger each.
        joints: number of joints of each finger.
        count: number of problems.
        index: index of the group, which is the seed and selects the kind.
    """
    rng, kind, N = np.random.default_rng([contacts, joints, index]), KINDS[index % len(KINDS)], contacts
    normals = rng.normal(size=(N, 3)) * (np.array([1.0, 1.0, 1e-5]) if kind == "flat" else 1.0)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    p = -rng.uniform(0.02, 0.08) * normals + 0.003 * rng.normal(size=(N, 3)) * (1e-3 if kind == "flat" else 1.0)
    R = np.array([frame(n, rng.normal(size=3)) for n in normals])
    mu = 10.0 ** rng.uniform(-4.0, 0.0, size=(count, N)) if kind == "slippery" else rng.uniform(0.2, 1.0, size=(count, N))
    f = rng.normal(size=(count, N, 3))
    f[..., 2] = rng.exponential(3.0, size=(count, N)) + 0.05
    share = rng.random((count, N)) * 0.95 / np.hypot(f[..., 0], f[..., 1])
    f[..., :2] *= (share * mu * f[..., 2])[..., None]
    forces = np.einsum("nij,mnj->mni", R, f)
    w = np.concatenate([forces.sum(axis=1), np.cross(p, forces).sum(axis=1)], axis=1)
    J = np.zeros((count, N, 3, N, joints))
    own = 0.05 * rng.normal(size=(N, count, 3, joints))
    J[:, np.arange(N), :, np.arange(N)] = own
    tau_u = 0.02 * rng.normal(size=(count, N, joints))
    tau = tau_u + np.einsum("nmcj,mnc->mnj", own, f)
    extra = 1e-6 if kind == "near the limit" else 0.3
    limit = np.abs(tau) * (1.0 + extra * rng.random(tau.shape)) + extra * 0.05
    most = f[..., 2] * (1.0 + extra) if kind == "near the limit" else np.maximum(20.0, 1.1 * f[..., 2])
    weight = 10.0 ** rng.uniform(-4.0, 4.0, size=tau.shape) if kind == "weights" else np.ones(tau.shape)
    if kind == "overloaded":
        w *= 10.0 ** rng.uniform(0.0, 3.0, size=(count, 1))
    n = N * joints
    flat = {"tau_u": tau_u, "upper": limit, "lower": -limit, "weight": weight}
    rows = {"w": w, "mu": mu, "max_normal": most, "J": J.reshape(count, 3 * N, n)}
    rows |= {name: np.ascontiguousarray(array.reshape(count, n)) for name, array in flat.items()}
    return Group(kind, p, R, rows)


def frame(normal: Array, direction: Array) -> Array:
    """Return a rotation whose third column is the normal.

    Args:
        normal: (3,) unit vector.
        direction: (3,) vector that is not parallel to it.
    """
    t = direction - (direction @ normal) * normal
    t /= np.linalg.norm(t)
    return np.column_stack([t, np.cross(normal, t), normal])


def problem(group: Group, i: int) -> gf.ForceProblem:
    """Return problem i of a group.

    Args:
        group: the group.
        i: index of the problem.
    """
    rows = {name: array[i] for name, array in group.rows.items()}
    contacts = [
        gf.Contact(position=p, normal=R[:, 2], tangent=R[:, 0], friction=mu, max_normal=most)
        for p, R, mu, most in zip(group.p, group.R, rows["mu"], rows["max_normal"], strict=True)
    ]
    hand = gf.Actuation(rows["J"], rows["tau_u"], rows["lower"], rows["upper"], rows["weight"])
    return gf.ForceProblem(contacts, rows["w"], hand)


@dataclass(frozen=True)
class Answers:
    """Certified answers to the failures of a size.

    Args:
        count: number of failures.
        by_steps, by_clarabel: those that the kernel with short steps, and Clarabel, solve.
        unsolved: those that neither solves.
        most_steps: most iterations of the kernel with short steps.
    """

    count: int
    by_steps: int
    by_clarabel: int
    unsolved: int
    most_steps: int


def solve_again(failed: Iterable[gf.ForceProblem]) -> Answers:
    """Return the answers to problems without an answer of the kernel's first path.

    Args:
        failed: the problems.
    """
    rows, most = [], 0
    for one in failed:
        with_steps = KernelSession(one, SolverSettings()).solve()
        by_clarabel = gf.solve(one, "clarabel", explain=False).status in (gf.Status.OPTIMAL, gf.Status.INFEASIBLE)
        rows.append((is_certified(one, with_steps), by_clarabel))
        most = max(most, with_steps.iterations)
    by_steps, clarabel = (sum(row[i] for row in rows) for i in range(2))
    return Answers(len(rows), by_steps, clarabel, sum(not any(row) for row in rows), most)


def recorded_failures(task: Task, record: Record) -> Iterator[gf.ForceProblem]:
    """Yield the failures of a piece.

    Args:
        task: contacts, joints, number of problems of a group, and index of the piece.
        record: its record.
    """
    for index, numbers in itertools.groupby(record["failed"], key=operator.itemgetter(0)):
        made = group(*task[:3], index)
        yield from (problem(made, i) for _, i in numbers)


def is_certified(problem: gf.ForceProblem, solution: gf.Solution) -> bool:
    """Return whether the certificate proves a solution of the kernel optimal or infeasible.

    Args:
        problem: the force problem.
        solution: the kernel's solution.
    """
    if solution.multipliers is None:
        return False
    if solution.status is gf.Status.INFEASIBLE:
        return certify_infeasibility(problem, solution.multipliers).certificate.verified
    return bool(len(solution.f)) and certify(problem, solution.f, solution.multipliers).is_tight


def solve_group(task: tuple[int, int, int, int]) -> tuple[str, npt.NDArray[np.int64], list[int]]:
    """Return kind, numbers of problems by iterations, and the failures of a group.

    Args:
        task: contacts, joints, number of problems and index of the group.
    """
    made = group(*task)
    count, n = len(made.rows["w"]), made.rows["tau_u"].shape[1]
    N = len(made.p)
    widths = {"force_unit": 1, "length_unit": 1, "cost_unit": 1, "torque_unit": n, "f": 3 * N, "y": 6, "z": 3 * N}
    widths |= {"nu_lower": N, "nu_upper": N, "lambda_lower": n, "lambda_upper": n, "tau": n}
    arrays: dict[str, Any] = {name: np.zeros((count, width)) for name, width in widths.items()}
    arrays |= made.rows
    arrays |= {"p": made.p, "R": made.R, "G": None, "gamma": np.zeros(N), "min_normal": np.zeros(N), "cost": None}
    arrays |= {"facet": np.zeros((0, 4)), "force_weight": np.zeros(1)}
    arrays["report"] = np.zeros(count, dtype=compiled_kernel.report_type)
    fingers = np.arange(N, dtype=np.intc)
    indices = {"components": np.full(N, 3, dtype=np.intc), "contact_block": fingers}
    indices |= {"joint_block": np.repeat(fingers, n // N), "facet_contact": np.zeros(0, dtype=np.intc)}
    kernel = compiled_kernel.Kernel(**indices, **arrays)
    kernel.solve(0, count, compiled_kernel.TOLERANCE, LARGEST, False)
    kernel.certify(0, count)
    report = arrays["report"]
    worst = np.max([report[f"certified_{name}"] for name in ("primal", "dual", "gap")], axis=0)
    is_proven = (report["status"] == 2) & (report["certified_primal"] == 0.0)
    failed = np.flatnonzero(~(((report["status"] <= 1) & (worst <= 1e-8)) | is_proven))
    return made.kind, np.bincount(report["iterations"], minlength=LARGEST + 1).astype(np.int64), failed.tolist()


def solve_piece(task: Task) -> Record:
    """Return the iterations by kind and the failures (group, problem) of a piece of `PIECE` groups.

    Args:
        task: contacts, joints, number of problems of a group, and index of the piece.
    """
    contacts, joints, each, piece = task
    seen = {kind: np.zeros(LARGEST + 1, dtype=np.int64) for kind in KINDS}
    failed: list[tuple[int, int]] = []
    for index in range(piece * PIECE, (piece + 1) * PIECE):
        kind, counts, rows = solve_group((contacts, joints, each, index))
        seen[kind] += counts
        failed += [(index, i) for i in rows]
    iterations = {kind: np.trim_zeros(counts, "b").tolist() for kind, counts in seen.items()}
    return {"iterations": iterations, "failed": failed}


def tasks_of(contacts: int, joints: int, count: int) -> list[Task]:
    """Return the pieces that contain `count` problems of a size, at least.

    Args:
        contacts: number of contacts.
        joints: number of joints of each finger.
        count: number of problems.
    """
    each = min(GROUP_NUMBERS // (3 * contacts * contacts * joints), 2000)
    return [(contacts, joints, each, piece) for piece in range(-(-count // (each * PIECE)))]


def row(contacts: int, joints: int, records: list[Record]) -> tuple[str, ...]:
    """Return the row of one size.

    Args:
        contacts: number of contacts.
        joints: number of joints of each finger.
        records: records of its pieces.
    """
    seen = {kind: np.zeros(LARGEST + 1, dtype=np.int64) for kind in KINDS}
    for record in records:
        for kind, counts in record["iterations"].items():
            seen[kind][: len(counts)] += np.array(counts, dtype=np.int64)
    total = np.sum(list(seen.values()), axis=0)
    mean = float(total @ np.arange(LARGEST + 1) / total.sum())
    most = [str(int(np.flatnonzero(counts).max())) for counts in seen.values()]
    return (str(contacts), str(joints), f"{total.sum()}", f"{mean:.1f}", *most)


def failures_row(contacts: int, joints: int, records: list[Record]) -> tuple[str, ...]:
    """Return the row of the failures of one size, which are solved again.

    Args:
        contacts: number of contacts.
        joints: number of joints of each finger.
        records: records of its pieces.
    """
    found = solve_again(itertools.chain.from_iterable(recorded_failures(record["task"], record) for record in records))
    count, steps, clarabel, unsolved = map(str, (found.count, found.by_steps, found.by_clarabel, found.unsolved))
    most = str(found.most_steps)
    first = problem(group(contacts, joints, 1, 0), 0)
    bound = str(KernelSession(first, SolverSettings()).short_step_bound(compiled_kernel.SHORT_STEP_REDUCTION))
    return (str(contacts), str(joints), count, steps, most, bound, clarabel, unsolved)


def count_instructions() -> list[tuple[str, ...]]:
    """Return the instructions of a solve for each size; empty without a compiler or valgrind."""
    compiler, valgrind = shutil.which("cc") or shutil.which("gcc"), shutil.which("valgrind")
    if compiler is None or valgrind is None:
        return []
    kernel = ROOT / "graspforce" / "csrc" / "kernel"
    sources = [ROOT / "benchmarks" / "iterations_count.c", kernel / "solve.c"]
    flags = ["-std=gnu11", "-O3", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi", f"-I{kernel.parent / 'include'}"]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        program = str(Path(folder) / "count")
        subprocess.run([compiler, *flags, *map(str, sources), "-lm", "-o", program], check=True)
        tool = [valgrind, "--tool=callgrind", "--toggle-collect=gf_solve", "--callgrind-out-file=/dev/null"]
        for contacts, joints in SIZES:
            size = [str(contacts), str(joints), str(COUNTED)]
            run = subprocess.run([*tool, program, *size], check=True, capture_output=True, text=True)
            found = re.search(r"Collected\s*:\s*(\d+)", run.stderr)
            assert found is not None  # callgrind prints it
            instructions, iterations = int(found[1]), int(run.stdout.split()[0])
            mean = iterations / COUNTED
            rows.append((*size[:2], f"{instructions / COUNTED:.0f}", f"{mean:.1f}", f"{instructions / iterations:.0f}"))
    return rows


def main() -> None:
    """Measure, print the tables and write the page."""
    options = report_page.parser("iterations", __doc__)
    options.add_argument("--count", type=int, default=100_000, help="problems of each size")
    options.add_argument("--most", type=int, default=0, help="problems of the size with 4 contacts and 3 joints")
    options.add_argument("--processes", type=int, default=2, help="number of processes")
    options.add_argument("--budget", type=float, default=math.inf, help="time after which no further piece starts (s)")
    options.add_argument("--records", type=Path, default=RECORDS, help="file of results that a later run continues")
    given = options.parse_args()
    tasks = [t for size in SIZES for t in tasks_of(*size, max(given.count, given.most if size == (4, 3) else 0))]
    results = run_tasks(solve_piece, tasks, given.records, given.processes, given.budget)
    by_size = {size: [record for task, record in results.items() if task[:2] == size] for size in SIZES}
    rows = [row(*size, records) for size, records in by_size.items() if records]
    report_page.show("Iterations", HEAD, rows, width=200)
    failures = [failures_row(*size, records) for size, records in by_size.items() if records]
    report_page.show("Failures", FAILURES_HEAD, failures, width=120)
    counts = count_instructions()
    report_page.show("Instructions", COUNT_HEAD, counts)
    if given.save:
        parts = (HEAD, rows), (FAILURES_HEAD, failures), (COUNT_HEAD, counts)
        tables = "\n\n".join(report_page.table(head, lines, 2) for head, lines in parts)
        facts = report_page.facts(f"graspforce {gf.__version__}")
        report_page.save(given.save, "Iterations of the structured kernel", __doc__, facts, tables)


if __name__ == "__main__":
    main()

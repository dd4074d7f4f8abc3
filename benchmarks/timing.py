"""Times of solvers on seeded force problems, in one process pinned to one core, as ratios to a peer in the same round.

The peer is raw Clarabel: set-up and solve on arrays built beforehand. In each round all subjects take turns, so that a drift of
the machine's speed affects them equally. Each subject solves a burst of similar problems, and its first solve is not timed. A
solution without a certificate is not timed either.
"""

from __future__ import annotations

import math
import os
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.subjects import PEER, subjects
from graspforce import Actuation, Contact, ContactSet, ForceProblem, solve_stack
from graspforce.contact.matrices import grasp_matrix

_BURST = 6  # similar problems that a subject solves in turn; the first is not timed


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """Times of one subject at one number of contacts.

    Args:
        subject: name of the subject.
        contacts: number of contacts.
        median: median time, s.
        p99: 99th percentile of the time, s.
        largest: largest time, s.
        ratio: median of the peer's time over the subject's time, in the same round.
        iterations: median number of iterations.
        certified: number of certified solutions.
        attempted: number of timed solves.
    """

    subject: str
    contacts: int
    median: float
    p99: float
    largest: float
    ratio: float
    iterations: float
    certified: int
    attempted: int


@dataclass(frozen=True, eq=False, slots=True)
class Throughput:
    """Throughput of stacked problems.

    Args:
        contacts: number of contacts of each problem.
        problems: number of problems.
        one_thread: solves per second on one thread, 1/s.
        two_threads: solves per second on two threads, 1/s.
        peak_memory: peak memory of the process, bytes.
    """

    contacts: int
    problems: int
    one_thread: float
    two_threads: float
    peak_memory: int


def pin(cores: set[int] | None) -> None:
    """Pin this process to some cores, if the system supports it.

    Args:
        cores: indices of the cores; None for one core.
    """
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores or {max(os.sched_getaffinity(0))})


def random_problem(rng: np.random.Generator, count: int) -> ForceProblem:
    """Return a feasible problem: point contacts near a sphere of 2 to 8 cm radius, one three-joint finger each.

    The torque limits exceed the torques of one feasible set of forces by 2 % to 50 %, and by 0.02 N·m.

    Args:
        rng: random generator.
        count: number of contacts.
    """
    radius = rng.uniform(0.02, 0.08)  # m
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    contacts = ContactSet.stack(
        [Contact(-radius * n + rng.normal(size=3) * 0.005, n, rng.uniform(0.2, 1.0), max_normal=50.0) for n in normals]
    )
    normal = np.minimum(rng.exponential(3.0, count) + 0.05, 40.0)  # N
    tangential = rng.normal(size=(count, 2))
    tangential *= (0.6 * contacts.mu * normal * rng.random(count) / np.linalg.norm(tangential, axis=1))[:, None]  # N
    f = np.column_stack([tangential, normal]).ravel()
    J = np.zeros((3 * count, 3 * count))
    for i in range(count):
        J[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = rng.normal(size=(3, 3)) * 0.05  # m/rad
    tau_u = rng.normal(size=3 * count) * 0.02  # N·m
    torque_limit = np.abs(tau_u + J.T @ f) * rng.uniform(1.02, 1.5, 3 * count) + 0.02  # N·m
    return ForceProblem(contacts, grasp_matrix(contacts) @ f, Actuation(J, tau_u, -torque_limit, torque_limit))


def perturbed(rng: np.random.Generator, problem: ForceProblem, share: float) -> ForceProblem:
    """Return the problem with wrench, Jacobian and bias torques changed at random.

    Args:
        rng: random generator.
        problem: the problem.
        share: largest relative change of each number.
    """
    assert problem.actuation is not None  # random_problem gives it one
    w = problem.w * (1.0 + share * rng.uniform(-1.0, 1.0, 6))
    J = problem.actuation.J * (1.0 + share * rng.uniform(-1.0, 1.0, problem.actuation.J.shape))
    return problem.replace(
        w=w, J=J, tau_u=problem.actuation.tau_u * (1.0 + share * rng.uniform(-1.0, 1.0, problem.actuation.tau_u.shape))
    )


def measure(sizes: tuple[int, ...], rounds: int, progress: Callable[[str], None]) -> list[Row]:
    """Measure all subjects at all sizes.

    Args:
        sizes: numbers of contacts.
        rounds: bursts per size; fewer above 20 contacts.
        progress: callback with the current size and round.
    """
    rows = []
    for count in sizes:
        bursts = max(5, rounds * 20 // max(count, 20))
        seconds: dict[str, list[float]] = {}
        steps: dict[str, list[int]] = {}
        rng = np.random.default_rng(count)
        for burst in range(bursts):
            progress(f"{count} contacts, round {burst + 1} of {bursts}")
            problem = random_problem(rng, count)
            nearby = [perturbed(rng, problem, 0.01) for _ in range(_BURST)]
            for subject in subjects(problem, nearby):
                times, iterations = seconds.setdefault(subject.name, []), steps.setdefault(subject.name, [])
                for i in range(_BURST):
                    start = time.perf_counter()
                    output = subject.run(i)
                    elapsed = time.perf_counter() - start
                    if i > 0:
                        times.append(elapsed if subject.is_certified(i, output) else math.nan)
                        iterations.append(subject.iterations(output))
        peer = np.array(seconds[PEER])
        rows += [_row(name, count, np.array(own), peer, steps[name]) for name, own in seconds.items()]
    return rows


def _row(name: str, count: int, seconds: np.ndarray, peer: np.ndarray, steps: list[int]) -> Row:
    certified = seconds[np.isfinite(seconds)]
    if not len(certified):
        return Row(name, count, math.nan, math.nan, math.nan, math.nan, math.nan, 0, len(seconds))
    ratio = float(np.nanmedian(peer / seconds))
    spread = (float(np.median(certified)), float(np.quantile(certified, 0.99)), float(certified.max()))
    return Row(name, count, *spread, ratio, float(np.median(steps)), len(certified), len(seconds))


def throughput(contacts: int, problems: int, repeats: int) -> Throughput:
    """Measure the throughput of stacked problems on one thread and on two: the best of several repeats, in turn.

    Args:
        contacts: number of contacts of each problem.
        problems: number of problems.
        repeats: number of repeats.
    """
    rng = np.random.default_rng(contacts)
    problem = random_problem(rng, contacts)
    assert problem.actuation is not None  # random_problem gives it one
    w = problem.w * (1.0 + 0.01 * rng.uniform(-1.0, 1.0, (problems, 6)))
    J = problem.actuation.J * (1.0 + 0.01 * rng.uniform(-1.0, 1.0, (problems, *problem.actuation.J.shape)))
    best = {1: math.inf, 2: math.inf}
    for _ in range(repeats):
        for threads in best:
            start = time.perf_counter()
            solve_stack(problem, w=w, J=J, threads=threads)
            best[threads] = min(best[threads], time.perf_counter() - start)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return Throughput(contacts, problems, problems / best[1], problems / best[2], memory)

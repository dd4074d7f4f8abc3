"""Times of solvers on seeded force problems, in one process, pinned to one core, each as a ratio to a peer in the same round.

The peer is raw Clarabel: its set-up and solve on arrays that are already built. Rounds go through all subjects in turn, so
that a machine whose speed drifts slows them alike, each with a burst of problems near one another, the first of them to warm
up; an answer that no certificate stands behind gets no time.
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

_BURST = 6  # problems near one another that a subject solves at a time, the first to warm up


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """One subject at one number of contacts: times in s, the ratio to the peer of the same round, median iterations."""

    subject: str
    contacts: int
    median: float
    p99: float
    largest: float
    ratio: float
    iterations: float
    certified: int
    asked: int


@dataclass(frozen=True, eq=False, slots=True)
class Throughput:
    """Solves a second of stacked problems, and the peak memory of the process, bytes."""

    contacts: int
    problems: int
    one_thread: float
    two_threads: float
    peak_memory: int


def pin(cores: set[int] | None) -> None:
    """Keep this process on one core, or give it back the ones named, where the system allows it."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores or {max(os.sched_getaffinity(0))})


def random_problem(rng: np.random.Generator, count: int) -> ForceProblem:
    """Return a feasible grasp: point contacts on a lump of 2 to 8 cm, one three-joint finger each, loose torque limits."""
    radius = rng.uniform(0.02, 0.08)  # m
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    contacts = ContactSet.stack(
        [Contact(-radius * n + rng.normal(size=3) * 0.005, n, rng.uniform(0.2, 1.0), max_normal=50.0) for n in normals]
    )
    pressing = np.minimum(rng.exponential(3.0, count) + 0.05, 40.0)  # N
    tangential = rng.normal(size=(count, 2))
    tangential *= (0.6 * contacts.mu * pressing * rng.random(count) / np.linalg.norm(tangential, axis=1))[:, None]  # N
    f = np.column_stack([tangential, pressing]).ravel()
    J = np.zeros((3 * count, 3 * count))
    for i in range(count):
        J[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = rng.normal(size=(3, 3)) * 0.05  # m/rad
    tau_u = rng.normal(size=3 * count) * 0.02  # N·m
    torque_limit = np.abs(tau_u + J.T @ f) * rng.uniform(1.02, 1.5, 3 * count) + 0.02  # N·m
    return ForceProblem(contacts, grasp_matrix(contacts) @ f, Actuation(J, tau_u, -torque_limit, torque_limit))


def perturbed(rng: np.random.Generator, problem: ForceProblem, share: float) -> ForceProblem:
    """Return the problem with wrench, Jacobian and bias torques changed by up to a fraction of each number."""
    assert problem.actuation is not None  # random_problem gives it one
    w = problem.w * (1.0 + share * rng.uniform(-1.0, 1.0, 6))
    J = problem.actuation.J * (1.0 + share * rng.uniform(-1.0, 1.0, problem.actuation.J.shape))
    return problem.replace(
        w=w, J=J, tau_u=problem.actuation.tau_u * (1.0 + share * rng.uniform(-1.0, 1.0, problem.actuation.tau_u.shape))
    )


def measure(sizes: tuple[int, ...], rounds: int, progress: Callable[[str], None]) -> list[Row]:
    """All subjects at all sizes.

    Args:
        sizes: numbers of contacts.
        rounds: bursts a size; fewer where there are more than 20 contacts.
        progress: told what is being measured.
    """
    rows = []
    for count in sizes:
        asked = max(5, rounds * 20 // max(count, 20))
        seconds: dict[str, list[float]] = {}
        steps: dict[str, list[int]] = {}
        rng = np.random.default_rng(count)
        for round_ in range(asked):
            progress(f"{count} contacts, round {round_ + 1} of {asked}")
            problem = random_problem(rng, count)
            nearby = [perturbed(rng, problem, 0.01) for _ in range(_BURST)]
            for subject in subjects(problem, nearby):
                taken, found = seconds.setdefault(subject.name, []), steps.setdefault(subject.name, [])
                for i in range(_BURST):
                    start = time.perf_counter()
                    answer = subject.run(i)
                    took = time.perf_counter() - start
                    if i > 0:
                        taken.append(took if subject.is_certified(i, answer) else math.nan)
                        found.append(subject.iterations(answer))
        peer = np.array(seconds[PEER])
        rows += [_row(name, count, np.array(times), peer, steps[name]) for name, times in seconds.items()]
    return rows


def _row(name: str, count: int, seconds: np.ndarray, peer: np.ndarray, steps: list[int]) -> Row:
    good = seconds[np.isfinite(seconds)]
    if not len(good):
        return Row(name, count, math.nan, math.nan, math.nan, math.nan, math.nan, 0, len(seconds))
    ratio = float(np.nanmedian(peer / seconds))
    spread = (float(np.median(good)), float(np.quantile(good, 0.99)), float(good.max()))
    return Row(name, count, *spread, ratio, float(np.median(steps)), len(good), len(seconds))


def throughput(contacts: int, problems: int, repeats: int) -> Throughput:
    """Stacked problems a second on one thread and on two, the best of some repeats taken in turn."""
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

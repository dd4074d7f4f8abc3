"""Times of solvers on seeded force problems, in one process, pinned to one core, each as a ratio to a peer in the same round.

The peer is raw Clarabel on the cone program that is already built: its set-up and solve and nothing else. Rounds go through
all subjects in turn, so that a machine whose speed drifts slows them alike; an answer without certificate gets no time.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graspforce import Actuation, Cone, Contact, ContactSet, ForceProblem, Solver, solve
from graspforce.backends import clarabel
from graspforce.grasp import grasp_matrix
from graspforce.program import conic_program

_FACETS = 8


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """One subject at one size: times in s, ratios to the peer of the same round."""

    subject: str
    contacts: int
    median: float
    p99: float
    largest: float
    ratio: float
    certified: int
    asked: int


def pin_to_one_core() -> None:
    """Keep this process on one core, where the system allows it."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def random_problem(rng: np.random.Generator, count: int, cone: Cone | None = None) -> ForceProblem:
    """A feasible grasp: point contacts on a lump of 2 to 8 cm, one three-joint finger each, torque limits with some room."""
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
    room = np.abs(tau_u + J.T @ f) * rng.uniform(1.001, 1.5, 3 * count) + 0.02  # N·m
    return ForceProblem(contacts, grasp_matrix(contacts) @ f, Actuation(J, tau_u, -room, room), cone)


def measure(sizes: tuple[int, ...], rounds: int, progress: Callable[[str], None]) -> list[Row]:
    """All subjects at all sizes.

    Args:
        sizes: numbers of contacts.
        rounds: problems a size, after two to warm up.
        progress: told what is being measured.
    """
    rows = []
    for count in sizes:
        progress(f"{count} contacts")
        times: dict[str, list[float]] = {}
        peers: list[float] = []
        rng = np.random.default_rng(count)
        for round_ in range(rounds + 2):
            problem = random_problem(rng, count)
            found = _one_round(problem)
            if round_ >= 2:
                peers.append(found.pop("raw Clarabel, set-up + solve"))
                for subject, seconds in found.items():
                    times.setdefault(subject, []).append(seconds)
        times = {"raw Clarabel, set-up + solve": peers, **times}
        for subject, seconds in times.items():
            good = np.array(seconds)
            ratio = float(np.nanmedian(good / np.array(peers)))
            fine = good[np.isfinite(good)]
            spread = (float(np.median(fine)), float(np.quantile(fine, 0.99)), float(fine.max())) if len(fine) else (np.nan,) * 3
            rows.append(Row(subject, count, *spread, ratio, len(fine), len(good)))
    return rows


def _one_round(problem: ForceProblem) -> dict[str, float]:
    """Seconds of every subject on one problem; NaN without a certified answer."""
    pyramid = ForceProblem(problem.contacts, problem.w, problem.hand, Cone("pyramid", _FACETS, "inner"))
    program = conic_program(problem)
    nearby = problem.w * 1.005
    warm_cone, warm_pyramid = Solver(problem), Solver(pyramid, "proxqp")
    warm_cone.solve()
    warm_pyramid.solve()
    subjects: dict[str, Callable[[], object]] = {
        "raw Clarabel, set-up + solve": lambda: clarabel.solve_program(program),
        "solve(problem)": lambda: solve(problem, explain=False),
        "Solver, load changed by 0.5 %": lambda: warm_cone.solve(w=nearby),
        f"solve(…, 'proxqp'), {_FACETS} facets": lambda: solve(pyramid, "proxqp", explain=False),
        f"Solver 'proxqp' warm, {_FACETS} facets": lambda: warm_pyramid.solve(w=nearby),
        f"solve(…, 'quadprog'), {_FACETS} facets": lambda: solve(pyramid, "quadprog", explain=False),
    }
    seconds = {}
    for subject, run in subjects.items():
        start = time.perf_counter()
        answer = run()
        took = time.perf_counter() - start
        certificate = getattr(answer, "certificate", None)
        own = getattr(answer, "backend", "") in subject.lower() or "'" not in subject
        seconds[subject] = took if certificate is None or (certificate.verified and own) else float("nan")
    return seconds

"""Learned starts of the force solver.

A fingertip grasp of a ball of 60 mm and 150 g: the object is at random places up to 5 mm from the grasp, with accelerations up
to 5 m/s² and moments up to 5 mN·m. From wrench and posture, learned from 1000 solved problems, follow the forces of least
torque, and with them a start for 300 other feasible problems. Starts are: *cold*; the *last* solution, of a problem that is not
related, or of the problem 1 ms earlier on a smooth path of the same object, which is the ordinary warm start of `Solver`; the
solution of the *nearest* solved problem in wrench and posture; the solution of the solved problem whose forces are nearest to
those that a network with 50 hidden units predicts (*network*); and, as a limit for every learned start, the exact solution of
the same problem with all multipliers (*exact*). The machine was shared: use the ratios. Each start of the kernel has forces,
active set and multipliers. Time is the median of processor time for the start and the certified solution; in parentheses
without the time to predict the forces and to find the nearest problem (a k-d tree). The certificate is the judge: all solutions
are certified, and a start that does not help costs time only.

*Active set*: the fraction of problems in which the network's forces have the same contacts on the edge of their friction cone,
and the same normal forces at their limit, as the solution, to 1 % of the force; the time of its prediction; and the time of a
single dense solve of the equations of an active set with NumPy, of which a solution without the kernel takes several.

*ProxQP*: the same problems with pyramids of 8 facets, with the network's forces as `guess`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

import graspforce as gf
from benchmarks import report_page
from graspforce import Hand
from graspforce.core.arrays import Array
from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.backends.structured import KernelSession
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Cone
from graspforce.force.solution import Solution, uncertified_solution
from graspforce.force.status import Status
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.hand.hand import GRAVITY_PALM_UP
from graspforce.learning.inverse_kinematics import Network, fit_network

TITLE = "Starts of the force solver"
HANDS = ("four_finger", "allegro_right", "dlr_hit2")
_TRAIN, _TEST, _PROXQP = 1000, 300, 100
_PATH_STEP = 1e-3  # s
_MASS, _SHIFT, _ACCELERATION, _MOMENT = 0.15, 0.005, 5.0, 5e-3  # kg, m, m/s², N·m
_ACTIVE = 0.01  # of a force


class _Case(NamedTuple):
    """One problem, its features (wrench and posture) and its forces."""

    problem: ForceProblem
    features: Array
    f: Array
    iterations: int


def run(_records: Path, _pictures: Path) -> list[dict[str, Any]]:
    """Compare the starts for all hands."""
    return [_compare(name) for name in HANDS]


def _cases(hand: Hand, poses: list[tuple[Array, Array, Array]]) -> list[_Case]:
    """Return the feasible problems of object shifts (m), accelerations (m/s²) and moments (N·m)."""
    grasp = find_grasp(hand, Body.solid(Sphere(0.03), _MASS), gravity_H=GRAVITY_PALM_UP)
    found, q = [], grasp.q
    for shift, acceleration, moment in poses:
        p = grasp.p_HO + shift
        try:
            q = hand.grasp_posture(grasp.fingers, grasp.contacts, p, grasp.R_HO, grasp.q)
        except gf.GraspForceError:
            continue
        tau_u = hand.gravity_torque(q, GRAVITY_PALM_UP)
        actuation = hand.actuation(q, grasp.fingers, grasp.contacts, p, grasp.R_HO, tau_u=tau_u)
        w = np.concatenate([grasp.R_HO.T @ (_MASS * (acceleration - np.asarray(GRAVITY_PALM_UP))), moment])
        problem = ForceProblem(grasp.contacts, w, actuation)
        solution = gf.solve(problem, explain=False)
        if solution.found:
            found.append(_Case(problem, np.concatenate([w, q]), np.array(solution.f), solution.iterations))
    return found


def _random_poses(rng: np.random.Generator, count: int) -> list[tuple[Array, Array, Array]]:
    """Return random shifts, accelerations and moments."""

    def ball(radius: float) -> Array:
        v = rng.normal(size=3)
        return np.asarray(radius * rng.uniform() ** (1 / 3) * v / np.linalg.norm(v))

    return [(ball(_SHIFT), ball(_ACCELERATION), ball(_MOMENT)) for _ in range(count)]


def _path_poses(count: int) -> list[tuple[Array, Array, Array]]:
    """Return a smooth path at the rate of a controller."""
    t = _PATH_STEP * np.arange(count)
    rates = 2.0 * np.pi * np.array([1.0, 1.4, 0.8])  # rad/s
    shift = 0.5 * _SHIFT * np.sin(t[:, None] * rates)
    moment = 0.5 * _MOMENT * np.cos(t[:, None] * rates[::-1])
    return list(zip(shift, -shift * rates**2, moment, strict=True))


_Prime = Callable[[int], _Case | None]  # the solved problem to start from, by the index of a problem; None for a cold start


class _Starts:
    """The learned starts: which solved problem to start from.

    Args:
        train: the solved problems.
    """

    def __init__(self, train: list[_Case]) -> None:
        x, f = np.array([each.features for each in train]), np.array([each.f for each in train])
        spread = x.std(axis=0)
        self._scale = np.where(spread > 1e-9, spread, 1.0)
        self._x, self._f = cKDTree(x / self._scale), cKDTree(f)
        self.network: Network = fit_network(x, f)

    def nearest(self, features: Array) -> int:
        """Return the solved problem with the nearest wrench and posture."""
        return int(self._x.query(features / self._scale)[1])

    def by_forces(self, features: Array) -> int:
        """Return the solved problem with the forces nearest to the predicted ones."""
        return int(self._f.query(self.network.predict(features))[1])


def _compare(hand_name: str) -> dict[str, Any]:
    """Return iterations and times of all starts for one hand."""
    rng = np.random.default_rng(0)
    hand = Hand.load(hand_name)
    cases = _cases(hand, _random_poses(rng, int(1.3 * (_TRAIN + _TEST))))
    train, test = cases[:_TRAIN], cases[_TRAIN : _TRAIN + _TEST]
    path = _cases(hand, _path_poses(_TEST))
    starts = _Starts(train)
    session = KernelSession(train[0].problem, SolverSettings())

    def measure(chosen: list[_Case], prime: _Prime, predict: Callable[[Array], Any] | None = None) -> dict[str, Any]:
        iterations, times, alone, certified = [], [], [], 0
        for i, case in enumerate(chosen):
            first = prime(i)
            own = KernelSession(case.problem, SolverSettings()) if first is None else session
            if first is not None:
                _step(own, first)
            begin = time.process_time_ns()
            if predict is not None:
                predict(case.features)
            middle = time.process_time_ns()
            solution = _step(own, case)
            end = time.process_time_ns()
            times.append(1e-3 * (end - begin))
            alone.append(1e-3 * (end - middle))
            iterations.append(solution.iterations)
            certified += int(solution.found and solution.is_final)
        return {
            "iterations": float(np.mean(iterations)),
            "time": float(np.median(times)),
            "alone": float(np.median(alone)),
            "certified": certified,
        }

    results: dict[str, Any] = {"hand": hand_name, "size": test[0].problem.size, "counts": [len(train), len(test), len(path)]}
    for kind, own in (("random", test), ("path", path)):
        primes: dict[str, tuple[_Prime, Callable[[Array], Any] | None]] = {
            "cold": (lambda i: None, None),
            "last": (lambda i, own=own: own[i - 1], None),  # type: ignore[misc]
            "nearest": (lambda i, own=own: train[starts.nearest(own[i].features)], starts.nearest),  # type: ignore[misc]
            "network": (lambda i, own=own: train[starts.by_forces(own[i].features)], starts.by_forces),  # type: ignore[misc]
            "exact": (lambda i, own=own: own[i], None),  # type: ignore[misc]
        }
        results[kind] = {name: measure(own, *start) for name, start in primes.items()}
    results["active"] = _active_set(starts, test)
    results["proxqp"] = _proxqp(starts, test[:_PROXQP])
    return results


def _step(session: KernelSession, case: _Case) -> Solution:
    """Return the solution of a problem from the last one of a session."""
    actuation = case.problem.actuation
    assert actuation is not None
    return session.solve(w=case.problem.w, J=actuation.J, tau_u=actuation.tau_u)


def _active_set(starts: _Starts, test: list[_Case]) -> dict[str, float]:
    """Return how often the predicted forces have the active set of the solution, and the times of its use."""
    hits, times = 0, []
    for case in test:
        begin = time.process_time_ns()
        f = starts.network.predict(case.features)
        times.append(1e-3 * (time.process_time_ns() - begin))
        hits += int((_is_active(case.problem, f) == _is_active(case.problem, case.f)).all())
    size = test[0].problem.size + 6 + len(test[0].problem.contacts)
    matrix, solves = np.random.default_rng(0).normal(size=(size, size)), []
    for _ in range(200):
        begin = time.process_time_ns()
        np.linalg.solve(matrix, matrix[0])
        solves.append(1e-3 * (time.process_time_ns() - begin))
    error = [np.linalg.norm(starts.network.predict(case.features) - case.f) / np.linalg.norm(case.f) for case in test]
    return {
        "hits": hits / len(test),
        "error": float(np.median(error)),
        "prediction": float(np.median(times)),
        "solve": float(np.median(solves)),
    }


def _is_active(problem: ForceProblem, f: Array) -> Array:
    """Return (2 N,) which friction cones and largest normal forces are active."""
    forces = f.reshape(-1, 3)
    tangential, normal = np.linalg.norm(forces[:, :2], axis=1), forces[:, 2]
    edge = tangential >= (1.0 - _ACTIVE) * problem.contacts.mu * normal
    return np.concatenate([edge, normal >= (1.0 - _ACTIVE) * problem.contacts.max_normal])


def _proxqp(starts: _Starts, test: list[_Case]) -> dict[str, Any]:
    """Return iterations and times of ProxQP with pyramids: cold, with the network's forces, and with those of the solution."""
    rows: dict[str, Any] = {}
    own = [each.problem for each in test]
    problems = [ForceProblem(each.contacts, each.w, each.actuation, cone=Cone("pyramid", 8)) for each in own]
    exact = [gf.solve(problem, "proxqp", explain=False) for problem in problems]
    for name in ("cold", "network", "exact"):
        iterations, times, certified = [], [], 0
        for case, problem, solution in zip(test, problems, exact, strict=True):
            begin = time.process_time_ns()
            guess = None
            if name != "cold":
                f = starts.network.predict(case.features) if name == "network" else np.array(solution.f)
                guess = uncertified_solution(problem, Status.OPTIMAL, f, None, backend="", iterations=0, seconds=0.0)
            found = gf.solve(problem, "proxqp", guess=guess, explain=False)
            times.append(1e-3 * (time.process_time_ns() - begin))
            iterations.append(found.iterations)
            certified += int(found.found)
        rows[name] = {"iterations": float(np.mean(iterations)), "time": float(np.median(times)), "certified": certified}
    return rows


def page(results: list[dict[str, Any]]) -> str:
    """Return the tables.

    Args:
        results: of `run`.
    """
    names = ("cold", "last", "nearest", "network", "exact")

    def cell(name: str, figures: dict[str, float]) -> str:
        alone = f" ({figures['alone']:.0f})" if name in ("nearest", "network") else ""
        return f"{figures['iterations']:.1f}, {figures['time']:.0f}{alone} µs"

    rows = [
        (each["hand"], kind, *(cell(name, each[kind][name]) for name in names))
        for each in results
        for kind in ("random", "path")
    ]
    total = sum(each["counts"][1] + each["counts"][2] for each in results)
    certified = {name: sum(each[kind][name]["certified"] for each in results for kind in ("random", "path")) for name in names}
    active = [
        (
            each["hand"],
            f"{100 * each['active']['error']:.1f} %",
            f"{100 * each['active']['hits']:.0f} %",
            f"{each['active']['prediction']:.1f} µs",
            f"{each['active']['solve']:.1f} µs",
            *(
                f"{each['proxqp'][name]['iterations']:.1f}, {each['proxqp'][name]['time']:.0f} µs"
                for name in ("cold", "network", "exact")
            ),
        )
        for each in results
    ]
    head = (
        "hand",
        "median force error",
        "active set right",
        "prediction",
        "one dense solve",
        "ProxQP, cold",
        "ProxQP, network",
        "ProxQP, exact",
    )
    first, second = report_page.table(("hand", "problems", *names), rows, 2), report_page.table(head, active)
    counts = ", ".join(f"{certified[name]} ({name})" for name in names)
    note = f"Mean iterations, and median time. Certified: {counts} of {total}."
    return f"{first}\n\n{note}\n\n{second}\n\n{_verdict(results)}"


def _verdict(results: list[dict[str, Any]]) -> str:
    """Return whether a learned start pays: it saves time over the cold start, and on a path over the last solution."""
    saved = []
    for kind, usual in (("random", "cold"), ("path", "last")):
        ratios = [
            min(each[kind][name]["time"] for name in ("nearest", "network")) / each[kind][usual]["time"] for each in results
        ]
        saved.append((usual, min(ratios), max(ratios)))
    pays = all(high < 1.0 for _, _, high in saved)
    alone = [
        min(each["random"][name]["alone"] for name in ("nearest", "network")) / each["random"]["cold"]["time"]
        for each in results
    ]
    texts = [f"{low:.1f} to {high:.1f} times the time of the {usual} start" for usual, low, high in saved]
    return (
        f"The better learned start takes {texts[0]} for random problems, and {texts[1]} on a path; "
        f"without prediction and search, {min(alone):.1f} to {max(alone):.1f} times the time of the cold start. "
        + ("It pays." if pays else "It does not pay, and `Solver` has no learned start.")
    )

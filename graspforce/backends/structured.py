"""Our own kernel: exact cones, torque limits and their proof in tens of microseconds (`structured.h`, `certify.h`).

It takes problems whose fingers share few joints, with the objectives that are quadratic or linear in the forces. The compiled
module may be absent, where there was no compiler: `available` tells.
"""

from __future__ import annotations

import contextlib
import importlib
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce import friction
from graspforce.arrays import Array, frozen
from graspforce.errors import BackendError
from graspforce.problem import ForceProblem, Objective
from graspforce.scale import ScaleRows, rescaled, standing
from graspforce.solution import Multipliers, Solution, Status

Kernel: Any = None
with contextlib.suppress(ImportError):  # it was not built: there was no compiler
    Kernel = importlib.import_module("graspforce.backends._structured").Kernel

_TOLERANCE = 1e-9  # of scaled residuals: a tenth of what the certificate asks
_MOST_ITERATIONS = 60
_LARGEST_BLOCK = 48  # force components that share joints; beyond, dense blocks cost more than a sparse solver
_OBJECTIVES = ("torque", "force", "sum_normal")
_STATUS = (Status.OPTIMAL, Status.INACCURATE, Status.INFEASIBLE, Status.FAILED)
_NO_FACETS = (np.zeros((0, 4)), np.zeros(0, dtype=np.intc))
_REPORT = 8  # status, iterations, primal, dual and gap as solved; primal, dual and gap as certified

Indices = npt.NDArray[np.intc]


def available() -> bool:
    """Whether the kernel was built when this package was installed."""
    return Kernel is not None


def solve(problem: ForceProblem, previous: Solution | None = None) -> Solution:
    """The answer by the structured kernel, on exact cones and on pyramids.

    Args:
        problem: a problem with the objective "torque", "force" or "sum_normal" whose fingers share few joints.
        previous: this backend's answer to a problem of the same shape, to start from.

    Raises:
        BackendError: another objective, too many fingers on shared joints, or the kernel was not built.
    """
    start = time.perf_counter()
    bound = None if previous is None else previous.restart
    warm = isinstance(bound, _Bound) and bound.load(problem)
    if not warm:
        bound = _Bound(problem)
    assert isinstance(bound, _Bound)  # by one of the two ways above
    return bound.solve(start, warm)


class _Bound:
    """A kernel bound to arrays of its own, into which later problems of the same shape are written."""

    def __init__(self, problem: ForceProblem) -> None:
        self._problem = problem
        self._k, self._count = problem.size, len(problem.contacts)
        self._n = 0 if problem.hand is None else len(problem.hand.tau_u)
        structure, self._inputs = _structure(problem), _inputs(problem)
        self._answer = np.zeros(_answer_width(problem))
        self._report = np.zeros(_REPORT)
        self._units = np.ones(3 + self._n)
        self._kernel = Kernel(*structure, *self._inputs.values(), self._units, self._answer, self._report)
        self._standing = standing(problem)
        self._weigh()

    def _weigh(self) -> None:
        """The problem's own units, by which the certificate measures."""
        unit = rescaled(self._standing, self._problem.w_centred)
        self._units[0], self._units[1], self._units[2], self._units[3:] = unit.force, unit.length, unit.cost, unit.torque

    def load(self, problem: ForceProblem) -> bool:
        """Write another problem's numbers where the kernel reads them; False where its shape is another."""
        old, self._problem = self._problem, problem
        if problem.contacts is not old.contacts:
            if problem.contacts.models != old.contacts.models or problem.cone.type == "pyramid":
                return False
            for name in ("mu", "gamma", "min_normal", "max_normal"):
                self._inputs[name][:] = getattr(problem.contacts, name)
            self._inputs["G"][:] = problem.G_centred
        if problem.cone is not old.cone and problem.cone != old.cone:
            return False
        if problem.objective is not old.objective and problem.objective != old.objective:
            return False
        self._inputs["w"][:] = problem.w_centred
        hand, before = problem.hand, old.hand
        if hand is not before:
            if hand is None or before is None or hand.J.shape != before.J.shape:
                return False
            for name in ("J", "tau_u", "lower", "upper"):
                if getattr(hand, name) is not getattr(before, name):
                    self._inputs[name][:] = getattr(hand, name)
            if hand.weight is not before.weight and problem.objective.type == "torque":
                self._inputs["weight"][:] = hand.weight
        if hand is not before or problem.contacts is not old.contacts:
            self._standing = standing(problem)
        self._weigh()
        return True

    def solve(self, start: float, warm: bool) -> Solution:
        """Run the kernel on what was loaded, and measure its answer by the certificate in C."""
        number, iterations, measured = self._kernel.step(_TOLERANCE, _MOST_ITERATIONS, warm)
        status = _STATUS[number]
        found = number <= 1
        x, k, N, n = frozen(self._answer), self._k, self._count, self._n
        multipliers = None
        if found or status is Status.INFEASIBLE:
            y, nu, torque = self._problem.multipliers_about_O(x[k : k + 6]), 2 * k + 6, 2 * k + 6 + 2 * N
            limits = (x[nu : nu + N], x[nu + N : torque], x[torque : torque + n], x[torque + n : torque + 2 * n])
            multipliers = Multipliers(y, *limits, np.zeros(N))
        return Solution(
            status,
            self._problem,
            x[:k] if found else x[:0],
            None,
            None,
            "structured",
            iterations,
            time.perf_counter() - start,
            multipliers,
            self,
            measured,
        )


def solve_rows(problem: ForceProblem, rows: Mapping[str, Array], units: ScaleRows) -> tuple[Array, Array]:
    """Problems that differ from one in some arrays, solved and certified one after another, without Python between.

    Args:
        problem: what all share; exact cones.
        rows: "w", "J", "tau_u": arrays whose first axis is the problem's number; w about the contacts' centroid.
        units: each problem's own units.

    Returns:
        (M, k + n) forces and torques, and (M, 8) reports: status, iterations, the kernel's own residuals, and the
        certificate's.

    Raises:
        BackendError: as `solve`.
    """
    inputs = {name: np.ascontiguousarray(rows.get(name, array)) for name, array in _inputs(problem).items()}
    count = len(units.force)
    answer, report = np.zeros((count, _answer_width(problem))), np.zeros((count, _REPORT))
    weights = np.column_stack([units.force, np.full(count, units.length), units.cost, units.torque])
    kernel = Kernel(*_structure(problem), *inputs.values(), np.ascontiguousarray(weights), answer, report)
    kernel.solve(0, count, _TOLERANCE, _MOST_ITERATIONS, False)
    kernel.certify(0, count)
    n = 0 if problem.hand is None else len(problem.hand.tau_u)
    return np.hstack([answer[:, : problem.size], answer[:, answer.shape[1] - n :]]), report


def _structure(problem: ForceProblem) -> tuple[Indices, Indices, Indices, Indices]:
    """Components and block of each contact, block of each joint, contact of each facet.

    Raises:
        BackendError: the kernel does not take such a problem, or was not built.
    """
    if Kernel is None:
        raise BackendError("structured was not built when graspforce was installed: there was no C compiler")
    if problem.objective.type not in _OBJECTIVES:
        raise BackendError(f"structured takes the objectives {', '.join(_OBJECTIVES)}, not {problem.objective.type}")
    components = np.array([len(model.columns) for model in problem.contacts.models], dtype=np.intc)
    contact_block, joint_block = _fingers(problem)
    largest = int(np.bincount(contact_block, weights=components).max())
    if largest > _LARGEST_BLOCK:
        raise BackendError(f"structured takes at most {_LARGEST_BLOCK} force components that share joints, not {largest}")
    return components, contact_block, joint_block, _facets(problem)[1]


def _inputs(problem: ForceProblem) -> dict[str, Array]:
    """The numbers that the kernel reads, in its order; copies, for others to write into."""
    contacts, hand = problem.contacts, problem.hand
    torque = problem.objective.type == "torque"
    cost, none = np.zeros(problem.size), np.zeros(0)
    if problem.objective.type == "sum_normal":
        cost[contacts.normal_rows] = 1.0
    return {
        "G": np.array(problem.G_centred),
        "w": np.array(problem.w_centred),
        "mu": np.array(contacts.mu),
        "gamma": np.array(contacts.gamma),
        "min_normal": np.array(contacts.min_normal),
        "max_normal": np.array(contacts.max_normal),
        "J": none if hand is None else np.array(hand.J),
        "tau_u": none if hand is None else np.array(hand.tau_u),
        "lower": none if hand is None else np.array(hand.lower),
        "upper": none if hand is None else np.array(hand.upper),
        "weight": none if hand is None else np.array(hand.weight) if torque else np.zeros(len(hand.weight)),
        "facet": _facets(problem)[0],
        "cost": cost,
        "force_weight": np.array([_force_weight(problem.objective)]),
    }


def _answer_width(problem: ForceProblem) -> int:
    """f, y, z, the normal forces' multipliers, the torques' multipliers, and the torques."""
    n = 0 if problem.hand is None else len(problem.hand.tau_u)
    return 2 * problem.size + 6 + 2 * len(problem.contacts) + 3 * n


def _force_weight(objective: Objective) -> float:
    """ρ of ½ρ‖f‖²."""
    return objective.force_weight if objective.type == "torque" else float(objective.type == "force")


def _fingers(problem: ForceProblem) -> tuple[Indices, Indices]:
    """The block of each contact and of each joint: contacts that share a joint are in one."""
    hand, count = problem.hand, len(problem.contacts)
    own = np.arange(count, dtype=np.intc)
    if hand is None or hand.J.shape[1] == 0:
        return own, np.zeros(0, dtype=np.intc)
    uses = np.logical_or.reduceat(hand.J != 0.0, problem.contacts.first_rows, axis=0)  # (N, n)
    if uses.sum(axis=0).max() > 1:
        own = _merged(uses)
    return own, own[uses.argmax(axis=0)]


def _merged(uses: npt.NDArray[np.bool_]) -> Indices:
    """Blocks numbered from 0, the least for which no joint is used by two."""
    block = list(range(len(uses)))
    for joint in uses.T:
        sharing = {block[i] for i in np.flatnonzero(joint)}
        if len(sharing) > 1:
            least = min(sharing)
            block = [least if b in sharing else b for b in block]
    return np.unique(block, return_inverse=True)[1].astype(np.intc)


def _facets(problem: ForceProblem) -> tuple[Array, Indices]:
    """The rows aᵀ(f_t1, f_t2, f_n, m_n) ≤ 0 of pyramids, and whose they are; none for exact cones and without friction."""
    contacts, cone = problem.contacts, problem.cone
    if cone.type == "exact":
        return _NO_FACETS
    rows, owners = [_NO_FACETS[0]], [_NO_FACETS[1]]
    mu = friction.pyramid_friction(contacts.mu, cone.facets, cone.side)
    for i in np.flatnonzero(contacts.mu > 0):
        gamma = float(contacts.gamma[i])
        a = friction.pyramid_facets(cone.facets, cone.side, gamma)
        twist = a[:, 2] * (mu[i] / gamma if gamma else 0.0)
        rows.append(np.column_stack([a[:, 0], a[:, 1], np.full(len(a), -mu[i]), twist]))
        owners.append(np.full(len(a), i, dtype=np.intc))
    return np.vstack(rows), np.concatenate(owners)

"""Derivatives of optimal forces against central differences: `python -m benchmarks.sensitivities --count 1000`.

Random problems of three to five frictionless, point and soft contacts. A quarter each has the cost of the torques of a hand,
½‖f‖² with a hand, ½‖f‖² without one, and the sum of normal forces. Problems with a degenerate optimum are counted and replaced.

Each block of data changes along a random direction of its own size. The optima at both ends are solved again, certified, and
refined by Newton's method; they count only if their active limits are those of the optimum. Steps are 4⁻⁴ to 4⁻¹⁰ of the data.
Two steps make a Richardson extrapolation, and the difference of two neighbouring extrapolations estimates its error. The
extrapolation with the least estimate is the reference; the analytic derivative has no part in this choice.

Errors are relative to the largest entry of the derivative of f, of tau, or of the objective; where that is below 1e-3 of the
quantity itself, to 1e-3 of the quantity. "Not compared" are blocks without three steps between the same active limits, or whose
reference has an estimated error above 1e-6.

Adjoint against forward products: |⟨x̄, D θ̇⟩ − ⟨Dᵀ x̄, θ̇⟩| for random x̄ and θ̇, relative to the sum of the sizes of all terms.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import graspforce as gf
from benchmarks import report_page
from graspforce.analysis.optimality import Optimum, find_optimum
from graspforce.analysis.sensitivity import Sensitivities
from graspforce.contact.matrices import grasp_matrix
from graspforce.core.arrays import Array
from graspforce.force.problem_data import change_problem

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.random_problems import inner_forces, random_actuation, random_contacts

KINDS = ("torque", "force", "object", "sum_normal")
SIZES = {"w": 1.0, "mu": 0.3, "p": 0.03, "rotation": 0.3, "tau_u": 0.05, "torque_lower": 0.1, "torque_upper": 0.1, "J": 0.05}
STEPS = tuple(4.0**-power for power in range(4, 11))
ENOUGH = 1e-8  # estimated error at which no smaller step is tried
LARGEST_ESTIMATE = 1e-6  # of the error of a reference
HEAD = ("data", "blocks compared", "not zero", "largest error", "above 1e-5", "not compared", "adjoint: largest error")


@dataclass
class BlockErrors:
    """Errors of one block of data.

    Args:
        errors: relative errors against central differences.
        adjoint: relative differences of adjoint and forward products.
        not_zero: number of compared blocks whose derivative is not zero.
        not_compared: number of blocks without a reference.
    """

    errors: list[float] = field(default_factory=list)
    adjoint: list[float] = field(default_factory=list)
    not_zero: int = 0
    not_compared: int = 0


def problem_of(kind: str, rng: np.random.Generator) -> gf.ForceProblem:
    """Return a random feasible problem.

    Args:
        kind: one of `KINDS`.
        rng: random numbers.
    """
    contacts = gf.ContactSet.stack(random_contacts(rng, int(rng.integers(3, 6))))
    f = inner_forces(rng, contacts, share=0.9)
    actuation = None if kind == "object" else random_actuation(rng, contacts, f)
    objective = gf.Objective("force", moment_length=0.02)
    if kind in ("torque", "sum_normal"):
        objective = gf.Objective("torque", force_weight=1e-4) if kind == "torque" else gf.Objective("sum_normal")
    return gf.ForceProblem(contacts, grasp_matrix(contacts) @ f, actuation, objective=objective)


def regular_answers(count: int, seed: int, skipped: dict[str, int]) -> Iterator[tuple[Sensitivities, np.random.Generator]]:
    """Yield derivatives of random problems with regular optima, a quarter of each kind.

    Args:
        count: number of problems.
        seed: seed of the random numbers.
        skipped: gets the numbers of degenerate and of unsolved problems.
    """
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        while True:
            solution = gf.solve(problem_of(KINDS[i % len(KINDS)], rng), explain=False)
            if not solution.found:
                skipped["unsolved"] += 1
                continue
            answer = gf.sensitivities(solution)
            if not answer.degenerate:
                break
            skipped["degenerate"] += 1
        yield answer, rng


def direction(problem: gf.ForceProblem, name: str, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Return a random direction of a block of data; zero where the data cannot change.

    Args:
        problem: the force problem.
        name: name of the block.
        shape: its shape.
        rng: random numbers.
    """
    change = SIZES[name] * rng.normal(size=shape)
    if name == "mu":
        change[problem.contacts.mu == 0.0] = 0.0
    if problem.actuation is not None:
        fixed = {"torque_lower": problem.actuation.lower, "torque_upper": problem.actuation.upper}.get(name)
        if fixed is not None:
            change[~np.isfinite(fixed)] = 0.0
        if name == "J":  # only within the fingers
            change *= problem.actuation.J != 0.0
    return change


def changed(problem: gf.ForceProblem, name: str, change: Array) -> gf.ForceProblem:
    """Return the problem with one block of data changed.

    Args:
        problem: the force problem.
        name: name of the block.
        change: the change; of frames a rotation vector.
    """
    c, a = problem.contacts, problem.actuation
    if name == "rotation":
        return change_problem(problem, {"R": Rotation.from_rotvec(change).as_matrix() @ c.R_OC})
    values = {"w": problem.w, "mu": c.mu, "p": c.p_OC}
    if a is not None:
        values |= {"tau_u": a.tau_u, "J": a.J, "torque_lower": a.lower, "torque_upper": a.upper}
    return change_problem(problem, {name: values[name] + change})


def outputs(optimum: Optimum) -> Array:
    """Return f, tau and the objective of an optimum in one array.

    Args:
        optimum: the optimum.
    """
    problem = optimum.problem
    return np.concatenate([optimum.f, problem.torques(optimum.f), [problem.cost(optimum.f)]])


def central_difference(optimum: Optimum, name: str, change: Array, step: float) -> Array | None:
    """Return the central difference of an optimum; None where the active limits change.

    Args:
        optimum: the optimum in the middle.
        name: name of the block of data.
        change: direction of the change.
        step: step along it.
    """
    ends = []
    for sign in (1.0, -1.0):
        try:
            solution = gf.solve(changed(optimum.problem, name, sign * step * change), explain=False)
        except gf.InvalidInput:  # beyond an allowed value, such as a negative friction coefficient
            return None
        if not solution.found:
            return None
        end = find_optimum(solution)
        if end.undecided or end.active != optimum.active:
            return None
        ends.append(outputs(end))
    return np.asarray((ends[0] - ends[1]) / (2.0 * step))


def relative(error: Array, size: Array, values: Array, k: int) -> float:
    """Return the largest error of f, tau and objective, each relative to its derivative, with a floor.

    Args:
        error: error of the derivative.
        size: the derivative.
        values: f, tau and objective.
        k: number of force components.
    """
    worst = 0.0
    for part in (slice(0, k), slice(k, -1), slice(-1, None)):
        if len(values[part]):
            scale = max(float(np.abs(size[part]).max()), 1e-3 * float(np.abs(values[part]).max()))
            worst = max(worst, float(np.abs(error[part]).max()) / scale)
    return worst


def reference(optimum: Optimum, name: str, change: Array) -> Array | None:
    """Return the extrapolated difference with the least estimated error; None without one.

    Args:
        optimum: the optimum.
        name: name of the block of data.
        change: direction of the change.
    """
    values, k = outputs(optimum), optimum.problem.size
    last_difference: Array | None = None
    last_extrapolation: Array | None = None
    best: tuple[float, Array | None] = (np.inf, None)
    for step in STEPS:
        difference = central_difference(optimum, name, change, step)
        extrapolation = None
        if difference is not None and last_difference is not None:
            extrapolation = (16.0 * difference - last_difference) / 15.0
        if extrapolation is not None and last_extrapolation is not None:
            estimate = relative(extrapolation - last_extrapolation, extrapolation, values, k)
            best = min(best, (estimate, extrapolation), key=lambda pair: pair[0])
            if estimate < ENOUGH:
                break
        last_difference, last_extrapolation = difference, extrapolation
    return best[1] if best[0] <= LARGEST_ESTIMATE else None


def adjoint_errors(answer: Sensitivities, rng: np.random.Generator) -> dict[str, float]:
    """Return the relative difference of adjoint and forward products by block of data.

    Args:
        answer: derivatives of an optimum.
        rng: random numbers.
    """
    problem = answer.optimum.problem
    f_bar, objective_bar = rng.normal(size=problem.size), float(rng.normal())
    tau_bar = rng.normal(size=len(problem.torques(answer.optimum.f)))
    gradient, result = answer.adjoint(f_bar, tau_bar, objective_bar), {}
    for name in answer.data:
        change = rng.normal(size=answer.objective[name].shape)
        forward = answer.forward({name: change})
        first = np.concatenate([f_bar * forward.f, tau_bar * forward.tau, [objective_bar * forward.objective]])
        second = (gradient[name] * change).ravel()
        size = float(np.abs(first).sum() + np.abs(second).sum())
        result[name] = abs(float(first.sum() - second.sum())) / size if size > 0.0 else 0.0
    return result


def measure(count: int, seed: int) -> tuple[dict[str, BlockErrors], dict[str, int]]:
    """Return the errors by block of data, and the numbers of skipped problems.

    Args:
        count: number of problems.
        seed: seed of the random numbers.
    """
    blocks = {name: BlockErrors() for name in SIZES}
    skipped = {"degenerate": 0, "unsolved": 0}
    for answer, rng in regular_answers(count, seed, skipped):
        optimum = answer.optimum
        for name, error in adjoint_errors(answer, rng).items():
            blocks[name].adjoint.append(error)
        for name in answer.data:
            change = direction(optimum.problem, name, answer.objective[name].shape, rng)
            expected = reference(optimum, name, change)
            if expected is None:
                blocks[name].not_compared += 1
                continue
            result = answer.forward({name: change})
            exact = np.concatenate([result.f, result.tau, [result.objective]])
            blocks[name].errors.append(relative(exact - expected, exact, outputs(optimum), optimum.problem.size))
            blocks[name].not_zero += bool(np.any(exact))
    return blocks, skipped


def main() -> None:
    """Measure, print the table and write the page."""
    options = report_page.parser("sensitivities", __doc__)
    options.add_argument("--count", type=int, default=40, help="number of problems")
    options.add_argument("--seed", type=int, default=17, help="seed of the random numbers")
    given = options.parse_args()
    blocks, skipped = measure(given.count, given.seed)
    rows = []
    for name, block in blocks.items():
        counts = (str(len(block.errors)), str(block.not_zero), f"{max(block.errors, default=0.0):.1e}")
        above = sum(error > 1e-5 for error in block.errors)
        rows.append((name, *counts, str(above), str(block.not_compared), f"{max(block.adjoint, default=0.0):.1e}"))
    report_page.show("Sensitivities", HEAD, rows)
    compared = sum(len(block.errors) for block in blocks.values())
    above = sum(error > 1e-5 for block in blocks.values() for error in block.errors)
    sentences = (
        f"{given.count} problems with regular optima; {skipped['degenerate']} with degenerate optima and {skipped['unsolved']} "
        f"without forces were replaced. Of {compared} blocks, {above} differ by more than 1e-5."
    )
    print(sentences)
    if given.save:
        facts = report_page.facts(f"graspforce {gf.__version__}")
        text = "\n\n".join([report_page.table(HEAD, rows), sentences])
        report_page.save(given.save, "Derivatives of optimal forces", __doc__, facts, text)


if __name__ == "__main__":
    main()

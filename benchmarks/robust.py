"""Forces that hold for errors: samples of the set, limits, price and time: `python -m benchmarks.robust --samples 1000000`.

Samples: random members of each set of errors, half of the numbers at their ends, with the true forces by plain linear algebra
(`benchmarks/robust_samples.py`). The slip margin is the least of all samples, beside the one that the certificate guarantees.

Limit: the factor on all errors up to which the certificate promises no slip, and the slip margin of the member that the
certificate names 1 % beyond it. It is negative: that member slips.

Price: the norm of the motor torques over that of the nominal forces, ‖tau‖/‖tau_nominal‖, for growing errors. "Bound" is the
largest possible excess of the cost over the least one.

Time: median of a warm step of `Solver` with new wrench, Jacobian and bias torques, nominal and with 15 % of friction and 10 %
of mass in error, on four contacts with twelve to sixteen motors. Steps that the structured kernel does not solve are solved by
Clarabel. Torque limits are active in some of the random grasps, whose limits leave little room.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf
from benchmarks import report_page
from benchmarks.robust_samples import sample
from graspforce.view.figures import LINE_COLOURS, save_figures

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.random_problems import inner_forces, random_actuation, random_contacts

GRASP = "trajectory/carry-1-000"
WRENCH = np.diag([0.1, 0.1, 0.1, 1e-3, 1e-3, 1e-3])  # N, N·m
SETS = {
    "friction 20 %": gf.Uncertainty(friction_error=0.2),
    "mass 20 %, centre of mass 2 mm": gf.Uncertainty(mass_error=0.2, centre_of_mass_error=0.002),
    "friction 15 %, mass 10 %": gf.Uncertainty(friction_error=0.15, mass_error=0.1),
    "wrenches, a polytope": gf.Uncertainty(wrenches=np.vstack([2.0 * WRENCH, -2.0 * WRENCH])),
    "wrenches, an ellipsoid": gf.Uncertainty(wrench_ellipsoid=WRENCH),
    "places 0.5 mm": gf.Uncertainty(position_error=5e-4),
    "normals 5°, friction 10 %": gf.Uncertainty(normal_error=np.radians(5.0), friction_error=0.1),
    "torques 3 %": gf.Uncertainty(torque_error=0.03),
    "all": gf.Uncertainty(
        friction_error=0.1,
        mass_error=0.1,
        centre_of_mass_error=0.001,
        wrench_ellipsoid=0.2 * WRENCH,
        position_error=2e-4,
        normal_error=np.radians(2.0),
        torque_error=0.01,
    ),
}
SAMPLE_HEAD = ("errors", "samples", "least margin (N)", "guaranteed (N)", "limit", "beyond it (N)", "bound (%)")
TIME_HEAD = ("grasp", "nominal (µs)", "with errors (µs)", "ratio", "by the kernel (%)")


def with_errors(problem: gf.ForceProblem, errors: gf.Uncertainty) -> gf.ForceProblem:
    """Return a problem with errors.

    Args:
        problem: the problem.
        errors: its errors.
    """
    return dataclasses.replace(problem, uncertainty=errors)


def random_grasp(seed: int) -> gf.ForceProblem:
    """Return four random point contacts with motors and a load that they bear.

    Args:
        seed: seed of the random numbers.
    """
    rng = np.random.default_rng(seed)
    contacts = gf.ContactSet.stack(random_contacts(rng, 4, ("point",)))
    f = inner_forces(rng, contacts, 0.3)
    w = gf.ForceProblem(contacts, np.zeros(6)).G @ f
    return gf.ForceProblem(contacts, w, random_actuation(rng, contacts, f))


def sample_rows(count: int) -> list[tuple[str, ...]]:
    """Return the rows of the table of samples.

    Args:
        count: number of samples of each set.
    """
    rows = []
    for name, errors in SETS.items():
        problem = with_errors(gf.problems.load(GRASP).problem, errors)
        solution = gf.solve(problem)
        assert solution.robust is not None  # the sets are chosen so
        outcome = sample(problem, solution.f, count, np.random.default_rng(1))
        holds, slips = solution.robust.error_factor
        beyond = "–"
        if np.isfinite(slips):
            member = solution.robust.slipping_member(1.01 * slips)
            assert member is not None  # it is beyond the limit
            plain = gf.ForceProblem(problem.contacts, problem.w, problem.actuation)
            margins = plain.replace(mu=member.friction).cone_margins(member.forces)
            beyond = f"{margins[member.contact]:.1e}"
        excess = solution.objective / solution.cost_bound - 1.0 if solution.objective and solution.cost_bound else np.nan
        limit = f"{holds:.4f}" if holds == slips else f"{holds:.4f} to {slips:.4g}"
        guaranteed = solution.robust.worst.guaranteed.min()
        cells = (name, str(outcome.count), f"{outcome.margin.min():.1e}", f"{guaranteed:.1e}", limit, beyond)
        rows.append((*cells, f"{100.0 * max(excess, 0.0):.2g}"))
        print(" | ".join(rows[-1]), flush=True)
    return rows


def closed_form_error() -> float:
    """Return the largest relative error of the cost on a ring of three contacts: W²(1 + (1 + e)²/μ'²)/6."""
    problem = gf.problems.load("ring/3-force").problem
    worst = 0.0
    for friction in (0.0, 0.2, 0.4):
        for mass in (0.0, 0.1, 0.5):
            for tilt in (0.0, 0.1):
                errors = gf.Uncertainty(friction_error=friction, mass_error=mass, normal_error=tilt)
                cost = gf.solve(with_errors(problem, errors)).objective
                mu = np.tan(np.arctan(0.5 * (1.0 - friction)) - tilt)
                exact = (((1.0 + mass) / mu) ** 2 + 1.0) / 6.0
                worst = max(worst, abs(float(cost or np.inf) / exact - 1.0))
    return worst


def price_figure() -> Figure:
    """Return the torques over the nominal ones for growing errors of one grasp."""
    problem = gf.problems.load(GRASP).problem
    nominal = gf.solve(problem).objective or np.nan
    kinds = {
        "friction (%)": (np.linspace(0.0, 50.0, 21), lambda x: gf.Uncertainty(friction_error=0.01 * x)),
        "mass (%)": (np.linspace(0.0, 50.0, 21), lambda x: gf.Uncertainty(mass_error=0.01 * x)),
        "normals (°)": (np.linspace(0.0, 20.0, 21), lambda x: gf.Uncertainty(normal_error=np.radians(x))),
        "places (0.1 mm)": (np.linspace(0.0, 20.0, 21), lambda x: gf.Uncertainty(position_error=1e-4 * x)),
        "torques (%)": (np.linspace(0.0, 20.0, 21), lambda x: gf.Uncertainty(torque_error=0.01 * x)),
    }
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.subplots()
    for colour, (name, (sizes, errors)) in zip(LINE_COLOURS, kinds.items(), strict=False):
        solutions = [gf.solve(with_errors(problem, errors(size))) for size in sizes]
        upper = [np.sqrt((s.objective or np.nan) / nominal) if s.found else np.nan for s in solutions]
        lower = [np.sqrt(max(s.cost_bound or np.nan, nominal) / nominal) if s.found else np.nan for s in solutions]
        axes.plot(sizes, upper, color=colour, label=name)
        axes.fill_between(sizes, lower, upper, color=colour, alpha=0.2)
    axes.set(xlabel="largest error, in the unit of the legend", ylabel="‖tau‖ over nominal", xlim=(0.0, 50.0))
    axes.set_title("Torques that hold for errors; shaded: bounds on the least torques", fontsize=11)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    return figure


def step_time(problem: gf.ForceProblem, steps: int) -> tuple[float, float]:
    """Return the median time of a warm step, s, and the share of steps that the structured kernel solved.

    Args:
        problem: the first problem.
        steps: number of steps.
    """
    solver, rng, times, solved = gf.Solver(problem), np.random.default_rng(1), [], 0
    solver.solve()
    actuation = problem.actuation
    assert actuation is not None  # the grasps have motors
    for _ in range(steps):
        w = problem.w * (1.0 + 0.01 * rng.normal(size=6))
        J = actuation.J * (1.0 + 0.01 * rng.normal(size=actuation.J.shape))
        tau_u = actuation.tau_u * (1.0 + 0.01 * rng.normal(size=len(actuation.tau_u)))
        start = time.perf_counter()
        solution = solver.solve(w=w, J=J, tau_u=tau_u)
        times.append(time.perf_counter() - start)
        solved += solution.found and solution.backend == "structured"
    return float(np.median(times)), solved / steps


def time_rows(steps: int) -> list[tuple[str, ...]]:
    """Return the rows of the table of times.

    Args:
        steps: number of steps of each grasp.
    """
    grasps = {GRASP: gf.problems.load(GRASP).problem}
    grasps |= {f"random {seed}": random_grasp(seed) for seed in (1, 2, 4, 5, 7, 8)}
    rows = []
    for name, problem in grasps.items():
        nominal, _ = step_time(problem, steps)
        robust, share = step_time(with_errors(problem, SETS["friction 15 %, mass 10 %"]), steps)
        rows.append((name, f"{1e6 * nominal:.1f}", f"{1e6 * robust:.1f}", f"{robust / nominal:.1f}", f"{100.0 * share:.0f}"))
        print(" | ".join(rows[-1]), flush=True)
    return rows


def main() -> None:
    """Measure, print the tables and write the page with its figure."""
    options = report_page.parser("robust", __doc__)
    options.add_argument("--samples", type=int, default=10_000, help="number of samples of each set")
    options.add_argument("--steps", type=int, default=300, help="number of timed steps of each grasp")
    given = options.parse_args()
    samples, times = sample_rows(given.samples), time_rows(given.steps)
    error = f"Largest relative error of the cost against closed forms on a ring of contacts: {closed_form_error():.1e}."
    print(error)
    if given.save:
        save_figures({"robust_price": price_figure()}, given.save.parent)
        parts = [report_page.table(SAMPLE_HEAD, samples), error, "![Torques over nominal](robust_price.png)"]
        parts.append(report_page.table(TIME_HEAD, times))
        facts = report_page.facts(f"graspforce {gf.__version__}")
        report_page.save(given.save, "Forces that hold for errors", __doc__, facts, "\n\n".join(parts))


if __name__ == "__main__":
    main()

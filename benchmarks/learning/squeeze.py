"""Learned squeeze.

A run holds an object of 20 to 300 g and 40 to 80 mm with three or four fingertips around it, turns it in a random direction to
gravity, and accelerates it by up to 5 m/s². True friction is 0.3 to 1.0. Known are: the friction, estimated from one to nine
slips with an error of 10 % each; the mass with 3 % error; the contact places with 1 mm error in each direction; and the
planned acceleration, which the true one misses by 0.3 m/s² in each direction. The oracle is the least sum of normal forces for
which forces within the true friction cones supply the true wrench. A run slips if the squeeze is smaller. 1500 runs are
recorded, 500 others are tested, and this is repeated with ten seeds of the division of 4000 runs.

*Fixed factor*: the nominal squeeze for the estimates times the smallest factor with which 95 % of the recorded runs do not
slip. *Fuzzy* and *network* are the kinds of learners of e_GRASP: rules of Takagi and Sugeno with memberships around 12 centres
by k-means, and 50 hidden units. They predict without confidence, and slip in about half of the runs. With the same calibration
as boosting and the Gaussian process, they become comparable. The coverage is the fraction of runs that do not slip, at a
stated confidence of 95 %; "median force" is the median of the squeeze divided by the oracle's.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks import report_page
from graspforce import Contact, ForceProblem
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.solver import solve
from graspforce.learning.inverse_kinematics import fit_network
from graspforce.learning.squeeze import FEATURES, fit_squeeze, nominal_normals, squeeze_features, with_squeeze
from graspforce.view.figures import BLUE, GREY, RED, save_figures

TITLE = "Learned squeeze"
CONFIDENCE = 0.95
_RUNS, _RECORDED, _TESTED, _SEEDS = 4000, 1500, 500, 10
_RULES = 12
_CERTIFIED = 100  # squeezes that are applied to force problems


@dataclass(frozen=True)
class Runs:
    """Simulated runs.

    Attributes:
        x: (N, d) features.
        needed: (N,) least sum of normal forces, N.
        estimated: the problems with the estimates, of the first runs.
    """

    x: Array
    needed: Array
    estimated: list[ForceProblem]


def run(_records: Path, pictures: Path) -> dict[str, Any]:
    """Compare the learners.

    Args:
        pictures: folder of the pictures.
    """
    runs = simulated_runs(_RUNS)
    results: dict[str, list[tuple[float, float]]] = {}
    for seed in range(_SEEDS):
        order = np.random.default_rng(100 + seed).permutation(_RUNS)
        train, test = order[:_RECORDED], order[_RECORDED : _RECORDED + _TESTED]
        for name, bound in _bounds(runs, train, test, seed).items():
            ratio = bound / runs.needed[test]
            results.setdefault(name, []).append((float((ratio >= 1.0).mean()), float(np.median(ratio))))
            if seed == 0 and name == "Gaussian process, calibrated":
                save_figures({"squeeze": _plot(runs.needed[test], bound)}, pictures)
    model = fit_squeeze(runs.x[_CERTIFIED:], runs.needed[_CERTIFIED:], FEATURES, CONFIDENCE)
    bounds = model.bound(runs.x[:_CERTIFIED])
    certified = 0
    for problem, total in zip(runs.estimated, bounds.tolist(), strict=True):
        solution = solve(with_squeeze(problem, total), explain=False)
        certified += int(solution.found and float(solution.f[problem.contacts.normal_rows].sum()) >= total * (1.0 - 1e-6))
    return {
        "learners": results,
        "certified": certified,
        "needed": [float(x) for x in np.quantile(runs.needed, [0.05, 0.5, 0.95])],
    }


def simulated_runs(count: int) -> Runs:
    """Return simulated runs; arrangements that cannot hold the object are drawn again.

    Args:
        count: number of runs.
    """
    rng, x, needed, estimated = np.random.default_rng(0), [], [], []
    while len(x) < count:
        number, radius = int(rng.integers(3, 5)), rng.uniform(0.02, 0.04)
        angles = 2.0 * np.pi * np.arange(number) / number + rng.uniform(-0.25, 0.25, number)
        tilt = rng.uniform(-0.2, 0.2, number)
        outward = np.column_stack([np.cos(angles) * np.cos(tilt), np.sin(angles) * np.cos(tilt), np.sin(tilt)])
        mass, mu, slips = rng.uniform(0.02, 0.3), rng.uniform(0.3, 1.0), int(rng.integers(1, 10))
        down = rng.normal(size=3)
        planned = rng.normal(size=3) * rng.uniform(0.0, 5.0) / np.sqrt(3.0)
        gravity = 9.81 * down / np.linalg.norm(down)
        true_w = mass * (planned + 0.3 * rng.normal(size=3) - gravity)
        known_w = mass * (1.0 + 0.03 * rng.normal()) * (planned - gravity)
        error = 0.10 / np.sqrt(slips)
        known_mu = mu * np.exp(error * rng.normal())
        places = radius * outward
        known_places = places + 1e-3 * rng.normal(size=places.shape)
        try:
            true = _problem(places, outward, mu, true_w)
            known = _problem(known_places, outward, known_mu, known_w)
            features, sum_needed = squeeze_features(known, error), float(nominal_normals(true).sum())
        except InvalidInput:
            continue
        x.append(features)
        needed.append(sum_needed)
        if len(estimated) < _CERTIFIED:
            estimated.append(known)
    return Runs(np.array(x), np.array(needed), estimated)


def _problem(places: Array, outward: Array, mu: float, force: Array) -> ForceProblem:
    """Return the problem of contacts on a sphere that supply a force."""
    contacts = [Contact(p, -n, friction=mu) for p, n in zip(places, outward, strict=True)]
    return ForceProblem(contacts, [*force, 0.0, 0.0, 0.0])


def _bounds(runs: Runs, train: Array, test: Array, seed: int) -> dict[str, Array]:
    """Return the squeezes of all learners for the tested runs, N."""
    x, y = runs.x[train], np.log(runs.needed[train])
    fit, calibration = np.arange(0, 2 * len(train) // 3), np.arange(2 * len(train) // 3, len(train))
    factor = np.quantile(y - x[:, 0], CONFIDENCE)
    found = {"nominal": np.exp(runs.x[test, 0]), "fixed factor": np.exp(runs.x[test, 0] + factor)}
    network = fit_network(x[fit], y[fit, None], seed=seed)
    learners = {"fuzzy": _fuzzy(x[fit], y[fit], seed), "network": lambda z: network.predict(z)[:, 0]}
    k = int(np.ceil((len(calibration) + 1) * CONFIDENCE)) - 1
    for name, predict in learners.items():
        score = np.sort(y[calibration] - predict(x[calibration]))[k]
        found[name] = np.exp(predict(runs.x[test]))
        found[f"{name}, calibrated"] = np.exp(predict(runs.x[test]) + score)
    for name, method in (("boosting", "boosting"), ("Gaussian process", "gaussian_process")):
        rows = train if method == "boosting" else train[:900]  # its time grows with the cube
        model = fit_squeeze(runs.x[rows], runs.needed[rows], FEATURES, CONFIDENCE, method, seed)
        found[f"{name}, calibrated"] = model.bound(runs.x[test])
    return found


def _fuzzy(x: Array, y: Array, seed: int) -> Any:
    """Return rules of Takagi and Sugeno: linear consequents, and Gaussian memberships around the centres of k-means."""
    mean, scale = x.mean(axis=0), x.std(axis=0)
    centres = rule_centres(x, seed)

    def basis(z: Array) -> Array:
        z = (z - mean) / scale
        weights = np.exp(-0.5 * np.square(z[:, None] - centres).sum(axis=2))
        weights /= weights.sum(axis=1, keepdims=True)
        terms = np.column_stack([np.ones(len(z)), z])
        return np.asarray((weights[:, :, None] * terms[:, None]).reshape(len(z), -1))

    A = basis(x)
    theta = np.linalg.solve(A.T @ A + 1e-3 * np.eye(A.shape[1]), A.T @ y)
    return lambda z: basis(z) @ theta


def rule_centres(x: Array, seed: int) -> Array:
    """Return the centres of the rules' memberships (12, d), in standard deviations of the features.

    Args:
        x: (N, d) features.
        seed: of k-means.
    """
    from sklearn.cluster import KMeans

    scaled = (x - x.mean(axis=0)) / x.std(axis=0)
    return np.asarray(KMeans(_RULES, n_init=3, random_state=seed).fit(scaled).cluster_centers_)


def _plot(needed: Array, bound: Array) -> Figure:
    """Return the bounds over the needed squeezes."""
    figure = Figure(figsize=(6.5, 5.0), layout="constrained")
    panel = figure.subplots()
    slips = bound < needed
    panel.loglog(needed[~slips], bound[~slips], ".", color=BLUE, markersize=4, label=f"held: {int((~slips).sum())}")
    panel.loglog(needed[slips], bound[slips], ".", color=RED, markersize=6, label=f"slipped: {int(slips.sum())}")
    ends = np.array([needed.min(), needed.max()])
    panel.loglog(ends, ends, color=GREY, linewidth=1.0)
    panel.set_xlabel("needed squeeze (N)")
    panel.set_ylabel("applied squeeze (N)")
    panel.grid(alpha=0.25)
    panel.legend(frameon=False)
    figure.suptitle(f"Gaussian process with a confidence of 95 %: {100 * (~slips).mean():.1f} % of {len(needed)} runs hold")
    return figure


def page(result: dict[str, Any]) -> str:
    """Return the table and the picture.

    Args:
        result: of `run`.
    """
    rows = []
    for name, values in result["learners"].items():
        coverage, ratio = np.array(values).T
        spread = f"{100 * coverage.min():.1f} to {100 * coverage.max():.1f} %"
        rows.append((name, f"{100 * coverage.mean():.1f} %", spread, f"{ratio.mean():.3f}"))
    low, middle, high = result["needed"]
    note = (
        f"The oracle's squeeze has a median of {middle:.1f} N, and 90 % between {low:.1f} and {high:.1f} N. As least normal "
        f"forces of the estimated problem, {result['certified']} of {_CERTIFIED} bounds give certified forces. A fixed factor "
        "on the nominal squeeze is as good here, because all errors scale the forces: the learners pay only if the needed "
        "force depends on what the model leaves out."
    )
    table = report_page.table(("learner", "coverage, mean", "coverage, range of ten", "median force"), rows)
    return f"{table}\n\n{note}\n\n![squeeze](learning/squeeze.png)"

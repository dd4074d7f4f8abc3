"""How hard to squeeze: a learned bound of the least sum of normal forces that a task needs, with calibrated confidence.

A regression predicts the logarithm of the force that recorded runs needed. A part of the runs is held back for calibration:
with the scores r_i = (ln s_i − m(x_i))/σ(x_i) of these n runs, the bound is

    s(x) = exp(m(x) + σ(x) r_(k)),   k = ⌈(n + 1) c⌉,

where r_(k) is the k-th smallest score. A new run of the same kind needs at most s(x) with a probability of at least c,
whatever the regression and the distribution are. σ is the standard deviation of a Gaussian process, and 1 for gradient
boosting. The statement is about an average run, not about each kind of run. Source: Vovk, Gammerman and Shafer (2005).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import optional_imports
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solver import solve
from graspforce.force.uncertainty import Uncertainty

METHODS = ("boosting", "gaussian_process")
_CALIBRATION = 1.0 / 3.0  # fraction of the runs
_LEAST_RUNS = 30
_MOST_LOSS = 0.95  # of the friction
_LOSS_ACCURACY = 1e-4


@dataclass(frozen=True, eq=False, slots=True)
class SqueezeModel:
    """A fitted bound; `fit_squeeze` makes one.

    Attributes:
        features: names of the features.
        confidence: probability c that the bound is enough.
        method: "boosting" or "gaussian_process".
        score: r_(k).
        runs: number of runs of the calibration.
    """

    features: tuple[str, ...]
    confidence: float
    method: str
    score: float
    runs: int
    _regression: Any

    def bound(self, x: npt.ArrayLike) -> Array:
        """Return the sums of normal forces that are enough with the stated confidence, (N,), N.

        Args:
            x: (N, d) features of N tasks.

        Raises:
            InvalidInput: another shape.
        """
        mean, sigma = _predict(self._regression, self.method, self._checked(x))
        return freeze(np.exp(mean + self.score * sigma))

    def estimate(self, x: npt.ArrayLike) -> Array:
        """Return the predicted sums of normal forces without confidence, (N,), N.

        Args:
            x: (N, d) features of N tasks.

        Raises:
            InvalidInput: another shape.
        """
        return freeze(np.exp(_predict(self._regression, self.method, self._checked(x))[0]))

    def _checked(self, x: npt.ArrayLike) -> Array:
        return arrays.check_array(x, "x", (None, len(self.features)))


def fit_squeeze(
    x: npt.ArrayLike,
    forces: npt.ArrayLike,
    features: tuple[str, ...],
    confidence: float = 0.95,
    method: str = "boosting",
    seed: int = 0,
) -> SqueezeModel:
    """Fit a bound of the squeeze to recorded runs.

    Args:
        x: (N, d) features of N ≥ 30 runs, such as `squeeze_features`.
        forces: (N,) sum of normal forces that each run needed, N, > 0.
        features: names of the d features.
        confidence: c, between 0 and 1. A third of the runs must be at least c/(1 − c).
        method: "boosting" or "gaussian_process". A Gaussian process takes time with the cube of the number of runs.
        seed: seed of the division into fit and calibration, ≥ 0.

    Raises:
        InvalidInput: an argument is not allowed, or there are too few runs for the confidence.
        MissingLibrary: scikit-learn is not installed.
    """
    x = arrays.check_array(x, "x", (None, len(features)))
    targets = np.log(arrays.check_array(forces, "forces", (len(x),), above=0.0))
    confidence = arrays.check_number(confidence, "confidence", above=0.0)
    method = fields.check_choice(method, "method", METHODS)
    seed = fields.check_integer(seed, "seed", minimum=0, maximum=2**32 - 1)
    if confidence >= 1.0:
        raise InvalidInput("confidence", confidence, "a number between 0 and 1")
    if len(x) < _LEAST_RUNS:
        raise InvalidInput("x", f"{len(x)} runs", f"at least {_LEAST_RUNS} runs")
    order = np.random.default_rng(seed).permutation(len(x))
    count = int(_CALIBRATION * len(x))
    calibration, train = order[:count], order[count:]
    k = int(np.ceil((count + 1) * confidence))
    if k > count:
        needed = int(np.ceil(confidence / (1.0 - confidence) / _CALIBRATION))
        raise InvalidInput("confidence", confidence, f"smaller, or with {needed} runs at least")
    regression = _fit(x[train], targets[train], method, seed)
    mean, sigma = _predict(regression, method, x[calibration])
    scores = np.sort((targets[calibration] - mean) / sigma)
    return SqueezeModel(tuple(features), confidence, method, float(scores[k - 1]), count, regression)


def squeeze_features(problem: ForceProblem, friction_error: float) -> Array:
    """Return features of a task: logarithms of the nominal squeeze, its largest contact force, the load, and the friction.

    Args:
        problem: the task with the estimated friction, and the largest wrench that is expected.
        friction_error: standard deviation of the estimated friction, as a fraction of it, ≥ 0.

    Raises:
        InvalidInput: the problem has no solution, or no friction.
    """
    friction_error = arrays.check_number(friction_error, "friction_error", minimum=0.0)
    f_n = nominal_normals(problem)
    mu = float(problem.contacts.mu.min())
    if mu <= 0.0:
        raise InvalidInput("problem.contacts", mu, "contacts with friction")
    load = float(np.linalg.norm(problem.w[:3]))
    return freeze([np.log(f_n.sum()), np.log(f_n.max()), np.log(max(load, 1e-6)), np.log(mu), friction_error])


FEATURES = ("nominal squeeze", "nominal largest force", "load", "friction", "friction error")


def nominal_normals(problem: ForceProblem) -> Array:
    """Return the normal forces with the least sum, (N,), N.

    Args:
        problem: the problem; its objective is not used.

    Raises:
        InvalidInput: no forces support the wrench.
    """
    solution = solve(replace(problem, objective=Objective("sum_normal")), explain=False)
    if not solution.found:
        raise InvalidInput("problem", solution.status.sentence, "a problem that has a solution")
    return freeze(solution.f[problem.contacts.normal_rows])


def with_squeeze(problem: ForceProblem, total: float) -> ForceProblem:
    """Return a problem whose normal forces add up to a squeeze at least, shared as in the nominal solution.

    Args:
        problem: the problem.
        total: sum of the normal forces, N, > 0.

    Raises:
        InvalidInput: no forces support the wrench, or the squeeze exceeds a limit of a normal force.
    """
    total = arrays.check_number(total, "total", above=0.0)
    f_n = nominal_normals(problem)
    least = f_n * total / float(f_n.sum())
    if (least > problem.contacts.max_normal).any():
        raise InvalidInput("total", total, "a squeeze within the largest normal forces of the contacts")
    contacts: ContactSet = replace(problem.contacts, min_normal=freeze(np.maximum(least, problem.contacts.min_normal)))
    return replace(problem, contacts=contacts)


def robust_squeeze(problem: ForceProblem, total: float) -> ForceProblem:
    """Return a robust problem: the errors of friction for which the least normal forces add up to a squeeze.

    The squeeze is turned into the fraction e of friction that it can lose: the least normal forces with (1 − e) μ have this
    sum. The forces of the returned problem then hold for every friction of at least (1 − e) μ, with their certificate.

    Args:
        problem: the problem, with friction and without uncertainty.
        total: sum of the normal forces, such as `SqueezeModel.bound`, N, > 0. Below that of the nominal solution e is zero.

    Raises:
        InvalidInput: no forces support the wrench, the problem has an uncertainty, or no loss of friction needs so large a
            squeeze.
    """
    total = arrays.check_number(total, "total", above=0.0)
    if problem.uncertainty is not None:
        raise InvalidInput("problem.uncertainty", "given", "None: the squeeze takes its place")
    lowest, highest = 0.0, _MOST_LOSS
    if float(nominal_normals(problem).sum()) >= total:
        return replace(problem, uncertainty=Uncertainty(friction_error=0.0))
    if (most := _needed(problem, highest)) is not None and most < total:
        raise InvalidInput(
            "total", total, f"at most {most:.4g} N, the squeeze after a loss of {_MOST_LOSS:.0%} of the friction"
        )
    while highest - lowest > _LOSS_ACCURACY:
        middle = 0.5 * (lowest + highest)
        needed = _needed(problem, middle)
        lowest, highest = (middle, highest) if needed is not None and needed <= total else (lowest, middle)
    return replace(problem, uncertainty=Uncertainty(friction_error=lowest))


def _needed(problem: ForceProblem, loss: float) -> float | None:
    """Return the least sum of normal forces after a loss of friction, N; None if no forces support the wrench."""
    contacts = replace(problem.contacts, mu=(1.0 - loss) * problem.contacts.mu, gamma=(1.0 - loss) * problem.contacts.gamma)
    try:
        return float(nominal_normals(replace(problem, contacts=contacts)).sum())
    except InvalidInput:
        return None


def _fit(x: Array, y: Array, method: str, seed: int) -> Any:
    """Return the fitted regression of scikit-learn."""
    with optional_imports():
        from sklearn.ensemble import HistGradientBoostingRegressor
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct, WhiteKernel
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import StandardScaler
    if method == "boosting":
        return HistGradientBoostingRegressor(learning_rate=0.05, max_iter=200, min_samples_leaf=10, random_state=seed).fit(x, y)
    kernel = ConstantKernel() * DotProduct() + ConstantKernel() * RBF(np.full(x.shape[1], 3.0)) + WhiteKernel(1e-2)
    process = GaussianProcessRegressor(kernel, normalize_y=True, random_state=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the calibration makes up for a worse fit
        return make_pipeline(StandardScaler(), process).fit(x, y)


def _predict(regression: Any, method: str, x: Array) -> tuple[Array, Array]:
    """Return mean and standard deviation of the logarithm."""
    if method == "boosting":
        return np.asarray(regression.predict(x)), np.ones(len(x))
    mean, sigma = regression.predict(x, return_std=True)
    return np.asarray(mean), np.maximum(np.asarray(sigma), 1e-9)

"""Synergies of found grasps.

The libraries hold one grasp of each of 30 spheres, cylinders and boxes of random sizes, for each hand. Half of the postures,
chosen at random, fit the components; the errors are those of the other half. The synthetic hand has 15 joints, three known
synergies with standard deviations of 0.5, 0.3 and 0.15 rad, noise of 0.005 rad, and 500 postures.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report_page
from benchmarks.learning.objects import FINGERS, library
from graspforce import Hand
from graspforce.core.arrays import freeze
from graspforce.learning import PostureLibrary, Synergies, correlate_with_size, fit_preshape, fit_synergies
from graspforce.learning.posture_library import SIZE_COLUMNS
from graspforce.view.figures import save_figures
from graspforce.view.learning_plots import (
    plot_component_postures,
    plot_cumulative_variance,
    plot_reconstruction_errors,
    plot_size_correlation,
)

TITLE = "Synergies"
_KNOWN = np.array([0.5, 0.3, 0.15])  # rad
_NOISE, _JOINTS, _POSTURES = 0.005, 15, 500
_SHOWN = "allegro_right"  # the hand of the picture of postures


def run(records: Path, pictures: Path) -> dict[str, Any]:
    """Fit all libraries, and draw the pictures.

    Args:
        records: folder of the libraries.
        pictures: folder of the pictures.
    """
    fitted: dict[str, Synergies] = {}
    errors, figures, hands = {}, {}, []
    for name in FINGERS:
        whole = library(name, records)
        order = np.random.default_rng(0).permutation(len(whole))
        train, test = (_part(whole, rows) for rows in (order[::2], order[1::2]))
        fitted[name] = fit_synergies(whole)
        half = fit_synergies(train)
        errors[name] = test.q - half.reconstruct(test.q, 4)
        correlation = correlate_with_size(whole, fitted[name])
        figures[f"size_{name}"] = plot_size_correlation(name, correlation)
        preshape = fit_preshape(train, half, 4)
        assert test.sizes is not None
        predicted = np.array([preshape.posture(size) for size in test.sizes])
        by_count = np.degrees(np.sqrt(np.square(half.reconstruction_error(test.q)).mean(axis=1)))
        hands.append(
            {
                "hand": name,
                "postures": len(whole),
                "joints": len(whole.joints),
                "count_90": fitted[name].count_for(0.9),
                "error": [float(by_count[k]) for k in (0, 1, 2, 4, 6, 8)],
                "preshape": float(np.degrees(np.sqrt(np.square(predicted - test.q).mean()))),
                "significant": int(correlation.significant[:5].sum()),
                "r": float(np.abs(correlation.r[:5]).max()),
            }
        )
    figures["variance"] = plot_cumulative_variance(fitted)
    figures["errors"] = plot_reconstruction_errors(errors, 4)
    figures["postures"] = plot_component_postures(Hand.load(_SHOWN), fitted[_SHOWN])
    save_figures(figures, pictures)
    return {"hands": hands, "exact": _exact_components(), "known": _known_synergies()}


def _part(whole: PostureLibrary, rows: np.ndarray) -> PostureLibrary:
    assert whole.sizes is not None
    return PostureLibrary(whole.joints, freeze(whole.q[rows]), (), freeze(whole.sizes[rows]))


def _exact_components() -> dict[str, float]:
    """Return the largest differences from the eigenvectors of the covariance matrix, by NumPy, for 100 random libraries."""
    variance, angle = 0.0, 0.0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        q = rng.normal(size=(60, 12)) @ rng.normal(size=(12, 12))
        found = fit_synergies(PostureLibrary(tuple(f"joint_{i}" for i in range(12)), freeze(q)))
        values, vectors = np.linalg.eigh(np.cov(q.T))
        variance = max(variance, float(np.abs(found.variances / values[::-1] - 1.0).max()))
        angle = max(angle, float(np.abs(np.abs((found.components * vectors[:, ::-1].T).sum(axis=1)) - 1.0).max()))
    return {"variance": variance, "alignment": angle}


def _known_synergies() -> dict[str, Any]:
    """Return relative errors of the standard deviations and angles of the components, degrees, of known synergies."""
    rng = np.random.default_rng(0)
    components = np.linalg.qr(rng.normal(size=(_JOINTS, 3)))[0].T
    a = rng.normal(size=(_POSTURES, 3))
    a -= a.mean(axis=0)
    a = a @ np.linalg.inv(np.linalg.cholesky(np.cov(a.T))).T * _KNOWN  # sample covariance as stated
    q = a @ components + _NOISE * rng.normal(size=(_POSTURES, _JOINTS))
    found = fit_synergies(PostureLibrary(tuple(f"joint_{i}" for i in range(_JOINTS)), freeze(q)), 3)
    deviation = np.abs(np.sqrt(found.variances) / _KNOWN - 1.0)
    cosine = np.abs((found.components * components).sum(axis=1))
    return {
        "deviation": float(deviation.max()),
        "sine": float(np.sqrt(1.0 - np.minimum(cosine, 1.0) ** 2).max()),
        "count": int(fit_synergies(PostureLibrary(found.joints, freeze(q))).count_for(0.99)),
    }


def page(result: dict[str, Any]) -> str:
    """Return tables and pictures.

    Args:
        result: of `run`.
    """
    exact, known = result["exact"], result["known"]
    lines = [
        f"- Principal components by scikit-learn and eigenvectors of the covariance by NumPy, 100 random libraries: variances "
        f"differ by {exact['variance']:.1e} at most (relative), |cos| of the components from 1 by {exact['alignment']:.1e}.",
        f"- Known synergies come back: standard deviations to {100 * known['deviation']:.2f} %, components to "
        f"{100 * known['sine']:.2f} % (sine of the angle); {known['count']} components explain 99 % of the variance.",
    ]
    head = ("hand", "joints", "postures", "90 % of variance", *(f"{k}" for k in (0, 1, 2, 4, 6, 8)), "pre-shape", "significant")
    rows = [
        (
            each["hand"],
            *(str(each[key]) for key in ("joints", "postures", "count_90")),
            *(f"{error:.1f}°" for error in each["error"]),
            f"{each['preshape']:.1f}°",
            f"{each['significant']}/15",
        )
        for each in result["hands"]
    ]
    note = (
        "Columns 0 to 8: RMS joint error in the other half with that many components. *Pre-shape*: RMS error of the posture "
        f"predicted from the object's {', '.join(SIZE_COLUMNS)} size. *Significant*: of the first five components and three "
        "sizes, pairs with p < 0.05; 0.75 are expected by chance."
    )
    worse = sum(each["preshape"] >= each["error"][0] for each in result["hands"])
    note += (
        f" For {worse} of {len(result['hands'])} hands the pre-shape is no better than the mean posture: the search turns "
        "objects at random, so that their size explains little of the posture."
    )
    names = ("variance", "errors", "postures", *(f"size_{name}" for name in FINGERS))
    pictures = [f"![{name.replace('_', ' ')}](learning/{name}.png)" for name in names]
    return "\n\n".join(["\n".join(lines), report_page.table(head, rows), note, *pictures])

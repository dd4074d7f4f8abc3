"""Plots of synergies state the values that they show."""

from __future__ import annotations

import numpy as np
from support import hands

from graspforce.learning import PostureLibrary, correlate_with_size, fit_synergies
from graspforce.view.learning_plots import (
    plot_component_postures,
    plot_cumulative_variance,
    plot_reconstruction_errors,
    plot_size_correlation,
)


def library(hand):
    """Postures near neutral, of which the first joint follows the opposition size."""
    rng = np.random.default_rng(0)
    sizes = rng.uniform(0.02, 0.08, (30, 3))
    q = hand.neutral + 0.01 * rng.normal(size=(30, hand.n))
    q[:, 1] += 5.0 * (sizes[:, 0] - 0.05)
    return PostureLibrary(tuple(joint.name for joint in hand.joints), q, sizes=sizes)


def test_variance_states_the_number_of_components():
    fitted = fit_synergies(library(hands.load("leap_right")))
    figure = plot_cumulative_variance({"all": fitted}, 0.5)
    assert figure.get_suptitle().startswith(f"{fitted.count_for(0.5)} components")
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata()[1:], 100.0 * fitted.cumulative_variance[:10])


def test_histograms_contain_all_joints():
    errors = np.radians(np.linspace(-40.0, 40.0, 60)).reshape(10, 6)
    figure = plot_reconstruction_errors({"hand": errors}, 2)
    assert sum(bar.get_height() for bar in figure.axes[0].patches) == 100.0


def test_postures_are_drawn_for_each_finger():
    hand = hands.load("leap_right")
    figure = plot_component_postures(hand, fit_synergies(library(hand)))
    assert len(figure.axes) == 6
    assert all(len(panel.lines) == len(hand.fingers) + 1 for panel in figure.axes)  # and the base


def test_bars_are_the_coefficients():
    found = library(hands.load("leap_right"))
    correlation = correlate_with_size(found, fit_synergies(found))
    figure = plot_size_correlation("leap", correlation)
    assert [bar.get_height() for bar in figure.axes[0].patches] == correlation.r[:5, 0].tolist()

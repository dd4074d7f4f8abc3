"""Plots of plans have the bases of the other plots, and colours that colour-blind readers can tell apart."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from support.allegro_grasp import three_finger_grasp

from graspforce.browser import charts
from graspforce.contact.use_colour import use_colour
from graspforce.control import ControlSettings
from graspforce.planning import PathMove, Plan, tracking
from graspforce.simulation.recordings import recording_plots
from graspforce.view import figures, plan_plots

GRASP = three_finger_grasp()
RESERVE = 0.2
# Machado, Oliveira and Fernandes (2009), severity 1.0, on linear red, green and blue.
DEFICIENCIES = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
}
LEAST = 10.0  # distance in CIELAB; 2.3 is just noticeable


@pytest.fixture(scope="module")
def plan() -> Plan:
    settings = ControlSettings(slip_margin=0.5)
    task = replace(tracking.object_task(GRASP, settings, RESERVE), collisions=None)
    p_HO = GRASP.p_HO + np.array([[0.0, 0.0, 0.0], [0.0, 0.005, 0.004]])
    found = PathMove(task, p_HO, np.array([GRASP.R_HO] * 2), "straight", q_start=GRASP.q).plan(budget=30.0)
    assert isinstance(found, Plan)
    return found


def lab(colour: object, deficiency: list[list[float]]) -> np.ndarray:
    """Return the CIELAB coordinates of a colour as a colour-blind reader sees it."""
    rgb = np.array(to_rgb(colour))  # type: ignore[arg-type]
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(deficiency) @ linear, 0.0, 1.0)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    t = (to_xyz @ seen) / np.array([0.9505, 1.0, 1.089])
    x, y, z = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16.0 / 116.0)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("deficiency", DEFICIENCIES)
@pytest.mark.parametrize(
    "palette",
    [
        figures.LINE_COLOURS,
        (figures.BLUE, figures.RED, figures.GREEN, figures.AMBER, figures.PURPLE, "#000000"),
        tuple(plan_plots._COLOURS.values()),
        (recording_plots._BLUE, recording_plots._VERMILION, recording_plots._GREEN, recording_plots._BLACK),
        charts._COLOURS,
        tuple(tuple(use_colour(use)) for use in (0.3, 0.75, 1.0)),
    ],
    ids=["lines", "named", "limits", "recordings", "browser", "friction use"],
)
def test_colours_stay_apart_for_colour_blind_readers(palette, deficiency):
    seen = [lab(colour, DEFICIENCIES[deficiency]) for colour in palette]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > LEAST


def test_torques_are_in_percent_of_the_whole_limit(plan: Plan):
    """As in the plots of runs: a torque that uses all that the plan may use is at 80 %, not at 100 %."""
    panel = plan_plots._torques(plan, plan.task, GRASP.hand).axes[0]
    assert panel.get_ylabel() == "torque (% of the motor's limit)"
    largest = max(np.abs(line.get_ydata()).max() for line in panel.lines if len(line.get_ydata()) > 2)
    at = plan.at(np.linspace(0.0, plan.duration, 600))
    assert largest == pytest.approx(100.0 * (np.abs(at.tau) / GRASP.hand.torque_upper).max())
    assert largest <= 100.0 * (1.0 - RESERVE) * (1.0 + 1e-6)
    assert {80.0, -80.0, 100.0, -100.0} <= {round(line.get_ydata()[0], 6) for line in panel.lines}


def test_friction_is_in_percent_of_its_limit(plan: Plan):
    figure = plan_plots._cones(plan, plan.task)
    uses, forces = figure.axes[::2], figure.axes[1::2]
    assert len(uses) == len(forces) == len(GRASP.fingers)
    for panel in uses:
        assert panel.get_ylabel().endswith("use of friction (%)")
        used = panel.lines[0].get_ydata()
        assert used.min() >= 0.0
        assert used.max() < 100.0
        assert panel.get_ylim() == (0.0, 105.0)

"""Plots of a recording, for any number of contacts; their titles state the result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image
from support.allegro_grasp import PALM_UP, three_finger_grasp

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.simulation import Plant, Recording, build_scene, constant_reference, simulate
from graspforce.simulation.recordings import recording_plots
from graspforce.simulation.recordings.metrics import compute_metrics

CONTACT_ARRAYS = ("planned", "planned_R_OC", "planned_margin", "touching", "f", "p_OC", "R_OC", "mu", "gamma", "depth")


@pytest.fixture(scope="module")
def recording() -> Recording:
    grasp = three_finger_grasp()
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    controller = ObjectController(grasp, ControlSettings(gravity_H=np.array(PALM_UP)))
    return simulate(plant, controller, constant_reference(BodyMotion(grasp.p_HO, grasp.R_HO)), 0.01)


def test_plots_are_drawn_of_any_number_of_contacts(recording, tmp_path):
    one = replace(recording, fingers=("index",), **{name: getattr(recording, name)[:, :1] for name in CONTACT_ARRAYS})
    for path in (
        *recording_plots.save_plots(recording, tmp_path / "three"),
        *recording_plots.save_plots(one, tmp_path / "one"),
    ):
        assert image.imread(path).std() > 0.02


def test_titles_state_the_result(recording):
    def title(run: Recording) -> str:
        return recording_plots._contact_result(run, compute_metrics(run))

    assert title(recording).startswith(f"no contact slips; minimum slip margin {recording.slip_margin.min():.2f} N (")
    lost = replace(recording, touching=np.where(recording.t[:, None] > 0.0045, 0.0, 1.0) * np.ones(3))
    assert title(lost) == "a contact is lost in 50 % of the time; no contact slips"


def test_pushes_are_shaded_with_their_force_in_every_plot(recording, tmp_path, monkeypatch):
    figures = {}
    monkeypatch.setattr(recording_plots, "save_figures", lambda made, folder: figures.update(made) or [])
    late = (1.0, 0.0, 0.0, 5.0, 0.1)  # after the end of the recording
    recording_plots.save_plots(recording, tmp_path, [(0.0, 3.0, 4.0, 0.004, 0.002), late])
    assert set(figures) == {"error", "forces", "torques"}
    for figure in figures.values():
        for axes in figure.axes:
            (span,) = [patch for patch in axes.patches if patch.get_alpha() == 0.18]
            assert (span.get_x(), span.get_x() + span.get_width()) == pytest.approx((0.004, 0.006))
            assert axes.get_xlim() == pytest.approx((recording.t[0], recording.t[-1]))
        assert [text.get_text() for text in figure.axes[0].texts] == ["push 5 N"]

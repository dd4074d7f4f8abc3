"""Plots of an estimate: what is drawn is the recording, and the title states the result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.simulated_runs import SETTINGS, start_of

from graspforce.control import OutputFeedbackController
from graspforce.estimation import CameraModel, SensorModel
from graspforce.simulation import World, constant_reference, make_world_plant, simulate_measured
from graspforce.simulation.recordings.estimate_plots import plot_estimate, save_estimate_plots
from graspforce.simulation.recordings.measured_recording import CameraHistory, MeasuredRecording


@pytest.fixture(scope="module")
def recording() -> MeasuredRecording:
    grasp = three_finger_grasp()
    sensors = SensorModel(encoder_noise=1e-3, camera=CameraModel(rate=100.0, latency=0.005, position_noise=1e-3))
    world = World(sensors=sensors)
    controller = OutputFeedbackController(grasp, SETTINGS, sensors)
    return simulate_measured(
        make_world_plant(world, grasp, PALM_UP), controller, constant_reference(start_of(grasp)), 0.05, world
    )


def lines(figure, axes: int) -> dict[str, np.ndarray]:
    """Return the y values of the labelled lines of one of the axes."""
    return {line.get_label(): np.asarray(line.get_ydata()) for line in figure.axes[axes].lines}


def test_errors_and_sliding_are_those_of_the_recording(recording):
    figure = plot_estimate(recording)
    error = recording.estimation_error()
    for axes, columns, scale in ((1, range(3), 1e3), (3, range(3, 6), np.degrees(1.0))):
        drawn = lines(figure, axes)
        for name, column in zip("xyz", columns, strict=True):
            np.testing.assert_allclose(drawn[name], scale * error[:, column])
    drawn = lines(figure, 4)
    for i, finger in enumerate(recording.truth.fingers):
        np.testing.assert_allclose(drawn[finger], 1e3 * recording.sliding[:, i])
    z = lines(figure, 0)["z"]
    np.testing.assert_allclose(z, 1e3 * (recording.truth.p_HO[:, 2] - recording.truth.p_HO[0, 2]))


def test_recordings_without_estimate_or_camera_are_drawn(recording, tmp_path):
    no_camera = CameraHistory(np.zeros(0), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    for i, each in enumerate((recording, replace(recording, estimate=None), replace(recording, camera=no_camera))):
        (path,) = save_estimate_plots(each, tmp_path / str(i))
        assert image.imread(path).std() > 0.02


def test_titles_state_the_result(recording):
    def title(run: MeasuredRecording) -> str:
        return plot_estimate(run).get_suptitle()

    rms = 1e3 * np.sqrt(np.mean(np.sum(recording.estimation_error()[:, :3] ** 2, axis=1)))
    slid = replace(recording, sliding=np.full_like(recording.sliding, 2.5e-3))
    assert title(slid) == (
        f"allegro_right: the object is held; its position is estimated to {rms:.2g} mm RMS; fingertips slide by 2.5 mm at most"
    )
    assert title(replace(recording, drop_time=0.03)) == "allegro_right: the object is dropped at 0.03 s"
    still = replace(recording, estimate=None, sliding=np.full_like(recording.sliding, 3e-6))
    assert title(still) == "allegro_right: the object is held; fingertips slide by 3 µm at most"

"""Plots of an estimate against the truth: pose of the object, error with its bound, sliding of the fingertips."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from graspforce.core.arrays import Array
from graspforce.simulation.recordings.measured_recording import MeasuredRecording
from graspforce.view.figures import save_figures

_COLOURS = ("#D55E00", "#009E73", "#0072B2")  # x, y, z: distinct for colour-blind readers
_BLACK = "#222222"
_DASHED: dict[str, Any] = {"linestyle": (0, (1.0, 1.5)), "linewidth": 1.6, "zorder": 4.0}
_WIDTH = 11.0  # inches


def save_estimate_plots(recording: MeasuredRecording, folder: Path) -> list[Path]:
    """Write estimate.png: the object's true, estimated and measured pose, the errors, and the fingertips' sliding.

    Args:
        recording: the run.
        folder: directory for the file; created if it is missing.

    Returns:
        The file.
    """
    return save_figures({"estimate": plot_estimate(recording)}, folder)


def plot_estimate(recording: MeasuredRecording) -> Figure:
    """Return a figure of the estimate against the truth.

    Args:
        recording: the run; without an estimate only the truth and the camera's poses are shown.
    """
    r = recording.truth
    figure = Figure(figsize=(_WIDTH, 8.0), layout="constrained")
    (moved, moved_error), (turned, turned_error), (sliding, joints) = figure.subplots(3, 2, sharex=True)
    _plot_pose(moved, recording, is_position=True)
    _plot_pose(turned, recording, is_position=False)
    moved.set_ylabel("displacement (mm)")
    turned.set_ylabel("rotation vector (°)")
    if recording.estimate is not None:
        error = recording.estimation_error()
        for axes, part, scale in ((moved_error, slice(0, 3), 1e3), (turned_error, slice(3, 6), np.degrees(1.0))):
            for i, (name, colour) in enumerate(zip("xyz", _COLOURS, strict=True)):
                axes.plot(recording.estimate.t, scale * error[:, part][:, i], color=colour, label=name, linewidth=1.0)
            bound = 2.0 * scale * recording.estimate.deviation[:, part].max(axis=1)
            _plot_bound(axes, recording.estimate.t, bound)
            held = recording.estimate.t <= _end_of_hold(recording)
            largest = np.fmax(np.abs(scale * error[held, part]).max(axis=1), bound[held]).max(initial=1e-3)
            axes.set_ylim(-1.2 * largest, 1.2 * largest)
        rows = recording.true_rows()
        joints.plot(recording.estimate.t, 1e3 * _rms(recording.estimate.q - r.q[rows]), color=_BLACK, linewidth=0.8)
        moved_error.legend(frameon=False, ncols=4, loc="upper right")
    moved_error.set_ylabel("estimate − truth (mm)")
    turned_error.set_ylabel("estimate − truth (°)")
    joints.set_ylabel("joint error, RMS (mrad)")
    joints.set_ylim(bottom=0.0)
    for i, finger in enumerate(r.fingers):
        sliding.plot(r.t, 1e3 * recording.sliding[:, i], label=finger)
    sliding.set_ylabel("sliding on the object (mm)")
    sliding.set_ylim(0.0, max(1.1e3 * float(recording.sliding.max()), 0.01))  # mm
    sliding.legend(frameon=False)
    if recording.drop_time is not None:
        for axes in figure.axes:
            axes.axvline(recording.drop_time, color=_BLACK, linewidth=0.8)
    figure.suptitle(_title(recording))
    for axes in (sliding, joints):
        axes.set_xlabel("time (s)")
    for axes in figure.axes:
        axes.grid(alpha=0.25)
        axes.set_xlim(r.t[0], r.t[-1] if len(r.t) > 1 else r.t[0] + 1e-3)
    figure.legend(*moved.get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    return figure


def _plot_pose(axes: Axes, recording: MeasuredRecording, *, is_position: bool) -> None:
    """Plot true, estimated and measured displacements in mm, or rotation vectors in degrees, since the start."""
    r, estimate, camera = recording.truth, recording.estimate, recording.camera
    truth = _since_start(r.p_HO, r.R_HO, recording, is_position=is_position)
    for i, (name, colour) in enumerate(zip("xyz", _COLOURS, strict=True)):
        axes.plot(r.t, truth[:, i], color=colour, label=name, zorder=3.0)
        if estimate is not None:
            estimated = _since_start(estimate.p_HO, estimate.R_HO, recording, is_position=is_position)
            axes.plot(estimate.t, estimated[:, i], color=colour, **_DASHED)
        if len(camera.t_image):
            measured = _since_start(camera.p_HO, camera.R_HO, recording, is_position=is_position)
            axes.plot(camera.t_image, measured[:, i], ".", color=colour, markersize=3.0, alpha=0.5)
    held = truth[r.t <= _end_of_hold(recording)]
    low, high = held.min(), held.max()
    room = max(high - low, 0.2)  # mm or degrees: outliers of the camera and the fall do not set the range
    axes.set_ylim(low - room, high + room)
    if estimate is not None:
        axes.plot([], [], color=_BLACK, label="estimate", **_DASHED)
    if len(camera.t_image):
        axes.plot([], [], ".", color=_BLACK, markersize=3.0, label="camera, at the image's time")


def _end_of_hold(recording: MeasuredRecording) -> float:
    """Return the time until which the object is held, s."""
    return np.inf if recording.drop_time is None else recording.drop_time


def _plot_bound(axes: Axes, t: Array, bound: Array) -> None:
    """Shade two standard deviations of the worst axis, if they are estimated."""
    if np.isfinite(bound).any():
        axes.fill_between(t, -bound, bound, color=_BLACK, alpha=0.12, linewidth=0.0, label="± 2 σ")


def _since_start(p: Array, R: Array, recording: MeasuredRecording, *, is_position: bool) -> Array:
    """Return displacements in mm or rotation vectors in degrees from the true start."""
    r = recording.truth
    if is_position:
        return np.asarray(1e3 * (p - r.p_HO[0]))
    return np.asarray(Rotation.from_matrix(R @ r.R_HO[0].T).as_rotvec(degrees=True))


def _title(recording: MeasuredRecording) -> str:
    """Return the result of the run as a sentence."""
    hand = recording.truth.hand
    if recording.drop_time is not None:
        return f"{hand}: the object is dropped at {recording.drop_time:.2f} s"
    slid = f"fingertips slide by {_length(float(recording.sliding.max()))} at most"
    if recording.estimate is None:
        return f"{hand}: the object is held; {slid}"
    rms = float(np.sqrt(np.mean(np.sum(recording.estimation_error()[:, :3] ** 2, axis=1))))  # m
    return f"{hand}: the object is held; its position is estimated to {_length(rms)} RMS; {slid}"


def _length(value: float) -> str:
    """Return a length in m as text with a readable unit."""
    return f"{1e6 * value:.2g} µm" if value < 1e-4 else f"{1e3 * value:.2g} mm"


def _rms(errors: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(errors**2, axis=1)))

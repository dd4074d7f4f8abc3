"""Plots of a recording: tracking error, contact forces with their margins, motor torques."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from graspforce.core.arrays import Array
from graspforce.simulation.recordings.metrics import RunMetrics, compute_metrics
from graspforce.simulation.recordings.recording import Recording
from graspforce.view.figures import plot_torques, save_figures

_BLUE, _VERMILION, _GREEN, _BLACK = "#0072B2", "#D55E00", "#009E73", "#222222"  # distinct for colour-blind readers
_PLANNED: dict[str, Any] = {"linewidth": 4.0, "alpha": 0.35, "zorder": 1.5}  # behind the true line, which may be noisy
_TRUE: dict[str, Any] = {"linewidth": 1.1}
_PURPLE = "#8C40A6"  # of pushes, as in films
_WIDTH = 11.0  # inches


def save_plots(recording: Recording, folder: Path, pushes: Sequence[Sequence[float]] = ()) -> list[Path]:
    """Write error.png, forces.png and torques.png, with the times of pushes shaded.

    Args:
        recording: the run.
        folder: directory for the files; created if it is missing.
        pushes: (fx, fy, fz, start, duration) of each external force on the object: force, N, and times, s.

    Returns:
        The files.
    """
    metrics = compute_metrics(recording)
    figures = {
        "error": _plot_error(recording, metrics),
        "forces": _plot_forces(recording, metrics),
        "torques": _plot_torques(recording, metrics),
    }
    for figure in figures.values():
        _mark_pushes(figure, pushes)
    return save_figures(figures, folder)


def _mark_pushes(figure: Figure, pushes: Sequence[Sequence[float]]) -> None:
    """Shade the times of pushes in all axes, with the force in the first one."""
    for k, axes in enumerate(figure.axes):
        first, last = axes.get_xlim()
        for *force, start, duration in pushes:
            if not first <= start < last:
                continue
            axes.axvspan(start, min(start + duration, last), color=_PURPLE, alpha=0.18, linewidth=0.0, zorder=0.5)
            if k == 0:
                text, place = f"push {np.linalg.norm(force):.2g} N", (start, 1.0)
                axes.annotate(text, place, xycoords=("data", "axes fraction"), xytext=(0, 2), textcoords="offset points",
                              color=_PURPLE, fontsize=8)  # fmt: skip


def _plot_error(r: Recording, metrics: RunMetrics) -> Figure:
    """Plot displacement and rotation of the object beside their errors, in H's axes."""
    figure = Figure(figsize=(_WIDTH, 5.6), layout="constrained")
    (moved, position), (turned, orientation) = figure.subplots(2, 2, sharex=True)
    rotation, desired = _rotation_from_start(r.R_HO), _rotation_from_start(r.R_desired)
    for i, (axis, colour) in enumerate(zip("xyz", (_VERMILION, _GREEN, _BLUE), strict=True)):
        moved.plot(r.t, 1e3 * (r.p_HO[:, i] - r.p_HO[0, i]), color=colour, label=axis)
        moved.plot(r.t, 1e3 * (r.p_desired[:, i] - r.p_HO[0, i]), color=colour, **_PLANNED)
        turned.plot(r.t, rotation[:, i], color=colour)
        turned.plot(r.t, desired[:, i], color=colour, **_PLANNED)
    _plot_norm(position, r.t, 1e3 * np.linalg.norm(r.position_error, axis=1))
    _plot_norm(orientation, r.t, np.degrees(np.linalg.norm(r.orientation_error, axis=1)))
    moved.plot([], [], color=_BLACK, label="desired", **_PLANNED)
    moved.set_ylabel("displacement (mm)")
    turned.set_ylabel("rotation vector (°)")
    position.set_ylabel("position error (mm)")
    orientation.set_ylabel("orientation error (°)")
    for axes in (turned, orientation):
        axes.set_xlabel("time (s)")
    figure.legend(*moved.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    error, angle = _length(metrics.position_error_rms), np.degrees(metrics.orientation_error_rms)
    figure.suptitle(f"{r.hand}: the object follows its reference to {error} and {angle:.2g}° RMS")
    _finish(figure, r.t)
    return figure


def _plot_forces(r: Recording, metrics: RunMetrics) -> Figure:
    """Plot the forces of each contact beside their slip margins and the use of friction."""
    N = len(r.fingers)
    figure = Figure(figsize=(_WIDTH, 1.9 * N + 1.5), layout="constrained")
    rows = figure.subplots(N, 3, sharex=True, sharey="col", squeeze=False)
    margins, bound = r.slip_margin, r.mu * r.f[..., 2]  # N
    planned_bound = r.planned_margin + _friction_load(r)  # with the coefficients of friction that the controller knows
    for i, (force, margin, use) in enumerate(rows):
        force.plot(r.t, r.f[:, i, 2], color=_BLUE, label="normal force", **_TRUE)
        force.plot(r.t, np.linalg.norm(r.f[:, i, :2], axis=1), color=_VERMILION, label="tangential force", **_TRUE)
        force.plot(r.t, r.planned[:, i, 2], color=_BLUE, **_PLANNED)
        force.plot(r.t, np.linalg.norm(r.planned[:, i, :2], axis=1), color=_VERMILION, **_PLANNED)
        margin.plot(r.t, margins[:, i], color=_GREEN, **_TRUE)
        margin.plot(r.t, r.planned_margin[:, i], color=_GREEN, **_PLANNED)
        margin.axhline(0.0, color=_BLACK, linewidth=1.0)
        use.plot(r.t, _use(margins[:, i], bound[:, i]), color=_BLACK, **_TRUE)
        use.plot(r.t, _use(r.planned_margin[:, i], planned_bound[:, i]), color=_BLACK, **_PLANNED)
        use.axhline(100.0, color=_VERMILION, linewidth=1.0)
        force.set_ylabel(f"{r.fingers[i]}\nforce (N)")
        margin.set_ylabel("slip margin (N)")
        use.set_ylabel("use of friction (%)")
    rows[0, 0].plot([], [], color=_BLACK, label="planned", **_PLANNED)
    rows[0, 0].set_ylim(bottom=0.0)
    rows[0, 2].set_ylim(0.0, 105.0)
    for axes in rows[-1]:
        axes.set_xlabel("time (s)")
    figure.legend(*rows[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"{r.hand}: {_contact_result(r, metrics)}")
    _finish(figure, r.t)
    return figure


def _plot_torques(r: Recording, metrics: RunMetrics) -> Figure:
    """Plot the motor torques over their limits."""
    figure, axes = plot_torques(r.t, r.tau, r.torque_lower, r.torque_upper, r.joints)
    used = 100.0 * metrics.max_torque_fraction
    shares = 100.0 * r.tau / np.where(r.tau >= 0.0, r.torque_upper, -r.torque_lower)  # %
    axes.set_ylim(min(1.1 * shares.min(), 0.0), max(1.1 * shares.max(), 0.1))
    axes.set_ylabel("torque (% of the motor's limit)")
    axes.set_xlabel("time (s)")
    figure.suptitle(f"{r.hand}: motors use at most {used:.0f} % of their torque")
    _finish(figure, r.t)
    return figure


def _contact_result(r: Recording, metrics: RunMetrics) -> str:
    """Return the result of the contacts as a sentence."""
    if metrics.lost_contact_steps or metrics.slip_steps:
        lost, slip = (f"{100.0 * count / len(r.t):.2g} %" for count in (metrics.lost_contact_steps, metrics.slip_steps))
        absence = f"a contact is lost in {lost} of the time" if metrics.lost_contact_steps else "no contact is lost"
        return f"{absence}; " + (
            f"friction is at its limit in {slip} of the time" if metrics.slip_steps else "no contact slips"
        )
    step, finger = np.unravel_index(int(r.slip_margin.argmin()), r.slip_margin.shape)
    return f"no contact slips; minimum slip margin {metrics.min_slip_margin:.2f} N ({r.fingers[finger]}, {r.t[step]:.2f} s)"


def _friction_load(r: Recording) -> Array:
    """Return the norm of the planned tangential forces with the moments about the normals, as in a soft contact's cone, N."""
    lever = np.divide(r.mu, r.gamma, out=np.zeros_like(r.mu), where=r.gamma > 0.0)  # 1/m
    return np.asarray(np.hypot(np.linalg.norm(r.planned[..., :2], axis=-1), lever * r.planned[..., 3]))


def _rotation_from_start(R: Array) -> Array:
    """Return the rotation vectors (s, 3) from the first orientation, in H, degrees."""
    vectors = Rotation.from_matrix(R @ R[0].T).as_rotvec(degrees=True)
    return np.asarray(vectors)


def _use(margin: Array, bound: Array) -> Array:
    """Return the part of friction in use, %: 100 (1 − margin / bound); 100 without normal force."""
    return np.asarray(100.0 - 100.0 * np.divide(margin, bound, out=np.zeros_like(bound), where=bound > 0.0))


def _plot_norm(axes: Axes, t: Array, values: Array) -> None:
    axes.plot(t, values, color=_BLACK)
    axes.set_ylim(bottom=0.0)


def _finish(figure: Figure, t: Array) -> None:
    """Set grid and time range of all axes."""
    for axes in figure.axes:
        axes.grid(alpha=0.25)
        axes.margins(x=0.0)
        axes.set_xlim(t[0], t[-1] if len(t) > 1 else t[0] + 1e-3)


def _length(value: float) -> str:
    """Return a length in m as text with a readable unit."""
    return f"{1e6 * value:.2g} µm" if value < 1e-4 else f"{1e3 * value:.2g} mm"

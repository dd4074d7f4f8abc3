"""Figures of the report: performance profiles, time against contacts, accuracy against time, speed-up by warm starts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from graspforce.bench.outcome import RaceOutcome
from graspforce.bench.statistics import (
    OutcomeGroup,
    WarmStartGain,
    feasible_cases,
    median_accuracy,
    performance_profile,
    times_by_contacts,
    warm_start_gains,
)

_COLOURS = ("#1b6ca8", "#d1495b", "#2e933c", "#edae49", "#6a4c93", "#00798c", "#8d6a3f", "#e07a5f", "#3d405b", "#7fb069")
_LINES = ("-", "--", ":", "-.")
_MARKS = "osD^v<>PX*phd8"
_MAX_RATIO = 1e3  # largest ratio to the shortest time that profiles show
_COUNTS = (3, 5, 10, 20, 50, 100, 200, 500, 1000)  # numbers of contacts with a tick


def draw_figures(outcomes: Sequence[RaceOutcome], groups: Sequence[OutcomeGroup], folder: Path) -> dict[str, str]:
    """Draw all figures that have data, and return their captions by file name.

    Args:
        outcomes: all outcomes of a race.
        groups: groups of the cold outcomes.
        folder: existing folder for the PNG files.
    """
    solvers = tuple(dict.fromkeys(outcome.task.solver for outcome in outcomes))
    captions = {}
    plain = [group for group in groups if (group.settings, group.units) == ("default", "scaled")]
    if plain:
        panels = [(group, common) for group in plain for common in (False, True)]
        figure, axes = _panels([group for group, _ in panels])
        for axis, (group, common) in zip(axes, panels, strict=True):
            _profile(axis, group, common, solvers)
        captions["profiles.png"] = _save(
            figure,
            folder / "profiles.png",
            "Performance profiles (Dolan and Moré, 2002), default settings, scaled: the share of feasible cases that a solver "
            "solves within a factor of the shortest time. Higher is more reliable; further left is faster. Over all feasible "
            "cases, an unsupported case counts as not solved; the other panels have the cases that every solver supports.",
        )
    scaling = [group for group in plain if any(times_by_contacts(group).values())]
    if scaling:
        figure, axes = _panels(scaling)
        for axis, group in zip(axes, scaling, strict=True):
            _contacts(axis, group, solvers)
        captions["contacts.png"] = _save(
            figure,
            folder / "contacts.png",
            "Time against number of contacts on the collection `scaling`, default settings, scaled. Points without a correct "
            "solution are omitted.",
        )
    scaled = [group for group in groups if group.units == "scaled"]
    if any(median_accuracy(group) for group in scaled):
        kinds = [[group for group in scaled if group.pyramid is pyramid] for pyramid in (False, True)]
        kinds = [kind for kind in kinds if kind]
        figure, axes = _panels([kind[0] for kind in kinds])
        for axis, kind in zip(axes, kinds, strict=True):
            _accuracy(axis, kind, solvers)
        captions["accuracy.png"] = _save(
            figure,
            folder / "accuracy.png",
            "Accuracy against time, scaled: median time and median residual, joined from low by default to high settings. "
            "Lower is more accurate. The settings do not affect solvers without tolerances. Medians are over the "
            "correct solutions of each solver.",
        )
    warm = warm_start_gains(outcomes)
    if warm:
        figure = Figure(figsize=(8.0, 0.5 + 0.42 * len(warm)), layout="constrained")
        _gains(figure.add_subplot(), warm)
        captions["warm.png"] = _save(
            figure,
            folder / "warm.png",
            "Speed-up by warm starts along sequences, default settings, scaled: cold time over warm time. Above 1, a warm "
            "start is faster.",
        )
    return captions


def _panels(groups: Sequence[OutcomeGroup]) -> tuple[Figure, list[Any]]:
    figure = Figure(figsize=(6.0 * len(groups), 5.6), layout="constrained")
    axes = [figure.add_subplot(1, len(groups), i + 1) for i in range(len(groups))]
    for axis, group in zip(axes, groups, strict=True):
        axis.set_title("pyramids" if group.pyramid else "exact cones", loc="left", fontsize=11)
        axis.grid(color="#dddddd", linewidth=0.6)
        axis.set_axisbelow(True)
    return figure, axes


def _legend(axis: Any) -> None:
    """Draw the legend below the axis, clear of the curves."""
    axis.legend(fontsize=8, ncols=5, loc="upper center", bbox_to_anchor=(0.5, -0.13), frameon=False)


def _save(figure: Figure, path: Path, caption: str) -> str:
    figure.savefig(path, format="png", dpi=110)
    return caption


def _style(solver: str, solvers: Sequence[str]) -> dict[str, Any]:
    """Return a colour and a dash pattern for each solver, the same in every figure."""
    i = solvers.index(solver)
    return {"color": _COLOURS[i % len(_COLOURS)], "linestyle": _LINES[i // len(_COLOURS) % len(_LINES)]}


def _profile(axis: Any, group: OutcomeGroup, common: bool, solvers: Sequence[str]) -> None:
    count = len(feasible_cases(group, common))
    which = f"the {count} feasible cases that all support" if common else f"all {count} feasible cases"
    axis.set_title(f"{'pyramids' if group.pyramid else 'exact cones'}, {which}", loc="left", fontsize=11)
    for solver, ratios in performance_profile(group, common).items():
        reached = [ratio for ratio in ratios if ratio <= _MAX_RATIO]
        x = [1.0, *reached, _MAX_RATIO]
        y = [sum(r <= 1.0 for r in ratios), *range(1, len(reached) + 1), len(reached)]
        axis.step(x, [100.0 * n / max(1, len(ratios)) for n in y], where="post", label=solver, **_style(solver, solvers))
    axis.set_xscale("log")
    axis.set(xlim=(1.0, _MAX_RATIO), ylim=(0.0, 101.0), xlabel="time / shortest time on the case")
    axis.set_ylabel("cases solved within this factor, %")
    _legend(axis)


def _contacts(axis: Any, group: OutcomeGroup, solvers: Sequence[str]) -> None:
    for solver, points in times_by_contacts(group).items():
        if points:
            style = _style(solver, solvers)
            mark = _MARKS[solvers.index(solver) % len(_MARKS)]
            axis.plot(*zip(*points, strict=True), marker=mark, markersize=3.5, label=solver, **style)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xticks(_contact_ticks(axis.get_xlim()), labels=[str(count) for count in _contact_ticks(axis.get_xlim())])
    axis.set_xticks([], minor=True)
    axis.set(xlabel="contacts", ylabel="median time of correct solutions, s")
    _legend(axis)


def _contact_ticks(limits: tuple[float, float]) -> list[int]:
    return [count for count in _COUNTS if limits[0] <= count <= limits[1]]


def _accuracy(axis: Any, groups: Sequence[OutcomeGroup], solvers: Sequence[str]) -> None:
    """Draw one line per solver, through its settings from low to high, in double precision."""
    order = {"low": 0, "default": 1, "high": 2}
    lines: dict[str, list[tuple[float, float]]] = {}
    double = [group for group in groups if group.settings in order]
    for group in sorted(double, key=lambda one: order[one.settings]):
        for solver, (time, residual) in median_accuracy(group).items():
            lines.setdefault(solver, []).append((time, max(residual, 1e-17)))
    for solver, points in lines.items():
        style = _style(solver, solvers)
        mark = _MARKS[solvers.index(solver) % len(_MARKS)]
        times, residuals = zip(*points, strict=True)
        axis.plot([1e6 * t for t in times], residuals, marker=mark, markersize=6, linewidth=1.0, label=solver, **style)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set(xlabel="median time of correct solutions, µs", ylabel="median residual")
    _legend(axis)


def _gains(axis: Any, gains: Sequence[WarmStartGain]) -> None:
    labels = [f"{gain.solver}, {'pyramids' if gain.pyramid else 'exact cones'}" for gain in gains]
    values = [gain.speedup for gain in gains]
    axis.barh(range(len(gains)), values, color=_COLOURS[0], height=0.6)
    for i, gain in enumerate(gains):
        text = f"{gain.speedup:.2f} ×, {gain.cold_iterations:.0f} → {gain.warm_iterations:.0f} iterations"
        box = {"facecolor": "white", "linewidth": 0, "pad": 1}
        place = {"xytext": (5, 0), "textcoords": "offset points", "va": "center"}
        axis.annotate(text, (gain.speedup, i), fontsize=8, bbox=box, **place)
    axis.axvline(1.0, color="#555555", linewidth=0.8, zorder=0.5)
    axis.set_yticks(range(len(gains)), labels)
    axis.invert_yaxis()
    finite = [value for value in values if math.isfinite(value)]
    axis.set(xlim=(0.0, 1.45 * max([*finite, 1.0])), xlabel="cold time / warm time, median along sequences")
    axis.set_title("speed-up by warm starts", loc="left", fontsize=11)

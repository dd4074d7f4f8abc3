"""Plots of answers about grasps: use of limits, payload by direction, sets of wrenches, sensitivities, contact regions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from graspforce.analysis.contact_regions import ContactRegions
from graspforce.analysis.explain import Explanation
from graspforce.analysis.largest_wrench import largest_wrench
from graspforce.analysis.sensitivity import Sensitivities
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.problem import ForceProblem

COLOURS = {"friction": "#E69F00", "normal force": "#0072B2", "torque": "#56B4E9"}
LIMIT, LOAD = "#CC3311", "#0072B2"
_MOST_BARS = 24
_FULL = 0.9995  # a limit that prints as 100 %
_MOST_COLUMNS = 4  # of maps of regions
_REGION_ENDS = {
    "lost": ("o", LOAD, "lost beyond"),
    "edge": ("s", "#E69F00", "edge of the surface"),
    "limit": ("^", "#009E73", "not tried beyond"),
}  # marker, colour and meaning by why a line ends
_COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")
_PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


def plot_limits(explanation: Explanation) -> Figure:
    """Return a bar chart of the limits that the forces use most, in percent, with what is left of each in N or N·m.

    Args:
        explanation: one of a problem with forces.

    Raises:
        InvalidInput: the problem has no forces.
    """
    if not explanation.limits:
        raise InvalidInput("explanation", explanation.solution.status.value, "one with forces that have limits")
    limits = explanation.limits[:_MOST_BARS][::-1]
    figure = Figure(figsize=(7.0, 1.4 + 0.28 * len(limits)), layout="constrained")
    axes = figure.subplots()
    for kind, colour in COLOURS.items():
        places = [i for i, limit in enumerate(limits) if limit.kind == kind]
        if places:
            axes.barh(places, [100.0 * limits[i].used for i in places], 0.7, color=colour, label=kind)
    for i, limit in enumerate(limits):
        left = f"{abs(limit.margin):.2g} {'N·m' if limit.kind == 'torque' else 'N'} left"
        axes.text(103.0, i, left if limit.used < _FULL else "nothing left", va="center", fontsize=9)
    axes.axvline(100.0, color=LIMIT, linestyle="--", linewidth=1.2)
    axes.set(yticks=range(len(limits)), xlabel="used (% of the limit)", xlim=(0.0, 132.0), xticks=range(0, 101, 20))
    axes.set_yticklabels([f"{limit.name}, {limit.kind}" for limit in limits])
    figure.legend(frameon=False, loc="outside lower center", ncols=3, fontsize=9)
    axes.set_title(f"{str(limits[-1])[0].upper()}{str(limits[-1])[1:]}", fontsize=11)
    return figure


def plot_payload(problem: ForceProblem, plane: str = "xz", directions: int = 72) -> Figure:
    """Return a polar plot of the largest force that can be added to the problem's wrench, by direction in a plane of O.

    Args:
        problem: the force problem.
        plane: "xy", "xz" or "yz", the angle counted from the first axis.
        directions: number of directions, 8 to 720.

    Raises:
        InvalidInput: another plane or number of directions, or a problem without feasible forces.
    """
    first, second = _PLANES[fields.check_choice(plane, "plane", tuple(_PLANES))]
    fields.check_integer(directions, "directions", minimum=8, maximum=720)
    angles = np.linspace(0.0, 2.0 * np.pi, directions, endpoint=False)
    amounts = []
    for angle in angles:
        direction = np.zeros(6)
        direction[first], direction[second] = np.cos(angle), np.sin(angle)
        largest = largest_wrench(problem, direction)
        if largest is None:
            raise InvalidInput("problem", "infeasible", "one with feasible forces")
        amounts.append(largest.amount)
    values = np.array(amounts)
    finite = np.isfinite(values)
    figure = Figure(figsize=(5.2, 5.2), layout="constrained")
    axes = figure.add_subplot(projection="polar")
    axes.plot(np.append(angles, angles[0]), np.append(np.where(finite, values, np.nan), values[0]), color=LOAD)
    axes.fill(angles[finite], values[finite], color=LOAD, alpha=0.2)
    axes.set_xticks(np.radians([0, 90, 180, 270]), [f"+{plane[0]}", f"+{plane[1]}", f"−{plane[0]}", f"−{plane[1]}"])
    if finite.any():
        weakest = int(np.argmin(np.where(finite, values, np.inf)))
        label = f"at least {values[weakest]:.3g} N, the least at {np.degrees(angles[weakest]):.0f}° from +{plane[0]}"
    else:
        label = "no limit bounds it"
    axes.set_title(f"Force that can be added in the {plane} plane (N):\n{label}", fontsize=10)
    return figure


def plot_sensitivities(answer: Sensitivities, scale: npt.ArrayLike | None = None) -> Figure:
    """Return bars of the objective's change for friction + 1 %, and for contacts moved by 1 mm in the best direction.

    Args:
        answer: regular sensitivities.
        scale: (N,) displacement of each contact, m; 1 mm by default.

    Raises:
        InvalidInput: the optimum is degenerate.
    """
    contacts = answer.optimum.problem.contacts
    step = arrays.check_array(np.full(len(contacts), 1e-3) if scale is None else scale, "scale", (len(contacts),))
    value = answer.optimum.problem.cost(answer.optimum.f)
    percent = 100.0 / value if value else np.nan
    friction = percent * 0.01 * answer.objective["mu"] * contacts.mu
    moved = -percent * step * np.linalg.norm(answer.objective["p"], axis=1)
    figure = Figure(figsize=(6.5, 3.6), layout="constrained")
    axes = figure.subplots()
    place = np.arange(len(contacts))
    axes.bar(place - 0.2, friction, 0.4, color=COLOURS["friction"], label="friction + 1 %")
    moves = f"moved by {1e3 * step.max():.3g} mm in the best direction"
    axes.bar(place + 0.2, moved, 0.4, color=COLOURS["torque"], label=moves)
    axes.axhline(0.0, color="#444444", linewidth=0.8)
    axes.set(xlabel="contact", ylabel="change of the objective (%)", xticks=place)
    axes.margins(y=0.3)
    axes.legend(frameon=False, fontsize=9, ncols=2, loc="lower center")
    best, rough = int(np.argmin(moved)), int(np.argmin(friction))
    title = f"1 % more friction at contact {rough} lowers the objective by {-friction[rough]:.2g} %"
    if moved[best] < friction[rough]:
        title = f"Contact {best} moved by {1e3 * step[best]:.3g} mm lowers the objective by {-moved[best]:.2g} %"
    axes.set_title(title, fontsize=10)
    return figure


def plot_wrench_set(problem: ForceProblem, plane: str = "fx,fz", directions: int = 90) -> Figure:
    """Return a section of the wrenches that contacts and motors can supply, through the problem's wrench.

    Args:
        problem: the force problem, with its cones and limits.
        plane: two of fx, fy, fz, mx, my and mz, components about O, in O, separated by a comma. The others are those of the
            problem's wrench.
        directions: number of directions of the boundary, 8 to 720.

    Raises:
        InvalidInput: other components or another number of directions, or a problem without feasible forces.
    """
    names = [fields.check_choice(name, "plane", _COMPONENTS) for name in plane.split(",")]
    if len(set(names)) != 2:
        raise InvalidInput("plane", plane, "two different components, such as fx,fz")
    fields.check_integer(directions, "directions", minimum=8, maximum=720)
    places = [_COMPONENTS.index(name) for name in names]
    units = [1.0 if place < 3 else problem.length for place in places]  # moments in N times the characteristic length
    ends = []
    for angle in np.linspace(0.0, 2.0 * np.pi, directions, endpoint=False):
        direction = np.zeros(6)
        direction[places] = np.array([np.cos(angle), np.sin(angle)]) * units
        largest = largest_wrench(problem, direction)
        if largest is None:
            raise InvalidInput("problem", "infeasible", "one with feasible forces")
        if np.isfinite(largest.amount):
            ends.append(largest.wrench[places])
    figure = Figure(figsize=(5.4, 5.0), layout="constrained")
    axes = figure.subplots()
    if ends:
        axes.fill(*np.array(ends).T, facecolor=LOAD, alpha=0.2)
        axes.plot(*np.array([*ends, ends[0]]).T, color=LOAD, label="largest wrenches")
    axes.plot(*problem.w[places], "o", color=LIMIT, label="wrench of the problem")
    axes.plot(0.0, 0.0, "+", color="#444444", markersize=10, label="zero")
    axes.set(**{f"{axis}label": f"{name} ({'N' if name[0] == 'f' else 'N·m'})" for axis, name in zip("xy", names, strict=True)})
    axes.margins(0.15)
    axes.grid(alpha=0.25)
    figure.legend(frameon=False, fontsize=9, ncols=3, loc="outside lower center")
    axes.set_title(_section_title(names, ends, len(ends) == directions), fontsize=10)
    return figure


def _section_title(names: list[str], ends: list[Array], bounded: bool) -> str:
    """Return the ranges of two components of the wrenches that a grasp can supply."""
    title = f"Wrenches that the grasp can supply: {names[0]} and {names[1]}"
    if not bounded:
        return f"{title}, without bound in some directions"
    corners = np.array(ends)
    ranges = [
        f"{name} from {low:.3g} to {high:.3g} {'N' if name[0] == 'f' else 'N·m'}"
        for name, low, high in zip(names, corners.min(axis=0), corners.max(axis=0), strict=True)
    ]
    return f"The grasp can supply {ranges[0]}\nand {ranges[1]}"


def plot_contact_regions(regions: ContactRegions) -> Figure:
    """Return a map of the region of each contact: the distances along the surface in all directions, in mm.

    Args:
        regions: regions of at least one contact.

    Raises:
        InvalidInput: no regions.
    """
    if not regions.regions:
        raise InvalidInput("regions", "empty", "regions of at least one contact")
    count = len(regions.regions)
    columns = min(count, _MOST_COLUMNS)
    rows = -(-count // columns)
    figure = Figure(figsize=(max(2.4 * columns, 5.5), 2.9 * rows + 0.8), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axes, region in zip(panels, regions.regions, strict=False):
        angles = 2.0 * np.pi * np.arange(len(region.distances)) / len(region.distances)
        x, y = 1e3 * region.distances * np.cos(angles), 1e3 * region.distances * np.sin(angles)
        axes.fill(x, y, facecolor=LOAD, alpha=0.2, edgecolor=LOAD)
        for end, (marker, colour, label) in _REGION_ENDS.items():
            own = [i for i, each in enumerate(region.ends) if each == end]
            if own:
                axes.plot(x[own], y[own], marker, color=colour, markersize=4, label=label)
        axes.plot(0.0, 0.0, "+", color="#444444", markersize=9, label="contact")
        axes.set_title(f"contact {region.contact}: {1e3 * region.radius:.3g} mm", fontsize=10)
        axes.set(aspect="equal", xlabel="along t₁ (mm)", ylabel="along t₂ (mm)")
        axes.grid(alpha=0.25)
    for axes in panels[count:]:
        axes.set_visible(False)
    entries = {label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(list(entries.values()), list(entries), frameon=False, fontsize=9, ncols=4, loc="outside lower center")
    least = min(regions.regions, key=lambda region: region.radius)
    kept = {"closure": "closure is", "payload": "the payload is"}[regions.kept]
    title = f"Contact {least.contact} may err by {1e3 * least.radius:.3g} mm along the surface before {kept} lost"
    figure.suptitle(title, fontsize=11)
    return figure

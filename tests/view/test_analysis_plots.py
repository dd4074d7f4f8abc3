"""Plots of answers about grasps: each title states the result, and the drawn numbers are those of the answer."""

from __future__ import annotations

import numpy as np
import pytest
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from graspforce import Contact, ForceProblem, InvalidInput, explain, sensitivities, solve
from graspforce.analysis.contact_regions import ContactRegions, contact_regions
from graspforce.cli import main
from graspforce.geometry import Sphere
from graspforce.view import plot_contact_regions, plot_limits, plot_payload, plot_sensitivities, plot_wrench_set, show


def pair(weight: float) -> ForceProblem:
    """Return two opposed contacts with μ = 0.5 and f_n ≤ 10 N that lift a weight, N."""
    contacts = [Contact((0, y, 0), (0, -y, 0), 0.5, max_normal=10.0) for y in (0.05, -0.05)]
    return ForceProblem(contacts, (0, 0, weight, 0, 0, 0))


def ring() -> ForceProblem:
    """Return three symmetric contacts with μ = 0.5 that lift 2 N."""
    angles = 2 * np.pi * np.arange(3) / 3
    contacts = [Contact((0.05 * np.cos(a), 0.05 * np.sin(a), 0), (-np.cos(a), -np.sin(a), 0), 0.5) for a in angles]
    return ForceProblem(contacts, (0, 0, 2.0, 0, 0, 0))


def test_the_plot_of_limits_has_a_bar_for_each_limit():
    answer = explain(pair(4.0))
    figure = plot_limits(answer)
    [axes] = figure.axes
    widths = sorted(bar.get_width() for bar in axes.patches)
    assert widths == pytest.approx(sorted(100.0 * limit.used for limit in answer.limits))
    assert "uses 100 % of its friction" in axes.get_title()
    assert [text.get_text() for text in axes.texts] == ["6 N left"] * 2 + ["nothing left"] * 2  # 4 N of 10 N, and 2 N of 2 N
    with pytest.raises(InvalidInput, match="explanation"):
        plot_limits(explain(pair(40.0)))


def test_the_payload_of_a_pair_is_drawn_by_direction():
    """10 N upwards in all: 6 N can be added upwards and 14 N downwards."""
    figure = plot_payload(pair(4.0), "xz", directions=8)
    [axes] = figure.axes
    amounts = axes.lines[0].get_ydata()
    assert (amounts[2], amounts[6]) == pytest.approx((6.0, 14.0), rel=1e-6)
    assert "at least 6 N, the least at 90° from +x" in axes.get_title()
    with pytest.raises(InvalidInput, match="plane"):
        plot_payload(pair(4.0), "zz")


def test_more_friction_lowers_the_objective_in_the_plot():
    """W²(1 + 1/μ²)/(2n): 1 % more friction at one of three contacts lowers it by 2/(1 + μ²)/3 %."""
    figure = plot_sensitivities(sensitivities(solve(ring())))
    bars = [bar.get_height() for bar in figure.axes[0].patches[:3]]
    assert bars == pytest.approx([-2.0 / 1.25 / 3.0] * 3, rel=1e-6)


def test_the_section_of_the_wrench_set_of_a_pair_is_a_disc():
    """Friction of 5 N at each contact bears forces along x and z of up to 10 N together."""
    figure = plot_wrench_set(pair(4.0), "fx,fz", directions=16)
    ends = np.column_stack(figure.axes[0].lines[0].get_data())
    assert np.linalg.norm(ends, axis=1) == pytest.approx(np.full(17, 10.0), rel=1e-6)
    assert figure.axes[0].get_xlabel() == "fx (N)"
    assert "fx from -10 to 10 N" in figure.axes[0].get_title()
    for bad in ("fx", "fx,fx", "fx,fq"):
        with pytest.raises(InvalidInput, match="plane"):
            plot_wrench_set(pair(4.0), bad)
    with pytest.raises(InvalidInput, match="infeasible"):
        plot_wrench_set(pair(40.0))


def test_the_map_of_regions_has_the_distances_by_direction():
    contacts = [
        Contact((0, y, 0), (0, -y, 0), 0.4, model="soft", torsional_friction=0.005, max_normal=10.0) for y in (0.03, -0.03)
    ]
    regions = contact_regions(ForceProblem(contacts, (0, 0, 6.0, 0, 0, 0)), Sphere(0.03), directions=4)
    figure = regions.plot()
    for axes, region in zip(figure.axes, regions.regions, strict=True):
        corners = axes.patches[0].get_xy()[:4]
        assert np.linalg.norm(corners, axis=1) == pytest.approx(1e3 * region.distances)
    shortest = min(region.radius for region in regions.regions)
    assert f"may err by {1e3 * shortest:.3g} mm" in figure.get_suptitle()
    with pytest.raises(InvalidInput, match="regions"):
        plot_contact_regions(ContactRegions("payload", ()))


def test_forces_are_drawn_in_their_cones():
    """The arrow of a force ends at its contact: the cones are drawn on the side of its tail, against the normals."""
    problem = ring()
    axes = show(problem, solve(problem)).axes[0]
    contacts = problem.contacts
    cones = [c for c in axes.collections if isinstance(c, Poly3DCollection)]
    assert len(cones) == len(contacts)
    for p, normal, cone in zip(contacts.p_OC, contacts.R_OC[:, :, 2], cones, strict=True):
        corners = np.concatenate(list(cone._faces))  # as matplotlib stores them
        assert (corners.reshape(-1, 3) - p).mean(axis=0) @ normal < 0.0


@pytest.mark.parametrize("command", ["quality", "explain"])
def test_the_commands_write_a_plot(command, tmp_path, capsys):
    import json

    file, picture = tmp_path / "pair.json", tmp_path / "plot.png"
    file.write_text(json.dumps(pair(4.0).to_dict()))
    budget = {"quality": "0", "explain": "60"}[command]  # s
    assert main([command, str(file), "--budget", budget, "--plot", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert capsys.readouterr().out

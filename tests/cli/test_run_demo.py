"""The demo's laws: every answer certified, nothing slips, and the forces are mirrored where the task is."""

from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib import image
from rich.console import Console
from support.servers import ANY_LOCAL_PORT

from graspforce.cli import run_demo
from graspforce.hand.hand import Hand
from graspforce.problems.carry import sinusoidal_carry
from graspforce.service import Client, Server


@pytest.fixture(scope="module")
def carried():
    path = sinusoidal_carry(steps=61, period=0.5, friction=run_demo.PLANNED_FRICTION)
    with Server([run_demo.HAND], listen=ANY_LOCAL_PORT) as server, Client(server.addresses[0], timeout=10.0) as client:
        yield run_demo.carry(path, client)


def test_all_forces_are_certified_and_inside_their_cones(carried):
    assert carried.certified_fraction == 1.0
    assert len(carried.answers) == 61
    # A tenth of the friction is in reserve, and every finger presses: what is left is far above the solver's 1e-9 N.
    assert carried.slip_margins.min() > 0.01
    for step, answer in zip(carried.steps, carried.answers, strict=True):
        assert answer.slip_margin.min() >= -1e-8 * np.abs(step.problem.w).max()
        # What came over the wire supplies the wrench that this instant needs.
        assert step.problem.G @ answer.f == pytest.approx(step.problem.w, abs=1e-8 * np.abs(step.problem.w).max())
        assert answer.torques == pytest.approx(step.problem.torques(answer.f), abs=1e-12)


def test_forces_are_symmetric_about_the_middle_of_the_path(carried):
    """As Al-Gallaf reports. The ways out and back are equal; the solver's accuracy is √1e-10 of the force at worst."""
    assert carried.asymmetry <= 1e-5 * np.abs(carried.forces).max()
    assert np.abs(np.diff(carried.forces, axis=0)).max() > 1e-2  # it is no symmetry of things that never change


def test_normal_forces_are_well_above_the_tangential_ones(carried):
    """Al-Gallaf et al.: by a factor that the friction at the fingertips determines, 1/μ = 1.85 at least."""
    f, mu = carried.forces, carried.steps[0].problem.contacts.mu[0]
    ratio = f[:, :, 2] / np.hypot(f[:, :, 0], f[:, :, 1])
    assert ratio.min() >= 1 / mu - 1e-6  # inside the cone for which the forces are planned
    assert ratio.min() > 1.8  # well above: where the cone is active,
    assert ratio.mean() > 2.2  # and further on average


def test_demo_prints_a_summary_and_writes_a_picture(carried, tmp_path):
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(run_demo.summary_table(carried, Hand.load(run_demo.HAND)))
    said = console.export_text()
    for words in ("61", "round trip, median", "round trip, 99 %", "100 %", "smallest slip margin", "largest joint torque"):
        assert words in said
    run_demo.plot_forces(carried, tmp_path / "forces.png")
    pixels = image.imread(tmp_path / "forces.png")
    assert pixels.shape[0] > 500
    assert len(np.unique(pixels.reshape(-1, pixels.shape[2]), axis=0)) > 10  # curves, labels and a grid


def test_the_whole_demo(tmp_path):
    """As `make run` runs it: a service in a process of its own."""
    assert run_demo.run(11, tmp_path / "carry.png", Console(quiet=True))
    assert (tmp_path / "carry.png").stat().st_size > 10_000

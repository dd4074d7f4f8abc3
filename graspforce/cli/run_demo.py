"""The command ``graspforce demo``: a box that four fingers carry along a sinusoid (Al-Gallaf), with forces from a service.

The service runs in its own process. The client requests the forces of each instant over Zenoh.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from graspforce.cli.console import progress_console
from graspforce.cli.json_output import put_result
from graspforce.core.arrays import Array
from graspforce.core.whole_file import replace_file
from graspforce.force.solution import Solution
from graspforce.hand.hand import Hand
from graspforce.problems.carry import FINGERS, CarryStep, sinusoidal_carry
from graspforce.service import Client, DistributeRequest, start_server_process

HAND = "four_finger"
SURFACE_FRICTION = 0.6  # friction between fingertip and box
PLANNED_FRICTION = 0.54  # of the force problems: a tenth of the friction stays in reserve


@dataclass(frozen=True, eq=False, slots=True)
class CarryResult:
    """Solutions of all instants.

    Args:
        steps: the instants.
        answers: solutions of the service.
        round_trips: (steps,) times from request to reply, s.
    """

    steps: tuple[CarryStep, ...]
    answers: tuple[Solution, ...]
    round_trips: Array

    @property
    def certified_fraction(self) -> float:
        """Fraction of solutions with a verified certificate."""
        return float(np.mean([a.found and a.certificate is not None and a.certificate.verified for a in self.answers]))

    @property
    def forces(self) -> Array:
        """(steps, fingers, 3) contact forces (f_t1, f_t2, f_n), N."""
        return np.array([np.stack(answer.forces) for answer in self.answers])

    @property
    def slip_margins(self) -> Array:
        """(steps, fingers) slip margins on the surface, μ f_n − ‖f_t‖, N."""
        f = self.forces
        return np.asarray(SURFACE_FRICTION * f[:, :, 2] - np.hypot(f[:, :, 0], f[:, :, 1]))

    @property
    def asymmetry(self) -> float:
        """Largest difference between a force and its mirror image about the middle of the path, N."""
        return float(np.abs(self.forces - self.forces[::-1]).max())


def run(steps: int, picture: Path, console: Console) -> bool:
    """Start a service, carry the box, print the table and write the picture.

    Args:
        steps: number of instants along the path.
        picture: file of the PNG.
        console: where progress and table are printed.

    Returns:
        Whether every solution is certified and no contact slips.

    Raises:
        ServiceError: the service did not start, or a query failed.
    """
    console.print(f"Planning the path: [bold]{HAND}[/] carries a box out and back, {steps} steps.")
    hand = Hand.load(HAND)
    path = sinusoidal_carry(hand, steps=steps, period=0.5, friction=PLANNED_FRICTION)
    with ExitStack() as stack:
        with console.status("Starting the service"):
            address = stack.enter_context(start_server_process(HAND)).address
        console.print(f"The service listens on [bold]{address}[/].")
        carried = carry(path, stack.enter_context(Client(address, timeout=30.0)))
    if carried.certified_fraction < 1.0:
        console.print(f"[bold red]Only {100 * carried.certified_fraction:.2f} % of the answers are certified.[/]")
        return False
    console.print(summary_table(carried, hand))
    plot_forces(carried, picture)
    console.print(f"Contact forces of each finger over time: [bold]{picture}[/]", soft_wrap=True)
    put_result(
        console,
        {
            "requests": len(path),
            "certified_fraction": carried.certified_fraction,
            "least_slip_margin": carried.slip_margins.min(),
            "largest_normal_force": carried.forces[:, :, 2].max(),
            "picture": picture,
        },
    )
    return bool(carried.slip_margins.min() >= 0.0)


def carry(path: tuple[CarryStep, ...], client: Client) -> CarryResult:
    """Request the forces of every instant, one query each."""
    answers, round_trips = [], []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=progress_console()) as progress:
        task = progress.add_task("Carrying", total=len(path))
        for step in path:
            request = DistributeRequest(
                q=step.q,
                contacts=step.problem.contacts.contacts,
                fingers=FINGERS,
                p_HO=step.p_HO,
                R_HO=np.eye(3),
                w=step.problem.w,
                v=step.v,
                a=step.a,
            )
            start = time.perf_counter()
            answers.append(client.distribute(HAND, request))
            round_trips.append(time.perf_counter() - start)
            pressing = max((float(force[2]) for force in answers[-1].forces), default=0.0)
            progress.update(task, advance=1, description=f"Carrying, pressing with {pressing:5.2f} N")
    return CarryResult(path, tuple(answers), np.array(round_trips))


def summary_table(carried: CarryResult, hand: Hand) -> Table:
    """Return the table of results."""
    torques = np.array([answer.torques for answer in carried.answers])  # N·m
    share = np.abs(torques) / hand.torque_upper
    worst = np.unravel_index(int(share.argmax()), share.shape)
    median, tail = np.quantile(carried.round_trips, [0.5, 0.99])
    table = Table("figure", "value", title="A box carried with certified contact forces")
    table.add_row("requests", str(len(carried.steps)))
    table.add_row("round trip, median", f"{1e3 * median:.2f} ms")
    table.add_row("round trip, 99 %", f"{1e3 * tail:.2f} ms")
    table.add_row("solutions certified", f"{100 * carried.certified_fraction:.0f} %")
    table.add_row(
        "smallest slip margin",
        f"{carried.slip_margins.min():.3f} N (friction {SURFACE_FRICTION:g}; problems use {PLANNED_FRICTION:g})",
    )
    table.add_row("largest normal force", f"{carried.forces[:, :, 2].max():.3f} N")
    table.add_row("largest joint torque", f"{np.abs(torques).max():.4f} N·m")
    table.add_row(
        "closest to its limit",
        f"{hand.joints[worst[1]].name}, {100 * share[worst]:.1f} % of {hand.torque_upper[worst[1]]:g} N·m",
    )
    table.add_row("asymmetry about the middle", f"{carried.asymmetry:.1g} N")
    return table


def plot_forces(carried: CarryResult, picture: Path) -> None:
    """Plot normal force, tangential force and available friction over time, one panel for each finger."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt  # after the choice of a backend that needs no display

    times = [step.time for step in carried.steps]
    figure, panels = plt.subplots(2, 2, figsize=(10, 6.5), sharex=True, sharey=True, layout="constrained")
    for i, panel in enumerate(panels.flat):
        f = carried.forces[:, i]
        tangential = np.hypot(f[:, 0], f[:, 1])
        panel.plot(times, f[:, 2], color="#1f4e8c", label="normal force")
        panel.plot(
            times,
            SURFACE_FRICTION * f[:, 2],
            color="#888888",
            linestyle="--",
            label=f"friction available, {SURFACE_FRICTION:g} × normal",
        )
        panel.plot(times, tangential, color="#c0392b", label="tangential force")
        panel.axvline(times[-1] / 2, color="#bbbbbb", linewidth=0.8)
        panel.set_title(FINGERS[i].replace("_", " "), fontsize=10)
        panel.grid(alpha=0.25)
    for panel in panels[:, 0]:
        panel.set_ylabel("force (N)")
    for panel in panels[1]:
        panel.set_xlabel("time (s)")
    panels[0, 0].set_ylim(bottom=0.0)
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle("No finger slips: tangential forces stay below the available friction (grey line: middle of the path)")
    picture.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(picture) as temporary:
        figure.savefig(temporary, dpi=130)
    plt.close(figure)

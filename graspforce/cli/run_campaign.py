"""The command ``graspforce simulate --campaign``: random worlds in several processes, and a table of the failures."""

from __future__ import annotations

import dataclasses
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from graspforce.cli.console import progress_console
from graspforce.cli.controllers import FACTORIES
from graspforce.cli.json_output import put_result
from graspforce.cli.options import GraspOptions
from graspforce.cli.output_files import check_new_file
from graspforce.cli.reference_motion import make_reference
from graspforce.cli.run_world import RunnerOptions
from graspforce.cli.simulate_options import SimulateOptions
from graspforce.cli.world_options import WorldOptions
from graspforce.core import fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import relax_idle_fingers
from graspforce.simulation import Reference, World
from graspforce.simulation.campaigns.campaign import CampaignFile, Trial, group_failures, run_campaign
from graspforce.simulation.campaigns.trial import COMPARISONS, CampaignSetup, Comparison, TrialRecord

_MAX_SEEDS = 12  # shown of a group of failures
_MAX_ERRORS = 5  # texts shown
MAX_WORLDS = 1_000_000


@dataclass(frozen=True, slots=True)
class CampaignOptions:
    """The size of a campaign, and where its results go.

    Args:
        hands: names of the hands, or description files.
        worlds: number of random worlds for each hand.
        workers: number of processes.
        results: file of results, which is continued if it exists; None for none.
        comparison: worlds in which a controller with full knowledge runs too.

    Raises:
        InvalidInput: a value is out of range, or the file cannot be written.
    """

    hands: tuple[str, ...]
    worlds: int
    workers: int = 1
    results: Path | None = None
    comparison: Comparison = "failures"

    def __post_init__(self) -> None:
        fields.check_integer(self.worlds, "--campaign", minimum=1, maximum=MAX_WORLDS)
        fields.check_integer(self.workers, "--workers", minimum=1, maximum=1024)
        check_new_file(self.results, "--results")


def check_comparison(text: str) -> Comparison:
    """Return when the controller with full knowledge runs.

    Args:
        text: "always", "failures" or "never".

    Raises:
        InvalidInput: another word.
    """
    return fields.check_choice(text, "--compare", COMPARISONS)


def run(
    options: SimulateOptions, world_options: WorldOptions, runner: RunnerOptions, campaign: CampaignOptions, console: Console
) -> bool:
    """Run random worlds for each hand, and show what failed.

    Args:
        options: the simulation; its hand is not used.
        world_options: changes of the worlds; the preset is "real" if none is given.
        runner: controller and plant.
        campaign: size, processes and results.
        console: shows progress and results.

    Returns:
        Whether no world failed in which a controller with full knowledge holds, or, without this comparison, no world failed.

    Raises:
        InvalidInput: an option is impossible, no grasp was found, or the results file is of another campaign or
            is being written by another process.
    """
    if runner.controller not in FACTORIES:
        raise InvalidInput("--controller", runner.controller, f"one of {', '.join(FACTORIES)} in a campaign")
    if world_options.preset is None:
        world_options = dataclasses.replace(world_options, preset="real")
    grasps = _find_grasps(options.grasp, campaign.hands, console)
    setup = CampaignSetup(
        grasps=grasps,
        controller=FACTORIES[runner.controller],
        reference=partial(_reference, dataclasses.replace(options, pushes=())),
        duration=options.duration,
        settings=runner.assumptions.settings(options.grasp.gravity_H),
        draw=partial(_draw, world_options, options.pushes),
        plant=runner.plant,
        comparison=campaign.comparison,
    )
    seeds = range(world_options.seed, world_options.seed + campaign.worlds)
    trials = [(label, seed) for seed in seeds for label, _ in grasps]
    conditions = _conditions(options, world_options, runner, campaign)
    with ExitStack() as stack:
        file = None if campaign.results is None else stack.enter_context(CampaignFile(campaign.results, conditions))
        chosen = set(trials)
        records = [] if file is None else [record for record in file.records if (record.grasp, record.seed) in chosen]
        _run_trials(setup, trials, records, file, campaign.workers)
    _show(records, len(trials), console)
    if campaign.results is not None:
        console.print(f"Results: [bold]{campaign.results}[/]", soft_wrap=True)
    failed = [record for record in records if not record.controller.is_held]
    put_result(console, {"worlds": len(trials), "failed": len(failed), "trials": [record.to_dict() for record in records]})
    return not any(record.exact is None or record.exact.is_held for record in failed)


def _run_trials(
    setup: CampaignSetup,
    trials: list[Trial],
    records: list[TrialRecord],
    file: CampaignFile | None,
    workers: int,
) -> None:
    """Run the missing trials with a progress bar, and add them to the records. Ctrl-C ends the campaign early."""
    missing = trials if file is None else file.missing(trials)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=progress_console()) as bar:
        task = bar.add_task("", total=len(trials), completed=len(trials) - len(missing))

        def add(record: TrialRecord) -> None:
            if file is not None:
                file.append(record)
            records.append(record)
            bar.update(task, advance=1, description=_progress_text(records))

        bar.update(task, description=_progress_text(records))
        try:
            run_campaign(setup, missing, workers=workers, on_trial=add)
        except KeyboardInterrupt:
            bar.console.print("Interrupted: the table shows the worlds so far.")


def _progress_text(records: list[TrialRecord]) -> str:
    """Return the number of held and of failed objects."""
    held = sum(record.controller.is_held for record in records)
    return f"held {held}, failed {len(records) - held}"


def _find_grasps(options: GraspOptions, hands: tuple[str, ...], console: Console) -> tuple[tuple[str, Grasp], ...]:
    """Return a grasp of each hand, with its label."""
    found = []
    for name in hands:
        grasp = relax_idle_fingers(dataclasses.replace(options, hand_name=name).search(console))
        found.append((f"{grasp.hand.name} {options.object_name}", grasp))
    return tuple(found)


def _reference(options: SimulateOptions, grasp: Grasp) -> Reference:
    """Return the reference of the options; a function that worker processes can import."""
    return make_reference(options, grasp)


def _draw(options: WorldOptions, pushes: tuple[tuple[float, ...], ...], seed: int, torque_limit: float) -> World:
    """Return the world of a seed; a function that worker processes can import."""
    return options.world(seed, torque_limit, pushes)


def _conditions(
    options: SimulateOptions, world_options: WorldOptions, runner: RunnerOptions, campaign: CampaignOptions
) -> JsonRecord:
    """Return the facts that distinguish a campaign; its size, seeds and hands may change from run to run."""
    grasp, world = options.grasp, dataclasses.asdict(world_options)
    del world["seed"]
    return {
        "object": grasp.object_name,
        "mass": grasp.body.mass,
        "friction": grasp.mu,
        "fingers": grasp.fingers,
        "gravity": grasp.gravity_H.tolist(),
        "grasp_seed": grasp.seed,
        "reference": options.reference,
        "travel": None if options.travel is None else list(options.travel),
        "period": options.period,
        "turn": list(options.turn),
        "turn_period": options.turn_period,
        "duration": options.duration,
        "pushes": [list(push) for push in options.pushes],
        "world": world,
        "controller": runner.controller,
        "assumptions": dataclasses.asdict(runner.assumptions),
        "plant": runner.plant,
        "comparison": campaign.comparison,
    }


def _show(records: list[TrialRecord], total: int, console: Console) -> None:
    """Print the number of held objects for each grasp, the table of the failures and the texts of errors."""
    console.print(held_table(records))
    if len(records) < total:
        console.print(f"[yellow]{total - len(records)} of {total} worlds did not run.[/]")
    if any(not record.controller.is_held for record in records):
        console.print(failure_table(records))
    texts: dict[str, str] = {}
    for record in records:
        for outcome in (record.controller, record.exact):
            if outcome is not None and outcome.message:
                texts.setdefault(outcome.message, f"{record.grasp}, seed {record.seed}")
    for message, place in list(texts.items())[:_MAX_ERRORS]:
        console.print(f"[yellow]{place}: {message}[/]")


def held_table(records: list[TrialRecord]) -> Table:
    """Return the number of worlds, of held objects and of avoidable failures for each grasp.

    Args:
        records: the trials.
    """
    table = Table("grasp", "worlds", "held", "failed", "failed where full knowledge holds", title="Campaign")
    for grasp in sorted({record.grasp for record in records}):
        own = [record for record in records if record.grasp == grasp]
        failed = [record for record in own if not record.controller.is_held]
        exact = [record.exact for record in failed if record.exact is not None]
        avoidable = "–" if failed and not exact else str(sum(outcome.is_held for outcome in exact))
        held = len(own) - len(failed)
        table.add_row(grasp, str(len(own)), f"{held} ({100.0 * held / len(own):.1f} %)", str(len(failed)), avoidable)
    return table


def failure_table(records: list[TrialRecord]) -> Table:
    """Return the failures by grasp, kind and first sign, with the seeds of their worlds.

    Args:
        records: the trials.
    """
    table = Table("grasp", "result", "first sign", "worlds", "full knowledge holds", "seeds", title="Failures")
    for group in group_failures(records):
        seeds = ", ".join(str(seed) for seed in group.seeds[:_MAX_SEEDS]) + (" …" if len(group.seeds) > _MAX_SEEDS else "")
        table.add_row(group.grasp, group.result, group.sign, str(len(group.seeds)), str(len(group.avoidable)), seeds)
    return table

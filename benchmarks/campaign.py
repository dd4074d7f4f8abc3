"""Random worlds for every hand: python -m benchmarks.campaign [--worlds N] [--slice S] [--save FILE].

Each hand holds a ball of 50 g and 30 mm radius in every second world, and a box of 50 g and 50 mm in the others, and moves it
by 5 mm at 1 Hz. A world differs in everything at once from what the controller is told; `World.real` lists the ranges. The
controller has the estimator and plans for 40 % less friction, half or twice the mass, and normals that are 0.1 rad off.

Where it fails, a controller with full knowledge of the same world runs, too. A failure is avoidable if that one holds the
object. A run fails if the object is dropped, if a fingertip slides by more than 1 mm or is without contact for 0.1 s, if the
controller is without certified forces for 0.1 s, or if the object is 5 mm from its place at the end. It ends 0.5 s after a
failure, so that a slip that leads to a drop counts as a drop.

In every second world the fingertips have soft pads, which the controller is not told. Where a finger cannot follow the
object's rotation about the contact normal, the pad spins, and a pad that spins creeps along its tangential force. A table
separates these worlds; with `--hard-pads` the same worlds have no torsional friction.

The results are in a file, one line for each world, which the next call continues, with the same grasps. So a campaign can be
run in slices.

The controller's observer of joint friction was changed afterwards. Of the worlds in the first tables only the 22 in which
`dlr_hit2` and `four_finger` had failed are with an intermediate one, the others from before. With the present controller every
world of seeds 0 to 56 ran again, and every world in which the object was not held (`--failed-in`;
`records/campaign_again.jsonl`). A table compares them. The same world with the same controller gives the same result, to the
bit.

`graspforce simulate --hand HAND --object OBJECT --travel 0.005,0,0 --duration 4 --world real --world-seed SEED` repeats a run.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace
from pathlib import Path

import mujoco
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmarks import report_page
from graspforce.cli.controllers import FACTORIES, REAL_ASSUMPTIONS
from graspforce.cli.options import parse_object
from graspforce.contact.motion import BodyMotion
from graspforce.core.result_file import read_results
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp, relax_idle_fingers
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.simulation import Reference, World, linear_reference
from graspforce.simulation.campaigns.campaign import SCHEMA, CampaignFile, Trial, group_failures, run_campaign
from graspforce.simulation.campaigns.trial import COMPARISONS, CampaignSetup, TrialRecord
from graspforce.simulation.worlds.world_plants import PLANT_NAMES

TITLE = "A campaign of random worlds"
HANDS = ("allegro_right", "allegro_left", "anthropomorphic15", "dlr_hit2", "four_finger")
OBJECTS = {"ball": "sphere:0.03", "box": "box:0.05,0.05,0.05"}
TRAVEL, PERIOD = (0.005, 0.0, 0.0), 1.0  # m, end to end, and s
DURATION = 4.0  # s: pushes end before 2.6 s, and times without images before 4 s
HEAD = ("hand", "object", "worlds", "held", "failed", "of these avoidable")
PAD_HEAD = ("hand", "object", "hard pads: held", "soft pads: held", "soft pads: full knowledge fails too")
AGAIN_HEAD = ("hand", "object", "before", "worlds again", "held", "failed, not dropped", "dropped", "of these avoidable")
FAILURE_HEAD = ("grasp", "result", "first sign", "worlds", "seeds, avoidable", "seeds, full knowledge fails too")


class SliceOver(Exception):
    """The time of this call is used up."""


def main() -> None:
    """Continue the campaign, print its tables, and save the page."""
    parser = report_page.parser("campaign", __doc__)
    parser.add_argument("--worlds", type=int, default=1000, help="number of worlds for each hand (default: 1000)")
    parser.add_argument("--first", type=int, default=0, help="seed of the first world (default: 0)")
    parser.add_argument("--hands", nargs="*", default=HANDS, choices=HANDS, help="hands (default: all)")
    parser.add_argument("--objects", nargs="*", default=list(OBJECTS), choices=OBJECTS, help="objects, in turns (default: all)")
    parser.add_argument("--plant", default="links", choices=PLANT_NAMES, help="plant (default: links)")
    parser.add_argument("--hard-pads", action="store_true", help="no torsional friction of the fingertips in any world")
    parser.add_argument("--results", type=Path, default=Path("out/campaign.jsonl"), help="file of results, which is continued")
    parser.add_argument("--slice", type=float, help="stop after this time, s (default: run to the end)")
    parser.add_argument("--full-knowledge", default="failures", choices=COMPARISONS, help="worlds in which it runs, too")
    parser.add_argument("--failed-in", type=Path, help="run only the worlds that failed in these results")
    parser.add_argument("--again", type=Path, help="results of the same worlds with a later controller: adds a comparison")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="number of processes")
    options = parser.parse_args()
    conditions: dict[str, object] = {"duration": DURATION, "travel": list(TRAVEL), "period": PERIOD, "plant": options.plant}
    if options.hard_pads:
        conditions["hard_pads"] = True
    objects = [OBJECTS[name] for name in options.objects]
    seeds = range(options.first, options.first + options.worlds)
    trials = [(f"{hand} {objects[seed % len(objects)]}", seed) for seed in seeds for hand in options.hands]
    if options.failed_in is not None:
        failed = {trial for trial, record in read_trials(options.failed_in).items() if not record.controller.is_held}
        trials = [trial for trial in trials if trial in failed]
    with CampaignFile(options.results, conditions) as file:
        run_missing(file, trials, options)
    chosen = set(trials)
    records = [record for record in file.records if (record.grasp, record.seed) in chosen]
    report(records, len(trials), options)


def read_trials(path: Path) -> dict[Trial, TrialRecord]:
    """Return the worlds of a file of results.

    Args:
        path: the file.
    """
    records = [TrialRecord.from_dict(each) for each in read_results(path, SCHEMA)[1]]
    return {(record.grasp, record.seed): record for record in records}


def run_missing(file: CampaignFile, trials: list[Trial], options: argparse.Namespace) -> None:
    """Run the trials that are not in the file, with a progress bar, until the end or the end of the slice.

    Args:
        file: the results.
        trials: label of the grasp and seed of the world of each.
        options: of the command line.
    """
    end = float("inf") if options.slice is None else time.monotonic() + options.slice
    missing, folder = file.missing(trials), options.results.with_suffix(".grasps")
    if not missing:
        return
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns) as bar:
        task = bar.add_task("searching grasps", total=len(trials), completed=len(trials) - len(missing))
        setup = CampaignSetup(
            grasps=tuple((label, search_grasp(label, folder)) for label in sorted({label for label, _ in missing})),
            controller=FACTORIES["estimate"],
            reference=reference,
            duration=DURATION,
            settings=REAL_ASSUMPTIONS.settings(GRAVITY_PALM_UP),
            draw=draw_hard if options.hard_pads else World.real,
            plant=options.plant,
            comparison=options.full_knowledge,
        )

        def add(record: TrialRecord) -> None:
            file.append(record)
            failed = sum(not each.controller.is_held for each in file.records)
            bar.update(task, advance=1, description=f"held {len(file.records) - failed}, failed {failed}")
            if time.monotonic() > end:
                raise SliceOver

        try:
            run_campaign(setup, missing, workers=options.workers, on_trial=add)
        except (SliceOver, KeyboardInterrupt):
            bar.console.print("Stopped: the tables show the worlds so far.")


def draw_hard(seed: int, torque_limit: float) -> World:
    """Return the random world of a seed, without torsional friction of the fingertips.

    Args:
        seed: as in `World.real`.
        torque_limit: as in `World.real`, N·m.
    """
    return replace(World.real(seed, torque_limit), pad_torsion=0.0)


def search_grasp(label: str, folder: Path) -> Grasp:
    """Return the grasp of a label, as `graspforce simulate` finds it.

    Args:
        label: name of a hand and object, such as "four_finger sphere:0.03".
        folder: files of the grasps that were found before; a new grasp is added.
    """
    hand, name = label.split()
    path = folder / f"{label.replace(' ', '_').replace(':', '_')}.json"
    if path.exists():
        return Grasp.load(path)
    body, friction = parse_object(name, None, None)
    grasp = relax_idle_fingers(find_grasp(Hand.load(hand), body, friction=friction, gravity_H=GRAVITY_PALM_UP))
    folder.mkdir(parents=True, exist_ok=True)
    grasp.save(path)
    return grasp


def reference(grasp: Grasp) -> Reference:
    """Return the desired motion of a grasp."""
    return linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), TRAVEL, PERIOD)


def report(records: list[TrialRecord], total: int, options: argparse.Namespace) -> None:
    """Print the tables, and write the page.

    Args:
        records: the worlds so far.
        total: number of worlds of the whole campaign.
        options: of the command line.
    """
    if not records:
        print("No world yet.")
        return
    rows, pads, failures = held_rows(records), pad_rows(records), failure_rows(records)
    title = f"{TITLE} with hard pads" if options.hard_pads else TITLE
    report_page.show(title, HEAD, rows)
    report_page.show("Pads", PAD_HEAD, pads)
    report_page.show("Failures", FAILURE_HEAD, failures, width=160)
    state = f"{len(records)} of {total} runs."
    print(state)
    again = [] if options.again is None else again_rows(records, read_trials(options.again))
    if again:
        report_page.show("Again with the present controller", AGAIN_HEAD, again)
    if options.save is not None:
        tables = [state, report_page.table(HEAD, rows, 2), "## Pads", report_page.table(PAD_HEAD, pads, 2)]
        if again:
            tables += ["## Again with the present controller", report_page.table(AGAIN_HEAD, again, 3)]
        if failures:
            tables += ["## Failures", report_page.table(FAILURE_HEAD, failures, 3)]
        report_page.save(options.save, title, __doc__, report_page.facts(f"MuJoCo {mujoco.__version__}"), "\n\n".join(tables))


def held_rows(records: list[TrialRecord]) -> list[tuple[str, ...]]:
    """Return for each grasp, and for all, the number of worlds, of held objects, of failures and of avoidable ones.

    Args:
        records: the worlds.
    """
    rows = []
    for label in [*sorted({record.grasp for record in records}), ""]:
        own = [record for record in records if label in ("", record.grasp)]
        failed = [record for record in own if not record.controller.is_held]
        avoidable = sum(record.exact is not None and record.exact.is_held for record in failed)
        hand, _, name = label.partition(" ")
        share = 100.0 * (1.0 - len(failed) / len(own))
        held = f"{len(own) - len(failed)} ({share:.1f} %)"
        rows.append((hand or "all", object_name(name), str(len(own)), held, str(len(failed)), str(avoidable)))
    return rows


def pad_rows(records: list[TrialRecord]) -> list[tuple[str, ...]]:
    """Return for each grasp how many objects are held in worlds without and with torsional friction of the fingertips.

    Args:
        records: the worlds.
    """
    rows = []
    for label in sorted({record.grasp for record in records}):
        own = [record for record in records if record.grasp == label]
        hard, soft = ([each for each in own if (each.world.pad_torsion > 0.0) == is_soft] for is_soft in (False, True))
        held = (f"{sum(each.controller.is_held for each in part)} of {len(part)}" for part in (hard, soft))
        hopeless = sum(each.exact is not None and not each.exact.is_held for each in soft)
        hand, _, name = label.partition(" ")
        rows.append((hand, object_name(name), *held, str(hopeless)))
    return rows


def again_rows(records: list[TrialRecord], again: dict[Trial, TrialRecord]) -> list[tuple[str, ...]]:
    """Return for each grasp, and for all, what became of the worlds that ran again, by whether the object was held before.

    A drop is avoidable unless a controller with full knowledge fails in the same world, before or again.

    Args:
        records: the worlds before.
        again: the worlds that ran again.
    """
    rows = []
    for label in [*sorted({record.grasp for record in records}), ""]:
        for was_held in (True, False):
            own = [each for each in records if label in ("", each.grasp) and each.controller.is_held == was_held]
            pairs = [(each, again[each.grasp, each.seed]) for each in own if (each.grasp, each.seed) in again]
            now = [each for _, each in pairs]
            held = sum(each.controller.is_held for each in now)
            dropped = [(each.exact or before.exact) for before, each in pairs if each.controller.result == "dropped"]
            avoidable = sum(exact is None or exact.is_held for exact in dropped)
            hand, _, name = label.partition(" ")
            counts = (len(now), held, len(now) - held - len(dropped), len(dropped), avoidable)
            rows.append((hand or "all", object_name(name), "held" if was_held else "failed", *map(str, counts)))
    return rows


def object_name(text: str) -> str:
    """Return the name of an object in `OBJECTS`, or its own text.

    Args:
        text: as `graspforce simulate --object` takes it.
    """
    return next((name for name, each in OBJECTS.items() if each == text), text)


def failure_rows(records: list[TrialRecord]) -> list[tuple[str, ...]]:
    """Return the failures by grasp, result and first sign, with the seeds of their worlds.

    Args:
        records: the worlds.
    """
    rows = []
    for group in group_failures(records):
        others = sorted(set(group.seeds) - set(group.avoidable))
        seeds = (", ".join(map(str, each)) or "–" for each in (group.avoidable, others))
        rows.append((group.grasp, group.result, group.sign, str(len(group.seeds)), *seeds))
    return rows


if __name__ == "__main__":
    main()

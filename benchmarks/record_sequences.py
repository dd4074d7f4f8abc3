"""Write the collection closed-loop: ``python -m benchmarks.record_sequences``, in a checkout (extras ``sim``, ``bench``).

A hand moves an object in MuJoCo at 1 kHz, in an ideal world or in a random world of `World.real`. The force problem of each
control period between 0.2 s and 0.3 s becomes a case. The problem is that of the controller: with its estimates of the motion
and of the contacts, its friction, and the forces of its slip margin moved to the load. Motors of idle fingers are left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from benchmarks.real_world_cases import find_case_grasp, gravity
from benchmarks.write_collections import solve_record
from graspforce import ForceProblem
from graspforce.cli.controllers import REAL_ASSUMPTIONS, make_estimating_controller
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.core.whole_file import write_text
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.records import problem_record, rounded_contact
from graspforce.problems.sequences import format_sequence, step_name
from graspforce.simulation import World, linear_reference, simulate, simulate_measured
from graspforce.simulation.worlds.world_plants import make_world_plant

PATH = Path(__file__).parents[1] / "problems" / "closed-loop" / "sequences.jsonl"
FIRST, STEPS = 200, 101  # periods of 1 ms: the first recorded one, and their number
DIGITS = 8  # of all numbers
TRAVEL = 0.005  # m, end to end


@dataclass(frozen=True, slots=True)
class SequenceRun:
    """A run in closed loop.

    Args:
        name: name of the sequence, without its collection.
        hand: name of a shipped hand.
        grasp_object: "ball" or "box", 50 g.
        axis: axis of H along which the object moves.
        period: of the sinusoidal motion, s.
        seed: seed of the world of `World.real`; None for the ideal world.
    """

    name: str
    hand: str
    grasp_object: str
    axis: int
    period: float
    seed: int | None = None


RUNS = (
    SequenceRun("ideal-01", "allegro_right", "ball", 0, 1.0),
    SequenceRun("ideal-02", "allegro_right", "box", 2, 0.33),
    SequenceRun("ideal-03", "dlr_hit2", "ball", 1, 0.33),
    SequenceRun("ideal-04", "dlr_hit2", "box", 0, 1.0),
    SequenceRun("ideal-05", "four_finger", "ball", 2, 0.2),
    SequenceRun("ideal-06", "four_finger", "box", 1, 1.0),
    SequenceRun("ideal-07", "four_finger", "box", 0, 0.2),
    SequenceRun("real-01", "allegro_right", "ball", 0, 1.0, 1),
    SequenceRun("real-02", "allegro_right", "box", 2, 0.5, 2),
    SequenceRun("real-03", "dlr_hit2", "ball", 1, 1.0, 3),
    SequenceRun("real-04", "dlr_hit2", "box", 0, 0.5, 4),
    SequenceRun("real-05", "four_finger", "ball", 2, 1.0, 5),
    SequenceRun("real-06", "four_finger", "box", 1, 0.5, 6),
    SequenceRun("real-07", "allegro_right", "ball", 2, 0.5, 7),
)


def main() -> None:
    """Run all sequences, solve their problems, and write the file."""
    argparse.ArgumentParser(prog="python -m benchmarks.record_sequences", description=__doc__).parse_args()
    lines = []
    for run in track(RUNS, description="closed-loop"):
        cases = [solve_record(record) for record in records(run)]
        lines.append(format_sequence(f"closed-loop/{run.name}", cases))
    PATH.parent.mkdir(exist_ok=True)
    write_text(PATH, "".join(line + "\n" for line in lines))
    print(f"closed-loop: {len(RUNS)} sequences of {STEPS} cases, {PATH.stat().st_size / 1e6:.2f} MB")


def records(run: SequenceRun, steps: int = STEPS) -> Iterator[Record]:
    """Yield the records of the cases of a run, without answers.

    Args:
        run: the run.
        steps: number of control periods to record.

    Raises:
        RuntimeError: the run ended before.
    """
    found = recorded_problems(run, steps)
    if len(found) < steps:
        raise RuntimeError(f"{run.name}: {len(found)} of {steps} problems, before the run ended")
    world = "an ideal world" if run.seed is None else f"the random world of seed {run.seed}"
    source = f"Control at 1 kHz in {world}: {run.hand} moves a {run.grasp_object} of 50 g by {1e3 * TRAVEL:g} mm along axis "
    source += f"{'xyz'[run.axis]} of H, with a period of {run.period:g} s."
    for i, problem in enumerate(found):
        yield _record(step_name(f"closed-loop/{run.name}", i), source, problem)


def recorded_problems(run: SequenceRun, steps: int) -> list[ForceProblem]:
    """Return the force problems of consecutive control periods of a run.

    Args:
        run: the run.
        steps: number of control periods to record.
    """
    grasp, gravity_H = find_case_grasp(run.hand, run.grasp_object), gravity(run.hand)
    world = World.nominal() if run.seed is None else World.real(run.seed, float(grasp.hand.torque_upper.min()))
    plant = make_world_plant(world, grasp, gravity_H, "links")
    reference = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), TRAVEL * np.eye(3)[run.axis], run.period)
    found: list[ForceProblem] = []
    seen = 0

    def on_step(_: Any, command: Any) -> bool:
        nonlocal seen
        seen += 1
        if seen > FIRST:
            found.append(command.solution.problem)
        return len(found) < steps

    duration = 1e-3 * (FIRST + steps + 1)  # s
    if run.seed is None:
        controller = ObjectController(grasp, ControlSettings(gravity_H=gravity_H))
        simulate(plant, controller, reference, duration, on_step=on_step)
    else:
        measured = make_estimating_controller(grasp, REAL_ASSUMPTIONS.settings(gravity_H, world.sensors.rate), world.sensors)
        simulate_measured(plant, measured, reference, duration, world, on_step=on_step)
    return found


def _record(name: str, source: str, problem: ForceProblem) -> Record:
    """Return the record of a problem, with rounded numbers and without motors that move no contact."""
    record = problem.to_dict()
    contacts = []
    for contact in record["contacts"]:
        more = {key: _rounded(value) for key, value in contact.items() if key not in ("position", "normal", "model")}
        contacts.append(rounded_contact(_rounded(contact["position"]), _rounded(contact["normal"]), **more))
    hand = record["hand"]
    kept = np.flatnonzero(np.abs(np.array(hand["jacobian"])).max(axis=0) > 0.0)
    motors = {key: _rounded(np.array(values)[..., kept].tolist()) for key, values in hand.items()}
    return problem_record(name, source, contacts, _rounded(record["wrench"]), objective=record["objective"], hand=motors)


def _rounded(value: Any) -> Any:
    """Return numbers rounded to `DIGITS` digits; integral values become integers."""
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    if isinstance(value, float):
        near = float(f"{value:.{DIGITS}g}")
        return int(near) if near.is_integer() and abs(near) < 10**DIGITS else near
    return value


if __name__ == "__main__":
    main()

"""How surely and how fast slip is found: python -m benchmarks.slip_detection [--slips N] [--minutes M] [--save FILE].

Allegro, DLR-HIT II and the four-finger hand hold a ball of 50 g and 30 mm radius and a box of 50 mm, and move them by
5 mm at 1 Hz. Friction falls at one finger or at all of them, at once or over up to 0.3 s, or a push acts on the
object or on a finger. A slip counts from 0.5 mm of tangential motion between fingertip and object, beyond rolling,
while they touch. The detectors run beside the controller. They get joint positions with 1 mrad of noise, the
commanded torques with 1 mN·m, and as the row says poses (0.5 mm and 10 mrad at 1 kHz) and fingertip forces (20 mN).
The delay counts from 0.5 mm of slip; alarms before that count as zero. "Motion" is slip found in the motion. With
fingertip forces, "any alarm" is that, an unexpected force, or a force at the friction limit; the latter two also come
with pushes that cause no slip.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
import numpy.typing as npt
from rich.progress import Progress

from benchmarks import report_page
from benchmarks.mujoco_loop import Row
from benchmarks.slip_cases import (
    HANDS,
    KINDS,
    OBJECTS,
    PERIOD,
    Sensing,
    Truth,
    grasp_of,
    gravity_of,
    random_disturbance,
    record,
)
from graspforce.estimation import CameraModel, SensorModel

TITLE = "Detection of slip"
POSE = CameraModel(rate=1.0 / PERIOD, latency=0.0, position_noise=5e-4, angle_noise=0.01)
SENSORS = {
    "fingertip forces, poses": SensorModel(encoder_noise=1e-3, torque_noise=1e-3, tip_force_noise=0.02, camera=POSE),
    "poses": SensorModel(encoder_noise=1e-3, torque_noise=1e-3, camera=POSE),
    "joints only": SensorModel(encoder_noise=1e-3, torque_noise=1e-3),
}
WITH_FORCES = "fingertip forces, poses"
COUNTS, BEGINS = 5e-4, 5e-5  # m: slip that counts, and begin of a slip
Flags = npt.NDArray[np.bool_]

_START = 0.35  # s: the disturbance begins after this time
_NOT_COUNTED = 0.02  # s: a slip after which the run ends sooner is not counted


@dataclass
class Case:
    """One run: when it slipped, and when each detector found it, in periods."""

    kind: str
    begin: int
    counts: int | None
    lost: int
    motion: dict[str, float] = field(default_factory=dict)
    any_alarm: dict[str, float] = field(default_factory=dict)
    right_finger: dict[str, bool] = field(default_factory=dict)
    friction: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    bounded: dict[str, list[bool]] = field(default_factory=dict)
    most: float = 0.0


def main() -> None:
    """Measure and show."""
    parser = report_page.parser("slip_detection", __doc__)
    parser.add_argument("--slips", type=int, default=100, help="true slips to observe (500 take about an hour)")
    parser.add_argument("--minutes", type=float, default=1.0, help="simulated minutes without slip")
    options = parser.parse_args()
    cases: list[Case] = []
    with Progress(transient=True) as progress:
        task = progress.add_task("slips", total=options.slips)
        seed = 0
        while sum(case.counts is not None for case in cases) < options.slips:
            cases.append(run_case(seed))
            seed += 1
            progress.update(task, completed=sum(case.counts is not None for case in cases))
        rows = [*slip_rows(cases), *friction_rows(cases)]
        task = progress.add_task("without slip", total=options.minutes)
        rows += quiet_rows(options.minutes, lambda done: progress.update(task, completed=done))
        rows += cost_rows()
    head = ("what", "bar", "measured", "met")
    cells = [(row.label, row.requirement, row.measured, "yes" if row.is_met else "no") for row in rows]
    report_page.show(TITLE, head, cells, width=150)
    if options.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        report_page.save(options.save, TITLE, __doc__, facts, report_page.table(head, cells, text_columns=4))


def run_case(seed: int) -> Case:
    """Run a random case, and all detectors on it."""
    rng = np.random.default_rng(seed)
    hand, held, kind = HANDS[seed % 3], OBJECTS[seed // 3 % 2], KINDS[seed // 6 % 4]
    grasp, start = grasp_of(hand, held), rng.uniform(_START, _START + 0.3)
    disturbance = random_disturbance(rng, kind, grasp, start)
    truth = record(hand, held, start + 0.5, rng.standard_normal(3), (disturbance,), after_slip=0.1)
    slip, lost = truth.slip, ~truth.rows["touching"].astype(bool)
    counts = first(slip.max(axis=1) > COUNTS)
    if counts is not None and (len(truth) - counts) * PERIOD < _NOT_COUNTED:
        counts = None
    begins: Flags = slip.max(axis=1) > BEGINS
    case = Case(kind, first_or_end(begins), counts, first_or_end(np.asarray(lost.any(axis=1))))
    case.most = float(slip.max())
    for name, sensors in SENSORS.items():
        observe(case, name, truth, Sensing(grasp, gravity_of(hand), sensors, seed), name == WITH_FORCES)
    return case


def observe(case: Case, name: str, truth: Truth, sensing: Sensing, has_forces: bool) -> None:
    """Add what a detector found in a run."""
    case.motion[name] = case.any_alarm[name] = np.inf
    errors: dict[int, tuple[float, float, bool]] = {}
    lost = [first_or_end(~touching) for touching in truth.rows["touching"].astype(bool).T]
    for k in range(len(truth)):
        estimate = sensing.step(truth, k)
        slip, friction = estimate.slip, estimate.friction
        if slip.has_alarm and case.motion[name] == np.inf:
            case.motion[name] = k
            case.right_finger[name] = bool(slip.alarms[truth.slip[k].argmax()])
        has_alarm = slip.has_alarm or (has_forces and (slip.force_alert or bool(slip.at_limit.any())))
        if has_alarm and case.any_alarm[name] == np.inf:
            case.any_alarm[name] = k
        for i in np.flatnonzero(slip.alarms):
            if truth.slip[k, i] > BEGINS and k < lost[i] and np.isfinite(friction.upper[i]):
                mu = truth.rows["mu"][k, i]
                errors[int(i)] = (float(friction.expected[i] - mu), mu, bool(friction.lower[i] <= mu <= friction.upper[i]))
    case.friction[name] = [(error, mu) for error, mu, _ in errors.values()]
    case.bounded[name] = [inside for _, _, inside in errors.values()]


def first(flags: Flags) -> int | None:
    """Return the first true row, if any."""
    return int(np.argmax(flags)) if flags.any() else None


def first_or_end(flags: Flags) -> int:
    """Return the first true row, or the number of rows."""
    return int(np.argmax(flags)) if flags.any() else len(flags)


def slip_rows(cases: Sequence[Case]) -> Iterator[Row]:
    """Say how many slips were found, and when."""
    slips = [case for case in cases if case.counts is not None]
    for name in SENSORS:
        for label, found in alarms(name, slips):
            delay = np.array([found[i] - (case.counts or 0) for i, case in enumerate(slips)])  # periods
            limit = 5 if name == WITH_FORCES else 20
            share = float((delay <= limit).mean())
            measured = f"{100 * np.isfinite(delay).mean():.1f} %; within 5 ms {100 * (delay <= 5).mean():.1f} %, "
            measured += f"10 ms {100 * (delay <= 10).mean():.1f} %, 20 ms {100 * (delay <= 20).mean():.1f} %; "
            onset = np.array([found[i] - case.begin for i, case in enumerate(slips)])
            measured += f"median {np.median(onset):.0f} ms after the first 0.05 mm"
            bar = "–" if name == "joints only" else f"≥ 99 % within {limit} ms"
            yield Row(f"{name}: {label}, {len(slips)} slips", bar, measured, bar == "–" or share >= 0.99)
    early = {name: [case for case in cases if case.motion[name] < min(case.begin, case.lost)] for name in SENSORS}
    for name in SENSORS:
        right = [case.right_finger[name] for case in slips if name in case.right_finger]
        measured = f"{100 * np.mean(right):.0f} % name the finger that slips most"
        measured += f"; {len(early[name])} of {len(cases)} runs with an alarm before any slip or lost contact"
        yield Row(f"{name}: fingers, and alarms of the motion without slip", "–", measured, True)


def alarms(name: str, slips: Sequence[Case]) -> Iterator[tuple[str, list[float]]]:
    """Return the times of the alarms of a row, by kind of alarm."""
    yield "motion", [case.motion[name] for case in slips]
    if name == WITH_FORCES:
        yield "any alarm", [case.any_alarm[name] for case in slips]


def friction_rows(cases: Sequence[Case]) -> Iterator[Row]:
    """Say how well friction is known at the last alarm before a contact opens; other fingers are unbounded above."""
    for name in SENSORS:
        errors, mu = np.array([pair for case in cases for pair in case.friction[name]]).reshape(-1, 2).T
        close = np.abs(errors) <= np.maximum(0.15 * mu, 0.02)
        inside = [each for case in cases for each in case.bounded[name]]
        measured = f"median error {np.median(np.abs(errors)):.3f}, within 15 % or 0.02: {100 * close.mean():.0f} %; "
        measured += f"bounds contain it in {100 * np.mean(inside):.0f} % of {len(errors)} fingers"
        yield Row(f"{name}: friction of fingers that slipped", "bounds hold it", measured, bool(np.mean(inside) > 0.9))


def quiet_rows(minutes: float, progress: Callable[[float], None]) -> Iterator[Row]:
    """Say how often the detectors alarm without slip: one period of true motion, again and again with new noise."""
    for name in (WITH_FORCES, "joints only"):
        alarmed, alerts, steps, values = 0, 0, 0, []
        threshold = 0.0
        for j, hand in enumerate(HANDS):
            truth = record(hand, OBJECTS[j % 2], 2.0, np.array([1.0, 1.0, 1.0]))
            sensing = Sensing(grasp_of(hand, OBJECTS[j % 2]), gravity_of(hand), SENSORS[name], j)
            cycle = round(1.0 / PERIOD)
            for k in range(round(minutes * 20.0 / PERIOD)):
                row = k if k < cycle else cycle + (k - cycle) % cycle
                slip = sensing.step(truth, row).slip
                threshold = slip.threshold
                alarmed += slip.has_alarm
                alerts += slip.force_alert or bool(slip.at_limit.any())
                steps += 1
                if len(slip.statistics) and k > cycle:
                    values.append(float(slip.statistics.max()))
            progress(minutes * (j + 1) / 3)
        largest = np.array(values)
        # P(max > x) per period, from the part of the tail that was seen, and continued as exp(-x/2)
        at = float(np.quantile(largest, 1.0 - 100.0 / len(largest)))
        rate = (largest > at).mean() / PERIOD * np.exp(-(threshold - at) / 2.0)  # 1/s
        measured = f"{alarmed} alarms, {alerts} periods with alerts in {steps * PERIOD / 60:.1f} min; "
        measured += (
            f"largest statistic {largest.max():.1f} of {threshold:.1f}; its tail says one alarm in {1 / rate / 3600:.0f} h"
        )
        yield Row(f"{name}: false alarms", "none in 30 min", measured, alarmed == 0 and alerts == 0 and rate * 1800.0 < 0.05)


def cost_rows() -> Iterator[Row]:
    """Say how long a step of forces, slip, friction and payload takes."""
    truth = record("allegro_right", "ball", 1.2, np.array([1.0, 0.0, 0.0]))
    sensing = Sensing(grasp_of("allegro_right", "ball"), gravity_of("allegro_right"), SENSORS[WITH_FORCES], 0)
    times, inner = [], sensing.monitor.step

    def timed(*args):  # type: ignore[no-untyped-def]
        begin = time.perf_counter()
        result = inner(*args)
        times.append(time.perf_counter() - begin)
        return result

    sensing.monitor.step = timed  # type: ignore[method-assign]
    for k in range(len(truth)):
        sensing.step(truth, k)
    measured = f"{1e6 * np.median(times):.0f} µs median, {1e6 * np.mean(times):.0f} µs mean, three fingers"
    yield Row("one step of forces, slip, friction and payload", "–", measured, True)


if __name__ == "__main__":
    main()

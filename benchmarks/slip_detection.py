"""How surely and how fast slip is found: `python -m benchmarks.slip_detection [--slips N] [--minutes M] [--save FILE]`.

Allegro, DLR-HIT II and the four-finger hand hold a ball of 50 g and 30 mm radius and a box of 50 mm, and move them by 5 mm at
1 Hz. Friction falls at one finger or at all of them, at once or over up to 0.3 s, or a push acts on the object or on a finger.
The detectors run beside the controller. They get joint positions with 1 mrad of noise, joint torques with 1 mN·m, poses with
0.5 mm and 10 mrad at 1 kHz, and in some rows fingertip forces with 20 mN.

A slip counts from 0.5 mm of tangential motion between fingertip and object, beyond rolling, while they touch. The reaction
time is the time from the period in which the true slip reaches 0.5 mm to the period of the first alarm. It is negative if the
alarm comes before. Alarms are those of the motion; an unexpected force lowers their threshold, but is no alarm. Time on the
way from sensors to the estimator is not included. A slip is found if an alarm comes within 60 ms.

Without disturbance, false alarms are counted. "Pushed without slip" are runs with a disturbance in which no slip reached 0.05
mm and no contact opened.

The cases are measured in slices: finished ones are kept in a file, and the next call continues.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
from rich.progress import Progress

from benchmarks import report_page
from benchmarks.case_file import ROOT, CaseFile, Record, Slice
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
}
WITH_FORCES = "fingertip forces, poses"
SENSORS_LIMITS = {WITH_FORCES: 5, "poses": 20}  # ms: required reaction times
RUN, QUIET, SOURCES = "run", "quiet", ("slip_detection.py", "slip_cases.py")
COUNTS, BEGINS = 5e-4, 5e-5  # m: slip that counts, and begin of a slip
Flags = npt.NDArray[np.bool_]

_START = 0.35  # s: the disturbance begins after this time
_FOUND_WITHIN = 0.06  # s after a slip of 0.5 mm
_NOT_COUNTED = 0.02  # s: a slip after which the run ends sooner is not counted


def main() -> None:
    """Measure a slice, and show all finished cases."""
    parser = report_page.parser("slip_detection", __doc__)
    parser.add_argument("--slips", type=int, default=500, help="true slips to observe")
    parser.add_argument("--minutes", type=int, default=30, help="simulated minutes without disturbance")
    parser.add_argument("--seconds", type=float, help="time after which no further case is begun")
    parser.add_argument("--part", default="0/1", metavar="K/N", help="measure only part K of N, beside other processes")
    parser.add_argument("--cases", type=Path, default=ROOT / "out" / "slip_detection.jsonl", help="file of finished cases")
    options = parser.parse_args()
    file, part = CaseFile(options.cases, SOURCES), Slice(options.part, options.seconds)
    with Progress(transient=True) as progress:
        task = progress.add_task("minutes without slip", total=options.minutes)
        for minute in range(options.minutes):
            done = {each["minute"] for each in file.records() if each["case"] == QUIET}
            progress.update(task, completed=len(done))
            if minute not in done and part.holds(minute) and not part.is_over:
                file.add(quiet_case(minute))
        task, seed = progress.add_task("slips", total=options.slips), 0
        while not part.is_over:
            runs = [each for each in file.records() if each["case"] == RUN]
            slips = sum(each["counts"] is not None for each in runs)
            progress.update(task, completed=slips)
            if slips >= options.slips:
                break
            if part.holds(seed) and seed not in {each["seed"] for each in runs}:
                file.add(run_case(seed))
            seed += 1
    records = file.records()
    runs, quiet = ([each for each in records if each["case"] == case] for case in (RUN, QUIET))
    rows = [*slip_rows(runs), *friction_rows(runs), *quiet_rows(quiet)]
    head = ("quantity", "required", "measured", "met")
    met = ["" if row.requirement == "–" else "yes" if row.is_met else "no" for row in rows]
    cells = [(row.label, row.requirement, row.measured, text) for row, text in zip(rows, met, strict=True)]
    report_page.show(TITLE, head, cells, width=150)
    if options.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        report_page.save(options.save, TITLE, __doc__, facts, report_page.table(head, cells, text_columns=4))


def run_case(seed: int) -> Record:
    """Return the record of a random run: its true slip, and the alarms of each detector.

    Detectors observe the runs with a slip that counts, and every fourth of the others.
    """
    rng = np.random.default_rng(seed)
    hand, held, kind = HANDS[seed % 3], OBJECTS[seed // 3 % 2], KINDS[seed // 6 % 4]
    grasp, start = grasp_of(hand, held), rng.uniform(_START, _START + 0.3)
    disturbance = random_disturbance(rng, kind, grasp, start)
    truth = record(hand, held, start + 0.5, rng.standard_normal(3), (disturbance,), after_slip=0.1)
    slip = truth.slip
    counts = first(slip.max(axis=1) > COUNTS)
    if counts is not None and (len(truth) - counts) * PERIOD < _NOT_COUNTED:
        counts = None
    is_calm = bool(slip.max() < BEGINS and truth.rows["touching"].all())
    case: Record = {"case": RUN, "seed": seed, "kind": kind, "counts": counts, "calm": is_calm, "alarms": {}}
    if counts is not None or seed % 4 == 0:
        end = len(truth) if counts is None else min(len(truth), counts + round(_FOUND_WITHIN / PERIOD))
        for name, sensors in SENSORS.items():
            case["alarms"][name] = observe(truth, end, Sensing(grasp, gravity_of(hand), sensors, seed))
    return case


def observe(truth: Truth, end: int, sensing: Sensing) -> Record:
    """Return the first alarm of a detector, whether it names the finger that slips most, and the friction at alarms."""
    found: Record = {"first": None, "right": None, "friction": []}
    errors: dict[int, list[float]] = {}
    lost = [first_or_end(~touching) for touching in truth.rows["touching"].astype(bool).T]
    for k in range(end):
        estimate = sensing.step(truth, k)
        slip, friction = estimate.slip, estimate.friction
        if not slip.has_alarm:
            continue
        if found["first"] is None:
            found["first"], found["right"] = k, bool(slip.alarms[truth.slip[k].argmax()])
        for i in np.flatnonzero(slip.alarms).tolist():
            if truth.slip[k, i] > BEGINS and k < lost[i]:
                mu = float(truth.rows["mu"][k, i])
                upper = float(friction.upper[i])
                errors[i] = [mu, float(friction.expected[i]), float(friction.lower[i]), upper if np.isfinite(upper) else -1.0]
    found["friction"] = list(errors.values())
    return found


def first(flags: Flags) -> int | None:
    """Return the first true row, if any."""
    return int(np.argmax(flags)) if flags.any() else None


def first_or_end(flags: Flags) -> int:
    """Return the first true row, or the number of rows."""
    return int(np.argmax(flags)) if flags.any() else len(flags)


def slip_rows(runs: Sequence[Record]) -> Iterator[Row]:
    """Return the rows about slips: how many were found, how fast, and alarms without slip."""
    slips = [each for each in runs if each["counts"] is not None]
    calm = [each for each in runs if each["calm"] and each["alarms"]]
    for name, limit in SENSORS_LIMITS.items():
        alarms = [each["alarms"][name] for each in slips]
        delay = np.array(
            [
                np.inf if alarm["first"] is None else alarm["first"] - each["counts"]
                for alarm, each in zip(alarms, slips, strict=True)
            ]
        )  # periods
        known = delay[np.isfinite(delay)]
        found, share = (count / max(len(slips), 1) for count in (len(known), np.count_nonzero(delay <= limit)))
        measured = [_percentage(count, len(slips), 1) for count in (len(known), np.count_nonzero(delay <= limit))]
        if len(known):
            measured[1] += f"; median {np.median(delay):.0f} ms, 99 % {np.quantile(known, 0.99):.0f} ms"
            measured[1] += f", largest {known.max():.0f} ms"
        yield Row(f"{name}: {len(slips)} slips found", "≥ 99 %", measured[0], found >= 0.99)
        yield Row(f"{name}: reaction within {limit} ms", "≥ 99 %", measured[1], share >= 0.99)
        right = [alarm["right"] for alarm in alarms if alarm["right"] is not None]
        yield Row(f"{name}: alarms that name the finger that slips most", "–", _percentage(sum(right), len(right), 0), True)
        false = sum(each["alarms"][name]["first"] is not None for each in calm)
        yield Row(f"{name}: alarms in runs pushed without slip", "–", f"{false} of {len(calm)}", True)


def _percentage(count: int, of: int, digits: int) -> str:
    """Return a share in percent; "none yet" of no cases."""
    return f"{100 * count / of:.{digits}f} %" if of else "none yet"


def friction_rows(runs: Sequence[Record]) -> Iterator[Row]:
    """Return the rows about friction at the last alarm of each finger before its contact opens."""
    for name in SENSORS:
        pairs = [pair for each in runs if each["alarms"] for pair in each["alarms"][name]["friction"]]
        mu, expected, lower, upper = np.array(pairs).reshape(-1, 4).T
        known = upper >= 0.0
        close = np.abs(expected - mu) <= np.maximum(0.15 * mu, 0.02)
        holds = (lower <= mu) & (mu <= upper)
        measured = f"{np.sum(~known)} of {len(mu)} unbounded above"
        if known.any():
            within, inside = (100.0 * np.mean(each[known]) for each in (close, holds))  # %
            measured += f"; of the others {within:.0f} % within 15 % or 0.02, "
            measured += f"median error {np.median(np.abs(expected - mu)[known]):.3f}, bounds hold {inside:.0f} %"
        is_met = not known.any() or bool(np.mean(close[known] | holds[known]) > 0.9)
        yield Row(f"{name}: friction of fingers that slipped", "within 15 %, or unbounded", measured, is_met)


def quiet_case(minute: int) -> Record:
    """Return the record of a minute without disturbance: one period of true motion, again and again with new noise."""
    hand, held = HANDS[minute % 3], OBJECTS[minute // 3 % 2]
    truth = record(hand, held, 2.0, np.random.default_rng(minute).standard_normal(3))
    sensing, cycle = Sensing(grasp_of(hand, held), gravity_of(hand), SENSORS[WITH_FORCES], minute), round(1.0 / PERIOD)
    case: Record = {"case": QUIET, "minute": minute, "alarms": 0, "alerts": 0, "largest": 0.0, "threshold": 0.0}
    for k in range(round(60.0 / PERIOD)):
        slip = sensing.step(truth, k if k < cycle else cycle + (k - cycle) % cycle).slip
        case["alarms"] += int(slip.has_alarm)
        case["alerts"] += int(slip.force_alert)
        case["threshold"] = slip.threshold
        case["largest"] = max(case["largest"], float(slip.statistics.max(initial=0.0)))
    return case


def quiet_rows(quiet: Sequence[Record]) -> Iterator[Row]:
    """Return the row about false alarms without disturbance."""
    alarms, alerts = (sum(each[name] for each in quiet) for name in ("alarms", "alerts"))
    largest, threshold = (max((each[name] for each in quiet), default=0.0) for name in ("largest", "threshold"))
    measured = (
        f"{alarms} alarms and {alerts} periods with unexpected forces; largest statistic {largest:.1f} of {threshold:.1f}"
    )
    label = f"false alarms without disturbance in {len(quiet)} min"
    yield Row(label, "none in 30 min", measured, alarms == 0 and len(quiet) >= 30)


if __name__ == "__main__":
    main()

"""How surely and how fast slip is found: `python -m benchmarks.slip_detection [--slips N] [--minutes M] [--save FILE]`.

Allegro, DLR-HIT II and the four-finger hand hold a ball of 50 g and 30 mm radius and a box of 50 mm, and move them by 5 mm at
1 Hz. Directions are random, among those whose motion is free of collisions until its far end. Friction falls at one finger or
at all of them, at once or over up to 0.3 s, or a push acts on the object or on a finger. The detectors run beside the
controller. They get joint positions with 1 mrad of noise, joint torques with 1 mN·m, poses with 0.5 mm and 10 mrad at 1 kHz,
and in some rows fingertip forces with 20 mN.

A slip counts from 0.5 mm of tangential motion between fingertip and object, beyond rolling, while they touch. A slip is found
if an alarm comes within 60 ms. Alarms are those of the motion; an unexpected force lowers their threshold, but is no alarm.

The reaction time is the time from the period in which the true slip reaches 0.5 mm to the first period in which the estimator
asks for a squeeze: by an alarm, or by a precaution. It is negative if that comes before. Precautions need fingertip forces.
They show that forces or motion differ from the commanded ones, and raise the normal forces by 15 % for a short time. One
counts as a reaction if it is asked for at most 50 ms before, while its squeeze acts. The reaction of alarms alone is shown,
too. Time on the way from sensors to the estimator is not included.

Without disturbance, false alarms and precautions are counted. "Pushed without slip" are runs with a disturbance in which no
slip reached 0.05 mm and no contact opened; a push changes forces and motion, so that a precaution is right there.

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
    free_direction,
    grasp_of,
    gravity_of,
    random_disturbance,
    record,
)
from graspforce.control.contacts.slip_reflex import PRECAUTION_TIME
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
    truth = record(hand, held, start + 0.5, free_direction(rng, hand, held), (disturbance,), after_slip=0.1)
    slip = truth.slip
    counts = first(slip.max(axis=1) > COUNTS)
    if counts is not None and (len(truth) - counts) * PERIOD < _NOT_COUNTED:
        counts = None
    is_calm = bool(slip.max() < BEGINS and truth.rows["touching"].all())
    case: Record = {"case": RUN, "seed": seed, "kind": kind, "counts": counts, "calm": is_calm, "alarms": {}}
    if counts is not None or seed % 4 == 0:
        end = len(truth) if counts is None else min(len(truth), counts + round(_FOUND_WITHIN / PERIOD))
        rows = round(start / PERIOD), counts, end
        for name, sensors in SENSORS.items():
            case["alarms"][name] = observe(truth, rows, Sensing(grasp, gravity_of(hand), sensors, seed))
    return case


def observe(truth: Truth, rows: tuple[int, int | None, int], sensing: Sensing) -> Record:
    """Return the first alarm and reaction of a detector, whether it names the finger that slips most, and friction at alarms.

    Args:
        truth: the run.
        rows: periods of the disturbance, of a slip of 0.5 mm, if any, and after the last one to observe.
        sensing: the detector.
    """
    start, counts, end = rows
    found: Record = {"first": None, "reaction": None, "early": 0, "precautions": 0, "right": None, "friction": []}
    since = 0 if counts is None else counts - round(PRECAUTION_TIME / PERIOD)
    errors: dict[int, list[float]] = {}
    lost = [first_or_end(~touching) for touching in truth.rows["touching"].astype(bool).T]
    for k in range(end):
        estimate = sensing.step(truth, k)
        slip, friction = estimate.slip, estimate.friction
        found["precautions"] += int(estimate.is_precaution_due)
        found["early"] += int(estimate.is_precaution_due and k < start)
        if found["reaction"] is None and (slip.has_alarm or (estimate.is_precaution_due and k >= since)):
            found["reaction"] = k
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
    """Return the rows about slips: how many were found, how fast, and alarms and precautions without slip."""
    slips = [each for each in runs if each["counts"] is not None]
    calm = [each for each in runs if each["calm"] and each["alarms"]]
    for name, limit in SENSORS_LIMITS.items():
        alarms = [each["alarms"][name] for each in slips]
        found = [each for each in alarms if each["first"] is not None]
        share = _percentage(len(found), len(slips), 1)
        yield Row(f"{name}: {len(slips)} slips found", "≥ 99 %", share, 0 < 0.99 * len(slips) <= len(found))
        yield _reaction_row(f"{name}: reaction within {limit} ms", "≥ 99 %", slips, (name, "reaction"))
        if name == WITH_FORCES:
            yield _reaction_row(f"{name}: alarm alone within {limit} ms", "–", slips, (name, "first"))
        right = [alarm["right"] for alarm in alarms if alarm["right"] is not None]
        yield Row(f"{name}: alarms that name the finger that slips most", "–", _percentage(sum(right), len(right), 0), True)
        false = sum(each["alarms"][name]["first"] is not None for each in calm)
        yield Row(f"{name}: alarms in runs pushed without slip", "–", f"{false} of {len(calm)}", True)
    calm = [each for each in calm if each["kind"].startswith("push")]
    asked = sum(each["alarms"][WITH_FORCES]["precautions"] > 0 for each in calm)
    yield Row(f"{WITH_FORCES}: precautions in pushes without slip", "–", f"{asked} of {len(calm)}", True)
    observed = [each["alarms"][WITH_FORCES]["early"] for each in runs if each["alarms"]]
    early = sum(each > 0 for each in observed)
    yield Row(f"{WITH_FORCES}: precautions before the disturbance", "none", f"{early} of {len(observed)} runs", early == 0)


def _reaction_row(label: str, requirement: str, slips: Sequence[Record], event: tuple[str, str]) -> Row:
    """Return the row of the reaction times of a detector, from its name and the name of the event."""
    name, kind = event
    firsts = [(each["alarms"][name][kind], each["counts"]) for each in slips]
    delay = np.array([np.inf if first is None else first - counts for first, counts in firsts])  # periods
    known, fast = delay[np.isfinite(delay)], int(np.count_nonzero(delay <= SENSORS_LIMITS[name]))
    measured = _percentage(fast, len(slips), 1)
    if len(known):
        measured += f"; median {np.median(delay):.0f} ms, 99 % {np.quantile(known, 0.99):.0f} ms, largest {known.max():.0f} ms"
    return Row(label, requirement, measured, 0 < 0.99 * len(slips) <= fast)


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
    truth = record(hand, held, 2.0, free_direction(np.random.default_rng(minute), hand, held))
    sensing, cycle = Sensing(grasp_of(hand, held), gravity_of(hand), SENSORS[WITH_FORCES], minute), round(1.0 / PERIOD)
    case: Record = {"case": QUIET, "minute": minute, "alarms": 0, "alerts": 0, "precautions": 0, "largest": 0.0}
    for k in range(round(60.0 / PERIOD)):
        estimate = sensing.step(truth, k if k < cycle else cycle + (k - cycle) % cycle)
        slip = estimate.slip
        case["precautions"] += int(estimate.is_precaution_due)
        case["alarms"] += int(slip.has_alarm)
        case["alerts"] += int(slip.force_alert)
        case["threshold"] = slip.threshold
        case["largest"] = max(case["largest"], float(slip.statistics.max(initial=0.0)))
    return case


def quiet_rows(quiet: Sequence[Record]) -> Iterator[Row]:
    """Return the rows about false alarms and precautions without disturbance."""
    alarms, alerts, precautions = (sum(each[name] for each in quiet) for name in ("alarms", "alerts", "precautions"))
    largest, threshold = (max((each[name] for each in quiet), default=0.0) for name in ("largest", "threshold"))
    is_complete, text = len(quiet) >= 30, f"without disturbance in {len(quiet)} min"
    measured = f"{alarms} alarms; largest statistic {largest:.1f} of {threshold:.1f}"
    yield Row(f"false alarms {text}", "none in 30 min", measured, alarms == 0 and is_complete)
    measured = f"{precautions} periods with a precaution, {alerts} with unexpected forces"
    yield Row(f"false precautions {text}", "none in 30 min", measured, precautions == 0 and is_complete)


if __name__ == "__main__":
    main()

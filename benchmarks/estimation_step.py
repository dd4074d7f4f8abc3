"""Time of a control step with estimation, relative to the nominal step: `python -m benchmarks.estimation_step [--save FILE]`.

The nominal step, `ObjectControlLaw.step`, gets joint positions, joint rates, and pose and twist of the object. The step with
estimation, `OutputFeedbackLaw.step`, gets joint positions with encoder noise, and camera poses in some rows. Grasps, motion and
settings are those of `control_step`: 8 mm peak to peak at 1 Hz, 1 kHz. The camera sends 30 poses a second, 50 ms late. In some
rows, the estimate is predicted over a latency of 2 ms. In rows with a monitor, joint torques and fingertip forces are measured
too: those of the last command, with noise. The monitor estimates contact forces, slip, friction and payload from them.

In each round both steps run in turn, so that a drift of the machine's speed affects them equally. The times are processor time
of the thread, without interruptions by other programs. Measurements are made before. The ratio is the median of the ratio in
the same round, and the quotient of the 99th percentiles. The median is required to be at most 2.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.control_grasps import GRASP_NAMES, named_grasp

import graspforce
from benchmarks import report_page
from benchmarks.control_step import PERIOD, states
from benchmarks.timing import pin
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.output_feedback_law import OutputFeedbackLaw, OutputFeedbackStep
from graspforce.core.compiled import native
from graspforce.estimation import CameraModel, Measurement, PoseMeasurement, SensorModel
from graspforce.grasp.grasp import Grasp

TITLE, REQUIRED_RATIO = "Time of a control step with estimation", 2.0
GRASPS = ("allegro_right sphere", "four_finger cylinder", "four_finger box", "four_finger superquadric", "dlr_hit2 sphere")
HEADINGS = ("grasp", "sensors", "nominal µs", "99 % µs", "with estimation µs", "99 % µs", "ratio", "99 %")
CAMERA = CameraModel()
SENSORS = {
    "encoders": SensorModel(),
    "encoders, camera": SensorModel(camera=CAMERA),
    "the same, 2 ms late": SensorModel(camera=CAMERA, latency=2e-3),
    "the same, monitor": SensorModel(encoder_noise=1e-5, torque_noise=1e-3, tip_force_noise=0.02, camera=CAMERA, latency=2e-3),
}


def measurements(samples: Sequence[tuple[GraspState, BodyMotion]], camera: CameraModel | None) -> list[Measurement]:
    """Return the measurements of states: joint positions, and late camera poses with noise if there is a camera."""
    rng, result, sent = np.random.default_rng(1), [], 0
    late = 0 if camera is None else round(camera.latency / PERIOD)
    for k, (state, _) in enumerate(samples):
        pose = None
        if camera is not None and k >= late and (k - late) * PERIOD * camera.rate >= sent:
            sent += 1
            seen = samples[k - late][0].object
            p = seen.p_HO + camera.position_noise * rng.normal(size=3)
            pose = PoseMeasurement((k - late) * PERIOD, p, seen.R_HO)
        result.append(Measurement(k * PERIOD, state.q, object=pose))
    return result


def with_forces(
    measurement: Measurement, last: OutputFeedbackStep, sensors: SensorModel, rng: np.random.Generator
) -> Measurement:
    """Return a measurement with the joint torques and the fingertip forces of the last command, and noise."""
    assert sensors.torque_noise is not None
    assert sensors.tip_force_noise is not None
    command = last.command
    f = command.contacts.pad(command.f)[:, :3]  # N
    f_H = np.einsum("ij,njk,nk->ni", last.estimate.object.R_HO, command.contacts.R_OC, f)
    tip_wrench = np.zeros((len(f), 6))
    tip_wrench[:, :3] = f_H + sensors.tip_force_noise * rng.normal(size=f_H.shape)
    tau = command.tau + sensors.torque_noise * rng.normal(size=len(command.tau))
    return replace(measurement, tau=tau, tip_wrench=tip_wrench)


def measure(grasp: Grasp, sensors: SensorModel, rounds: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the times of the nominal step and of the step with estimation, s, and the number of certified solutions."""
    settings, samples = ControlSettings(period=PERIOD), states(grasp, rounds)
    nominal, law = ObjectControlLaw(grasp, settings), OutputFeedbackLaw(grasp, settings, sensors)
    nominal_memory, memory = nominal.initial_memory(), law.initial_memory()
    seconds, certified, step, rng = np.empty((rounds, 2)), 0, None, np.random.default_rng(2)
    for k, measurement in enumerate(measurements(samples, sensors.camera)):
        state, desired = samples[k]
        if step is not None and sensors.has_force_sensors:
            measurement = with_forces(measurement, step, sensors, rng)
        start = time.thread_time()
        _, nominal_memory = nominal.step(nominal_memory, state, desired)
        between = time.thread_time()
        step = law.step(memory, measurement, desired)
        end = time.thread_time()
        seconds[k] = between - start, end - between
        memory, certified = step.memory, certified + step.command.solution.found
    kept = seconds[rounds // 10 :]
    return kept[:, 0], kept[:, 1], certified


def row(name: str, sensors: str, nominal: np.ndarray, estimated: np.ndarray) -> tuple[str, ...]:
    """Return the cells of a grasp: medians and 99 % in µs, and of the ratio."""
    cells = [f"{1e6 * value:.1f}" for seconds in (nominal, estimated) for value in np.quantile(seconds, [0.5, 0.99])]
    quotient = np.quantile(estimated, 0.99) / np.quantile(nominal, 0.99)
    return (name, sensors, *cells, f"{np.median(estimated / nominal):.2f}", f"{quotient:.2f}")


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("estimation_step", __doc__)
    parser.add_argument("--rounds", type=int, default=3000, help="control steps; the first tenth is not timed")
    parser.add_argument(
        "--grasp", action="append", choices=GRASP_NAMES, metavar="NAME", help="a grasp of the control tests; repeatable"
    )
    options = parser.parse_args()
    pin(None)
    rows, certified, steps = [], 0, 0
    medians: dict[bool, list[float]] = {False: [], True: []}  # by whether a monitor runs
    for name in options.grasp or GRASPS:
        for described, sensors in SENSORS.items():
            nominal, estimated, found = measure(named_grasp(name), sensors, options.rounds)
            rows.append(row(name, described, nominal, estimated))
            medians[sensors.has_force_sensors].append(float(np.median(estimated / nominal)))
            certified, steps = certified + found, steps + options.rounds
    report_page.show(TITLE, HEADINGS, rows, width=120)
    sentences = [
        f"Largest median ratio {described}: {max(ratios):.2f}, "
        f"{'met' if max(ratios) <= REQUIRED_RATIO else 'missed'}, required at most {REQUIRED_RATIO:g}."
        for described, ratios in (("without monitor", medians[False]), ("with monitor", medians[True]))
        if ratios
    ]
    compiled = "Compiled" if native is not None else "Not compiled"
    summary = f"{' '.join(sentences)} {certified} of {steps} solutions certified. {compiled}."
    print(summary)
    if options.save:
        facts = report_page.facts(f"graspforce {graspforce.__version__}")
        facts = f"{summary} {facts} {os.cpu_count()} cores, one used; load average {os.getloadavg()[0]:.1f}."
        report_page.save(options.save, TITLE, __doc__, facts, report_page.table(HEADINGS, rows, text_columns=2))


if __name__ == "__main__":
    main()

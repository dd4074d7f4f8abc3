"""Mass, centre of mass and external wrench of a held object: `python -m benchmarks.payload_estimation [--save FILE]`.

Allegro, DLR-HIT II and the four-finger hand hold a ball of 30 mm radius and a box of 50 mm, and move them by 5 mm at 1 Hz.
They count on 50 g; the true mass is 0.5 to 2 times as much, and the true centre of mass is up to 5 mm away. The estimators run
beside the controller. They get joint positions with 1 mrad of noise, and as the row says fingertip forces (20 mN), measured
joint torques (1 mN·m), or the commanded torques only. Drives are ideal: they make the commanded torque.

After 1 s, mass and centre of mass are compared with the truth. The centre is compared across gravity: along gravity, it does
not show before the object turns. At 1.05 s, a force of 0.5 N pushes the object for 0.2 s. In the last 0.1 s, the external
force is compared with it, as a mean. Each row has the largest errors of its runs, and the mean of the standard deviations that
the estimator stated.

NEES is the squared error of mass and first moment, weighted with the inverse covariance and divided by four. Its mean is 1 if
the covariance equals the errors, and less if the covariance is an upper bound. The estimator counts on a constant external
force of 10 mN that nobody knows, and there is none here; so the NEES is small. In the rows "no unknown force", it does not
count on one. From torques, it counts on errors of the joint accelerations that are independent between periods, which is
cautious too.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from rich.progress import Progress

from benchmarks import report_page
from benchmarks.slip_cases import HANDS, OBJECTS, PERIOD, Sensing, Truth, body_of, grasp_of, gravity_of, record
from graspforce.core.arrays import Array
from graspforce.estimation import SensorModel
from graspforce.estimation.grasp_monitor import GraspMonitorSettings
from graspforce.estimation.payload import PayloadEstimate, PayloadSettings
from graspforce.grasp.body import Body
from graspforce.simulation import Push

TITLE = "Estimation of the payload"
TIPS = SensorModel(encoder_noise=1e-3, torque_noise=1e-3, tip_force_noise=0.02)
SENSORS = {
    "fingertip forces": TIPS,
    "joint torques": SensorModel(encoder_noise=1e-3, torque_noise=1e-3),
    "commanded torques": SensorModel(encoder_noise=1e-3),
    "fingertip forces, no unknown force": TIPS,
}
NO_UNKNOWN_FORCE = GraspMonitorSettings(payload=PayloadSettings(external_force=1e-4))  # N
SETTINGS = {"fingertip forces, no unknown force": NO_UNKNOWN_FORCE}
MASS_RATIOS = (0.5, 0.7, 1.0, 1.4, 2.0)
HEADINGS = ("grasp", "sensors", "mass %", "stated %", "centre mm", "stated mm", "NEES", "force mN", "stated mN")
ALLOWED_MASS_ERROR, MEASURED_AT = 0.03, 1.0  # s
_PUSH, _PUSH_START, _PUSH_TIME, _PUSH_MEAN = 0.5, 1.05, 0.2, 0.1  # N, s, s and s
_CENTRE_SIZE = 0.003  # m: standard deviation of each coordinate of the true centre of mass, at most 5 mm


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of one run, with the standard deviations that the estimator stated.

    Attributes:
        mass, mass_deviation: relative to the true mass.
        centre, centre_deviation: of the centre of mass across gravity, m.
        nees: of mass and first moment.
        force, force_deviation: of the external force during a push, N.
    """

    mass: float
    mass_deviation: float
    centre: float
    centre_deviation: float
    nees: float
    force: float
    force_deviation: float


def true_body(held: str, ratio: float, rng: np.random.Generator) -> Body:
    """Return the body with another mass, and another centre of mass."""
    body = body_of(held)
    offset = _CENTRE_SIZE * rng.standard_normal(3)  # m
    offset *= min(1.0, 0.005 / np.linalg.norm(offset))
    return Body(ratio * body.mass, ratio * body.inertia, body.p_OM + offset, body.shape)


def payload_errors(estimate: PayloadEstimate, body: Body, up_O: Array) -> tuple[float, ...]:
    """Return the errors of mass and centre with their stated deviations, and NEES."""
    error = np.append(estimate.mass - body.mass, estimate.mass * estimate.p_OM - body.mass * body.p_OM)
    across = np.linalg.svd(up_O[None])[2][1:]  # (2, 3): two directions across gravity
    centre = across @ (estimate.p_OM - body.p_OM)
    spread = across @ estimate.centre_covariance @ across.T
    nees = float(error @ np.linalg.solve(estimate.covariance, error)) / 4.0
    mass, deviation = error[0] / body.mass, estimate.mass_deviation / body.mass
    return mass, deviation, float(np.linalg.norm(centre)), float(np.sqrt(np.trace(spread))), nees


def observe(truth: Truth, body: Body, push_H: Array, name: str, seed: int) -> Errors:
    """Return the errors of the estimator behind the named sensors in a run."""
    gravity_H = gravity_of(truth.hand)
    sensing = Sensing(grasp_of(truth.hand, truth.held), gravity_H, SENSORS[name], seed, SETTINGS.get(name))
    found: tuple[float, ...] = ()
    forces, deviation = [], 0.0
    for k in range(len(truth)):
        payload = sensing.step(truth, k).payload
        R_HO = truth.rows["R_HO"][k]
        if k == round(MEASURED_AT / PERIOD):
            found = payload_errors(payload, body, -R_HO.T @ gravity_H / np.linalg.norm(gravity_H))
        if k * PERIOD > _PUSH_START + _PUSH_TIME - _PUSH_MEAN:
            forces.append(R_HO @ payload.external[:3])
            deviation = float(np.sqrt(np.trace(payload.external_covariance[:3, :3])))
    force = float(np.linalg.norm(np.mean(forces, axis=0) - push_H))
    return Errors(*found, force, deviation)


def run(hand: str, held: str, ratio: float, seed: int) -> dict[str, Errors]:
    """Return the errors of one run by sensors."""
    rng = np.random.default_rng(seed)
    body, direction, push_H = true_body(held, ratio, rng), rng.standard_normal(3), rng.standard_normal(3)
    push_H *= _PUSH / np.linalg.norm(push_H)
    push = Push(push_H, _PUSH_START, _PUSH_TIME, point=body.p_OM)
    truth = record(hand, held, _PUSH_START + _PUSH_TIME, direction, (push,), body=body)
    return {name: observe(truth, body, push_H, name, seed) for name in SENSORS}


def row(grasp: str, sensors: str, errors: list[Errors]) -> tuple[str, ...]:
    """Return the cells of several runs: largest errors, mean stated deviations, and the mean NEES."""
    values = {name: np.array([getattr(each, name) for each in errors]) for name in Errors.__slots__}
    numbers = (
        100.0 * np.abs(values["mass"]).max(), 100.0 * values["mass_deviation"].mean(),
        1e3 * values["centre"].max(), 1e3 * values["centre_deviation"].mean(), values["nees"].mean(),
        1e3 * values["force"].max(), 1e3 * values["force_deviation"].mean(),
    )  # fmt: skip
    return (grasp, sensors, *(f"{number:.2f}" for number in numbers[:5]), *(f"{number:.0f}" for number in numbers[5:]))


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("payload_estimation", __doc__)
    parser.add_argument("--runs", type=int, default=5, help="runs of each grasp, with a mass ratio each")
    options = parser.parse_args()
    rows, everything = [], {name: list[Errors]() for name in SENSORS}
    with Progress(transient=True) as progress:
        task = progress.add_task("runs", total=len(HANDS) * len(OBJECTS) * options.runs)
        for g, (hand, held) in enumerate((hand, held) for hand in HANDS for held in OBJECTS):
            results = []
            for i in range(options.runs):
                results.append(run(hand, held, MASS_RATIOS[i % len(MASS_RATIOS)], 100 * g + i))
                progress.update(task, advance=1)
            for name in SENSORS:
                rows.append(row(f"{hand} {held}", name, [each[name] for each in results]))
                everything[name] += [each[name] for each in results]
    report_page.show(TITLE, HEADINGS, rows, width=120)
    summary = " ".join(sentence(name, errors) for name, errors in everything.items())
    print(summary)
    if options.save:
        facts = f"{summary} {report_page.facts(f'MuJoCo {mujoco.__version__}')}"
        report_page.save(options.save, TITLE, __doc__, facts, report_page.table(HEADINGS, rows, text_columns=2))


def sentence(name: str, errors: list[Errors]) -> str:
    """Return the summary of all runs of one kind of sensors."""
    mass = np.abs([each.mass for each in errors])
    nees = np.mean([each.nees for each in errors])
    within = float((mass <= ALLOWED_MASS_ERROR).mean())
    return (
        f"{name.capitalize()}: mass within 3 % after 1 s in {100 * within:.0f} % of {len(errors)} runs "
        f"({'met' if within == 1.0 else 'missed'}), mean NEES {nees:.2f}."
    )


if __name__ == "__main__":
    main()

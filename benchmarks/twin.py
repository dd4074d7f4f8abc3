"""Drift of simulated hands: `python -m benchmarks.twin [--hands NAME …] [--save FILE]`.

Each hand holds a ball of 50 g and moves it on a circle of 6 mm, with noise of encoders and pose, at 500 Hz in a plant without
MuJoCo's engine. A healthy plant runs for ten minutes; the twin must not report it. A plant whose motors make 20 % less torque
than commanded runs for 12 s; the twin must report it within 10 s. The simulated time per time shows that a twin of a recording
is faster than the hand.
"""

from __future__ import annotations

import os
import time
from typing import NamedTuple

import numpy as np

from benchmarks import report_page
from benchmarks.control_stream import allegro_grasp
from graspforce import Hand, find_grasp
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.estimation.motor_share import HeldState
from graspforce.estimation.twin import Twin, TwinReading
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.plants.urdf_plant import UrdfPlant

HANDS = ("allegro_right", "leap_right", "four_finger")
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s²
DT = 2e-3  # s
RADIUS, RATE = 3e-3, 0.5  # m, Hz: of the circle
ENCODER, POSITION, ROTATION = 1e-4, 2e-5, 2e-4  # rad, m, rad: standard deviations of the noise
RATES = np.array([1e-3] * 3 + [1e-2] * 3)  # m/s, rad/s: of the object's twist
JOINT_RATE = 5e-3  # rad/s
HEALTHY, WEAK = 600.0, 12.0  # s
GAINS = {1.0: HEALTHY, 0.8: WEAK}


class Run(NamedTuple):
    """A run of one hand.

    Attributes:
        gain: torque of the motors per commanded torque.
        first: first reading with a drift; None without.
        last: last reading.
        extremes: smallest and largest share of all readings.
        speed: simulated time per time of the twin alone.
    """

    gain: float
    first: TwinReading | None
    last: TwinReading
    extremes: tuple[float, float]
    speed: float


def circle(grasp: Grasp, t: float) -> BodyMotion:
    """Return the desired motion."""
    w = 2.0 * np.pi * RATE
    c, s = np.cos(w * t), np.sin(w * t)
    p = grasp.p_HO + RADIUS * np.array([c - 1.0, s, 0.0])
    twist, acceleration = w * np.array([-s, c, 0, 0, 0, 0]), -w * w * np.array([c, s, 0, 0, 0, 0])
    return BodyMotion(p, grasp.R_HO, RADIUS * twist, RADIUS * acceleration)


def measured(state: GraspState, rng: np.random.Generator) -> GraspState:
    """Return a state with noise."""
    n, now = len(state.q), state.object
    turn = BodyMotion(np.zeros(3), np.eye(3), np.concatenate([np.zeros(3), ROTATION * rng.standard_normal(3)]))
    axis = turn.twist[3:]
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    U, _, V = np.linalg.svd((np.eye(3) + skew) @ now.R_HO)
    motion = BodyMotion(now.p_HO + POSITION * rng.standard_normal(3), U @ V, now.twist + RATES * rng.standard_normal(6))
    q, v = state.q + ENCODER * rng.standard_normal(n), state.v + JOINT_RATE * rng.standard_normal(n)
    return GraspState(q, v, motion)


def run(grasp: Grasp, gain: float, duration: float) -> Run:
    """Simulate a hand, and return what its twin reads."""
    plant = UrdfPlant(grasp, PlantOptions(gravity_H=GRAVITY, torque_gain=gain, dt=DT))
    controller = ObjectController(grasp, ControlSettings(gravity_H=GRAVITY, period=DT))
    twin, rng, seconds = Twin(grasp, GRAVITY), np.random.default_rng(1), 0.0
    readings: list[TwinReading] = []
    state = plant.reset()
    for k in range(round(duration / DT)):
        seen = measured(state, rng)
        command = controller.step(seen, circle(grasp, k * DT))
        began = time.perf_counter()
        reading = twin.add(HeldState(k * DT, seen.q, seen.v, seen.object, command.tau, command.contacts))
        seconds += time.perf_counter() - began
        if reading is not None:
            readings.append(reading)
        state = plant.step(command.tau)
    shares = [each.share for each in readings]
    first = next((each for each in readings if each.drifts), None)
    return Run(gain, first, readings[-1], (min(shares), max(shares)), duration / seconds)


def row(hand: str, each: Run) -> tuple[str, ...]:
    """Return the row of a run."""
    reported = "never" if each.first is None else f"after {each.first.t:.1f} s"
    low, high = each.extremes
    numbers = f"{low:.3f} to {high:.3f}", f"{2.0 * each.last.share_error:.3f}", f"{each.last.residual:.2f}"
    text = "" if each.first is None else "; ".join(each.first.drifts)
    creep = f"{1e3 * each.last.creep.max():.2f}"
    return hand, f"{each.gain:g}", f"{GAINS[each.gain]:g}", reported, *numbers, creep, f"{each.speed:.0f}", text


def main() -> None:
    """Simulate, print the table and write the page."""
    parser = report_page.parser("twin", __doc__)
    parser.add_argument("--hands", nargs="+", default=list(HANDS), help="hands to simulate")
    parser.add_argument("--healthy", type=float, default=HEALTHY, help="duration of the healthy runs, s")
    options = parser.parse_args()
    GAINS[1.0] = options.healthy
    rows = []
    for name in options.hands:
        ball = Body.solid(Sphere(0.03), 0.05)
        grasp = allegro_grasp() if name == "allegro_right" else find_grasp(Hand.load(name), ball, friction=0.7)
        rows += [row(name, run(grasp, gain, duration)) for gain, duration in GAINS.items()]
    head = (
        "hand",
        "motor share",
        "time s",
        "reported",
        "share",
        "± 2 σ",
        "residual",
        "creep mm/min",
        "× real time",
        "sentence",
    )
    report_page.show("Drift of simulated hands", head, rows, width=200)
    if options.save is not None:
        facts = report_page.facts(f"{os.cpu_count()} cores, one used", f"load average {os.getloadavg()[0]:.1f}")
        report_page.save(options.save, "Drift of simulated hands", __doc__, facts, report_page.table(head, rows))


if __name__ == "__main__":
    main()

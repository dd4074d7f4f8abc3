"""Parts of `benchmarks.every_hand` on heat: copper loss against an equal squeeze, and ten minutes at the thermal limit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks import report_page
from benchmarks.every_hand_drives import FRICTION, OBJECTS, gravity
from graspforce import ForceProblem, Hand, solve
from graspforce.contact import friction
from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.control.heat_protection import HeatProtectedController
from graspforce.core.arrays import Array
from graspforce.estimation import Measurement
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp, relax_idle_fingers
from graspforce.hand.descriptions.drive_description import ThermalDescription
from graspforce.hand.drives.drive import Drive, Drives
from graspforce.hand.heat import ThermalModel
from graspforce.simulation import PlantOptions, UrdfPlant
from graspforce.simulation.plants.driven_plant import DrivenPlant

MASS = 0.1  # kg
MARGIN = 0.5  # N
SQUEEZES = np.linspace(0.0, 40.0, 4001)  # N, tried for the equal squeeze
HOLD_HANDS = ("allegro_right", "dlr_hit2", "four_finger")
HOLD_TIME, HOLD_PERIOD = 600.0, 0.01  # s
OVERLOAD = 1.3  # torque of the most loaded motor, of the one that it can hold forever
THERMAL = ThermalDescription(
    winding_resistance=8.0, winding_time_constant=6.0, housing_resistance=30.0, housing_time_constant=400.0,
    largest_temperature=100.0, source="assumed: a brushed motor of 16 mm",
)  # fmt: skip
DRIVE = Drive("current", torque_constant=0.8, resistance=5.0, thermal=THERMAL)


def sections(results: dict[tuple[Any, ...], dict[str, Any]]) -> list[str]:
    """Return the sections of the page on heat.

    Args:
        results: of all tasks.
    """
    parts = []
    squeezes = {task: result for task, result in results.items() if task[0] == "squeeze" and "saving" in result}
    if squeezes:
        text = (
            "Forces of the least copper loss against an equal squeeze: each finger presses towards the contacts' centroid "
            "with the same force, corrected to the object's weight by the forces of least norm, with the smallest squeeze "
            f"that keeps a slip margin of {MARGIN:g} N. Objects of {1e3 * MASS:.0f} g, motors with the same constants. "
            "Grasps that no equal squeeze up to 40 N holds with this margin count apart."
        )
        head = ("hand", "grasps", "less heat, median", "least", "most", "not held by an equal squeeze")
        parts += ["## Heat", text, report_page.table(head, squeeze_rows(squeezes))]
    holds = [(task[1], result) for task, result in results.items() if task[0] == "limit" and "hottest" in result]
    if holds:
        text = (
            "Ten minutes at the thermal limit: the wanted slip margin loads the hottest motor with 1.3 times the torque that "
            "it can hold forever. The motors' true thermal resistances and time constants differ by up to 10 % from those of "
            "the estimate. Plant: the hand's URDF, with current drives; control at 100 Hz."
        )
        head = ("hand", "result", "hottest winding, °C", "limit, °C", "estimate less truth, K", "slip margin, N, start to end")
        parts += [text, report_page.table(head, [hold_row(*each) for each in holds], 2)]
    return parts


def squeeze_rows(results: dict[tuple[Any, ...], dict[str, Any]]) -> list[tuple[str, ...]]:
    """Return the rows of the comparison with an equal squeeze, by hand and over all grasps.

    Args:
        results: by task.
    """
    by_hand: dict[str, list[float | None]] = {}
    for task, result in results.items():
        by_hand.setdefault(task[1], []).append(result["saving"])
    by_hand["all"] = [saving for values in by_hand.values() for saving in values]
    return [(name, *_statistics(values)) for name, values in by_hand.items()]


def compare_grasp(name: str, object_name: str, seed: int) -> dict[str, Any]:
    """Return the saving of a grasp against an equal squeeze; None if no equal squeeze holds the object.

    Args:
        name: name of the hand.
        object_name: one of `OBJECTS`.
        seed: of the search.
    """
    body = Body.solid(OBJECTS[object_name], MASS)
    grasp = find_grasp(Hand.load(name), body, friction=FRICTION, gravity_H=gravity(name), seed=seed)
    return {"saving": heat_saving(grasp, gravity(name))}


def heat_saving(grasp: Grasp, gravity_H: Array) -> float | None:
    """Return the part of an equal squeeze's heat that the optimal forces save; None if no equal squeeze holds the object.

    Args:
        grasp: the grasp.
        gravity_H: (3,) acceleration of gravity in H, m/s².
    """
    hand = grasp.hand.with_drives(DRIVE).with_torque_weight("copper_loss")
    problem = replace(grasp, hand=hand).force_problem(gravity_H)
    contacts, actuation = problem.contacts, problem.actuation
    squeeze = equal_squeeze(problem)
    if squeeze is None:
        return None
    shift = MARGIN / contacts.mu  # N
    offset = np.zeros(contacts.size)
    offset[contacts.normal_rows] = shift
    shifted = replace(contacts, min_normal=np.maximum(contacts.min_normal - shift, 0.0), max_normal=contacts.max_normal - shift)
    G = grasp_matrix(contacts)
    solution = solve(
        ForceProblem(shifted, problem.w - G @ offset, actuation.replace(tau_u=actuation.tau_u + actuation.J.T @ offset))
    )
    if not solution.found:
        return None
    heats = [heat(actuation.tau_u + actuation.J.T @ f, actuation.weight) for f in (solution.f + offset, squeeze)]
    return 1.0 - heats[0] / heats[1]


def heat(tau: Array, weight: Array) -> float:
    """Return the copper loss of torques, W.

    Args:
        tau: (n,) torques, N·m.
        weight: (n,) copper loss per squared torque, W/(N·m)².
    """
    return float(tau @ (weight * tau))


def equal_squeeze(problem: ForceProblem) -> Array | None:
    """Return the forces of the smallest equal squeeze with the slip margin, (k,), N; None if there is none.

    Args:
        problem: contacts and wrench.
    """
    contacts, G = problem.contacts, grasp_matrix(problem.contacts)
    inverse = np.linalg.pinv(G)
    towards = contacts.p_OC.mean(axis=0) - contacts.p_OC
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    pressure = np.zeros((len(contacts), 4))
    pressure[:, :3] = np.einsum("nji,nj->ni", contacts.R_OC, towards)
    direction = pressure.ravel()[contacts.columns]
    internal = direction - inverse @ (G @ direction)
    base = inverse @ problem.w
    for level in SQUEEZES:
        f = base + level * internal
        padded = contacts.pad(f)
        if (friction.slip_margin(padded, contacts.mu, contacts.gamma) >= MARGIN).all() and (padded[:, 2] > 0.0).all():
            return np.asarray(f)
    return None


def hold_at_limit(name: str) -> dict[str, Any]:
    """Return the measured values of ten minutes at the thermal limit.

    Args:
        name: name of the hand.
    """
    gravity_H, rng = gravity(name), np.random.default_rng(7)
    grasp = relax_idle_fingers(
        find_grasp(Hand.load(name), Body.solid(OBJECTS["box"], MASS), friction=FRICTION, gravity_H=gravity_H)
    )
    grasp = replace(grasp, hand=grasp.hand.with_drives(scaled_drives(grasp, gravity_H)))
    margin = 2.0  # N, with which `scaled_drives` loads the motors
    settings = ControlSettings(gravity_H=gravity_H, slip_margin=margin, period=HOLD_PERIOD)
    controller = HeatProtectedController(grasp, settings)
    plant = DrivenPlant(UrdfPlant(grasp, PlantOptions(gravity_H=gravity_H)), grasp.hand.drives)
    truth = ThermalModel(true_drives(grasp.hand.drives, rng))
    temperatures, rest = truth.at_rest(), BodyMotion(grasp.p_HO, grasp.R_HO)
    state = plant.reset()
    steps = round(HOLD_PERIOD / plant.dt)
    hottest, worst, margins, distance = 0.0, 0.0, [], 0.0
    for k in range(round(HOLD_TIME / HOLD_PERIOD)):
        command = controller.step(Measurement(k * HOLD_PERIOD, state.q), rest)
        squares = np.zeros(grasp.hand.n)
        for _ in range(steps):
            state = plant.step_drives(command.drive)
            squares += plant.current**2
        temperatures = truth.step(temperatures, np.sqrt(squares / steps), HOLD_PERIOD)
        hottest = max(hottest, float(temperatures.winding.max()))
        worst = max(worst, float(np.abs(controller.temperatures.winding - temperatures.winding).max()))
        margins.append(float(command.slip_margin.min()))
        distance = max(distance, float(np.linalg.norm(state.object.p_HO - grasp.p_HO)))
        if distance > 0.02:
            break
    return {
        "hottest": hottest,
        "limit": float(truth.largest.min()),
        "worst": worst,
        "margins": [margins[10], margins[-1]],
        "distance": distance,
    }


def hold_row(name: str, result: dict[str, Any]) -> tuple[str, ...]:
    """Return the row of ten minutes at the thermal limit.

    Args:
        name: name of the hand.
        result: its measured values.
    """
    distance, margins = result["distance"], result["margins"]
    text = f"held, {1e3 * distance:.2f} mm" if distance < 0.001 else f"moved by {1e3 * distance:.1f} mm"
    hottest, limit, worst = f"{result['hottest']:.1f}", f"{result['limit']:.0f}", f"{result['worst']:.1f}"
    return name, text, hottest, limit, worst, f"{margins[0]:.2f} to {margins[1]:.2f}"


def scaled_drives(grasp: Grasp, gravity_H: Array) -> Drive:
    """Return a drive whose motors are too weak to hold the grasp with a margin of 2 N forever, by the factor `OVERLOAD`.

    Args:
        grasp: the grasp.
        gravity_H: (3,) acceleration of gravity in H, m/s².
    """
    hot = replace(grasp, hand=grasp.hand.with_drives(DRIVE).with_torque_weight("copper_loss"))
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    settings = ControlSettings(gravity_H=gravity_H, slip_margin=2.0)
    tau = ObjectController(hot, settings).step(GraspState(grasp.q, np.zeros(grasp.hand.n), rest), rest).tau
    forever = ThermalModel(hot.hand.drives).continuous_torques()
    return replace(DRIVE, torque_constant=DRIVE.torque_constant * float((np.abs(tau) / forever).max()) / OVERLOAD)


def true_drives(drives: Drives, rng: np.random.Generator) -> Drives:
    """Return drives whose thermal data differ by up to 10 %.

    Args:
        drives: drives that the controller knows.
        rng: source of the differences.
    """
    names = ("winding_resistance", "winding_time_constant", "housing_resistance", "housing_time_constant")
    joints = []
    for drive in drives.joints:
        factors = {name: getattr(THERMAL, name) * (1.0 + 0.1 * rng.uniform(-1.0, 1.0)) for name in names}
        joints.append(replace(drive, thermal=ThermalDescription(**factors, largest_temperature=100.0, source=THERMAL.source)))
    return Drives(tuple(joints))


def _statistics(savings: list[float | None]) -> tuple[str, ...]:
    """Return the number of savings, their median, least and largest in percent, and the number of grasps without one."""
    values = [saving for saving in savings if saving is not None]
    figures = (f"{100 * value:.0f} %" for value in (np.median(values), min(values), max(values))) if values else ("–",) * 3
    return str(len(values)), *figures, str(len(savings) - len(values))
